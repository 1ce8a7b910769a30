"""The runs behind the study of the separation: which code, tolerance, arithmetic and start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.backends.exudyn.stepper import EngineFailed
from exunet.codegen.compile import numba_installed
from exunet.studies.both_codes import Pair
from exunet.verification.converged import best_plan
from exunet.verification.ensemble import in_parallel
from exunet.verification.growth import ROUND_OFF, SEEDS, perturbed

Floats = NDArray[np.float64]

TOLERANCES = tuple(10.0**-k for k in range(3, 13))
END = 2.0  # [s], of the paper's run
BEYOND = 2.5  # [s], to which the symmetric solution is shown
STATES = 400  # stored states to END
OFTEN = 2000  # the same where the paper's net is stored as often as its case file says
CODES = ("Exudyn", "reference")
MIRRORED = (1e-10, 1e-11)  # tolerances of the symmetric solution
NUDGE = 1e-15  # [m]: a few units in the last place of the coordinates
DRAWS, FIRST_SEED = 20, 3000  # starts moved by `NUDGE` at each of some tolerances, all in other ways
MATLAB = 1e-3  # relative tolerance that ode45 takes if none is given; the absolute one is a thousandth


@dataclass(frozen=True)
class Curve:
    """Bullets of one run.

    tolerance : of the integrator
    speeds    : (t, bullets) [m/s]; NaN if the run stopped
    """

    tolerance: float
    speeds: Floats

    @property
    def spread(self) -> Floats:
        """(t,) largest less smallest speed of a bullet [m/s]."""
        return np.ptp(self.speeds, axis=1)

    @property
    def mean(self) -> Floats:
        """(t,) mean speed [m/s]."""
        return self.speeds.mean(axis=1)

    @property
    def stopped(self) -> bool:
        return bool(np.isnan(self.speeds).any())

    def separates(self, time: Floats, level: float) -> float:
        """First stored time at which the spread is above `level` [s]; infinite if there is none.

        NaN for a run that stopped.
        """
        if self.stopped:
            return float("nan")
        beyond = np.flatnonzero(self.spread > level)
        return float(time[beyond[0]]) if len(beyond) else float("inf")


@dataclass(frozen=True)
class Study:
    """All runs: as the case starts, from starts moved by `NUDGE`, mirrored, and as the paper calculates.

    time, longer  : (t,) [s], to `END` and to `BEYOND`
    plain, nudged : "code, case" -> curves over `time`
    mirrored      : case -> curves over `longer`, in mirrored arithmetic
    paper         : case -> how -> curve, evenly spaced to `END`: assembled matrices, ode45's pair at `MATLAB`
    drawn         : case -> curves over `time` of the compiled loop, `DRAWS` moved starts at each of some
                    tolerances; empty where Numba is not installed
    """

    time: Floats
    longer: Floats
    plain: dict[str, list[Curve]]
    nudged: dict[str, list[Curve]]
    mirrored: dict[str, list[Curve]]
    paper: dict[str, dict[str, Curve]]
    drawn: dict[str, list[Curve]]


def run_one(
    pair: Pair, code: str, tolerance: float, end: float, symmetric: bool, states: int = STATES
) -> Curve:
    """One run: Exudyn's DOPRI5, or the reference's pair behind ode45 (symmetric: its DOP853).

    pair   : if `looped`, the compiled loop stands in for Exudyn
    states : how many to store until `END`
    """
    times = np.linspace(0.0, end, round(states * end / END) + 1)
    try:
        if code == "Exudyn":
            motion = pair.engine(times, best_plan(pair, tolerance))
        elif symmetric:
            motion = pair.march(times, True, rtol=tolerance, atol=1e-2 * tolerance)
        else:
            motion = pair.march(times, method="RK45", rtol=tolerance, atol=1e-3 * tolerance)
    except (EngineFailed, reference.Diverged):
        bullets = len(pair.start.net.bullet_nodes)
        return Curve(tolerance, np.full((len(times), bullets), np.nan))
    # Squares are summed as x + y first, as the symmetric arithmetic does, so that mirrored speeds are equal.
    vx, vy, vz = np.moveaxis(motion.velocity[:, pair.start.net.bullet_nodes], -1, 0)
    return Curve(tolerance, np.sqrt((vx * vx + vy * vy) + vz * vz))


def study(pairs: dict[str, Pair]) -> Study:
    """The runs, on all cores; pairs by the name that tables give them."""
    plan: list[tuple[dict[str, list[Curve]], str, tuple[Any, ...]]] = []
    plain: dict[str, list[Curve]] = {}
    nudged: dict[str, list[Curve]] = {}
    mirrored: dict[str, list[Curve]] = {}
    paper: dict[str, list[Curve]] = {}
    drawn: dict[str, list[Curve]] = {}
    hows = {}
    for name, pair in pairs.items():
        plan += [(mirrored, name, (pair, "reference", t, BEYOND, True)) for t in MIRRORED]
        moved = perturbed(pair, NUDGE)
        for code in CODES:
            plan += [(plain, f"{code}, {name}", (pair, code, t, END, False)) for t in TOLERANCES]
            plan += [(nudged, f"{code}, {name}", (moved, code, t, END, False)) for t in TOLERANCES[::4]]
        if numba_installed():
            tolerances = [t for t in TOLERANCES[::2] for _ in range(DRAWS)]
            plan += [
                (drawn, name, (perturbed(pair.looped(), NUDGE, FIRST_SEED + k), "Exudyn", t, END, False))
                for k, t in enumerate(tolerances)
            ]
        hows[name] = _as_the_paper(pair)
        plan += [
            (paper, name, (start, "reference", MATLAB, END, False, n)) for start, n in hows[name].values()
        ]
    for (group, name, _), curve in zip(plan, in_parallel(run_one, [job for *_, job in plan]), strict=True):
        group.setdefault(name, []).append(curve)
    time, longer = (np.linspace(0.0, end, round(STATES * end / END) + 1) for end in (END, BEYOND))
    named = {name: dict(zip(hows[name], paper[name], strict=True)) for name in pairs}
    return Study(time, longer, plain, nudged, mirrored, named, drawn)


def _as_the_paper(pair: Pair) -> dict[str, tuple[Pair, int]]:
    """How -> (start with assembled matrices, states to store)."""
    whole = replace(pair, system=replace(pair.system, assembled=True))
    hows = {f"stored every {END / n:g} s": (whole, n) for n in (STATES, OFTEN)}
    for number, seed in enumerate(SEEDS):
        hows[f"last bits of the start moved, {number + 1}"] = (perturbed(whole, ROUND_OFF, seed), STATES)
    return hows
