"""The compiled loop as an `Integrator`: its steps under the eyes of guards, events, and the keyboard."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.integration import CompiledIntegration, loop_kernel
from exunet.backends.compiled.sight import THINNED, StepSight
from exunet.backends.compiled.work_space import (
    CLOCK,
    EqualSteps,
    Kept,
    Run,
    Stages,
    empty_rows,
    looks_at,
)
from exunet.backends.events import Events
from exunet.backends.protocol import Arrays, Observer, StepsCollapsed
from exunet.base.errors import InputError
from exunet.base.interrupt import postponed
from exunet.bodies.kinematics import OnGuided, sites_of, steer
from exunet.bodies.port import Piece
from exunet.codegen.kernel import Kernel
from exunet.forces.terms import Seen
from exunet.methods.plan import Plan
from exunet.system.system import Moving, State, System

Floats = NDArray[np.float64]

_ROWS = 256  # states that the guards look at in one go
_ATTEMPTS = 2000  # steps between two looks at the keyboard
_ROWS_TO_LOCATE = 16  # that steps to a crossing in a step may take


class EventsFound(IntEnum):
    """Whether anything was due: nothing; quiet events only, after which nothing else is; more may be."""

    NOTHING = 0
    ALL = 1
    MORE = 2


class _Before(NamedTuple):
    """The beginning of steps, the row of states to come, and all else that steps change, with copies."""

    begin: Seen
    row: int
    arrays: tuple[tuple[NDArray[Any], NDArray[Any]], ...]


class CompiledLoop(CompiledIntegration):
    """The integrator without an engine.

    One state in some is handed over, but none is left out in which an element may be stretched beyond the
    law's validity; energies and tensions of the others are reported as extremes.
    """

    items: dict[str, int] = {}  # noqa: RUF012 - it has none
    can_restart = True

    def __init__(
        self, system: System, state: State, plan: Plan, observer: Observer, kernel: Kernel | None = None
    ) -> None:
        super().__init__(system, state, plan, kernel or loop_kernel(system))
        self._observer = observer
        self._events = Events(system, state.memory, observer)
        self._sight = StepSight(system, self._seen, observer)
        rows = max(16, min(_ROWS, 2**19 // max(1, len(self._motion.v))))
        self._kept = empty_rows(rows, system)
        self._looks = looks_at(self._events.watch, system, self._table)
        self._hold()
        self._moving = self._layout.unpack(self._motion.x, self._motion.v)  # views
        self._looks_to_come: list[int] = []  # after how many steps, the next one last; none: as many as fit
        self._ports = _steady_ports(system, state)
        if state.memory:
            self._remember(state.memory)
        self._steer_all()
        self._row = self._module.keep(0, state.time, self._motion, self._kept)

    @property
    def room(self) -> int:
        return len(self._kept.time)

    def _recall(self) -> None:
        """Take over the memories that the kernel has changed itself."""
        for name, values in self._table.kept.items():
            self._events.memory[name][:] = values

    def state(self) -> State:
        self._recall()
        m = self._motion
        memory = {name: values.copy() for name, values in self._events.memory.items()}
        moving = self._layout.unpack(m.x.copy(), m.v.copy())
        return State.of(self.time, moving.completed(self._system.kinematics, self.time, memory), memory)

    def push(self, force: Floats) -> None:
        self._motion.push[: force.size] = force.ravel()
        self._motion.pushed[0] = float(self._motion.push.any())
        self._module.begin(self.time, self._verlet, self._motion)

    def tell(self, inputs: Arrays) -> None:
        self._recall()
        for name, values in inputs.items():
            self._events.memory[name] = values.copy()
        self._remember(self._events.memory)
        self._module.begin(self.time, self._verlet, self._motion)

    def steer(self, port: str, piece: Piece) -> None:
        self.steered(port)  # or there is none
        self._ports[port] = piece
        steer(self._sites[port], piece)
        if self._bears:
            self._module.begin(self.time, self._verlet, self._motion)

    def steered(self, port: str) -> Piece:
        found = self._ports.get(port) if isinstance(port, str) else None
        if found is None:
            there = ", ".join(self._ports) or "none"
            raise InputError(f'there is no body {port!r} of motion = "port" (there: {there})')
        return found

    def _steer_all(self) -> None:
        data, blocks = self._table.data, self._system.blocks
        # A guided body that holds masses has forces on it that jump with its acceleration.
        self._bears = any(isinstance(part, OnGuided) for part in data)
        self._sites = {name: sites_of(data, blocks.centre(name)) for name in self._ports}
        for name, piece in self._ports.items():
            steer(self._sites[name], piece)

    def moving(self) -> Moving:
        return self._moving

    def view(self) -> State:
        self._recall()
        return State.of(self.time, self._moving, self._events.memory)

    def advance(self, until: float) -> None:
        self._sight.begin()
        if self._events.is_due(self.time):
            self._look_for_events()
        with postponed() as check_interrupt:
            while self.time < until and not self.stopped:
                stop = self._events.next_instant(self.time, until)
                advance = self._advance_chosen if self._chosen else self._advance_equal
                if advance(stop, check_interrupt) == EventsFound.MORE:
                    self._look_for_events()
        until = min(until, self.time)
        self._observer.between(until, self._sight.extremes)
        self._events.tell(until, self._table.kept.items(), self.hand_over)
        if not math.isfinite(np.dot(self._motion.x, self._motion.x)):  # a square may overflow; no harm
            self.hand_over()

    @property
    def stopped(self) -> bool:
        return self._events.stopped

    def _advance_chosen(self, until: float, check_interrupt: Callable[[], None]) -> EventsFound:
        """Steps to a time [s], or until an event plans something before it; what was found at their end."""
        found = EventsFound.NOTHING
        while self.time < until:
            if self._events.in_each_step:
                self._shorten(until)
            before = self._before()
            limit, every = self._stretch
            self._row = self._module.chosen_stretch(self._control, until, limit, self._row, every, self._held)
            self._locate(before)
            self._make_room()
            if (found := self._look_for_events()) and self._is_otherwise(until):
                return found
            if words := self.collapse():
                self.hand_over()
                raise StepsCollapsed(words)
            check_interrupt()
        return found

    def _advance_equal(self, until: float, check_interrupt: Callable[[], None]) -> EventsFound:
        """The same."""
        found = EventsFound.NOTHING
        begin, before = self.time, int(self._steps[0])
        number = max(1, math.ceil((until - begin) / (self._plan.step or math.inf) * (1 - 1e-9)))
        done = 0
        while done < number:
            at_begin = self._before()
            limit, every = self._stretch
            steps = EqualSteps(begin, until, number, done, limit)
            self._row = self._module.equal_stretch(self._verlet, steps, self._row, every, self._held)
            located = self._locate(at_begin)
            done = int(self._steps[0]) - before
            self._make_room()
            if ((found := self._look_for_events()) and self._is_otherwise(until)) or located:
                return found
            check_interrupt()
        return found

    def _is_otherwise(self, until: float) -> bool:
        """True if an event has ended the run, or planned something between now and a time [s]."""
        return self.stopped or (self.time < until and self._events.next_instant(self.time, until) < until)

    def _before(self) -> _Before | None:
        """All that the next steps change, if crossings in them are to be located."""
        self._looks.at[:] = 0
        if not self._events.watches:
            return None
        self._looks.at[1] = self._looks_to_come.pop() if self._looks_to_come else len(self._looks.time)
        self._recall()
        if self._row + _ROWS_TO_LOCATE > self.room:
            self.hand_over()
        m = self._motion
        held = (m.taken, m.work[_A1], self._clock, self._seen.peaks, self._seen.largest)
        arrays = (*held, self._seen.of_elements, self._seen.longest, *self._table.kept.values())
        return _Before(self._now(), self._row, tuple((array, array.copy()) for array in arrays))

    def _now(self) -> Seen:
        m = self._motion
        return self._events.seen(np.array([self.time]), m.x[None].copy(), m.v[None].copy())

    def _go_back(self, before: _Before) -> None:
        """To the beginning of the last step, which counts as rejected."""
        m, rejections = self._motion, self._clock["rejections"] + 1
        m.x[:], m.v[:], self._row = before.begin.x[0], before.begin.v[0], before.row
        for array, values in before.arrays:
            array[:] = values
        self._clock["rejections"] = rejections
        self._recall()

    def _locate(self, before: _Before | None) -> bool:
        """Make the step just taken end where a condition that is watched comes true; True if steps are to be
        laid out anew from there.

        Several steps, in one of which that happens, are taken again: those before it, then it alone. Steps
        that end before the crossing are accepted as they are.
        """
        if before is None or self._looks.at[0] == 0:  # no attempt was accepted
            return False
        self._recall()
        looks, rows = self._looks, slice(int(self._looks.at[0]))
        mean = looks.mean[rows] if looks.weights.size else None
        x, v = looks.x[:, rows].T, looks.v[:, rows].T
        steps = self._events.seen(looks.time[rows], x, v, looks.told[rows], mean)
        first = self._events.comes_true(steps)
        if first is None:
            self._events.steps_done(steps)
            return False
        if not self._singly:
            self._looks_to_come = [1, first] if first else [1]
            self._go_back(before)
            return False
        self._looks.at[:] = 0
        beyond = math.inf
        while True:
            self._recall()
            now = self._now()
            target = self._events.crossing(before.begin, now)
            if target is not None and target < self.time:
                beyond = self.time
                self._go_back(before)
            else:
                self._events.steps_done(now)
                if target is not None or not self.time < beyond < math.inf:
                    break
                if (before := self._before()) is None:
                    break
                target = beyond  # on to where it had come true
            self._step_to(target)
        return math.isfinite(beyond)

    def _step_to(self, time: float) -> None:
        """By one step, or by more where its error would be too large."""
        if not self._chosen:
            number = max(1, math.ceil((time - self.time) / (self._plan.step or math.inf) * (1 - 1e-9)))
            steps = EqualSteps(self.time, time, number, 0, number)
            self._row = self._module.equal_stretch(self._verlet, steps, self._row, 1, self._held)
            return
        while self.time < time and not self.collapse():
            self._row = self._module.chosen_stretch(self._control, time, 1, self._row, 1, self._held)

    @property
    def _stretch(self) -> tuple[int, int]:
        """How many steps to take without a look at events, and of how many one is handed over."""
        if self._events.in_each_step:
            return 1, 1
        return _ATTEMPTS, 1 if self._looks.at[1] == 1 else THINNED

    @property
    def _singly(self) -> bool:
        """True if each step is kept, and looked at by itself."""
        return self._events.in_each_step or self._looks.at[1] == 1

    def _shorten(self, until: float) -> None:
        """Make the step that comes end near the next event."""
        beyond = float(self._clock["beyond"][0])
        step = min(beyond or float(self._clock["step"][0]), self._plan.longest_step, until - self.time)
        m = self._motion
        shorter = self._events.step_within(step, 8.0 * self._plan.least_step, m.x, m.v)
        if shorter < step:
            self._clock["step"][0] = shorter
            self._clock["beyond"][0] = min(beyond, shorter)

    def _look_for_events(self) -> EventsFound:
        """Let happen what is due."""
        found = EventsFound.NOTHING
        if not self._events.any:
            return found
        self._recall()
        m = self._motion
        for name, change in self._events.at(self.time, m.x, m.v):
            if change.quiet:
                found = found or EventsFound.ALL
                self._table.kept[name][:] = change.memory
                self._module.begin(self.time, self._verlet, self._motion)
                continue
            found = EventsFound.MORE
            self.hand_over()  # so that no batch has states from before and after
            m.taken[0] += change.energy_lost or 0.0
            if change.x is not None:
                m.x[:] = change.x
            if change.v is not None:
                m.v[:] = change.v
            self._row = self._module.keep(0, self.time, m, self._kept)
            self._remember(self._events.memory_after(name, change))
            self._module.begin(self.time, self._verlet, self._motion)
        return found

    def _remember(self, memory: Arrays) -> None:
        """Let the forces, and what looks at tensions, take all memories into account."""
        self._memory = memory
        self._table = self._kernel.table(memory)
        self._motion = self._motion._replace(data=self._table.rows)
        self._looks = self._looks._replace(memory=self._table.changed)
        self._steer_all()
        self._motion.inverse[:] = self._layout.inverse_mass(self._system, memory)
        self._hold()
        self._sight.remember(memory, self._motion.x)

    def _hold(self) -> None:
        self._held = self._module.hold(Run(self._motion, self._clock, self._seen, self._kept, self._looks))

    def _make_room(self) -> None:
        if self._row == len(self._kept.time):
            self.hand_over()

    def hand_over(self) -> None:
        rows = self._row
        if rows > 1:
            batch = self._batch(Kept(*(values[:rows].copy() for values in self._kept)), rows)
            for values in self._kept:
                values[0] = values[rows - 1]
            self._row = 1
            self._observer.take(batch)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        self._recall()
        m = self._motion
        arrays = {"x": m.x, "v": m.v, "a": m.work[_A1], "push": m.push, "taken": m.taken}
        arrays |= {f"clock/{name}": self._clock[name] for name in CLOCK.names or ()}
        arrays |= self._sight.arrays()
        arrays |= {f"kept/{name}": value[: self._row] for name, value in self._kept._asdict().items()}
        arrays |= {f"memory/{name}": value for name, value in self._events.memory.items()}
        arrays |= {f"port/{name}": piece.numbers() for name, piece in self._ports.items()}
        return {name: np.array(value) for name, value in arrays.items()}

    def restore(self, arrays: Arrays) -> None:
        m = self._motion
        for held, name in ((m.x, "x"), (m.v, "v"), (m.push, "push"), (m.taken, "taken")):
            held[:] = arrays[name]
        m.pushed[0] = float(m.push.any())
        for name in CLOCK.names or ():
            self._clock[name] = arrays[f"clock/{name}"]
        self._sight.restore(arrays)
        self._row = len(arrays["kept/time"])
        for name, values in self._kept._asdict().items():
            values[: self._row] = arrays[f"kept/{name}"]
        for name in self._ports:
            self._ports[name] = Piece.of_numbers(arrays[f"port/{name}"])
        for name in self._events.memory:
            self._events.memory[name] = np.array(arrays[f"memory/{name}"])
        self._remember(dict(self._events.memory))
        self._seen.peaks["elastic"] = arrays["seen/elastic"]
        m.work[_A1] = arrays["a"]


_A1 = Stages._fields.index("a1")  # in the rows of `Motion.work`


def _steady_ports(system: System, state: State) -> dict[str, Piece]:
    """The ports by name, each going on as it moves in a state."""
    found, bodies = {}, state.bodies
    for number in system.kinematics.ports:
        parts = (part[number] for part in bodies.parts())
        found[system.blocks.rigid[number]] = Piece.steady(state.time, *parts)
    return found
