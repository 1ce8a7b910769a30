"""One run, or several side by side, through compiled code, with what an ensemble keeps of them."""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Mapping, Sequence
from threading import Event
from typing import NamedTuple

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
from exunet.results import measures as metrics
from exunet.results.course import breaks_of
from exunet.results.ends import no_ends
from exunet.results.pulls import let_go
from exunet.results.script_story import ending, times_of_awaited
from exunet.simulation.extremes import DiscreteSeries
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start
from exunet.studies.measured import MEASURED, Measured, PulledPlaces, ends_in, measured, rows_of

Floats = NDArray[np.float64]

_STRETCH = 0.2  # [s] of wall time after which a run sees that it is to be left
_MOST_TIMES = 128  # states that the guards look at in one go
_MOST_VALUES = 2**21  # coordinates that runs side by side keep in one go
_MOST_WORK = 1e7  # elements times steps of runs side by side in one go: about _STRETCH


class MeasuredRun(NamedTuple):
    """A whole run: its states, what there was at its start and end, and what was seen of all its steps.

    ended, stopped : when [s], and with which verdict of a script; "" at its time
    breaks         : when elements broke [s]; None: nothing can break
    awaited        : when entries of the script happened [s], of those whose times the case does not give
    """

    states: Measured
    ends: NDArray[np.void]
    ejection: float
    peaks: Floats
    largest_tension: float
    time_of_largest_tension: float
    element_of_largest_tension: int
    right_hand_sides: int
    contact: Floats
    ended: float
    stopped: str
    breaks: tuple[float, ...] | None
    awaited: Mapping[str, tuple[float, ...]]


def _joined(
    parts: Sequence[Measured],
    times: Floats,
    ends: NDArray[np.void],
    monitor: Monitor,
    right_hand_sides: int,
    contact: Floats,
    pulled: PulledPlaces = PulledPlaces(),  # noqa: B008 - frozen
) -> MeasuredRun:
    """All of a run at its times, from what was measured in parts of it."""
    peak, story = monitor.peaks.provenance(), {**pulled.story, **monitor.provenance()}
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in MEASURED}
    whole["dissipated"] += metrics.ejected(times, story)
    whole["pull"] = let_go(whole["pull"], times, pulled.places, story)
    return MeasuredRun(
        Measured(**whole),
        ends,
        metrics.work_of_ejection(story) or 0.0,
        np.array(monitor.peaks.largest, dtype=float),
        peak["tension_N"],
        peak["time_s"],
        peak["element"],
        right_hand_sides,
        contact,
        float(times[-1]),
        ending(story),
        breaks_of(story),
        times_of_awaited(story),
    )


def times_until(times: Floats, end: float) -> Floats:
    """The times [s] of a run that has ended at `end`, at that or before it."""
    return np.append(times[: np.searchsorted(times, end)], end)


def one_run(start: Start, kernel: Kernel, times: Floats, stop: Event) -> MeasuredRun:
    """Through the stored times, with guards and events, as a run."""
    first = last = States.of(start.system, start.state)
    rule, pulled = start.scene.capture, PulledPlaces.of(start)
    parts = [measured(first, np.array([start.system.lost_at_start]), rule, pulled)]
    series = DiscreteSeries(start.system, start.state.time, start.state.memory)

    def store(states: States, dissipated: Floats, *, again: bool = False) -> None:
        nonlocal last
        if again:
            parts[-1] = rows_of(parts[-1], 0, -1)
        parts.append(measured(states, dissipated, rule, pulled))
        last = states

    monitor = Monitor(start.system, start.state, store=store, series=series)
    monitor.explain(start.plan, Backend.COMPILED)
    stops = start.state.memory or start.system.kinematics.knots
    through = _from_time_to_time if stops else _in_stretches
    try:
        right_hand_sides, end = through(start, kernel, times, monitor, stop)
    except IntegrationFailed as failure:
        collapsed = isinstance(failure, StepsCollapsed)
        raise RunStopped(f"stopped: {failure}", step_cause=not collapsed) from failure
    ends, times = ends_in(first, last, monitor.provenance()), times_until(times, end)
    return _joined(parts, times, ends, monitor, right_hand_sides, series.at(times), pulled)


