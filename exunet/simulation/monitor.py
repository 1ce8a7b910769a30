"""Looks at the states of a run once: guards that stop it, energy balance, largest values, record."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.backends.protocol import Arrays, Batch, Extremes
from exunet.base.errors import RunStopped
from exunet.forces.blocks import AWAKE
from exunet.forces.cable import STRETCH_BOUND
from exunet.forces.terms import Change
from exunet.methods.method import Backend, turning_polynomial
from exunet.methods.plan import Plan
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
from exunet.system.ejection import Ejection
from exunet.system.script import HEADING as SCRIPT
from exunet.system.states import States
from exunet.system.system import State, System

Floats = NDArray[np.float64]
# The guards look at one state in so many; where they find one wrong, they look at those before it too.
STATES_A_LOOK = 32
# A run may continue from a state while its energy balance is within this part of the guard's bound: what the
# steps that went wrong have done to it is then a tenth of what may be wrong with a result.
GOOD_PART = 0.1


class Store(Protocol):
    """What takes the marked states; `again`: in place of the last one, which an event changed at its time."""

    def __call__(self, states: States, dissipated: Floats, *, again: bool = False) -> None: ...


class Monitor:
    """The observer of a run (see `exunet.backends.protocol.Observer`).

    every    : the guards look at one state in so many, at each that is asked for by `mark`, and at the last
    store    : takes the marked states with their dissipated energy (k,) [J]
    envelope : takes the energies of all good states
    element_peaks : takes the tensions of all good states
    series   : takes the memories that compiled code keeps, at the times that are gone to
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
        self._keeps = {one.name: one for one in memories if one and (one.kept_in or one.in_steps)}
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
        """What errors of the energy are measured by [J]."""
        return self._guards.scale

    def explain(self, plan: Plan, backend: Backend) -> None:
        """Set plan and backend of the run from now on, for the guards and their messages."""
        self._plan = plan
        self._guards.explain(plan.step, turning_polynomial(plan.method, backend))

    def mark(self, time: float) -> None:
        """The state of the accepted step that ends at a time [s] is to be looked at and stored."""
        self._marks.append(time)

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside act from now on; their work is booked."""
        self._push = force.copy() if force.any() else None

    def tell(self, inputs: Arrays) -> None:
        """Inputs have these values from now on."""
        self._remember({**self._memory, **inputs})

    @property
    def phase(self) -> str:
        """The entry of the script that has happened last; "" if none has."""
        mine = (one for one in reversed(self.events) if one["heading"] == SCRIPT and one["done"])
        return str(next(mine, {"entry": ""})["entry"])

    def story(self) -> dict[str, list[dict[str, Any]]]:
        """The events so far, by heading."""
        return {
            heading: [
                {key: value for key, value in one.items() if key != "heading"}
                for one in self.events
                if one["heading"] == heading
            ]
            for heading in self._headings.values()
            if heading
        }

    def go_back(self) -> State:
        """Go back to the last state from which a run may continue, which is returned."""
        self.dissipated = self.safe_dissipated
        self._base = self.safe_dissipated + float(self._system.given_work(self.safe.first_order))
        self.last_good = self.safe
        self._marks, self._drifted, self._kept_at = [], False, {}
        self.events = [one for one in self.events if one["time_s"] <= self.safe.time]
        self._remember(self.safe.memory)
        self.forget_after(self.safe.time)
        return self.safe

    def forget_after(self, time: float) -> None:
        """Drop the largest values after the stored time [s] at which a run ends or continues."""
        self.peaks.forget_after(time)
        if self._envelope is not None:
            self._envelope.forget_after(time)
        if self._element_peaks is not None:
            self._element_peaks.forget_after(time)

    def arrays(self, now: float) -> dict[str, NDArray[Any]]:
        """All that the books hold at a time [s], for a snapshot."""
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
        """Times and memories of `remembered`, a row for each."""
        if not self._keeps:
            return {}
        rows = {
            name: np.array([one[name] for one in self._kept_at.values()]).reshape(-1, len(memory.initial))
            for name, memory in self._keeps.items()
        }
        return {"time": np.array(list(self._kept_at), dtype=float), **rows}

    def restore(self, arrays: Arrays, events: list[dict[str, Any]]) -> None:
        """Go back to what `arrays` gave."""
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
        """The error for an integrator that gave up, with its words and the last good state."""
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
        if time == self.last_good.time:  # seen already, and perhaps stored
            self._marks = []
            if time > max(self._stored_until, self._began) and self._store is not None:
                last = State.of(time, self.last_good.moving, dict(self._memory))
                self._store(States.of(self._system, last), np.array([self.dissipated]))
                self._stored_until = time
            return
        self._marks = [*(one for one in self._marks if one < time), time]

    def remembered(self, time: float, memory: Arrays) -> None:
        if self._series is not None:
            self._series.take(time, memory)
        for name, values in memory.items():
            look = self._keeps[name].wrong
            if look is not None and (words := look(values)):
                self._good_until = self._remembered_until
                raise RunStopped(words, step_cause=False)
        self._kept_at[time] = memory
        self._remembered_until = time
        if time == self.safe.time:
            self._put_memory_into_safe()

    def changed(self, time: float, memory: str, change: Change) -> None:
        left = (change.energy_lost or 0.0) - change.work_given
        self.dissipated += left
        told = [{"heading": self._headings[memory], **one} for one in change.events]
        self.events = [*self.events, *told]  # snapshots hold the old list
        asleep = {} if change.awake is None else {AWAKE: change.awake}
        self._remember({**self._memory, **change.others, memory: change.memory, **asleep})
        moves = change.x is not None or change.v is not None
        if time == self.safe.time:  # a run that goes back there is beyond the event
            self.safe_dissipated += left
            self.safe = self._changed(self.safe, change)
        if time == self._stored_until and self._store is not None and moves:
            after = States.of(self._system, self._changed(self.last_good, change))
            self._store(after, np.array([self.dissipated]), again=True)

    def _changed(self, state: State, change: Change) -> State:
        """A state after an event, with the memories of now."""
        x, v = self._system.layout.pack(state.moving)
        x, v = (x if change.x is None else change.x), (v if change.v is None else change.v)
        return State.of(state.time, self._system.layout.unpack(x, v), dict(self._memory))

    def take(self, batch: Batch) -> None:
        """Raises RunStopped, with the `step_cause` that a smaller step may mend or not."""
        memory = dict(self._memory)
        states = States(self._system, batch.time, *batch[1:4], memory, batch.first_order)
        with np.errstate(all="ignore"):
            dissipated = self._dissipated(states, batch)
        rows = int(np.searchsorted(batch.time, self._good_until, side="right"))
        if rows == len(states):
            self.see(states, dissipated)
        elif rows > 1:
            self.see(states[:rows], dissipated[:rows])

    def see(self, states: States, dissipated: Floats) -> None:
        """As `take`, of states and the energy (k,) [J] taken out until each."""
        with np.errstate(all="ignore"):  # numbers that overflow are what the guards look for
            marked = self._marked(states.time)
            # The longest element is looked for in every state: its peak may last for one of them.
            too_long = (states.length > self._longest).any()
            if self._envelope is not None:
                self._envelope.look(states.time, states.elastic, states.kinetic)
            every = np.arange(self._every, len(states) - 1, self._every)
            rows = np.union1d(np.append(every, len(states) - 1), marked)
            # Rows that follow each other are not copied.
            part = slice(rows[0], rows[-1] + 1) if rows[-1] - rows[0] == len(rows) - 1 else rows
            look = self._guards.look(states[part], dissipated[part])
            if too_long or look.wrong.any():
                self._stop(states, dissipated, marked)
            self._accept(states, dissipated, rows, look, marked)
        self.dissipated = float(dissipated[-1])

    def _marked(self, time: Floats) -> NDArray[np.int64]:
        """Rows of the times that are marked; the first row was the last of the batch before."""
        marks = np.array(self._marks, dtype=float)
        rows = np.searchsorted(time, marks)
        rows = rows[rows < len(time)]  # marks to come have no row yet
        return rows[(time[rows] == marks[: len(rows)]) & (rows > 0)]

    def _dissipated(self, states: States, batch: Batch) -> Floats:
        """(k,) energy taken out until each state [J]."""
        given = states.given_work
        if batch.taken is not None:
            return self._base + batch.taken - given
        work = states.work_taken() - np.diff(given)
        if self._push is not None:
            work = work - np.einsum("kna,na->k", np.diff(states.position, axis=0), self._push)
        return np.cumsum(np.concatenate([[self.dissipated], work]))  # whatever the batches are

    def _accept(
        self,
        states: States,
        dissipated: Floats,
        rows: NDArray[np.int64],
        look: GuardValues,
        marked: NDArray[np.int64],
    ) -> None:
        """Take states that have nothing wrong with them."""
        self._guards.accept(look, -1)
        self.last_good = states.state(len(states) - 1)
        self.peaks.look(states.time, states.tension, marked.tolist())
        if self._element_peaks is not None:
            self._element_peaks.look(states.time, states.tension)
        del self._marks[: len(marked)]
        if len(marked) and not self._drifted:
            off = look.off[np.searchsorted(rows, marked)] > GOOD_PART
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
        """A run that goes back to the safe state has the memories of its time."""
        kept = self._kept_at.get(self.safe.time)
        if kept is not None:
            self.safe = replace(self.safe, memory={**self.safe.memory, **kept})
        self._kept_at = {time: one for time, one in self._kept_at.items() if time > self.safe.time}

    def _stop(self, states: States, dissipated: Floats, marked: NDArray[np.int64]) -> NoReturn:
        """Raise RunStopped for the first state of a batch that is wrong."""
        look = self._guards.look(states, dissipated)
        bad = int(np.argmax(look.wrong))
        if bad:
            before = np.arange(bad)
            self._accept(states[:bad], dissipated[:bad], before, look[:bad], marked[marked < bad])
            self.dissipated = float(dissipated[bad - 1])
        shown = states.state(bad) if look.finite[bad] else self.last_good
        where = TURNING if look.turns_too_fast(bad) else SNAPPING
        advice = step_advice(self._plan, where) if look.of_steps(bad) else LOAD_ADVICE
        raise RunStopped(
            f"diverged at t = {states.time[bad]:.6g} s: {look.words(bad)}; "
            f"{state_of_worst(self._system, shown)}. {advice}",
            step_cause=look.of_steps(bad),
        )
