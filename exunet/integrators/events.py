"""The events of a run: switching functions looked at when a step is accepted, memories that they change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import cast

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import RunStopped
from exunet.forces.blocks import AWAKE
from exunet.forces.terms import Change, Seen, Switch, Watch
from exunet.integrators.protocol import Arrays, Observer
from exunet.model.energy import total
from exunet.model.system import System


def _memories(name: str, change: Change) -> dict[str, Floats]:
    awake = {} if change.awake is None else {AWAKE: change.awake}
    return {**change.others, name: change.memory, **awake}


class Events:
    """The memories of a scene's terms, and who changes them when.

    memory   : the values of each memory now, by name
    any      : True if there are any
    """

    def __init__(self, system: System, memory: Arrays, observer: Observer) -> None:
        self._system = system
        self.memory = {name: np.array(values, dtype=float) for name, values in memory.items()}
        self._observer = observer
        self._switches: list[tuple[str, Switch]] = []
        self._sees: dict[str, tuple[str, ...]] = {}
        self._watch: tuple[str, Watch] | None = None
        self._reported: tuple[tuple[str, int], ...] = ()
        for term, switch in system.forces.switches:
            assert term.memory is not None
            self._switches.append((term.memory.name, switch))
            inputs = term.inputs if switch.sees_inputs else ()
            self._sees[term.memory.name] = tuple(item.name for item in inputs)
            if term is system.forces.script:
                watch = cast("Watch", switch)
                self._watch = term.memory.name, watch
                self._sees[term.memory.name], self._reported = watch.sees, watch.reports
        self.any = bool(self._switches)

    @property
    def in_steps(self) -> bool:
        """True if one may come at a time that is not known beforehand."""
        return any(switch.in_steps(self._seen(name)) for name, switch in self._switches)

    def _seen(self, name: str) -> Floats:
        """The memory of a term, followed by the inputs, or other memories, that its switch sees, and by the
        numbers that it observes.
        """
        own, others = self.memory[name], self._sees[name]
        reported = self._reported if self._watch is not None and name == self._watch[0] else ()
        if not others and not reported:
            return own
        numbers = [self.memory[one][place] for one, place in reported]
        return np.concatenate([own, *(self.memory[other] for other in others), numbers])

    @property
    def stopped(self) -> bool:
        """True if the run has been ended."""
        return self._watch is not None and self._watch[1].stops(self.memory[self._watch[0]])

    def is_due(self, time: float) -> bool:
        """True at the start of a run in which something is planned for then."""
        return min(self._planned, default=np.inf) <= time

    @property
    def _planned(self) -> Iterator[float]:
        """The instants that switches have planned."""
        return chain.from_iterable(switch.instants(self.memory[name]) for name, switch in self._switches)

    @property
    def watches(self) -> bool:
        """True while conditions are watched, whose crossings are to be located in steps."""
        return self._watch is not None and self._watch[1].in_steps(self.memory[self._watch[0]])

    @property
    def watch(self) -> Watch | None:
        """What watches, if anything does."""
        return None if self._watch is None else self._watch[1]

    def seen(
        self, time: Floats, x: Floats, v: Floats, reported: Floats | None = None, mean: Floats | None = None
    ) -> Seen:
        """States at the ends of steps (k,), as what watches gets them.

        reported, mean : see `Seen`; without reported: of one state, with the present memories
        """
        assert self._watch is not None
        memory = self._seen(self._watch[0])
        reported = memory[None, len(memory) - len(self._reported) :] if reported is None else reported
        return Seen(time, x, v, memory, reported, mean)

    def comes_true(self, steps: Seen) -> int | None:
        """See `Watch.comes_true`."""
        assert self._watch is not None
        return self._watch[1].comes_true(steps)

    def crossing(self, begin: Seen, end: Seen) -> float | None:
        """See `Watch.crossing`."""
        assert self._watch is not None
        return self._watch[1].crossing(begin, end)

    def steps_done(self, steps: Seen) -> None:
        """Let what watches remember accepted steps."""
        assert self._watch is not None
        name, watch = self._watch
        after = watch.remembered(steps)
        if after is not None:
            self.memory[name] = after

    @property
    def kept(self) -> dict[str, Floats]:
        """The memories that change at the end of steps without an event, as copies."""
        if self._watch is None:
            return {}
        return {self._watch[0]: self.memory[self._watch[0]].copy()}

    def report(
        self, time: float, remembered: Iterable[tuple[str, Floats]], flush: Callable[[], None]
    ) -> None:
        """Report to the observer what memories without events are at a time [s]; raises what it raises.

        remembered : those that forces change, with their names
        flush  : lets the observer see the states so far; it knows which of them are good
        """
        kept = {name: values.copy() for name, values in remembered} | self.kept
        if not kept:
            return
        try:
            self._observer.remembered(time, kept)
        except RunStopped:
            flush()
            raise

    def memory_after(self, name: str, change: Change) -> dict[str, Floats]:
        """All memories once a change of one has come into force."""
        return self.memory | _memories(name, change)

    def _at_rest(self, change: Change, v: Floats) -> Change:
        """What goes to sleep has no velocity."""
        if change.awake is None:
            return change
        if AWAKE not in self.memory:
            raise ValueError("an event wakes points of a system in which none sleeps: give Blocks.awake")
        speed = (v if change.v is None else change.v).copy()
        speed[: 3 * len(change.awake)] *= np.repeat(change.awake, 3)
        return replace(change, v=speed)

    def _booked(self, change: Change, name: str, time: float, x: Floats, v: Floats) -> Change:
        """Add the energy that is lost, if that is the change of the energy of the system."""
        if change.energy_lost is not None:
            return change
        after = x if change.x is None else change.x, v if change.v is None else change.v
        before = total(self._system, time, x, v, self.memory)
        lost = before - total(self._system, time, *after, self.memory_after(name, change))
        first = self._system.blocks.n_x - self._system.blocks.n_states
        given = float(self._system.given_work(after[0][first:] - x[first:]))
        own = lost + given  # what a guide gives with the event is in the guide's books
        change = replace(change, energy_lost=own, work_given=given)
        if len(change.events) != 1:
            return change
        return replace(change, events=(replace(change.events[0], energy_lost_J=own),))

    def next_instant(self, after: float, until: float) -> float:
        """The first known instant of an event later than `after`, or of a knot of a guide, or `until` [s]."""
        times = (time for _, switch in self._switches for time in switch.times)
        every = chain(times, self._planned, self._system.kinematics.knots)
        return min((time for time in every if after < time < until), default=until)

    def step_within(self, step: float, least: float, x: Floats, v: Floats) -> float:
        """A step [s] that ends near what would happen next; see `Switch.step_within`."""
        for name, switch in self._switches:
            step = switch.step_within(step, least, x, v, self._seen(name))
        return step

    def at(self, time: float, x: Floats, v: Floats) -> Iterator[tuple[str, Change]]:
        """What happens at the end of an accepted step; memories change, and the observer is notified.

        Terms come in their order, the constraint last; a switch is asked again at once if its change says so,
        and those before the script whose memories it has changed once it is done.

        x, v : changed by the integrator after each event, so that the next one acts on the new state
        """
        for k, (name, switch) in enumerate(self._switches):
            others = set[str]()
            for change in self._of(name, switch, time, x, v):
                others.update(change.others)
                yield name, change
            if self.stopped:
                return
            for before, one in self._switches[:k]:
                if before in others:
                    yield from ((before, change) for change in self._of(before, one, time, x, v))

    def _of(self, name: str, switch: Switch, time: float, x: Floats, v: Floats) -> Iterator[Change]:
        """What one switch does."""
        more = True
        while more and not self.stopped and len(items := switch.crossed(time, x, v, self._seen(name))):
            change = switch.change(time, x, v, self._seen(name), items, self.memory)
            change = self._booked(self._at_rest(change, v), name, time, x, v)
            if change.stops:
                self._observer.ends(time)
            yield change  # the integrator hands over the states before first
            self.memory |= _memories(name, change)
            if not change.quiet:
                self._observer.changed(time, name, change)
            more = change.more
