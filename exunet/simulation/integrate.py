"""The loop of a run: step to the next stop or event, let it act, pass states to observers, go back and retry.

A *stop* is a time to which a run, or the caller of a simulation, goes. The state there is marked: it is
stored, and checked by the guards. Observers see blocks of states: before somebody reads a state, before an
event changes it, and when a block is full. They know two marked states: the last *stored* one, at which a
run that fails ends, and the last *safe* one, which the guards trust. A run that fails goes back to the safe
state, and on with finer steps through the same stops, with the same external forces and inputs.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import Interrupted, RunStopped
from exunet.base.files import group_of, grouped
from exunet.base.interrupt import postponed
from exunet.forces.terms import Change, Seen
from exunet.integrators.events import Events, discrete_states_of
from exunet.integrators.protocol import Arrays, IntegrationFailed, StepCounts, Stepper, Steps, StepsCollapsed
from exunet.methods.method import Plan, finer
from exunet.model.system import State
from exunet.simulation.block import Block
from exunet.simulation.external import ExternalInputs, Stops
from exunet.simulation.observers import Event, Observers

_MANY = 2**31  # steps: as many as a stepper takes in one go
_INTERVAL = 0.2  # [s] of wall time after which a run reacts to an interrupt
Checkpoint = Callable[[], None]
Make = Callable[[State, Plan], Stepper]  # a stepper at a state with a plan


class Integration:
    """A stepper on its way through the stops of a run, with events and observers, from their first state.

    retries  : how often a run that fails because of its steps goes back and on with finer ones
    together : stops that one call of the stepper may go through; more than 1 only without events, which is
               how each state that it returns is at a stop
    """

    def __init__(
        self, plan: Plan, make: Make, observers: Observers, *, retries: int = 0, together: int = 1
    ) -> None:
        self.plan, self._make, self.observers = plan, make, observers
        self.retries, self.spent, self.seconds = retries, StepCounts(), 0.0
        self.external = ExternalInputs(observers.system)
        self.acting = self.external.at_start
        self._stops, self._together, self._at_once = Stops(), together, 1
        self._begin_at(observers.first)

    def _begin_at(self, state: State) -> None:
        """Begin with a new stepper at a state, with the present plan."""
        began = clock.perf_counter()
        try:
            self.stepper = self._make(state, self.plan)
        except IntegrationFailed as failure:
            raise RunStopped(f"not started: {failure}") from failure
        self._discrete = state.discrete  # of states; without what steps have changed since
        self.events = Events(self.observers.system, self.stepper)
        self._block = Block(self.observers.system, state.time, *self.stepper.flat(), 16 + self._together)
        self._began: tuple[Seen, Arrays] | None = None  # state at the beginning of steps that are watched
        self._crossed = self._changed = False  # a condition came true; events changed discrete states
        self._to_come: list[int] = []  # numbers of steps to take without a test, the next one last
        self._let_act(self.external.at_start)  # which a new stepper has
        self.observers.built(self.plan, self.stepper.items, clock.perf_counter() - began)

    @property
    def counts(self) -> StepCounts:
        """Steps and force evaluations so far, of all attempts."""
        return self.spent + self.stepper.counts

    # From stop to stop

    def go(
        self, times: Sequence[float], checkpoint: Checkpoint | None = None, *, settle: bool = False
    ) -> None:
        """Go through times [s], or to the end of the run by a script.

        checkpoint : called after each stop
        settle     : let observers see all states at the end

        Raises RunStopped if the run fails and no retry is left, Interrupted on Ctrl-C.
        """
        # Stops after `last` are those of another `go`, of which an observer or controller calls this one.
        stops, last = self._stops, times[-1] if times else self.stepper.time
        stops.add(times, self.acting)
        try:
            while True:
                began = clock.perf_counter()
                ahead = None if self.events.stopped else stops.next(self.stepper.time, last, self._at_once)
                if ahead is None and not settle:
                    break
                try:
                    with postponed() as check_interrupt:  # Ctrl-C must not interrupt the check of a block
                        if ahead is None:
                            self._flush()
                            break
                        until, acting = ahead
                        self.act(acting)
                        self._advance(until, check_interrupt)
                except (RunStopped, IntegrationFailed) as failure:
                    self._retry(failure)
                    continue
                except KeyboardInterrupt:
                    raise self.interrupted() from None
                finally:
                    self.seconds += clock.perf_counter() - began
                if clock.perf_counter() - began < _INTERVAL:
                    self._at_once = min(2 * self._at_once, self._together)
                if checkpoint is not None:
                    checkpoint()
        except BaseException:
            stops.forget_after(self.stepper.time)
            raise
        stops.forget_until(self.observers.safe.state.time)

    def settle(self) -> None:
        """Let observers see all states; if steps failed, return to this time with finer steps."""
        self.go((), settle=True)

    def _advance(self, times: list[float], check_interrupt: Checkpoint) -> None:
        """Step to the next stop, or through some, and let events happen on the way."""
        until, events, stepper, self._changed = times[-1], self.events, self.stepper, False
        if events.any and events.is_due(stepper.time):
            self._happen()
        while stepper.time < until and not events.stopped:
            target = events.next_instant(stepper.time, until)
            self._step(times if target == until else [target], until)
            if events.any:
                self._happen()
            if stepper.time < until:
                check_interrupt()
        if self._changed and not self._block.replace_marked(kept := events.kept):
            self.observers.changed_at(stepper.time, self._discrete, kept)
        check_interrupt()

    # Steps and events

    def _step(self, times: Sequence[float], until: float) -> None:
        """Take steps to the last of some times, or fewer.

        Of several steps in one of which a condition that is watched comes true, those before it are taken
        again, then that step alone, which is made to end there.
        """
        events, most = self.events, None
        self._began, self._crossed = None, False
        if events.watches:
            most = self._to_come.pop() if self._to_come else _MANY
            self._begin()
        steps = self.stepper.step(times, most, self._should_end if events.any else None)
        if steps.watched is not None and len(steps.watched.time):
            first = events.comes_true(steps.watched)
            if first is not None and most != 1:
                self._to_come = [1, first] if first else [1]  # `first` steps end before it
                self._take_back()
                return
            self._crossed = first is not None
        if self._crossed:
            self._locate(steps, until)
        else:
            self._add(steps, until)

    def _should_end(self) -> bool:
        """At the end of an accepted step: True if a condition came true within it, or an event is due."""
        if self._began is not None:
            target = self.events.crossing(self._began[0])
            if target is not None and target < self.stepper.time:
                self._crossed = True
                return True
            self._begin()
        return self.events.happen()

    def _begin(self) -> None:
        """Begin steps in which conditions are watched."""
        self._began = self.events.now(), self.stepper.save()

    def _take_back(self) -> None:
        """Go back to the beginning of steps; the last counts as rejected."""
        assert self._began is not None
        self.stepper.load(self._began[1], self.stepper.counts.rejected + 1)

    def _locate(self, steps: Steps, until: float) -> None:
        """Make the last step end where a condition comes true in it; steps that end before are accepted."""
        came_true, tests_each_step = math.inf, steps.watched is None
        # Extremes come from steppers that have taken this step alone.
        self._add(steps._replace(states=steps.states[:-1], extremes=None), until)
        taken = [steps._replace(states=steps.states[-1:])]
        while True:
            assert self._began is not None
            target = self.events.crossing(self._began[0])
            if target is not None and target < self.stepper.time:
                came_true, taken = self.stepper.time, []
                self._take_back()
            else:
                for part in taken:
                    self._add(part, until)
                # A stepper that tests each step goes on by itself; others go on to where it had come true.
                goes_on = target is None and not tests_each_step and self.stepper.time < came_true < math.inf
                if not (goes_on and self.events.watches):
                    return
                self._begin()
                target, taken = came_true, []
            while self.stepper.time < target:
                part = self.stepper.step([target], 1)
                taken.append(part._replace(states=part.states.copy()))

    def _add(self, steps: Steps, until: float) -> None:
        """Add accepted steps to the block; a state at a stop is marked, and each where stops go together."""
        block, states, at, number = self._block, steps.states, 0, steps.states.time.size
        block.gather(steps.extremes)
        while at < number:
            first = block.rows
            at = block.add(states, at)
            ends = block.rows == block.room or self._together > 1
            if self._together > 1:
                block.mark({}, first)
            elif at == number and states.time[-1] == until:
                block.mark(kept := self.events.kept)
                ends = ends or not block.finite or self.observers.finds_wrong(kept)
            if ends:
                self._flush()

    def _flush(self) -> None:
        """Let observers see the states that they have not seen; raise RunStopped at one that is not valid."""
        if (steps := self._block.take(self._discrete)) is not None:
            self.observers.see(steps)

    def _happen(self) -> None:
        """Let what is due happen, twice where an event changes a state: it may make another due."""
        for _ in range(2):
            acts = False
            x, v = self.stepper.flat()
            for name, change in self.events.at(self.stepper.time, x, v):
                self._changed, acts = True, acts or not change.quiet
                self._apply(name, change)
                for held, new in ((x, change.x), (v, change.v)):
                    if new is not None:
                        held[:] = new
            if not acts:
                return

    def _apply(self, name: str, change: Change) -> None:
        """Apply an event; unless it is quiet, once observers have seen all states before it."""
        discrete = {**self.stepper.discrete, **discrete_states_of(name, change)}
        if change.quiet:
            self.stepper.change(change, discrete)
            return
        block, kept, time = self._block, self.events.kept, self.stepper.time
        if block.time != time:
            block.put(time, *self.stepper.flat())
        if change.stops and not block.replace_marked(kept) and time > self.observers.stored.state.time:
            block.mark(kept)
        self._flush()
        self.stepper.change(change, discrete)
        self._discrete = {**self._discrete, **discrete_states_of(name, change)}
        block.changed(change)
        self.observers.changed(Event(time, name, change), self._discrete, self.events.kept)

    # Going back

    def _failure(self, failure: IntegrationFailed) -> RunStopped:
        """Return the error for a stepper that failed: of its last states, else its own."""
        try:
            if failure.steps is not None:
                self._add(failure.steps, math.nan)
            self._flush()
        except RunStopped as stop:
            return stop
        return self.observers.engine_failed(failure, step_cause=not isinstance(failure, StepsCollapsed))

    def _retry(self, failure: RunStopped | IntegrationFailed) -> None:
        """Go back to the last safe state with finer steps; raise the error if no retry is left."""
        stop = failure if isinstance(failure, RunStopped) else self._failure(failure)
        plan = finer(self.plan) if stop.step_cause and self.retries else None
        if plan is None:
            self._end()
            raise stop
        self.plan, self.retries = plan, self.retries - 1
        self._go_back()
        self.observers.retried(str(stop), self.stepper.time, plan)

    def _go_back(self) -> None:
        self.spent = self.spent + self.stepper.counts
        self._begin_at(self.observers.back_to_safe())

    def _end(self) -> float:
        """End a run at its last stored state; one that stores nothing is then at its last safe state.

        A run that stores is over: its stepper stays where it was.
        """
        if self.observers.stores:
            return self.observers.back_to_stored().time
        self._go_back()
        return self.stepper.time

    def interrupted(self) -> Interrupted:
        """Return the error for Ctrl-C, with the last checked time, and end the run there."""
        with suppress(RunStopped):  # observers have the last valid state
            self._flush()
        return Interrupted(f"interrupted after t = {self._end():.6g} s")

    # External forces, snapshots

    def act(self, acting: Floats) -> None:
        """Set external forces and inputs from now on (see `ExternalInputs`); stops to come keep theirs."""
        if acting is not self.acting and not np.array_equal(acting, self.acting):
            self._flush()
            before, self.acting = self.acting, acting
            self._let_act(before)

    def _let_act(self, before: Floats) -> None:
        force, inputs = self.external.forces(self.acting), self.external.inputs(self.acting)
        self.observers.set_external_force(force)
        if inputs:
            self._discrete = {**self._discrete, **inputs}
            self.stepper.set_inputs(inputs)
        if not np.array_equal(force, self.external.forces(before)):
            self.stepper.set_external_force(force)

    def save(self) -> dict[str, NDArray[Any]]:
        """Return all that the run depends on from now on, for a snapshot."""
        return {
            "acting": self.acting.copy(),
            **grouped("discrete", {name: values.copy() for name, values in self._discrete.items()}),
            **grouped("stepper", self.stepper.save()),
            **grouped("block", self._block.save()),
            **grouped("stops", self._stops.save(self.observers.safe.state.time, self.stepper.time)),
            **self.observers.save(),
        }

    def load(self, arrays: Arrays, plan: Plan, retries: int, spent: StepCounts) -> None:
        """Go back to what `save` returned, with the plan, retries left and cost then."""
        self.observers.load(arrays)
        self.acting = np.array(arrays["acting"])
        self._stops.load(group_of("stops", arrays))
        self.retries, self.spent = retries, spent
        if plan != self.plan:
            self.plan = plan
            self._begin_at(self.observers.safe.state)
        self._discrete, self._to_come = group_of("discrete", arrays), []
        self.stepper.load(group_of("stepper", arrays))
        self._block.load(group_of("block", arrays))
        self.observers.set_external_force(self.external.forces(self.acting))  # steppers save their own
