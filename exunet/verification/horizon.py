"""Rung 7: until when a trajectory can be predicted at all, and what can be said after that."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from exunet.base.markdown import markdown_table
from exunet.studies.both_codes import BothCodes
from exunet.studies.perturbation import MOVE, PAPER_SIZE
from exunet.verification.check import Check, Evidence, Plate, Text, left_out
from exunet.verification.figures import bands, curves
from exunet.verification.growth import AMPLITUDE, FURTHER, ROUND_OFF, SEEDS, VISIBLE, Growth
from exunet.verification.statistics import REFERENCE, Statistics, our_code, statistics
from exunet.verification.tolerances import PROPORTIONAL, RAN, SAME_STATISTICS

SMALL = 1e-8 / PAPER_SIZE  # of the size: differences below are in proportion to their start, see PROPORTIONAL
# Quantities of `Statistics`: label with unit, name.
MEANS = {
    "area": ("area / achievable", "Mouth area"),
    "energy": ("energy / start", "Kinetic and elastic energy"),
    "speed": ("bullet speed [m/s]", "Mean speed of the bullets"),
}


def sensitivity(case: BothCodes, grown: Growth) -> Iterator[Evidence]:
    """Rate of growth and horizon of a case, and that small differences grow in proportion.

    A difference that is NaN or infinite fails, and ends the comparison.
    """
    horizon, size = grown.horizon, case.size
    wrong = np.argwhere(~np.isfinite(grown.difference))
    if len(wrong):
        row, at = wrong[0]
        words = f"first: start moved by {grown.amplitudes[row] * size:.0e} m, t = {grown.time[at]:.4g} s"
        yield Check("differences of the growth that are NaN or infinite", len(wrong), RAN, words)
        return
    if len(grown.amplitudes) > 2:
        yield _in_proportion(case, grown)
    words = ", ".join(
        f"{rate:.3g}/s from {a * size:.0e} m"
        for rate, a in zip(grown.rates, grown.amplitudes, strict=True)
        if math.isfinite(rate)
    )
    yield Check("mean rate of growth [1/s]", grown.rate, None, words or "nothing grew")
    apart = f"starts {ROUND_OFF * size:.0e} m apart"
    if math.isfinite(horizon):
        words = f"measured, the earliest of {len(SEEDS)} starts, to {grown.time[1]:.2g} s"
        yield Check(f"horizon [s]: {apart} are {VISIBLE * size:.0e} m apart", horizon, None, words)
    else:
        name = f"no horizon before t = {grown.time[-1]:.3g} s: largest difference [m]"
        cut = grown.time[-1] < 0.999 * case.start.scene.time.end
        words = "followed no further" if cut else "differences stay small for the whole run"
        yield Check(name, size * float(grown.of(ROUND_OFF).max()), None, words)
    moved = [f"start moved by {a * size:.0e} m" for a in grown.amplitudes]
    lines = dict(zip(moved, size * grown.difference, strict=True))
    title = f"{case.name}: distance from the unperturbed motion"
    figure = curves(title, grown.time, lines, grown.named_horizon)
    caption = (
        f"{case.name}: growth of perturbations of the start. The vertical line is where {apart}, about the "
        f"round-off of one operation, have become {VISIBLE * size:.0e} m apart."
    )
    yield Plate(f"growth_{case.name}", figure, caption)


def _in_proportion(case: BothCodes, grown: Growth) -> Check:
    """While all differences are small, one that started 100 times larger is 100 times larger."""
    if "material_damping" in case.effects:
        why = "the viscous stress jumps where a thread becomes taut: there any runs separate by step x jump"
        return left_out("growth in proportion", why)
    smaller, larger = (grown.of(a) for a in (MOVE, FURTHER))
    small = np.logical_and.accumulate(larger < SMALL)
    if not small.any():
        why = f"differences are above {SMALL * case.size:.0e} m from the start"
        return left_out("growth in proportion", why)
    if not (smaller[small] > 0.0).all() or not (larger[small] > 0.0).all():
        return left_out("growth in proportion", "a difference is zero: no free node was moved")
    ratio = np.abs(np.log10(larger[small] / (FURTHER / MOVE * smaller[small])))
    at = int(np.argmax(ratio))
    places = (
        f"{apart[at] * case.size:.3e} m (node {grown.nodes[list(grown.amplitudes).index(a), at]})"
        for apart, a in ((smaller, MOVE), (larger, FURTHER))
    )
    words = f"t = {grown.time[at]:.4g} s: " + " and ".join(places)
    name = f"growth in proportion until t = {grown.time[small][-1]:.3g} s, decades off"
    return Check(name, float(ratio[at]), PROPORTIONAL, words)


def after_it(case: BothCodes, grown: Growth, both: bool) -> Iterator[Evidence]:
    """Mean and spread of perturbed runs; with `both`, those of the two codes are compared.

    A value that is NaN or infinite fails, and ends the comparison.
    """
    ours, parted = statistics(case, our_code()), grown.reaches(AMPLITUDE)
    if wrong := _not_finite(ours):
        yield from wrong
        return
    yield _band(case, ours, parted)
    yield _words(case, ours)
    if both and parted < ours.time[-1]:
        theirs = statistics(case, REFERENCE)
        yield from _not_finite(theirs) or (_same_mean(name, ours, theirs) for name in MEANS)


def _same_mean(name: str, ours: Statistics, theirs: Statistics) -> Check:
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
        words = "the runs do not separate: difference of the means relative to the largest value"
        return Check(f"mean {name} of both codes", gap, None, words)
    # Neighbouring times are not independent: ten of them stand for all.
    shown = np.flatnonzero(parted)[:: max(1, int(parted.sum()) // 10)]
    gap = np.abs(a.mean(axis=0) - b.mean(axis=0))[shown] / error[shown]
    at = shown[int(np.argmax(gap))]
    words = (
        f"t = {ours.time[at]:.4g} s: {a[:, at].mean():.5g} and {b[:, at].mean():.5g}, "
        f"standard error of their difference {error[at]:.2g}"
    )
    title = f"mean {name}, {len(a)} runs ({ours.code}), {len(b)} ({theirs.code})"
    return Check(title, float(gap.max()), SAME_STATISTICS, words)


def _not_finite(found: Statistics) -> list[Check]:
    """A check that fails for each quantity of which a run has a value that is NaN or infinite."""
    checks = []
    for name in MEANS:
        if len(wrong := np.argwhere(~np.isfinite(getattr(found, name)))):
            words = f"first: run {wrong[0, 0]}, t = {found.time[wrong[0, 1]]:.4g} s"
            title = f"values of the {name} that are NaN or infinite ({found.code})"
            checks.append(Check(title, len(wrong), RAN, words))
    return checks


def _band(case: BothCodes, found: Statistics, parted: float) -> Plate:
    panels = {label: (getattr(found, name), title) for name, (label, title) in MEANS.items()}
    moved, seen = f"{AMPLITUDE * case.size:.0e} m", f"{VISIBLE * case.size:.0e} m"
    title = f"{case.name}: {len(found.area)} runs ({found.code}), starts moved by {moved}"
    figure = bands(title, found.time, panels, {f"{moved} has become {seen}": parted})
    caption = (
        f"{case.name}: what {len(found.area)} perturbed runs have in common. Dashed: where a start moved by "
        f"{moved} is {seen} from the unmoved one."
    )
    return Plate(f"ensemble_{case.name}", figure, caption)


def _words(case: BothCodes, found: Statistics) -> Text:
    rows = []
    for at in np.linspace(0, len(found.time) - 1, 9).round().astype(int)[1:]:
        values = [getattr(found, name)[:, at] for name in MEANS]
        cells = [f"{value.mean():.4f} ± {value.std(ddof=1):.1e}" for value in values]
        rows.append([f"{found.time[at]:.3g}", *cells])
    runs = f"{len(found.area)} runs ({found.code})"
    head = f"What stays predictable in `{case.name}`: mean ± standard deviation over {runs}."
    table = markdown_table(["t [s]", *(label for label, _ in MEANS.values())], rows)
    return Text("\n".join([head, "", *table[:-1]]))
