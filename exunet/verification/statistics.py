"""Many perturbed runs of a case: what stays predictable when a single trajectory does not.

The runs are adaptive: after the horizon no step is small enough for the trajectory, but the energy must be
right. The starts are moved by more than the integrators err in a step. Moved by less, all runs of a code
follow the error that they have in common, and their mean says more about the code than about the case: with
1e-10 m at this tolerance, the means of one code at two tolerances differ by up to 45 standard errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exunet.codegen.compile import numba_installed
from exunet.net.areas import achievable_area, mouth_area
from exunet.studies.both_codes import BothCodes, Floats
from exunet.studies.ensemble import perturbed_positions, run_ensemble
from exunet.studies.perturbation import tracked_speeds
from exunet.system import energy
from exunet.verification.growth import AMPLITUDE, grid
from exunet.verification.trajectories import best_plan

TOLERANCE = 1e-7  # of `best_plan`: keeps the energy of the paper's undamped net to 2e-5
COMPILED, EXUDYN, REFERENCE = "compiled loop", "Exudyn", "reference"
RUNS = {COMPILED: 128, EXUDYN: 64, REFERENCE: 16}
SEEDS = {COMPILED: 1000, EXUDYN: 1000, REFERENCE: 2000}  # the two codes draw starts of their own


@dataclass(frozen=True)
class Statistics:
    """Measures of the perturbed runs of one code.

    code  : which
    time  : (t,) [s]
    area  : (runs, t) mouth area, part of the largest that it can have
    energy: (runs, t) kinetic and elastic energy, part of that at the start
    speed : (runs, t) mean speed of the bullets; without any, the nodes' root mean square over the mass [m/s]
    """

    code: str
    time: Floats
    area: Floats
    energy: Floats
    speed: Floats


def our_code() -> str:
    """Which code runs exunet's ensembles: the compiled loop, or Exudyn where Numba is not installed."""
    return COMPILED if numba_installed() else EXUDYN


def statistics(case: BothCodes, code: str, runs: int | None = None) -> Statistics:
    """Runs by the compiled loop or Exudyn (Dormand-Prince), or the reference (its RK45).

    runs : how many; None: `RUNS`
    """
    times, net = grid(case)[0][::2], case.start.net
    start = replace(case.start, plan=best_plan(case, TOLERANCE))
    places = perturbed_positions(start, runs or RUNS[code], AMPLITUDE * case.size, SEEDS[code])
    if code == COMPILED:
        changes = {"end": times[-1], "output_times": tuple(times.tolist()), "output_step": None}
        scene = start.scene.model_copy(update={"time": start.scene.time.model_copy(update=changes)})
        found = run_ensemble(replace(start, scene=scene), places)
        area, kinetic, elastic, bullets = found.area, found.kinetic, found.elastic, found.bullet_speed
    else:
        rows = [_one(case, code, times, place) for place in places]
        area, kinetic, elastic, bullets = (np.array([row[k] for row in rows]) for k in range(4))
    full = achievable_area(net) or 1.0
    total = kinetic + elastic
    at_start = np.where(total[:, :1] > 0.0, total[:, :1], 1.0)
    speed = bullets.mean(axis=-1) if len(net.bullet_nodes) else np.sqrt(2.0 * kinetic / net.mass.sum())
    return Statistics(code, times, area / full, total / at_start, speed)


def _one(case: BothCodes, code: str, times: Floats, place: Floats) -> tuple[Floats, ...]:
    """Area, kinetic and elastic energy and the bullets' speeds of one run, as in `run_ensemble`."""
    other, net = case.from_state(place, case.start.velocity), case.start.net
    if code == EXUDYN:
        motion = other.run_exunet(times, best_plan(case, TOLERANCE))
    else:
        motion = other.run_reference(times, method="RK45", rtol=TOLERANCE, atol=TOLERANCE)
    return (
        mouth_area(net, motion.position),
        energy.kinetic(net.mass, motion.velocity[:, : net.n_nodes]),
        energy.elastic(case.start.system.forces, motion.position),
        tracked_speeds(net, motion.velocity),
    )
