"""Many runs of one net from perturbed starts, by the compiled loop on all cores, and their measures."""

from __future__ import annotations

import os
import time as clock
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from numbers import Integral, Real
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.loop import CompiledIntegration, CompiledLoop, loop_kernel
from exunet.backends.protocol import IntegrationFailed, StepsCollapsed
from exunet.base.errors import InputError, RunStopped
from exunet.case.stored_times import stored_times
from exunet.codegen.kernel import Kernel
from exunet.methods.method import COMPILED_METHODS
from exunet.results import measures as metrics
from exunet.results.headlines import Course, Peak
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start
from exunet.simulation.refinement import finer
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
    centre        : (runs, t, 3) centre of mass of the net [m]
    tension       : (runs, t) largest tension of all elements at that time [N]
    largest_tension, time_of_largest_tension : (runs,) of all steps, stored or not [N], [s]
    element_of_largest_tension : (runs,) in which element; -1: none was ever taut
    right_hand_sides : (runs,) evaluations of the forces
    """

    time: Floats
    bullet_speed: Floats
    area: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    centre: Floats
    tension: Floats
    largest_tension: Floats
    time_of_largest_tension: Floats
    element_of_largest_tension: NDArray[np.int64]
    right_hand_sides: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.area)

    def course(self, run: int, achievable_area: float) -> Course:
        """One of the runs, for its headlines; achievable_area: of its net [m2]."""
        return Course(
            time=self.time,
            area=self.area[run],
            achievable_area=achievable_area,
            centre=self.centre[run],
            bullet_speed=self.bullet_speed[run],
            kinetic=self.kinetic[run],
            elastic=self.elastic[run],
            dissipated=self.dissipated[run],
            tension=self.tension[run],
            peak=Peak(
                float(self.largest_tension[run]),
                float(self.time_of_largest_tension[run]),
                int(self.element_of_largest_tension[run]),
            ),
        )


def perturbed_positions(start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0) -> Floats:
    """(runs, n_nodes, 3) initial positions, each coordinate of free nodes moved by up to +-amplitude [m].

    first : number of the first of the runs
    Run k gets the same perturbation however many runs there are. Raises InputError for a number of runs, a
    seed or an amplitude that is out of range.
    """
    whole_number("runs", runs, at_least=0)
    whole_number("seed", seed, at_least=0)
    if not (isinstance(amplitude, Real) and 0.0 <= float(amplitude) < float("inf")):
        raise InputError(f"amplitude: must be a finite number of metres, 0 or more, got {amplitude!r}")
    found = [
        perturbed(start.net, start.position, amplitude, (seed, run)) for run in range(first, first + runs)
    ]
    return np.array(found).reshape(-1, *start.position.shape)


def run_ensemble(
    start: Start,
    position: Floats,
    velocity: Floats | None = None,
    workers: int | None = None,
    *,
    retries: int = 0,
    progress: Callable[[int], None] | None = None,
    first: int = 0,
) -> Ensemble:
    """Run `start` once from each initial state; the result does not depend on the number of workers.

    position, velocity : (runs, n_nodes, 3) [m], [m/s]; velocity None: that of `start` for all
    workers            : threads (compiled code runs beside each other); None: one a core
    retries            : how often a run that fails because of its steps begins anew with finer ones
    progress           : called with the number of runs that are done, after each of them
    first              : number of the first run in the words of errors
    Raises RunStopped, naming the run, if one diverges or its steps collapse; MissingExtra without Numba;
    InputError for a method that the compiled loop does not have, states of another shape or that are not
    finite numbers, or a number of workers below 1; KeyboardInterrupt on Ctrl-C.
    """
    if start.plan.method not in COMPILED_METHODS:
        words = f"an ensemble runs by {', '.join(COMPILED_METHODS)}, not by {start.plan.method}"
        if start.scene.solver.method == "auto":
            words += ', which auto chose for Exudyn: set engine.loop = "auto", or "compiled"'
        raise InputError(words)
    if workers is not None:
        whole_number("workers", workers, at_least=1)
    position = _states("position", position, start.system.blocks.n_points, None)
    if velocity is None:
        speeds = np.broadcast_to(start.velocity, position.shape)
    else:
        speeds = _states("velocity", velocity, start.system.blocks.n_points, len(position))
    times = stored_times(start.scene.time)
    kernel = loop_kernel(start.system)
    stop = Event()

    def one(run: int) -> tuple[Any, ...]:
        moved = start.moved(position[run], speeds[run])
        for left in range(retries, -1, -1):
            try:
                return _one(moved, kernel, times, stop)
            except RunStopped as found:
                plan = finer(moved.plan) if found.step_cause and left else None
                if plan is None:
                    raise RunStopped(f"run {first + run} of the ensemble {found}") from found
                moved = replace(moved, plan=plan)
        raise AssertionError("the last attempt returns or raises")

    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            found = []
            for done in pool.map(one, range(len(position))):
                found.append(done)
                if progress is not None:
                    progress(len(found))
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return Ensemble(times, *_stacked(found))


def whole_number(name: str, given: object, at_least: int) -> None:
    """Raise InputError for an argument that is no whole number, or too small a one."""
    if isinstance(given, bool) or not isinstance(given, Integral) or given < at_least:
        raise InputError(f"{name}: must be a whole number, {at_least} or more, got {given!r}")


def metres(name: str, given: object) -> None:
    """Raise InputError for an argument that is no length, or a negative one."""
    if isinstance(given, bool) or not (isinstance(given, Real) and 0.0 <= float(given) < float("inf")):
        raise InputError(f"{name}: must be a finite number of metres, 0 or more, got {given!r}")


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


def _one(start: Start, kernel: Kernel, times: Floats, stop: Event) -> tuple[Any, ...]:
    """Through the stored times, with guards and events, as a run."""
    system, net = start.system, start.net
    stored: list[tuple[States, Floats]] = [(States.of(system, start.state), np.zeros(1))]
    monitor = Monitor(system, start.state, store=lambda *rows: stored.append(rows))
    monitor.explain(start.plan)
    through = _from_time_to_time if start.state.memory else _in_stretches
    try:
        right_hand_sides = through(start, kernel, times, monitor, stop)
    except IntegrationFailed as failure:
        collapsed = isinstance(failure, StepsCollapsed)
        raise RunStopped(f"stopped: {failure}", step_cause=not collapsed) from failure
    parts = [
        (
            np.linalg.norm(states.velocity[:, net.bullet_nodes], axis=-1),
            metrics.mouth_area(net, states.position[:, : net.n_nodes]),
            states.kinetic,
            states.elastic,
            states.potential,
            dissipated,
            metrics.net_centre(net, states.position[:, : net.n_nodes]),
            states.tension.max(axis=1, initial=0.0),
        )
        for states, dissipated in stored
    ]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    peak = monitor.peaks.provenance()
    return (*columns, peak["tension_N"], peak["time_s"], peak["element"], right_hand_sides)


def _from_time_to_time(start: Start, kernel: Kernel, times: Floats, monitor: Monitor, stop: Event) -> int:
    """The general way: events are looked for after each step."""
    loop = CompiledLoop(start.system, start.state, start.plan, monitor, kernel)
    for time in times[1:]:
        monitor.mark(time)
        loop.advance(time)
        _leave_if(stop)
    loop.hand_over()
    return loop.counts.right_hand_sides


def _in_stretches(start: Start, kernel: Kernel, times: Floats, monitor: Monitor, stop: Event) -> int:
    """Without events many times are reached in one call of compiled code; the steps are the same."""
    loop = CompiledIntegration(start.system, start.state, start.plan, kernel)
    loop.look_at_tensions()
    at, number = 0, 1
    while at < len(times) - 1:
        began = clock.perf_counter()
        stretch = times[at : at + number + 1]
        batch = loop.through(stretch)
        for time in batch.time[1:]:
            monitor.mark(time)
        if len(batch.time) > 1:
            monitor.take(batch)
        if words := loop.collapse():
            raise StepsCollapsed(words)
        tension, time, element = loop.largest_tension
        monitor.peaks.take(time, tension, element)
        _leave_if(stop)
        at += len(stretch) - 1
        if clock.perf_counter() - began < _STRETCH:
            number = min(2 * number, _MOST_TIMES)
    return loop.counts.right_hand_sides


_STRETCH = 0.2  # [s] of wall time after which a run sees that it is to be left
_MOST_TIMES = 128  # states that the guards look at in one go


def _leave_if(stop: Event) -> None:
    if stop.is_set():
        raise KeyboardInterrupt
