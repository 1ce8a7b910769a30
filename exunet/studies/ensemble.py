"""Many runs of one net from perturbed starts, by the compiled loop on all cores, and their measures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.loop import CompiledLoop, loop_kernel
from exunet.backends.protocol import IntegrationFailed
from exunet.base.errors import InputError, RunStopped
from exunet.case.stored_times import stored_times
from exunet.codegen.kernel import Kernel
from exunet.methods.method import COMPILED_METHODS
from exunet.results import measures as metrics
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start
from exunet.studies.neighbours import perturbed
from exunet.system.states import States

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ensemble:
    """Measures of all runs at the stored times.

    time          : (t,) [s]
    bullet_speed  : (runs, t, n_bullets) [m/s]
    area          : (runs, t) area of the mouth [m2]
    kinetic, elastic, potential, dissipated : (runs, t) [J]
    right_hand_sides : (runs,) evaluations of the forces
    """

    time: Floats
    bullet_speed: Floats
    area: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    right_hand_sides: NDArray[np.int64]


def perturbed_positions(start: Start, runs: int, amplitude: float, seed: int) -> Floats:
    """(runs, n_nodes, 3) initial positions, each coordinate of free nodes moved by up to +-amplitude [m].

    Run k gets the same perturbation however many runs there are. Raises InputError for a number of runs, a
    seed or an amplitude that is out of range.
    """
    _whole("runs", runs, at_least=0)
    _whole("seed", seed, at_least=0)
    if not (isinstance(amplitude, Real) and 0.0 <= float(amplitude) < float("inf")):
        raise InputError(f"amplitude: must be a finite number of metres, 0 or more, got {amplitude!r}")
    found = [perturbed(start.net, start.position, amplitude, (seed, run)) for run in range(runs)]
    return np.array(found).reshape(-1, *start.position.shape)


def run_ensemble(
    start: Start, position: Floats, velocity: Floats | None = None, workers: int | None = None
) -> Ensemble:
    """Run `start` once from each initial state; the result does not depend on the number of workers.

    position, velocity : (runs, n_nodes, 3) [m], [m/s]; velocity None: that of `start` for all
    workers            : threads (compiled code runs beside each other); None: one a core
    Raises RunStopped, naming the run, if one diverges or its steps collapse; MissingExtra without Numba;
    InputError for a method that the compiled loop does not have, states of another shape or that are not
    finite numbers, or a number of workers below 1.
    """
    if start.plan.method not in COMPILED_METHODS:
        words = f"an ensemble runs by {', '.join(COMPILED_METHODS)}, not by {start.plan.method}"
        if start.scene.solver.method == "auto":
            words += ', which auto chose for Exudyn: set engine.loop = "auto", or "compiled"'
        raise InputError(words)
    if workers is not None:
        _whole("workers", workers, at_least=1)
    position = _states("position", position, start.system.blocks.n_points, None)
    if velocity is None:
        speeds = np.broadcast_to(start.velocity, position.shape)
    else:
        speeds = _states("velocity", velocity, start.system.blocks.n_points, len(position))
    times = stored_times(start.scene.time)
    kernel = loop_kernel(start.system)

    def one(run: int) -> tuple[Any, ...]:
        return _one(start.moved(position[run], speeds[run]), kernel, times, run)

    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        found = list(pool.map(one, range(len(position))))
    return Ensemble(times, *_stacked(found))


def _whole(name: str, given: object, at_least: int) -> None:
    if isinstance(given, bool) or not isinstance(given, Integral) or given < at_least:
        raise InputError(f"{name}: must be a whole number, {at_least} or more, got {given!r}")


def _states(name: str, given: object, n_points: int, runs: int | None) -> Floats:
    """(runs, n_points, 3) finite floats, at least one run."""
    wanted = f"({'runs' if runs is None else runs}, {n_points}, 3)"
    try:
        states = np.asarray(given)
    except ValueError:
        raise InputError(f"{name}: initial states must be {wanted}, got rows of different lengths") from None
    if states.ndim != 3 or states.shape[1:] != (n_points, 3) or len(states) != (runs or len(states)):
        raise InputError(f"{name}: initial states must be {wanted}, got {states.shape}")
    if not len(states):
        raise InputError(f"{name}: there is no run in it")
    if states.dtype.kind not in "iuf" or not np.isfinite(states).all():
        raise InputError(f"{name}: initial states must be finite numbers, got an array of {states.dtype}")
    return states.astype(np.float64)


def _stacked(found: Sequence[tuple[Any, ...]]) -> list[Any]:
    return [np.array(column) for column in zip(*found, strict=True)]


def _one(start: Start, kernel: Kernel, times: Floats, run: int) -> tuple[Any, ...]:
    """Through the stored times, with guards and events, as a run."""
    system, net = start.system, start.net
    stored: list[tuple[States, Floats]] = [(States.of(system, start.state), np.zeros(1))]
    monitor = Monitor(system, start.state, store=lambda *rows: stored.append(rows))
    monitor.explain(start.plan)
    loop = CompiledLoop(system, start.state, start.plan, monitor, kernel)
    try:
        for time in times[1:]:
            monitor.mark(time)
            loop.advance(time)
        loop.hand_over()
    except RunStopped as stop:
        raise RunStopped(f"run {run} of the ensemble {stop}") from stop
    except IntegrationFailed as failure:
        raise RunStopped(f"run {run} of the ensemble stopped: {failure}") from failure
    parts = [
        (
            np.linalg.norm(states.velocity[:, net.bullet_nodes], axis=-1),
            metrics.mouth_area(net, states.position[:, : net.n_nodes]),
            states.kinetic,
            states.elastic,
            states.potential,
            dissipated,
        )
        for states, dissipated in stored
    ]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return (*columns, loop.counts.right_hand_sides)
