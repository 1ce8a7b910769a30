"""Monitor of a run: checks each batch of states once by the guards, sums the energy balance, records."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import RunStopped
from exunet.forces.blocks import AWAKE
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.contact.status import TooFast
from exunet.forces.terms import Change
from exunet.integrators.protocol import Arrays, Batch, Extremes
from exunet.methods.method import Backend, Plan, turning_polynomial
from exunet.model.ejection import Ejection
from exunet.model.script import HEADING as SCRIPT
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.simulation.extremes import DiscreteSeries, ElementPeaks, Envelope, Peaks
from exunet.simulation.guards import (
    COLLAPSE_ADVICE,
    LOAD_ADVICE,
    SNAPPING,
    TURNING,
    Guards,
    GuardValues,
    state_of_worst,
    step_advice,
)
from exunet.simulation.snapshot import group_of, grouped

Floats = NDArray[np.float64]
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
        self.events: list[dict[str, Any]] = []
        switches = system.forces.switches
        self._headings = {term.memory.name: switch.heading for term, switch in switches if term.memory}
        if system.ejection is not None:
            self._headings[Ejection.heading] = Ejection.heading
            self.events = [{"heading": Ejection.heading, **system.ejection.event}]
        self._remember(state.memory)

    def _remember(self, memory: Arrays) -> None:
        self._memory = dict(memory)
        longest = STRETCH_BOUND * self._system.forces.cable.law.natural_length
        carrying = self._system.forces.cable.carrying(self._memory)
        self._longest = longest if carrying is None else np.where(carrying, longest, np.inf)

    @property
    def energy_scale(self) -> float:
        """Energy scale of the guards [J]."""
        return self._guards.scale

    def explain(self, plan: Plan, backend: Backend) -> None:
        """Set plan and backend of the run from now on, for the guards and their messages."""
        self._plan = plan
        self._guards.explain(plan.step, turning_polynomial(plan.method, backend))

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
        mine = (event for event in reversed(self.events) if event["heading"] == SCRIPT and event["done"])
        return str(next(mine, {"entry": ""})["entry"])

    def provenance(self) -> dict[str, list[dict[str, Any]]]:
        """Return the events so far, by heading."""
        return {
            heading: [
                {key: value for key, value in event.items() if key != "heading"}
                for event in self.events
                if event["heading"] == heading
            ]
            for heading in self._headings.values()
            if heading
        }

    def go_back(self) -> State:
        """Go back to the last safe state and return it."""
        self.dissipated = self.safe_dissipated
        self._base = self.safe_dissipated + float(self._system.given_work(self.safe.first_order))
        self.last_good = self.safe
        self._marks, self._drifted, self._kept_at = [], False, {}
        self._remembered_until, self._good_until = self.safe.time, math.inf
        self.events = [event for event in self.events if event["time_s"] <= self.safe.time]
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

    def restore(self, arrays: Arrays, events: list[dict[str, Any]]) -> None:
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
        self.events = list(events)
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
        advice = step_advice(self._plan, SNAPPING) if step_cause else COLLAPSE_ADVICE
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
        events = [{"heading": self._headings[memory], **event} for event in change.events]
        self.events = [*self.events, *events]  # snapshots hold the old list
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

    def take(self, batch: Batch) -> None:
        """Check a batch; raise RunStopped, with `step_cause` if a smaller step may help."""
        memory = dict(self._memory)
        states = States(self._system, batch.time, *batch[1:4], memory, batch.first_order)
        with np.errstate(all="ignore"):
            dissipated = self._dissipated(states, batch)
        rows = int(np.searchsorted(batch.time, self._good_until, side="right"))
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
            rows = np.union1d(np.append(every, len(states) - 1), marked)
            # Contiguous rows are not copied.
            part = slice(rows[0], rows[-1] + 1) if rows[-1] - rows[0] == len(rows) - 1 else rows
            values = self._guards.look(states[part], dissipated[part])
            if too_long or values.wrong.any():
                self._stop(states, dissipated, marked)
            self._accept(states, dissipated, rows, values, marked)
        self.dissipated = float(dissipated[-1])

    def _marked(self, time: Floats) -> NDArray[np.int64]:
        """Return the rows of marked times; the first row was the last of the previous batch."""
        marks = np.array(self._marks, dtype=float)
        rows = np.searchsorted(time, marks)
        rows = rows[rows < len(time)]  # later marks do not have a row yet
        return rows[(time[rows] == marks[: len(rows)]) & (rows > 0)]

    def _dissipated(self, states: States, batch: Batch) -> Floats:
        """Return (k,) dissipated energy until each state [J]."""
        given = states.given_work
        if batch.taken is not None:
            return self._base + batch.taken - given
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

    def _stop(self, states: States, dissipated: Floats, marked: NDArray[np.int64]) -> NoReturn:
        """Raise RunStopped for the first state of a batch that exceeds a bound."""
        values = self._guards.look(states, dissipated)
        bad = int(np.argmax(values.wrong))
        if bad:
            before = np.arange(bad)
            self._accept(states[:bad], dissipated[:bad], before, values[:bad], marked[marked < bad])
            self.dissipated = float(dissipated[bad - 1])
        shown = states.state(bad) if values.finite[bad] else self.last_good
        where = TURNING if values.turns_too_fast(bad) else SNAPPING
        advice = step_advice(self._plan, where) if values.of_steps(bad) else LOAD_ADVICE
        raise RunStopped(
            f"diverged at t = {states.time[bad]:.6g} s: {values.words(bad)}; "
            f"{state_of_worst(self._system, shown)}. {advice}",
            step_cause=values.of_steps(bad),
        )
