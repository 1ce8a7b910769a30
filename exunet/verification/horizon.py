"""Rung 7: until when a trajectory can be predicted at all, and what can be said after that."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.studies.both_codes import Pair
from exunet.verification.check import Check, Finding, Plate, Text, left_out
from exunet.verification.ensemble import AMPLITUDE, REFERENCE, Ensemble, ensemble, our_code
from exunet.verification.figures import bands, curves
from exunet.verification.growth import LONE, ROUND_OFF, SEEDS, VISIBLE, Growth
from exunet.verification.tolerances import PROPORTIONAL, RAN, SAME_STATISTICS

Floats = NDArray[np.float64]

SMALL = 1e-8  # [m]: differences below are in proportion to their start, see PROPORTIONAL
MEANS = ("area", "energy", "speed")  # of an `Ensemble`
FURTHER = 1e-10  # [m]: the amplitude that is compared with `LONE`


def sensitivity(pair: Pair, grown: Growth) -> Iterator[Finding]:
    """Rate of growth and horizon of a case, and that small differences grow in proportion.

    A difference that is no number fails; nothing is said of such a growth then.
    """
    horizon = grown.horizon
    wrong = np.argwhere(~np.isfinite(grown.difference))
    if len(wrong):
        row, at = wrong[0]
        words = f"first: start moved by {grown.amplitudes[row]:.0e} m, t = {grown.time[at]:.4g} s"
        yield Check(7, pair.name, "differences of the growth that are no numbers", len(wrong), RAN, words)
        return
    if len(grown.amplitudes) > 2:
        yield _in_proportion(pair, grown)
    words = ", ".join(
        f"{rate:.3g}/s from {a:.0e} m"
        for rate, a in zip(grown.rates, grown.amplitudes, strict=True)
        if math.isfinite(rate)
    )
    yield Check(7, pair.name, "mean rate of growth [1/s]", grown.rate, None, words or "nothing grew")
    if math.isfinite(horizon):
        name = f"horizon [s]: starts {ROUND_OFF:.0e} m apart are {VISIBLE:.0e} m apart"
        words = f"measured, the earliest of {len(SEEDS)} starts, to {grown.time[1]:.2g} s"
        yield Check(7, pair.name, name, horizon, None, words)
    else:
        name = f"no horizon before t = {grown.time[-1]:.3g} s: largest difference [m]"
        cut = grown.time[-1] < 0.999 * pair.start.scene.time.end
        words = "followed no further" if cut else "differences stay small for the whole run"
        yield Check(7, pair.name, name, float(grown.of(ROUND_OFF).max()), None, words)
    lines = {f"start moved by {a:.0e} m": d for a, d in zip(grown.amplitudes, grown.difference, strict=True)}
    title = f"{pair.name}: distance from the unperturbed motion"
    marks = {f"horizon, t = {horizon:.3g} s": horizon}
    figure = curves(title, "largest difference of a position [m]", grown.time, lines, marks)
    caption = (
        f"{pair.name}: growth of perturbations of the start. The vertical line is where starts 1e-16 m "
        "apart, the round-off of one operation, have become 1e-3 m apart."
    )
    yield Plate(7, f"growth_{pair.name}", figure, caption)


def _in_proportion(pair: Pair, grown: Growth) -> Check:
    """While all differences are small, one that started 100 times larger is 100 times larger."""
    if "material_damping" in pair.effects:
        why = "the viscous stress jumps where a thread becomes taut: any start parts there by step x jump"
        return left_out(7, pair.name, "growth in proportion", why)
    smaller, larger = (grown.of(a) for a in (LONE, FURTHER))
    small = larger < SMALL
    small[int(np.argmin(small)) if not small.all() else len(small) :] = False
    if not small.any():
        why = f"differences are above {SMALL:.0e} m from the start"
        return left_out(7, pair.name, "growth in proportion", why)
    if not (smaller[small] > 0.0).all() or not (larger[small] > 0.0).all():
        return left_out(7, pair.name, "growth in proportion", "a difference is zero: no free node was moved")
    ratio = np.abs(np.log10(larger[small] / (FURTHER / LONE * smaller[small])))
    at = int(np.argmax(ratio))
    places = (
        f"{apart[at]:.3e} m (node {grown.nodes[list(grown.amplitudes).index(a), at]})"
        for apart, a in ((smaller, LONE), (larger, FURTHER))
    )
    words = f"t = {grown.time[at]:.4g} s: " + " and ".join(places)
    name = f"growth in proportion until t = {grown.time[small][-1]:.3g} s, decades off"
    return Check(7, pair.name, name, float(ratio[at]), PROPORTIONAL, words)


def after_it(pair: Pair, grown: Growth, both: bool) -> Iterator[Finding]:
    """Mean and spread of perturbed runs; with `both`, those of the two codes are compared.

    A value that is no number fails; nothing is said of such runs then.
    """
    ours, parted = ensemble(pair, our_code()), grown.reaches(AMPLITUDE)
    if wrong := _no_numbers(pair, ours):
        yield from wrong
        return
    yield _band(pair, ours, parted)
    yield _words(pair, ours)
    if both and parted < ours.time[-1]:
        theirs = ensemble(pair, REFERENCE)
        yield from _no_numbers(pair, theirs) or (_same_mean(pair, name, ours, theirs) for name in MEANS)


def _same_mean(pair: Pair, name: str, ours: Ensemble, theirs: Ensemble) -> Check:
    """Difference of the means in standard errors, where the runs have parted.

    Before that, it is the integrators' errors that differ, not the draws: rungs 4 and 5 compare those.
    """
    a, b = getattr(ours, name), getattr(theirs, name)
    largest = float(np.abs(a).max()) or 1.0  # a net without a mouth has no area
    # One spread for both, as it is if they agree: a small sample may miss a tail and look too narrow.
    spread = np.concatenate([a, b]).std(axis=0, ddof=1)
    error = spread * np.sqrt(1.0 / len(a) + 1.0 / len(b))
    parted = error > 1e-4 * largest
    if not parted.any():
        gap = float(np.abs(a.mean(axis=0) - b.mean(axis=0)).max() / largest)
        words = "the runs do not part: difference of the means relative to the largest value"
        return Check(7, pair.name, f"mean {name} of both codes", gap, None, words)
    # Neighbouring times are not independent: ten of them stand for all.
    shown = np.flatnonzero(parted)[:: max(1, int(parted.sum()) // 10)]
    gap = np.abs(a.mean(axis=0) - b.mean(axis=0))[shown] / error[shown]
    at = shown[int(np.argmax(gap))]
    words = (
        f"t = {ours.time[at]:.4g} s: {a[:, at].mean():.5g} and {b[:, at].mean():.5g}, "
        f"standard error of their difference {error[at]:.2g}"
    )
    title = f"mean {name}, {len(a)} runs ({ours.code}), {len(b)} ({theirs.code})"
    return Check(7, pair.name, title, float(gap.max()), SAME_STATISTICS, words)


def _no_numbers(pair: Pair, found: Ensemble) -> list[Check]:
    """A check that fails for each quantity of which a run has a value that is no number."""
    checks = []
    for name in MEANS:
        wrong = np.argwhere(~np.isfinite(getattr(found, name)))
        if len(wrong):
            title = f"values of the {name} that are no numbers ({found.code})"
            run, at = wrong[0]
            words = f"first: run {run}, t = {found.time[at]:.4g} s"
            checks.append(Check(7, pair.name, title, len(wrong), RAN, words))
    return checks


def _band(pair: Pair, found: Ensemble, parted: float) -> Plate:
    panels = {
        "area / reference": (found.area, "Mouth area"),
        "energy / start": (found.energy, "Kinetic and elastic energy"),
        "speed [m/s]": (found.speed, "Mean speed of the bullets"),
    }
    figure = bands(
        f"{pair.name}: {len(found.area)} runs ({found.code}), starts moved by {AMPLITUDE:.0e} m",
        found.time,
        panels,
        (f"{AMPLITUDE:.0e} m has become {VISIBLE:.0e} m", parted),
    )
    return Plate(
        7,
        f"ensemble_{pair.name}",
        figure,
        f"{pair.name}: what {len(found.area)} perturbed runs have in common. Dashed: where a start "
        f"moved by {AMPLITUDE:.0e} m is {VISIBLE:.0e} m from the unmoved one.",
    )


def _words(pair: Pair, found: Ensemble) -> Text:
    rows = ["| t [s] | area / reference | energy / start | mean bullet speed [m/s] |", "|---|---|---|---|"]
    for at in np.linspace(0, len(found.time) - 1, 9).round().astype(int)[1:]:
        cells = [
            f"{values[:, at].mean():.4f} ± {values[:, at].std(ddof=1):.1e}"
            for values in (found.area, found.energy, found.speed)
        ]
        rows.append(f"| {found.time[at]:.3g} | " + " | ".join(cells) + " |")
    runs = f"{len(found.area)} runs ({found.code})"
    head = f"What stays predictable in `{pair.name}`: mean ± standard deviation over {runs}."
    return Text(7, head + "\n\n" + "\n".join(rows))
