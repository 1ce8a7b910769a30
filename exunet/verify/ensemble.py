"""Many perturbed runs of a case: what stays predictable when a single trajectory does not.

The runs are adaptive: after the horizon no step is small enough for the trajectory, but the energy must be
right.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet import energy, metrics
from exunet.verify.converged import best_plan
from exunet.verify.growth import grid, perturbed
from exunet.verify.pair import Motion, Pair

Floats = NDArray[np.float64]

AMPLITUDE = 1e-10  # [m]
RUNS = {"Exudyn": 64, "reference": 24}
TOLERANCE = 1e-7  # [m, m/s]: keeps the energy of the paper's undamped net to 2e-5
FIRST_SEED = 1000


@dataclass(frozen=True)
class Ensemble:
    """Perturbed runs of one code.

    time  : (t,) [s]
    area  : (runs, t) mouth area, part of that in the reference configuration
    energy: (runs, t) kinetic and elastic energy, part of that at the start
    speed : (runs, t) mean speed of the bullets (of the nodes, if there are none) [m/s]
    """

    time: Floats
    area: Floats
    energy: Floats
    speed: Floats


def ensemble(pair: Pair, code: str, runs: int | None = None) -> Ensemble:
    """Runs by "Exudyn" (DOPRI5) or "reference" (its pair RK45), each with a start of its own, on all cores.

    runs : how many; None: `RUNS`
    """
    times = grid(pair)[0][::2]
    jobs = [(pair, code, times, FIRST_SEED + k) for k in range(runs or RUNS[code])]
    found = in_parallel(_one, jobs)
    area, total, speed = (np.array([row[k] for row in found]) for k in range(3))
    return Ensemble(times, area, total, speed)


def _one(pair: Pair, code: str, times: Floats, seed: int) -> tuple[Floats, Floats, Floats]:
    moved = perturbed(pair, AMPLITUDE, seed)
    if code == "Exudyn":
        motion = moved.engine(times, best_plan(pair, TOLERANCE * pair.speed))
    else:
        motion = moved.march(times, method="RK45", rtol=TOLERANCE, atol=TOLERANCE)
    return _measures(pair, motion)


def _measures(pair: Pair, motion: Motion) -> tuple[Floats, Floats, Floats]:
    net, terms = pair.start.net, pair.start.terms
    full = float(metrics.mouth_area(net, net.reference_position)) or 1.0
    total = energy.kinetic(net, motion.velocity) + energy.elastic(net, terms, motion.position)
    scale = float(total[0]) or 1.0
    area = metrics.mouth_area(net, motion.position) / full
    return area, total / scale, pair.bullet_speeds(motion).mean(axis=1)


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