def _from_time_to_time(
    start: Start, kernel: Kernel, times: Floats, monitor: Monitor, stop: Event
) -> tuple[int, float]:
    """The general way: events are looked for after each step, and steps end at the knots of guides.

    Returns the right-hand sides, and when the run ended [s]; a script may end it.
    """
    loop = CompiledLoop(start.system, start.state, start.plan, monitor, kernel)
    for time in times[1:]:
        monitor.mark(time)
        loop.advance(time)
        _leave_if(stop)
        if loop.stopped:
            break
    loop.flush()
    return loop.counts.right_hand_sides, loop.time


def _in_stretches(
    start: Start, kernel: Kernel, times: Floats, monitor: Monitor, stop: Event
) -> tuple[int, float]:
    """Without events many times are reached in one call of compiled code; the steps are the same."""
    loop = CompiledIntegration(start.system, start.state, start.plan, kernel)
    loop.look_at_tensions()
    for stretch in _stretches(times, stop):
        batch = loop.through(stretch)
        for time in batch.time[1:]:
            monitor.mark(time)
        if len(batch.time) > 1:
            monitor.take(batch)
        if words := loop.collapse():
            raise StepsCollapsed(words)
        monitor.peaks.take(loop.largest_tensions)
    return loop.counts.right_hand_sides, float(times[-1])


def runs_side_by_side(
    starts: list[Start], loop: RunsSideBySide, times: Floats, stop: Event
) -> list[MeasuredRun | None]:
    """The same of several runs at once; None for a run that stopped."""
    system, runs = starts[0].system, len(starts)
    moved = (
        np.array(parts) for parts in zip(*((item.position, item.velocity) for item in starts), strict=True)
    )
    begun = measured(States.of_points(system, np.repeat(times[0], runs), *moved), np.zeros(runs))
    parts = [[rows_of(begun, run, run + 1)] for run in range(runs)]
    # The guards look at each stored time, as in a run.
    monitors: list[Monitor | None] = [Monitor(system, start.state, every=1) for start in starts]
    loop.begin([start.state for start in starts])
    number = _times_side_by_side(starts[0], times)
    for stretch in _stretches(times, stop, number, number):
        found = loop.through(stretch)
        points = (part.reshape(-1, *part.shape[2:]) for part in (found.position, found.velocity))
        states = States.of_points(system, np.tile(found.time, runs), *points)
        with np.errstate(all="ignore"):  # of runs that diverge
            of_states = measured(states, found.taken.ravel())
        for run, monitor in enumerate(monitors):
            if monitor is None:
                continue
            first = run * len(stretch)
            try:
                monitor.check(states[first : first + len(stretch)], found.taken[run])
            except RunStopped:
                monitors[run] = None
            monitor.peaks.take(loop.largest_tensions(run))
            parts[run].append(rows_of(of_states, first + 1, first + len(stretch)))
    nothing = np.zeros((len(times), 0))  # scenes with contact do not go side by side
    return [
        None
        if monitor is None
        else _joined(parts[run], times, no_ends(), monitor, loop.right_hand_sides, nothing)
        for run, monitor in enumerate(monitors)
    ]


def _times_side_by_side(start: Start, times: Floats) -> int:
    """Times that runs side by side go through in one go, without many values or long work."""
    assert start.plan.step is not None  # what such runs go by
    longest = float(np.diff(times).max(initial=0.0))
    work = max(1, start.net.n_elements) * max(1.0, longest / start.plan.step)
    return max(2, min(_MOST_VALUES // (WIDTH * start.system.blocks.n_x), int(_MOST_WORK / work)))


def _stretches(times: Floats, stop: Event, first: int = 1, most: int = _MOST_TIMES) -> Iterator[Floats]:
    """Parts of the times, each from the last of the one before; raises KeyboardInterrupt once it is to stop.

    first, most : times in the first of them, and at most
    """
    at, number = 0, min(first, most)
    while at < len(times) - 1:
        began = clock.perf_counter()
        stretch = times[at : at + number + 1]
        yield stretch
        _leave_if(stop)
        at += len(stretch) - 1
        if clock.perf_counter() - began < _STRETCH:
            number = min(2 * number, most)


def _leave_if(stop: Event) -> None:
    if stop.is_set():
        raise KeyboardInterrupt
