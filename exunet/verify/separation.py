"""Why the paper's four bullet curves separate after 1.75 s: the study behind rung 7.

The net, its start and the equations have the mirror symmetries of the square, so the four bullets must keep
exactly the same speed. An error of an integrator is the same for mirrored nodes and keeps the symmetry; only
round-off, which depends on the order of additions, breaks it. So the spread between the bullets shows
round-off and its growth, and the error of the common curve shows the integrator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet import energy
from exunet.engine.stepper import EngineFailed
from exunet.verify.check import Check, Finding, Plate, Text, worst_first
from exunet.verify.converged import best_plan
from exunet.verify.ensemble import in_parallel
from exunet.verify.figures import curves, families, values
from exunet.verify.growth import perturbed
from exunet.verify.pair import Pair
from exunet.verify.separation_text import PAPER, answer
from exunet.verify.tolerances import SYMMETRIC

Floats = NDArray[np.float64]

TOLERANCES = tuple(10.0**-k for k in range(3, 13))
END = 2.0  # [s], of the paper's run
BEYOND = 2.5  # [s], to which the symmetric solution is shown
STATES = 400
CODES = ("Exudyn", "reference")
MIRRORED = (1e-10, 1e-11)  # tolerances of the symmetric solution
NUDGE = 1e-15  # [m]: a few units in the last place of the coordinates


@dataclass(frozen=True)
class Curve:
    """Bullets of one run.

    tolerance : of the integrator
    spread    : (t,) largest less smallest speed of a bullet [m/s]; NaN after a run that stopped
    mean      : (t,) mean speed [m/s]
    total     : (t,) kinetic and elastic energy [J]
    """

    tolerance: float
    spread: Floats
    mean: Floats
    total: Floats

    def separates(self, time: Floats, level: float) -> float:
        """First stored time at which the spread is above `level` [s]; NaN if there is none."""
        beyond = np.flatnonzero(self.spread > level)
        return float(time[beyond[0]]) if len(beyond) else float("nan")


def run_one(pair: Pair, code: str, tolerance: float, end: float, symmetric: bool) -> Curve:
    """One run: Exudyn's DOPRI5, or the reference's pair behind ode45 (symmetric: its DOP853)."""
    times = np.linspace(0.0, end, round(STATES * end / END) + 1)
    try:
        if code == "Exudyn":
            motion = pair.engine(times, best_plan(pair, tolerance))
        elif symmetric:
            motion = pair.march(times, True, rtol=tolerance, atol=1e-2 * tolerance)
        else:
            motion = pair.march(times, method="RK45", rtol=tolerance, atol=1e-3 * tolerance)
    except (EngineFailed, reference.Diverged):
        nothing = np.full(len(times), np.nan)
        return Curve(tolerance, nothing, nothing, nothing)
    # Squares are summed as x + y first, as the symmetric arithmetic does, so that mirrored speeds are equal.
    vx, vy, vz = np.moveaxis(motion.velocity[:, pair.start.net.bullet_nodes], -1, 0)
    speeds = np.sqrt((vx * vx + vy * vy) + vz * vz)
    net, terms = pair.start.net, pair.start.terms
    total = energy.kinetic(net, motion.velocity) + energy.elastic(net, terms, motion.position)
    return Curve(tolerance, np.ptp(speeds, axis=1), speeds.mean(axis=1), total)


@dataclass(frozen=True)
class Study:
    """All runs: as the case starts, from a start moved by `NUDGE`, and in mirrored arithmetic.

    plain, nudged : "code, case" -> curves over `time`
    mirrored      : case -> curves over `longer`
    """

    tolerances: tuple[float, ...]
    nudge: float
    time: Floats
    longer: Floats
    plain: dict[str, list[Curve]]
    nudged: dict[str, list[Curve]]
    mirrored: dict[str, list[Curve]]


def study(pairs: dict[str, Pair]) -> Study:
    """The runs, on all cores; pairs by name: "damped" and "undamped"."""
    plan: list[tuple[dict[str, list[Curve]], str, tuple[Any, ...]]] = []
    plain: dict[str, list[Curve]] = {}
    nudged: dict[str, list[Curve]] = {}
    mirrored: dict[str, list[Curve]] = {}
    for name, pair in pairs.items():
        plan += [(mirrored, name, (pair, "reference", t, BEYOND, True)) for t in MIRRORED]
        moved = perturbed(pair, NUDGE)
        for code in ("Exudyn", "reference"):
            plan += [(plain, f"{code}, {name}", (pair, code, t, END, False)) for t in TOLERANCES]
            plan += [(nudged, f"{code}, {name}", (moved, code, t, END, False)) for t in TOLERANCES[::4]]
    for (group, name, _), curve in zip(plan, in_parallel(run_one, [job for *_, job in plan]), strict=True):
        group.setdefault(name, []).append(curve)
    time, longer = (np.linspace(0.0, end, round(STATES * end / END) + 1) for end in (END, BEYOND))
    return Study(TOLERANCES, NUDGE, time, longer, plain, nudged, mirrored)


def separation(damped: Pair, undamped: Pair) -> Iterator[Finding]:
    """Spread of the bullets at ten tolerances in both codes, the symmetric solution, and what follows."""
    pairs = {"damped": damped, "undamped": undamped}
    found = study(pairs)
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
            families(title, "largest less smallest speed [m/s]", panels),
            f"Spread between the four bullets of the paper's net, {caption}, at tolerances from 1e-3 (light) "
            "to 1e-12 (dark). Equal speeds are drawn at 1e-17.",
        )
    for name, runs in found.mirrored.items():
        worst = max((float(run.spread.max()) for run in runs), key=worst_first)
        title = f"spread in mirrored arithmetic to t = {BEYOND} s"
        yield Check(7, pairs[name].name, title, worst, SYMMETRIC, "tolerances 1e-10 and 1e-11")
    changes = {name: np.abs(a.mean - b.mean) for name, (a, b) in found.mirrored.items()}
    yield Plate(
        7,
        "symmetric",
        curves(
            "Mirrored arithmetic: speed of the four bullets as one",
            "change from tolerance 1e-10 to 1e-11 [m/s]",
            found.longer,
            changes,
            {"the paper's separation, 1.75 s": PAPER},
        ),
        "The symmetric solution, in which the four bullets have the same speed to the last bit: how much it "
        "depends on the tolerance. This is the integrator's part of the error.",
    )
    yield Plate(
        7,
        "symmetric_speed",
        values(
            "Mirrored arithmetic: speed of the four bullets",
            "speed [m/s]",
            found.longer,
            {name: runs[-1].mean for name, runs in found.mirrored.items()},
            {"the paper's separation, 1.75 s": PAPER},
        ),
        "Speed of the bullets in the symmetric solution (tolerance 1e-11): the paper's Fig. 5 as the exact "
        "equations have it, one curve instead of four.",
    )
    yield Text(7, answer(found, damped.speed))
