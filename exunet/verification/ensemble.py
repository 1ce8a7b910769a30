"""Many perturbed runs of a case: what stays predictable when a single trajectory does not.

The runs are adaptive: after the horizon no step is small enough for the trajectory, but the energy must be
right. The starts are moved by more than the integrators err in a step. Moved by less, all runs of a code
follow the error that they have in common, and their mean says more about the code than about the case: with
1e-10 m at this tolerance, the means of one code at two tolerances differ by up to 45 standard errors.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.codegen.compile import numba_installed
from exunet.results import measures as metrics
from exunet.studies.both_codes import Pair
from exunet.studies.ensemble import perturbed_positions, run_ensemble
from exunet.system import energy
from exunet.verification.converged import best_plan
from exunet.verification.growth import grid

Floats = NDArray[np.float64]

AMPLITUDE = 1e-6  # [m]
TOLERANCE = 1e-7  # [m, m/s]: keeps the energy of the paper's undamped net to 2e-5
COMPILED, EXUDYN, REFERENCE = "compiled loop", "Exudyn", "reference"
RUNS = {COMPILED: 128, EXUDYN: 64, REFERENCE: 16}
SEEDS = {COMPILED: 1000, EXUDYN: 1000, REFERENCE: 2000}  # the two codes draw starts of their own


@dataclass(frozen=True)
class Ensemble:
    """Perturbed runs of one code.

    code  : which
    time  : (t,) [s]
    area  : (runs, t) mouth area, part of that in the reference configuration
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


def ensemble(pair: Pair, code: str, runs: int | None = None) -> Ensemble:
    """Runs by the compiled loop or Exudyn (Dormand-Prince), or the reference (its pair RK45), on all cores.

    runs : how many; None: `RUNS`
    """
    times = grid(pair)[0][::2]
    start = replace(pair.start, plan=best_plan(pair, TOLERANCE * pair.speed))
    places = perturbed_positions(start, runs or RUNS[code], AMPLITUDE, SEEDS[code])
    if code == COMPILED:
        changes = {"end": times[-1], "output_times": tuple(times.tolist()), "output_step": None}
        scene = start.scene.model_copy(update={"time": start.scene.time.model_copy(update=changes)})
        found = run_ensemble(replace(start, scene=scene), places)
        area, kinetic, elastic, bullets = found.area, found.kinetic, found.elastic, found.bullet_speed
    else:
        rows = in_parallel(_one, [(pair, code, times, place) for place in places])
        area, kinetic, elastic, bullets = (np.array([row[k] for row in rows]) for k in range(4))
    net = start.net
    full = float(metrics.mouth_area(net, net.reference_position)) or 1.0
    total = kinetic + elastic
    at_start = np.where(total[:, :1] > 0.0, total[:, :1], 1.0)
    speed = bullets.mean(axis=-1) if bullets.shape[-1] else np.sqrt(2.0 * kinetic / net.mass.sum())
    return Ensemble(code, times, area / full, total / at_start, speed)


def _one(pair: Pair, code: str, times: Floats, place: Floats) -> tuple[Floats, ...]:
    """Area, kinetic and elastic energy and the bullets' speeds of one run, as in `run_ensemble`."""
    moved = pair.from_state(place, pair.start.velocity)
    if code == EXUDYN:
        motion = moved.engine(times, best_plan(pair, TOLERANCE * pair.speed))
    else:
        motion = moved.march(times, method="RK45", rtol=TOLERANCE, atol=TOLERANCE)
    net, terms = pair.start.net, pair.start.terms
    return (
        metrics.mouth_area(net, motion.position),
        energy.kinetic(net, motion.velocity),
        energy.elastic(net, terms, motion.position),
        np.linalg.norm(motion.velocity[:, net.bullet_nodes], axis=-1),
    )


def in_parallel(work: Any, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
    """work(*job) of each job in order, on all cores; an interrupt ends the processes."""
    context = multiprocessing.get_context("spawn")  # the engine has threads, which a fork would not survive
    with ProcessPoolExecutor(max_workers=os.cpu_count(), mp_context=context) as pool:
        try:
            return list(pool.map(_call, [work] * len(jobs), jobs, chunksize=1))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _call(work: Any, job: Iterable[Any]) -> Any:
    return work(*job)
