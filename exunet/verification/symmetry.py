"""Rung 7: what separates the four bullet curves of the paper's net is round-off, not the integrator.

The net, its start and the equations have the mirror symmetries of the square, so the four bullets must keep
exactly the same speed. An error of an integrator is the same for mirrored nodes and keeps the symmetry; only
round-off, which depends on the order of additions, breaks it. In mirrored arithmetic, which differs in that
order only, the spread must be zero. benchmarks/separation.py times the separation in ordinary arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.studies.perturbation import PAPER_SIZE
from exunet.verification.check import Check, worst_of
from exunet.verification.growth import nearby
from exunet.verification.tolerances import SYMMETRIC

LATER = 1.25  # of the run of the case: how far the symmetric solution is followed
INSTANTS = 501
TOLERANCES = (1e-10, 1e-11)  # rtol of DOP853, the absolute one [m, m/s] is a hundredth
NUDGE = 1e-15 / PAPER_SIZE  # of the size: a few units in the last place of the coordinates
SEPARATE = 0.01  # of the launch speed: two curves that far apart are seen as two


def symmetry(case: BothCodes) -> Iterator[Check]:
    """Spread of the bullets' speeds in mirrored arithmetic, and when it is seen in ordinary arithmetic."""
    end = case.start.scene.time.end
    equal = [_run(mirrored(case), tolerance, LATER * end) for tolerance in TOLERANCES]
    ordinary = _run(nearby(case, NUDGE), TOLERANCES[0], end)
    rows = []
    for tolerance, motion in zip(TOLERANCES, equal, strict=True):
        spread = bullet_spread(case, motion)
        at = int(np.argmax(spread))
        words = f"t = {motion.time[at]:.4g} s"
        rows.append(Check(f"tolerance {tolerance:.0e}", float(spread[at]), SYMMETRIC, words))
    yield worst_of(f"spread of speeds in mirrored arithmetic to t = {LATER * end:g} s", rows)
    name = f"bullets {SEPARATE:.0%} of the launch speed apart, start moved by {NUDGE * case.size:.0e} m [s]"
    yield Check(name, separation(case, ordinary), None, f"tolerance {TOLERANCES[0]:.0e}, ordinary arithmetic")


def mirrored(case: BothCodes) -> BothCodes:
    """The case with the reference's mirrored arithmetic, which keeps mirror symmetries to the last bit."""
    system = replace(case.theirs.system, symmetric=True)
    return replace(case, theirs=replace(case.theirs, system=system))


def bullet_spread(case: BothCodes, motion: Trajectory) -> Floats:
    """(t,) largest less smallest speed of a bullet [m/s]."""
    # x and y first, as the mirrored arithmetic adds them, so that mirrored speeds are equal.
    x, y, z = np.moveaxis(motion.velocity[:, case.start.net.bullet_nodes] ** 2, -1, 0)
    return np.asarray(np.ptp(np.sqrt((x + y) + z), axis=1))


def separation(case: BothCodes, motion: Trajectory, part: float = SEPARATE) -> float:
    """First stored time [s] at which the spread exceeds a part of the launch speed; infinite if never."""
    apart = np.flatnonzero(bullet_spread(case, motion) > part * case.speed)
    return float(motion.time[apart[0]]) if len(apart) else float("inf")


def _run(case: BothCodes, tolerance: float, end: float) -> Trajectory:
    return case.run_reference(np.linspace(0.0, end, INSTANTS), rtol=tolerance, atol=1e-2 * tolerance)
