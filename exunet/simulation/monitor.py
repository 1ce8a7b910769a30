"""Monitor of a run: checks each batch by the guards, sums the balances, records extremes and states."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import RunStopped
from exunet.base.run_events import RunEvent, ScriptEvent
from exunet.forces.blocks import AWAKE
from exunet.forces.contact.status import TooFast
from exunet.forces.terms import Change, Series
from exunet.integrators.protocol import Arrays, Extremes, Largest
from exunet.kernels.kernel import term_kernel
from exunet.methods.method import Plan, turning_polynomial
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.results.run_record import Peak
from exunet.simulation.guards import (
    COLLAPSE_ADVICE,
    LOAD_ADVICE,
    TURNING,
    Guards,
    GuardValues,
    beyond_table,
    state_of_worst,
    step_advice,
    where_steps_fail,
)
from exunet.simulation.snapshot import group_of, grouped


class Peaks:
    """Largest tensions of groups of elements over all steps, in increasing order of time and tension.

    A run that goes back to a state forgets maxima after it. So a maximum is kept for each interval between
    states to which the run may go back, if it exceeds all before: at its first time, of the lowest element.

    groups : elements of each group, by name
    """

    def __init__(self, groups: Mapping[str, range]) -> None:
        self._groups = dict(groups)
        self._maxima = [[Largest(0.0, 0.0, -1)] for _ in self._groups]

    def look(self, time: Floats, tension: Floats, marked: Iterable[int] = ()) -> None:
        """Update by tensions (k, n_elements) [N] at times (k,) [s], in order.

        marked : rows of the states to which a run may go back, in order
        """
        for maxima, group in zip(self._maxima, self._groups.values(), strict=True):
            own = tension[:, group.start : group.stop]
            largest, begin = own.max(axis=1, initial=0.0), 0
            for end in dict.fromkeys((*(row + 1 for row in marked), len(time))):
                state = begin + int(np.argmax(largest[begin:end]))
                if largest[state] > maxima[-1].tension:
                    element = group.start + int(np.argmax(own[state]))
                    maxima.append(Largest(float(largest[state]), float(time[state]), element))
                begin = end

    def take(self, largest: Iterable[Largest]) -> None:
        """Update by the largest tension of each group in steps without stored states."""
        for maxima, new in zip(self._maxima, largest, strict=True):
            if new.tension > maxima[-1].tension:
                maxima.append(new)

    def forget_after(self, time: float) -> None:
        """Drop maxima after a time [s]."""
        for maxima in self._maxima:
            while len(maxima) > 1 and maxima[-1].time > time:
                maxima.pop()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the maxima for a snapshot: rows of group, tension, time, element."""
        rows = [(float(k), *peak) for k, maxima in enumerate(self._maxima) for peak in maxima]
        return {"peaks": np.array(rows)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        for k, maxima in enumerate(self._maxima):
            rows = arrays["peaks"][arrays["peaks"][:, 0] == k].tolist()
            maxima[:] = [Largest(tension, time, int(element)) for _, tension, time, element in rows]

    @property
    def largest(self) -> tuple[Largest, ...]:
        """Largest tension of each group."""
        return tuple(maxima[-1] for maxima in self._maxima)

    def of_groups(self) -> dict[str, Peak]:
        """Return the largest tension of each group, by name."""
        return {name: Peak(*peak) for name, peak in zip(self._groups, self.largest, strict=True)}


class ElementPeaks:
    """Largest tension of each element over all accepted steps.

    A maximum does not contain earlier values. So maxima of intervals between stored times are kept apart
    until the run cannot go back before them: it continues from the last safe state, or ends at the last
    stored one.

    times : (n,) stored times of the run [s]; a step belongs to the interval that ends with a stored time
    """

    def __init__(self, times: Floats, n_elements: int) -> None:
        self._times = times
        self._safe = np.zeros(n_elements)  # until the last safe state
        self._stored, self._stored_until = (
            np.zeros(n_elements),
            -math.inf,
        )  # from there to the last stored one
        self._later: dict[int, Floats] = {}  # by the interval

    def look(self, time: Floats, tension: Floats) -> None:
        """Update by tensions (k, n_elements) [N] of steps that end at times (k,) [s], in order."""
        interval = np.searchsorted(self._times, time)
        first = np.flatnonzero(np.append(True, np.diff(interval) > 0))
        for k, peaks in zip(interval[first].tolist(), np.maximum.reduceat(tension, first), strict=True):
            self._take(k, peaks)

    def take(self, until: float, peaks: Floats) -> None:
        """Update by the largest tensions (n_elements,) [N] of the interval that ends at `until` [s]."""
        self._take(int(self._times.searchsorted(until)), peaks)

    def _take(self, interval: int, peaks: Floats) -> None:
        interval = min(interval, len(self._times) - 1)  # round-off may put a step behind the end
        known = self._later.get(interval)
        if known is None:
            self._later[interval] = peaks.copy()
        else:
            np.maximum(known, peaks, out=known)

    def settle(self, safe: float, stored: float) -> None:
        """Set the stored times [s] to which the run may go back (safe), or at which it may end (stored)."""
        if safe >= self._stored_until:
            np.maximum(self._safe, self._stored, out=self._safe)
            self._stored[:] = 0.0
        for interval in [k for k in self._later if self._times[k] <= stored]:
            into = self._safe if self._times[interval] <= safe else self._stored
            np.maximum(into, self._later.pop(interval), out=into)
        self._stored_until = stored

    def forget_after(self, time: float) -> None:
        """Drop maxima after a time [s] that was given to `settle`."""
        if time < self._stored_until:
            self._stored[:], self._stored_until = 0.0, time
        self._later = {k: peaks for k, peaks in self._later.items() if self._times[k] <= time}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the maxima for a snapshot."""
        return {
            "safe": self._safe.copy(),
            "stored": self._stored.copy(),
            "stored_until": np.array([self._stored_until]),
            "intervals": np.array(sorted(self._later), dtype=np.int64),
            "later": np.array([self._later[k] for k in sorted(self._later)]).reshape(
                len(self._later), len(self._safe)
            ),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        self._safe[:], self._stored[:] = arrays["safe"], arrays["stored"]
        self._stored_until = float(arrays["stored_until"][0])
        intervals = np.clip(arrays["intervals"], 0, len(self._times) - 1).tolist()
        self._later = {k: peaks.copy() for k, peaks in zip(intervals, arrays["later"], strict=True)}

    @property
    def largest(self) -> Floats:
        """(n_elements,) largest tensions [N]."""
        return np.max([self._safe, self._stored, *self._later.values()], axis=0)


class Envelope:
    """Largest elastic and smallest kinetic energy between stored times, over all accepted steps.

    A snap may be shorter than the time between two stored states, which then do not show it.

    times : (n,) stored times of the run [s]; a step belongs to the interval that ends with a stored time
    """

    def __init__(self, times: Floats) -> None:
        self._times, self._next = times, 0
        self._elastic = np.zeros(len(times))
        self._kinetic = np.full(len(times), np.inf)

    def look(self, time: Floats, elastic: Floats, kinetic: Floats) -> None:
        """Update by energies (k,) [J] of steps that end at times (k,) [s]."""
        # Round-off may put a step behind the end.
        interval = np.minimum(np.searchsorted(self._times, time), len(self._times) - 1)
        np.maximum.at(self._elastic, interval, elastic)
        np.minimum.at(self._kinetic, interval, kinetic)

    def take(self, until: float, elastic: float, kinetic: float) -> None:
        """Update by the extremes [J] of the interval that ends with a stored time [s]."""
        k = self._next
        if k >= len(self._times) or self._times[k] != until:
            k = min(bisect_left(self._times, until), len(self._times) - 1)
        self._next = k + 1
        self._elastic[k] = max(self._elastic[k], elastic)
        self._kinetic[k] = min(self._kinetic[k], kinetic)

    def forget_after(self, time: float) -> None:
        """Drop extremes after the stored time [s] to which a run goes back."""
        late = self._times > time
        self._elastic[late], self._kinetic[late] = 0.0, np.inf

    def arrays(self, until: float) -> dict[str, Floats]:
        """Return the extremes of the intervals until a time [s], for a snapshot."""
        number = int(np.searchsorted(self._times, until, side="right")) + 1
        return {"elastic": self._elastic[:number].copy(), "kinetic": self._kinetic[:number].copy()}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Restore from `arrays`."""
        self._elastic[:], self._kinetic[:] = 0.0, np.inf
        self._elastic[: len(arrays["elastic"])] = arrays["elastic"]
        self._kinetic[: len(arrays["kinetic"])] = arrays["kinetic"]

    def around(self, first: int, elastic: Floats, kinetic: Floats) -> tuple[Floats, Floats]:
        """Return the largest elastic and smallest kinetic energy of intervals, ends included, (k,) each [J].

        first            : number of the first interval
        elastic, kinetic : (k + 1,) energies [J] of the stored states, from the one before that interval on
        """
        ours = slice(first, first + len(elastic) - 1)
        largest = np.maximum(self._elastic[ours], np.maximum(elastic[1:], elastic[:-1]))
        least = np.minimum(self._kinetic[ours], np.minimum(kinetic[1:], kinetic[:-1]))
        return largest, least


def series_of(system: System) -> tuple[tuple[str, Series], ...]:
    """Return the recorded entries of discrete states of a system, each with the name of its state."""
    memories = (term.memory for term in system.forces.memories)
    return tuple(
        (memory.name, series) for memory in memories if memory is not None for series in memory.series
    )


class DiscreteSeries:
    """Values of discrete states at the ends of intervals, which are stored at the stored times.

    state : at the start; its values, such as contact, are those of a step that ends there
    """

    def __init__(self, system: System, state: State) -> None:
        self._series = series_of(system)
        self._at: dict[float, Floats] = {}
        if self._series:
            states = States.of(system, state)
            x, v = states.x[0], states.v[0]
            kernel, size = term_kernel(system.forces.kernels), system.blocks.n_force
            after = kernel.remembered(state.time, x, v, size, state.memory)
            self.take(state.time, {**state.memory, **after})

    def take(self, time: float, memory: Mapping[str, Floats]) -> None:
        """Record the discrete states at a time [s]."""
        if self._series:
            self._at[time] = np.concatenate(
                [memory[name][np.arange(one.place, one.place + one.size)] for name, one in self._series]
            )

    def arrays(self) -> dict[str, Floats]:
        """Return the recorded values for a snapshot; empty without series."""
        if not self._series:
            return {}
        return {"time": np.array(list(self._at)), "values": np.array(list(self._at.values()))}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Restore from `arrays`."""
        if self._series:
            self._at = dict(zip(arrays["time"].tolist(), arrays["values"], strict=True))

    def at(self, time: Floats) -> Floats:
        """Return (k, n) values at times (k,) [s], in order; forget earlier ones."""
        if not self._series:
            return np.zeros((len(time), 0))
        rows = np.array([self._at[instant] for instant in time.tolist()])
        self._at = {instant: values for instant, values in self._at.items() if instant >= time[-1]}
        return rows


# The guards check one state in so many, and all before a state that exceeds a bound.
STATES_A_LOOK = 32
# A run may go back to a state whose energy balance is within this part of the bound of the guards: so steps
# that failed have at most a tenth of the allowed error.
GOOD_PART = 0.1


class Store(Protocol):
    """Receiver of marked states; again: in place of the last state, changed by an event at its time."""

    def __call__(self, states: States, dissipated: Floats, *, again: bool = False) -> None: ...


class Monitor:
    """Observer of a run (see `exunet.integrators.protocol.Observer`).

    every    : the guards check one state in so many, marked states, and the last one
    store    : receives the marked states with their dissipated energy (k,) [J]
    envelope : receives the energies of all valid states
    element_peaks : receives the tensions of all valid states
    series   : receives the discrete states of compiled code at marked times
    """

    def __init__(
        self,
        system: System,
        state: State,
        *,
        every: int = STATES_A_LOOK,
        store: Store | None = None,
        envelope: Envelope | None = None,
        element_peaks: ElementPeaks | None = None,
        series: DiscreteSeries | None = None,
    ) -> None:
        self._system = system
        self._plan: Plan | None = None
        self._every = every
        self._store = store
        self._envelope = envelope
        self._element_peaks = element_peaks
        self._series = series
        self.asks_for_elements = element_peaks is not None
        self._guards = Guards(system, state)
        self._marks: list[float] = []
        self._base = system.lost_at_start + float(system.given_work(state.first_order))
        self._drifted = False
        self._stored_until, self._began = -math.inf, state.time
        self._push: Floats | None = None
        self._kept_at: dict[float, Arrays] = {}
        self._remembered_until, self._good_until = -math.inf, math.inf
        memories = (term.memory for term in system.forces.memories)
        self._keeps = {
            memory.name: memory for memory in memories if memory and (memory.kept_in or memory.in_steps)
        }
        self.peaks = Peaks(system.net.spans)
        self.dissipated = system.lost_at_start
        self.last_good = state
        self.safe, self.safe_dissipated = state, self.dissipated
        self.events: list[RunEvent] = []
        if system.ejection is not None and system.ejection.event is not None:
            self.events = [system.ejection.event]
        self._remember(state.memory)

    def _remember(self, memory: Arrays) -> None:
        self._memory = dict(memory)
        longest = self._system.forces.cable.law.longest
        carrying = self._system.forces.cable.carrying(self._memory)
        self._longest = longest if carrying is None else np.where(carrying, longest, np.inf)

    @property
    def energy_scale(self) -> float:
        """Energy scale of the guards [J]."""
        return self._guards.scale

    def explain(self, plan: Plan) -> None:
        """Set the plan of the run from now on, for the guards and their messages."""
        self._plan = plan
        self._guards.explain(plan, turning_polynomial(plan.method, plan.backend))

    def mark(self, time: float) -> None:
        """Mark a time [s] at which a step ends, whose state is checked and stored."""
        self._marks.append(time)

    def push(self, force: Floats) -> None:
        """Set external forces (n_points, 3) [N], whose work counts in the energy balance."""
        self._push = force.copy() if force.any() else None

    def set_inputs(self, inputs: Arrays) -> None:
        """Set values of inputs from now on."""
        self._remember({**self._memory, **inputs})

    @property
    def phase(self) -> str:
        """Last entry of the script that has happened; "" without."""
        events = (event for event in reversed(self.events) if isinstance(event, ScriptEvent))
        return next((event.entry for event in events if event.done), "")

    def go_back(self) -> State:
        """Go back to the last safe state and return it."""
        self.dissipated = self.safe_dissipated
        self._base = self.safe_dissipated + float(self._system.given_work(self.safe.first_order))
        self.last_good = self.safe
        self._marks, self._drifted, self._kept_at = [], False, {}
        self._remembered_until, self._good_until = self.safe.time, math.inf
        self.events = [event for event in self.events if event.time_s <= self.safe.time]
        self._remember(self.safe.memory)
        self.forget_after(self.safe.time)
        return self.safe

    def forget_after(self, time: float) -> None:
        """Drop extremes after the stored time [s] at which a run ends or continues."""
        self.peaks.forget_after(time)
        if self._envelope is not None:
            self._envelope.forget_after(time)
        if self._element_peaks is not None:
            self._element_peaks.forget_after(time)

    def arrays(self, now: float) -> dict[str, NDArray[Any]]:
        """Return the state of the monitor at a time [s], for a snapshot."""
        held = {
            "gained": self._guards.gained.copy(),
            "dissipated": np.array([self.dissipated, self._base, self.safe_dissipated]),
            "drifted": np.array([self._drifted]),
            "marks": np.array(self._marks),
            **grouped("last_good", self.last_good.arrays()),
            **grouped("safe", self.safe.arrays()),
            **grouped("memory", self._memory),
            **self.peaks.arrays(),
            **grouped("kept_at", self._kept_rows()),
        }
        if self._series is not None:
            held |= grouped("series", self._series.arrays())
        if self._envelope is not None:
            held |= grouped("envelope", self._envelope.arrays(now))
        if self._element_peaks is not None:
            held |= grouped("element_peaks", self._element_peaks.arrays())
        return held

    def _kept_rows(self) -> dict[str, NDArray[Any]]:
        """Return times and discrete states of `remembered`, a row for each."""
        if not self._keeps:
            return {}
        rows = {
            name: np.array([kept[name] for kept in self._kept_at.values()]).reshape(-1, len(memory.initial))
            for name, memory in self._keeps.items()
        }
        return {"time": np.array(list(self._kept_at), dtype=float), **rows}

    def restore(self, arrays: Arrays, events: list[RunEvent]) -> None:
        """Restore from `arrays`."""
        self._guards.gained = arrays["gained"]
        self.dissipated, self._base, self.safe_dissipated = map(float, arrays["dissipated"])
        self._drifted = bool(arrays["drifted"][0])
        self._marks = arrays["marks"].tolist()
        self.last_good = State.from_arrays(group_of("last_good", arrays))
        self.safe = State.from_arrays(group_of("safe", arrays))
        self._remember(group_of("memory", arrays))
        self.peaks.restore(arrays)
        rows = dict(group_of("kept_at", arrays))
        times = rows.pop("time", np.zeros(0)).tolist()
        self._kept_at = {time: {name: rows[name][k] for name in rows} for k, time in enumerate(times)}
        self.events = events
        self._remembered_until, self._good_until = self.last_good.time, math.inf
        if self._series is not None:
            self._series.restore(group_of("series", arrays))
        if self._envelope is not None:
            self._envelope.restore(group_of("envelope", arrays))
        if self._element_peaks is not None:
            self._element_peaks.restore(group_of("element_peaks", arrays))

    def engine_failed(self, failure: Exception, *, step_cause: bool) -> RunStopped:
        """Return the error for an integrator that failed, with its message and the last valid state."""
        worst = state_of_worst(self._system, self.last_good)
        where = where_steps_fail(States.of(self._system, self.last_good))
        advice = step_advice(self._plan, where) if step_cause else COLLAPSE_ADVICE
        words = f"the engine stopped after t = {self.last_good.time:.6g} s: {failure}; {worst}. {advice}"
        return RunStopped(words, step_cause=step_cause)

    def between(self, until: float, extremes: Extremes) -> None:
        if self._envelope is not None:
            self._envelope.take(until, extremes.elastic, extremes.kinetic)
        if self._element_peaks is not None:
            self._element_peaks.take(until, extremes.of_elements)
        self.peaks.take(extremes.largest)

    def ends(self, time: float) -> None:
        if time == self.last_good.time:  # checked already, and perhaps stored
            self._marks = []
            if time > max(self._stored_until, self._began) and self._store is not None:
                last = State.of(time, self.last_good.moving, dict(self._memory))
                self._store(States.of(self._system, last), np.array([self.dissipated]))
                self._stored_until = time
            return
        self._marks = [*(mark for mark in self._marks if mark < time), time]

    def remembered(self, time: float, memory: Arrays) -> None:
        if self._series is not None:
            self._series.take(time, memory)
        for name, values in memory.items():
            check = self._keeps[name].wrong
            if check is not None and (words := check(values)):
                self._good_until = self._remembered_until
                raise RunStopped(words, step_cause=isinstance(words, TooFast))
        self._kept_at[time] = memory
        self._remembered_until = time
        if time == self.safe.time:
            self._put_memory_into_safe()

    def changed(self, time: float, memory: str, change: Change) -> None:
        left = (change.energy_lost or 0.0) - change.work_given
        self.dissipated += left
        self.events = [*self.events, *change.events]
        asleep = {} if change.awake is None else {AWAKE: change.awake}
        self._remember({**self._memory, **change.others, memory: change.memory, **asleep})
        moves = change.x is not None or change.v is not None
        if time == self.safe.time:  # a run that goes back there starts after the event
            self.safe_dissipated += left
            self.safe = self._changed(self.safe, change)
        if time == self._stored_until and self._store is not None and moves:
            after = States.of(self._system, self._changed(self.last_good, change))
            self._store(after, np.array([self.dissipated]), again=True)

    def _changed(self, state: State, change: Change) -> State:
        """Return the state after an event, with the present discrete states."""
        x, v = self._system.layout.pack(state.moving)
        x, v = (x if change.x is None else change.x), (v if change.v is None else change.v)
        return State.of(state.time, self._system.layout.unpack(x, v), dict(self._memory))

    def take(self, states: States) -> None:
        """Check states; raise RunStopped, with `step_cause` if a smaller step may help."""
        memory = dict(self._memory)
        states = States(self._system, states.time, states.x, states.v, memory, states.taken)
        with np.errstate(all="ignore"):
            dissipated = self._dissipated(states)
        rows = int(np.searchsorted(states.time, self._good_until, side="right"))
        if rows == len(states):
            self.check(states, dissipated)
        elif rows > 1:
            self.check(states[:rows], dissipated[:rows])

    def check(self, states: States, dissipated: Floats) -> None:
        """Check states with the dissipated energy (k,) [J] until each; raise RunStopped."""
        with np.errstate(all="ignore"):  # the guards check for overflow
            marked = self._marked(states.time)
            # The longest element is checked in every state: its peak may last for a single one.
            too_long = (states.length > self._longest).any()
            if self._envelope is not None:
                self._envelope.look(states.time, states.elastic, states.kinetic)
            every = np.arange(self._every, len(states) - 1, self._every)
            every = np.append(every, len(states) - 1)
            rows = np.union1d(every, marked)
            # Contiguous rows are not copied.
            part = slice(rows[0], rows[-1] + 1) if rows[-1] - rows[0] == len(rows) - 1 else rows
            truncated = self._guards.truncated(states, every)[np.searchsorted(every, rows)]
            values = self._guards.look(states[part], dissipated[part], truncated)
            if too_long or values.wrong.any():
                rows, values = self._all_valid(states, dissipated, marked)
            self._accept(states, dissipated, rows, values, marked)
        self.dissipated = float(dissipated[-1])

    def _marked(self, time: Floats) -> NDArray[np.int64]:
        """Return the rows of marked times; the first row was the last of the previous batch."""
        marks = np.array(self._marks, dtype=float)
        rows = np.searchsorted(time, marks)
        rows = rows[rows < len(time)]  # later marks do not have a row yet
        return rows[(time[rows] == marks[: len(rows)]) & (rows > 0)]

    def _dissipated(self, states: States) -> Floats:
        """Return (k,) dissipated energy until each state [J]."""
        given = states.given_work
        if states.taken is not None:
            return self._base + states.taken - given
        work = states.work_taken() - np.diff(given)
        if self._push is not None:
            work = work - np.einsum("kna,na->k", np.diff(states.position, axis=0), self._push)
        return np.cumsum(np.concatenate([[self.dissipated], work]))  # independent of the batches

    def _accept(
        self,
        states: States,
        dissipated: Floats,
        rows: NDArray[np.int64],
        values: GuardValues,
        marked: NDArray[np.int64],
    ) -> None:
        """Accept valid states."""
        self._guards.accept(values, -1)
        self.last_good = states.state(len(states) - 1)
        self.peaks.look(states.time, states.tension, marked.tolist())
        if self._element_peaks is not None:
            self._element_peaks.look(states.time, states.tension)
        del self._marks[: len(marked)]
        if len(marked) and not self._drifted:
            off = values.off[np.searchsorted(rows, marked)] > GOOD_PART
            good = marked[: int(np.argmax(off))] if off.any() else marked
            self._drifted = bool(off.any())
            if len(good):
                self.safe, self.safe_dissipated = states.state(good[-1]), float(dissipated[good[-1]])
                self._put_memory_into_safe()
        if self._element_peaks is not None and len(marked):
            self._element_peaks.settle(self.safe.time, float(states.time[marked[-1]]))
        if self._store is not None and len(marked):
            self._store(states[marked], dissipated[marked])
            self._stored_until = float(states.time[marked[-1]])

    def _put_memory_into_safe(self) -> None:
        """Set the discrete states of the safe state to those of its time."""
        kept = self._kept_at.get(self.safe.time)
        if kept is not None:
            self.safe = replace(self.safe, memory={**self.safe.memory, **kept})
        self._kept_at = {time: later for time, later in self._kept_at.items() if time > self.safe.time}

    def _all_valid(
        self, states: States, dissipated: Floats, marked: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], GuardValues]:
        """Check all states of a batch; raise RunStopped for the first that exceeds a bound."""
        every = np.arange(len(states))
        values = self._guards.look(states, dissipated, self._guards.truncated(states, every))
        if not values.wrong.any():  # the bounds know more of the forces by all states
            return every, values
        bad = int(np.argmax(values.wrong))
        if bad:
            before = np.arange(bad)
            self._accept(states[:bad], dissipated[:bad], before, values[:bad], marked[marked < bad])
            self.dissipated = float(dissipated[bad - 1])
        shown = states.state(bad) if values.finite[bad] else self.last_good
        words = beyond_table(states, bad) if values.finite[bad] else ""
        if words and not values.of_steps(bad):
            raise RunStopped(f"stopped at t = {states.time[bad]:.6g} s: {words}")
        advice = LOAD_ADVICE
        if values.of_steps(bad):
            with np.errstate(all="ignore"):
                where = TURNING if values.turns_too_fast(bad) else where_steps_fail(states[: bad + 1])
            advice = step_advice(self._plan, where)
        raise RunStopped(
            f"diverged at t = {states.time[bad]:.6g} s: {words or values.words(bad)}; "
            f"{state_of_worst(self._system, shown)}. {advice}",
            step_cause=values.of_steps(bad),
        )
