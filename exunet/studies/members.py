"""Members of an ensemble: runs through compiled code, single or side by side, each with its result."""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Sequence
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import RunStopped
from exunet.integrators.compiled.loop import CompiledIntegration, CompiledLoop
from exunet.integrators.compiled.vectorised_runs import RunsSideBySide
from exunet.integrators.protocol import IntegrationFailed, StepsCollapsed
from exunet.kernels.compile import WIDTH
from exunet.kernels.kernel import Kernel
from exunet.methods.method import Backend
from exunet.model.states import States
from exunet.results.result import Result
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import Recorder

Floats = NDArray[np.float64]

_INTERVAL = 0.2  # [s] of wall time after which a run reacts to an interrupt
_MAX_TIMES = 128  # states that the guards check in one go
_MAX_VALUES = 2**21  # coordinates that runs side by side keep in one go
_MAX_WORK = 1e7  # elements times steps of runs side by side in one go: about _INTERVAL


def run_member(start: Start, kernel: Kernel, stop: Event) -> Result:
    """Run through the stored times, with guards and events, in the compiled loop.

    stop : ends the run by KeyboardInterrupt
    """
    recorder = Recorder(start, {}, every_step=False)
    recorder.store(States.of(start.system, start.state), np.array([start.system.lost_at_start]))
    monitor = Monitor(start.system, start.state, store=recorder.store, series=recorder.series)
    monitor.explain(start.plan, Backend.COMPILED)
    through = _step_by_step if start.state.memory or start.system.kinematics.knots else _in_intervals
    try:
        evaluations = through(start, kernel, recorder, monitor, stop)
    except IntegrationFailed as failure:
        collapsed = isinstance(failure, StepsCollapsed)
        raise RunStopped(f"stopped: {failure}", step_cause=not collapsed) from failure
    return _result(recorder, monitor, evaluations)


def _result(recorder: Recorder, monitor: Monitor, evaluations: int) -> Result:
    recorder.provenance["right_hand_sides"] = evaluations
    return recorder.result("ok", monitor)


def _step_by_step(start: Start, kernel: Kernel, recorder: Recorder, monitor: Monitor, stop: Event) -> int:
    """Check for events after each step, and end steps at the knots of prescribed motions.

    Returns the number of right-hand sides. A script may end the run before its end.
    """
    loop = CompiledLoop(start.system, start.state, start.plan, monitor, kernel)
    for time in recorder.times[1:]:
        monitor.mark(time)
        loop.advance(time)
        _leave_if(stop)
        if loop.stopped:
            break
    loop.flush()
    return loop.counts.right_hand_sides


def _in_intervals(start: Start, kernel: Kernel, recorder: Recorder, monitor: Monitor, stop: Event) -> int:
    """Reach many times in one call of compiled code, without events; the steps are the same."""
    loop = CompiledIntegration(start.system, start.state, start.plan, kernel)
    loop.look_at_tensions()
    for times in _intervals(recorder.times, stop):
        batch = loop.through(times)
        for time in batch.time[1:]:
            monitor.mark(time)
        if len(batch.time) > 1:
            monitor.take(batch)
        if words := loop.collapse():
            raise StepsCollapsed(words)
        monitor.peaks.take(loop.largest_tensions)
    return loop.counts.right_hand_sides


def run_side_by_side(starts: Sequence[Start], loop: RunsSideBySide, stop: Event) -> list[Result | None]:
    """Run several starts of one scene at once; None for a run that stopped."""
    system = starts[0].system
    recorders = [Recorder(start, {}, every_step=False) for start in starts]
    for recorder, start in zip(recorders, starts, strict=True):
        recorder.store(States.of(system, start.state), np.zeros(1))
    # The guards check each stored time, as in a run.
    monitors: list[Monitor | None] = [Monitor(system, start.state, every=1) for start in starts]
    loop.begin([start.state for start in starts])
    number = _times_side_by_side(starts[0], recorders[0].times)
    for times in _intervals(recorders[0].times, stop, number, number):
        found = loop.through(times)
        for run, monitor in enumerate(monitors):
            if monitor is None:
                continue
            states = States.of_points(system, found.time, found.position[run], found.velocity[run])
            try:
                monitor.check(states, found.taken[run])
            except RunStopped:
                monitors[run] = None
                continue
            monitor.peaks.take(loop.largest_tensions(run))
            recorders[run].store(states[1:], found.taken[run][1:])
            recorders[run].flush()  # the loop overwrites its states
    return [
        None if monitor is None else _result(recorder, monitor, loop.right_hand_sides)
        for recorder, monitor in zip(recorders, monitors, strict=True)
    ]


def _times_side_by_side(start: Start, times: Floats) -> int:
    """Number of times that runs side by side go through in one go, without many values or long work."""
    assert start.plan.step is not None  # what such runs go by
    longest = float(np.diff(times).max(initial=0.0))
    work = max(1, start.net.n_elements) * max(1.0, longest / start.plan.step)
    return max(2, min(_MAX_VALUES // (WIDTH * start.system.blocks.n_x), int(_MAX_WORK / work)))


def _intervals(times: Floats, stop: Event, first: int = 1, most: int = _MAX_TIMES) -> Iterator[Any]:
    """Yield parts of the times, each from the last of the one before; raises KeyboardInterrupt on `stop`.

    first, most : times in the first of them, and at most
    """
    at, number = 0, min(first, most)
    while at < len(times) - 1:
        began = clock.perf_counter()
        part = times[at : at + number + 1]
        yield part
        _leave_if(stop)
        at += len(part) - 1
        if clock.perf_counter() - began < _INTERVAL:
            number = min(2 * number, most)


def _leave_if(stop: Event) -> None:
    if stop.is_set():
        raise KeyboardInterrupt
