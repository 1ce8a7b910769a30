"""Observers of a run: what they see, the energy balance with its guards, extremes of all steps, events."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import finite_number
from exunet.base.arrays import Floats
from exunet.base.errors import RunStopped
from exunet.base.files import group_of, grouped
from exunet.base.run_events import RunEvent, ScriptEvent, tagged, untagged
from exunet.forces.contact.status import TooFast
from exunet.forces.terms import Change, DiscreteStates
from exunet.integrators.protocol import Arrays, IntegrationFailed
from exunet.kernels.kernel import term_kernel
from exunet.methods.method import Plan, turning_polynomial
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.results.run_record import Peak
from exunet.simulation.block import Observed
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


class Event(NamedTuple):
    """An event: when [s], the discrete state that belongs to it, what it did, the state after it."""

    time: float
    discrete: str
    change: Change
    after: States | None = None


class Observer:
    """Observer of a run.

    every_step : True if it is to see the state after each step, not one in many
    """

    every_step: bool = False

    def observe(self, steps: Observed) -> None:
        """See accepted states; an exception ends the run at the last stored state before them."""

    def changed(self, event: Event) -> None:
        """See an event; no states before and after it come together."""

    def built(self, plan: Plan, items: dict[str, int], seconds: float) -> None:
        """See the plan of the run from now on, and the items of its engine, built in a time [s]."""

    def retried(self, stopped: str, time: float, plan: Plan) -> None:
        """See why the run goes on from an earlier state at a time [s] with a finer plan."""

    def save(self) -> dict[str, NDArray[Any]]:
        """Return copies of all that changes, for a snapshot and for a run that goes back."""
        return {}

    def load(self, arrays: Arrays) -> None:
        """Go back to what `save` returned."""

    def report(self) -> dict[str, float]:
        """Return finite real numbers, by name, for the record of the result; it has None for other values."""
        return {}


class RunningExtremes(Observer):
    """Largest tensions of all steps so far; where a run stores states also energies, and of each element.

    A snap may be shorter than the time between two stored states, which then do not show it.

    stores    : energies and tensions of each element are wanted
    largest   : (n_groups, 3) see `Extremes`
    intervals : (m, 2) largest elastic and least kinetic energy [J] of the intervals that end at the marks of
                the states seen last
    elements  : (n_elements,) largest tensions [N]
    """

    def __init__(self, system: System, *, stores: bool = False) -> None:
        self._groups, self._stores = dict(system.net.spans), stores
        self.largest = np.tile([0.0, 0.0, -1.0], (len(self._groups), 1))
        self.elements = np.zeros(system.net.n_elements if stores else 0)
        self._energies = np.array([0.0, np.inf])
        self.intervals = np.zeros((0, 2))

    def observe(self, steps: Observed) -> None:
        states, tension = steps.states, steps.states.tension
        last = next((seen for seen in reversed(steps.extremes) if seen is not None), None)
        for k, group in enumerate(self._groups.values()):
            if last is not None and last.largest[k, 0] > self.largest[k, 0]:
                self.largest[k] = last.largest[k]
            own = tension[:, group.start : group.stop]
            largest = own.max(axis=1, initial=0.0)
            row = int(np.argmax(largest))
            if largest[row] > self.largest[k, 0]:
                self.largest[k] = largest[row], states.time[row], group.start + np.argmax(own[row])
        if self._stores:
            self.elements = np.maximum(self.elements, tension.max(axis=0))
            if last is not None:
                self.elements = np.maximum(self.elements, last.of_elements)
            self._observe_energies(steps)

    def _observe_energies(self, steps: Observed) -> None:
        """Close the interval of each mark; both states at its ends belong to it."""
        states, begins = steps.states, np.array([0, *(mark + 1 for mark in steps.marks)])
        # With a row behind the last, so that each interval has one.
        largest = np.maximum.reduceat(np.append(states.elastic, 0.0), begins)
        least = np.minimum.reduceat(np.append(states.kinetic, np.inf), begins)
        found = np.stack([largest, least], axis=1)
        found[0] = max(largest[0], self._energies[0]), min(least[0], self._energies[1])
        for row, seen in zip(found, steps.extremes, strict=False):
            if seen is not None:
                row[:] = max(row[0], seen.energies[0]), min(row[1], seen.energies[1])
        self.intervals, self._energies = found[:-1], found[-1]

    def save(self) -> dict[str, NDArray[Any]]:
        return {
            "largest": self.largest.copy(),
            "elements": self.elements.copy(),
            "energies": self._energies.copy(),
        }

    def load(self, arrays: Arrays) -> None:
        self.largest, self.elements, self._energies = (
            np.array(arrays[name]) for name in ("largest", "elements", "energies")
        )

    def of_groups(self) -> dict[str, Peak]:
        """Return the largest tension of each group, by name."""
        largest = zip(self._groups, self.largest.tolist(), strict=True)
        return {name: Peak(tension, time, int(element)) for name, (tension, time, element) in largest}


class EventLog(Observer):
    """Events of a run, in order."""

    def __init__(self, system: System) -> None:
        self.events: list[RunEvent] = []
        if system.ejection is not None and system.ejection.event is not None:
            self.events = [system.ejection.event]

    def changed(self, event: Event) -> None:
        self.events = [*self.events, *event.change.events]

    def save(self) -> dict[str, NDArray[Any]]:
        text = json.dumps([tagged(event) for event in self.events]).encode()
        return {"events": np.frombuffer(text, dtype=np.uint8).astype(np.int64)}

    def load(self, arrays: Arrays) -> None:
        self.events = [untagged(event) for event in json.loads(arrays["events"].astype(np.uint8).tobytes())]

    @property
    def phase(self) -> str:
        """Last entry of the script that has happened; "" without."""
        events = (event for event in reversed(self.events) if isinstance(event, ScriptEvent))
        return next((event.entry for event in events if event.done), "")


# The guards check one state in so many, and all before a state that exceeds a bound.
STATES_A_LOOK = 32
# A run may go back to a state whose energy balance is within this part of the bound of the guards: so steps
# that failed have at most a tenth of the allowed error.
GOOD_PART = 0.1


class Judged(NamedTuple):
    """Which of some states are valid: their number, the safe ones among their marks, why the run stops."""

    valid: int
    safe: list[int]
    stop: RunStopped | None = None


class EnergyBalance(Observer):
    """Energy balance of a run, and the guards that check it.

    every      : the guards check one state in so many, marked states, and the last one
    dissipated : energy dissipated so far [J], without the work of prescribed bodies and drives
    last       : the last valid state, for messages
    """

    _plan: Plan

    def __init__(self, system: System, state: State, *, every: int = STATES_A_LOOK) -> None:
        self._system, self._every = system, every
        self._guards = Guards(system, state)
        self._external: Floats | None = None
        discrete_states = (term.discrete for term in system.forces.discrete_states)
        self._wrong = {
            discrete.name: discrete.wrong for discrete in discrete_states if discrete and discrete.wrong
        }
        self.dissipated = system.lost_at_start
        self.begin(state)

    def begin(self, state: State) -> None:
        """Go on from a state with another stepper."""
        self._base = self.dissipated + float(self._system.given_work(state.first_order))
        self.last, self._drifted = state, False

    @property
    def energy_scale(self) -> float:
        """Energy scale of the guards [J]."""
        return self._guards.scale

    def built(self, plan: Plan, items: dict[str, int], seconds: float) -> None:
        self._plan = plan
        self._guards.explain(plan, turning_polynomial(plan.method, plan.backend))

    def set_external_force(self, force: Floats) -> None:
        """Set external forces (n_points, 3) [N], whose work counts in the energy balance."""
        self._external = force.copy() if force.any() else None

    def until_each(self, states: States) -> Floats:
        """Compute (k,) dissipated energies until each state [J]."""
        with np.errstate(all="ignore"):
            given = states.given_work
            if states.taken is not None:
                return self._base + states.taken - given
            work = states.work_taken() - np.diff(given)
            if self._external is not None:
                work = work - np.einsum("kna,na->k", np.diff(states.position, axis=0), self._external)
            return np.cumsum(np.concatenate([[self.dissipated], work]))  # independent of the batches

    def observe(self, steps: Observed) -> None:
        self.dissipated = float(steps.dissipated[-1])
        self.last = steps.states.state(len(steps.states) - 1)

    def changed(self, event: Event) -> None:
        self.dissipated += (event.change.energy_lost or 0.0) - event.change.work_given

    def save(self) -> dict[str, NDArray[Any]]:
        own = [self.dissipated, self._base, float(self._drifted)]
        return {"gained": self._guards.gained.copy(), "balance": np.array(own)}

    def load(self, arrays: Arrays) -> None:
        self._guards.gained = np.array(arrays["gained"])
        self.dissipated, self._base, drifted = map(float, arrays["balance"])
        self._drifted = bool(drifted)

    def engine_failed(self, failure: Exception, *, step_cause: bool) -> RunStopped:
        """Return the error for a stepper that failed, with its message and the last valid state."""
        last = self.last
        where = where_steps_fail(States.of(self._system, last))
        advice = step_advice(self._plan, where) if step_cause else COLLAPSE_ADVICE
        words = f"the engine stopped after t = {last.time:.6g} s: {failure}; "
        words += f"{state_of_worst(self._system, last)}. {advice}"
        return RunStopped(words, step_cause=step_cause)

    def why_wrong(self, discrete: DiscreteStates) -> str:
        """Return why a run must stop with discrete states that steps have changed; "": it need not."""
        checks = ((self._wrong[name], discrete[name]) for name in discrete if name in self._wrong)
        return next((words for check, values in checks if (words := check(values))), "")

    def judge(self, steps: Observed) -> Judged:
        """Check states by the guards."""
        for k, discrete in enumerate(steps.discrete_states if self._wrong else ()):
            if words := self.why_wrong(discrete):  # states until the mark before are valid
                before = steps.marks[k - 1] if k else 0
                found = self._judge(steps.between(0, before)) if before else Judged(1, [])
                stop = RunStopped(words, step_cause=isinstance(words, TooFast))
                return found if found.stop else found._replace(stop=stop)
        return self._judge(steps)

    def _judge(self, steps: Observed) -> Judged:
        states, dissipated, marks = steps.states, steps.dissipated, np.array(steps.marks, dtype=np.int64)
        with np.errstate(all="ignore"):  # the guards check for overflow
            # The longest element is checked in every state: its peak may last for a single one.
            too_long = (states.length > states.longest).any()
            every = np.append(np.arange(self._every, len(states) - 1, self._every), len(states) - 1)
            rows = np.union1d(every, marks)
            truncated = self._guards.truncated(states, every)[np.searchsorted(every, rows)]
            values = self._guards.look(states[rows], dissipated[rows], truncated)
            bad = len(states)
            if too_long or values.wrong.any():  # then all states are checked
                rows = np.arange(len(states))
                values = self._guards.look(states, dissipated, self._guards.truncated(states, rows))
                if values.wrong.any():  # else the bounds know more of the forces by all states
                    bad = int(np.argmax(values.wrong))
            accepted = int(np.searchsorted(rows, bad))
            if accepted:
                self._guards.gained = values.gained[:, accepted - 1]
            safe = self._safe(values, rows, marks[marks < bad])
        return Judged(bad, safe, self._stop(states, values, bad) if bad < len(states) else None)

    def _safe(self, values: GuardValues, rows: NDArray[np.int64], marks: NDArray[np.int64]) -> list[int]:
        """Return the marks until the energy balance drifts, for good."""
        if self._drifted or not len(marks):
            return []
        off = values.off[np.searchsorted(rows, marks)] > GOOD_PART
        self._drifted = bool(off.any())
        good: list[int] = (marks[: int(np.argmax(off))] if self._drifted else marks).tolist()
        return good

    def _stop(self, states: States, values: GuardValues, bad: int) -> RunStopped:
        """Return the error for the first state that exceeds a bound."""
        last = states.state(bad - 1) if bad else self.last
        shown = states.state(bad) if values.finite[bad] else last
        words = beyond_table(states, bad) if values.finite[bad] else ""
        if words and not values.of_steps(bad):
            return RunStopped(f"stopped at t = {states.time[bad]:.6g} s: {words}")
        advice = LOAD_ADVICE
        if values.of_steps(bad):
            with np.errstate(all="ignore"):
                where = TURNING if values.turns_too_fast(bad) else where_steps_fail(states[: bad + 1])
            advice = step_advice(self._plan, where)
        return RunStopped(
            f"diverged at t = {states.time[bad]:.6g} s: {words or values.words(bad)}; "
            f"{state_of_worst(self._system, shown)}. {advice}",
            step_cause=values.of_steps(bad),
        )


class Saved(NamedTuple):
    """A state to which a run may go back, and what its observers saved there."""

    state: State
    observers: dict[str, dict[str, NDArray[Any]]]


class Observers:
    """Observers of a run from its first state, which see blocks of states; where a run may go back to.

    own     : by name, in order; "record" stores marked states
    balance : energy balance and guards; None: no state is checked
    stores  : one of the observers is a record
    safe    : the last state from which a failed run may go on with finer steps
    stored  : the last marked state
    """

    def __init__(self, system: System, state: State, own: Mapping[str, Observer]) -> None:
        self.system, self.first, self._all, self.stores = system, state, own, "record" in own
        self.balance = next((each for each in own.values() if isinstance(each, EnergyBalance)), None)
        self._last = States.of(system, state)
        self.safe = self.stored = self._saved(self._last, 0, {})

    @property
    def every_step(self) -> bool:
        """True if one is to see the state after each step."""
        return any(observer.every_step for observer in self._all.values())

    def report(self) -> dict[str, float | None]:
        """Return the numbers that observers have for the record of the result; None: no finite number."""
        reports = (observer.report() for observer in self._all.values())
        return {str(name): finite_number(value) for own in reports for name, value in own.items()}

    def start(self) -> None:
        """Show the first state as a marked one, with discrete states as after a step that ends there."""
        first, kernels = self._last, self.system.forces.kernels
        kept = dict(first.discrete)
        if any(term.discrete is not None and term.discrete.series for term in kernels):
            (time,), (x,), (v,), size = first.time, first.x, first.v, self.system.blocks.n_force
            kept |= term_kernel(kernels).remembered(time, x, v, size, first.discrete)
        dissipated = np.array([0.0 if self.balance is None else self.balance.dissipated])
        self._observe(Observed(first, [0], [kept], [None], dissipated))
        self.safe = self.stored = self._saved(first, 0, {})

    def see(self, steps: Observed) -> None:
        """Show states, split where the run may go back to; raise RunStopped at one that is not valid."""
        judged, last = Judged(len(steps.states), steps.marks), len(steps.states) - 1
        with np.errstate(all="ignore"):
            if 2 * len(steps.marks) > last:  # then of all, which parts then have
                steps.states.elastic, steps.states.kinetic, steps.states.potential  # noqa: B018
            if self.balance is not None:
                steps = steps._replace(dissipated=self.balance.until_each(steps.states))
                judged = self.balance.judge(steps)
            stored = [mark for mark in steps.marks if mark < judged.valid][-1:]
            at = 0
            for mark in sorted({*judged.safe[-1:], *stored}):
                self._observe(steps.between(at, mark))
                self.stored = self._saved(steps.states, mark, steps.discrete_states[steps.marks.index(mark)])
                if mark in judged.safe:
                    self.safe = self.stored
                at = mark
            if judged.stop is not None:
                raise judged.stop
            if at < last:
                self._observe(steps.between(at, last))

    def _observe(self, steps: Observed) -> None:
        for observer in self._all.values():
            observer.observe(steps)
        self._last = steps.states[-1:]

    def changed(self, event: Event, discrete: DiscreteStates, kept: DiscreteStates) -> None:
        """Show an event that follows the last state, with the discrete states after it."""
        change, last = event.change, self._last
        x = last.x if change.x is None else change.x[None]
        v = last.v if change.v is None else change.v[None]
        self._last = States(self.system, last.time, x, v, discrete)
        for observer in self._all.values():
            observer.changed(event._replace(after=self._last))
        self.changed_at(event.time, discrete, kept)

    def changed_at(self, time: float, discrete: DiscreteStates, kept: DiscreteStates) -> None:
        """Let a run that goes back to the safe or the stored state do so after the events of its time [s]."""
        if time == self.stored.state.time:
            is_safe = time == self.safe.state.time
            self.stored = self._saved(self._last, 0, {**discrete, **kept})
            self.safe = self.stored if is_safe else self.safe

    def _saved(self, states: States, row: int, discrete: DiscreteStates) -> Saved:
        """Return a state, with the discrete states there that steps change, and what observers save."""
        state = states.state(row)
        own = {name: observer.save() for name, observer in self._all.items()}
        return Saved(replace(state, discrete={**state.discrete, **discrete}), own)

    def set_external_force(self, force: Floats) -> None:
        """Set external forces (n_points, 3) [N]."""
        if self.balance is not None:
            self.balance.set_external_force(force)

    def finds_wrong(self, discrete: DiscreteStates) -> bool:
        """Return True if a run must stop with discrete states that steps have changed."""
        return bool(discrete) and self.balance is not None and bool(self.balance.why_wrong(discrete))

    def engine_failed(self, failure: IntegrationFailed, *, step_cause: bool) -> RunStopped:
        """Return the error for a stepper that failed; raise the stepper's own where no state is checked."""
        if self.balance is None:
            raise failure
        return self.balance.engine_failed(failure, step_cause=step_cause)

    def built(self, plan: Plan, items: dict[str, int], seconds: float) -> None:
        """Show the plan from now on, and the items of its engine, built in a time [s]."""
        for observer in self._all.values():
            observer.built(plan, items, seconds)

    def retried(self, stopped: str, time: float, plan: Plan) -> None:
        """Show a retry."""
        for observer in self._all.values():
            observer.retried(stopped, time, plan)

    def back_to_safe(self) -> State:
        """Go back to the safe state, where another stepper begins."""
        state = self._back_to(self.safe)
        if self.balance is not None:
            self.balance.begin(state)
        return state

    def back_to_stored(self) -> State:
        """Go back to the last stored state, at which a run ends."""
        return self._back_to(self.stored)

    def _back_to(self, saved: Saved) -> State:
        for name, observer in self._all.items():
            observer.load(saved.observers[name])
        self._go_on_from(saved.state)
        return saved.state

    def _go_on_from(self, state: State) -> None:
        self._last = States.of(self.system, state)
        if self.balance is not None:
            self.balance.last = state

    def save(self) -> dict[str, NDArray[Any]]:
        """Return copies of all, each name with its group before it."""
        arrays = grouped("last", self._last.state(0).arrays())
        groups = {"": {name: observer.save() for name, observer in self._all.items()}}
        for which, saved in (("safe", self.safe), ("stored", self.stored)):
            arrays |= grouped(which, saved.state.arrays())
            groups[f"{which}:"] = saved.observers
        for which, every in groups.items():
            for name, own in every.items():
                arrays |= grouped(which + name, own)
        return arrays

    def load(self, arrays: Arrays) -> None:
        """Go back to what `save` returned."""

        def saved(which: str) -> Saved:
            state = State.from_arrays(group_of(which, arrays))
            return Saved(state, {name: group_of(f"{which}:{name}", arrays) for name in self._all})

        self.safe, self.stored = saved("safe"), saved("stored")
        self._go_on_from(State.from_arrays(group_of("last", arrays)))
        for name, observer in self._all.items():
            observer.load(group_of(name, arrays))
