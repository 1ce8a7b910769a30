"""Why the paper's four bullet curves separate after 1.75 s: the study behind rung 7.

The net, its start and the equations have the mirror symmetries of the square, so the four bullets must keep
exactly the same speed. An error of an integrator is the same for mirrored nodes and keeps the symmetry; only
round-off, which depends on the order of additions, breaks it. So the spread between the bullets shows
round-off and its growth, and the error of the common curve shows the integrator.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from exunet.studies.both_codes import Pair
from exunet.verification.check import Check, Finding, Plate, Text, worst_first
from exunet.verification.figures import curves, families, values
from exunet.verification.separation_runs import BEYOND, MIRRORED, NUDGE, Curve, Study, study
from exunet.verification.separation_text import PAPER, VISIBLE, answer
from exunet.verification.tolerances import SYMMETRIC

Floats = NDArray[np.float64]

MARK = {f"the paper's separation, {PAPER} s": PAPER}


def separation(damped: Pair, undamped: Pair, tighter: Pair) -> Iterator[Finding]:
    """Spread of the bullets at ten tolerances in both codes, the symmetric solution, and what follows.

    tighter : the damped net packed to 0.06
    """
    pairs = {"damped": damped, "undamped": undamped, "damped, packing 0.06": tighter}
    found = study(pairs)
    for name, runs in found.mirrored.items():
        yield _equal(pairs[name], runs, found.longer)
    yield from _spreads(found)
    yield from _symmetric(found, damped.speed)
    yield Text(7, answer(found, damped.speed))


def _equal(pair: Pair, runs: list[Curve], time: Floats) -> Check:
    """The four bullets in mirrored arithmetic, at the time and tolerance at which they differ most."""
    run = max(runs, key=lambda one: worst_first(float(one.spread.max())))
    at = int(np.argmax(run.spread))
    slow, fast = int(np.argmin(run.speeds[at])), int(np.argmax(run.speeds[at]))
    words = (
        f"tolerance {run.tolerance:.0e}, t = {time[at]:.4g} s, bullets {slow} and {fast}: "
        f"{run.speeds[at, slow]:.16g} and {run.speeds[at, fast]:.16g} m/s"
    )
    title = f"spread of speeds in mirrored arithmetic to t = {BEYOND} s"
    return Check(7, pair.name, title, float(run.spread[at]), SYMMETRIC, words)


def _spreads(found: Study) -> Iterator[Plate]:
    for name, group, title, caption in (
        ("separation", found.plain, "Spread of the four bullet speeds, by tolerance", "as the case starts"),
        (
            "separation_nudged",
            found.nudged,
            f"The same, starts moved by {NUDGE:.0e} m",
            f"from a start whose coordinates are moved by up to {NUDGE:.0e} m",
        ),
    ):
        panels = {
            label: (found.time, {f"{run.tolerance:.0e}": run.spread for run in runs})
            for label, runs in group.items()
        }
        yield Plate(
            7,
            name,
            families(title, "largest less smallest speed [m/s]", panels, MARK),
            f"Spread between the four bullets of the paper's net, {caption}, at tolerances from the loosest "
            "(light) to the tightest (dark). Speeds that are equal to the last bit are not drawn.",
        )


def _symmetric(found: Study, speed: float) -> Iterator[Plate]:
    changes = {name: np.abs(a.mean - b.mean) for name, (a, b) in found.mirrored.items()}
    loose, tight = (f"{tolerance:.0e}" for tolerance in MIRRORED)
    yield Plate(
        7,
        "symmetric",
        curves(
            "Mirrored arithmetic: speed of the four bullets as one",
            f"change from tolerance {loose} to {tight} [m/s]",
            found.longer,
            changes,
            MARK,
        ),
        "The symmetric solution, in which the four bullets have the same speed to the last bit: how much it "
        "depends on the tolerance. This is the integrator's part of the error.",
    )
    lines, known = {}, []
    for name, change in changes.items():
        beyond = np.flatnonzero(~(change <= VISIBLE * speed))
        kept = int(beyond[0]) if len(beyond) else len(change)
        mean = found.mirrored[name][-1].mean
        lines[name] = np.where(np.arange(len(change)) < kept, mean, np.nan)
        if kept == 0:
            known.append(f"{name}: not known")
            continue
        until = f"until {found.longer[kept - 1]:.3g} s" if kept < len(change) else "for the whole run"
        known.append(f"{name}: {until}, to {change[:kept].max(initial=0.0):.1e} m/s")
    yield Plate(
        7,
        "symmetric_speed",
        values("Mirrored arithmetic: speed of the four bullets", "speed [m/s]", found.longer, lines, MARK),
        f"Speed of the bullets in the symmetric solution (tolerance {tight}): the paper's Fig. 5 as one "
        f"curve instead of four, as long as it changes by less than {VISIBLE:.0%} of the launch speed "
        f"between the tolerances {loose} and {tight} ({'; '.join(known)}). The symmetry is exact, the speed "
        "is not.",
    )
