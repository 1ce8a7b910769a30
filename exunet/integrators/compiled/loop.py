"""Compiled loop as an integrator: steps with guards, events and the keyboard between them."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.interrupt import postponed
from exunet.bodies.kinematics import OnGuided, sites_of, steer
from exunet.bodies.port import Piece
from exunet.forces.cable import elastic_energy, lengths
from exunet.forces.law import energy
from exunet.forces.loops import ViscousElements
from exunet.forces.reel import Winding
from exunet.forces.terms import Seen
from exunet.integrators.compiled.steps import IMPORTS, LOOP, STEPS, TINY_IN_A_ROW
from exunet.integrators.compiled.workspace import (
    CLOCK,
    OUTLET,
    PEAKS,
    EqualSteps,
    Kept,
    ObservedSteps,
    Run,
    Stages,
    StepLimits,
    clock_at,
    empty_states,
    largest_tensions_of,
    motion_of,
    no_extremes,
    no_samples,
    samples_of,
)
from exunet.integrators.events import Events
from exunet.integrators.protocol import Arrays, Extremes, Largest, Observer, StepCounts, StepsCollapsed
from exunet.kernels.compile import require_numba
from exunet.kernels.kernel import Kernel
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model.energy import law_of
from exunet.model.states import States
from exunet.model.system import Moving, State, System

_NO_STRESS = np.zeros(0)
OUTPUT_EVERY = 64  # one state in so many steps goes to the observer


class StepExtremes:
    """Sets what compiled steps observe (`ObservedSteps`), and reports extremes.

    No step is left out in which an element may be stretched beyond the law's validity (`keep_above`).
    """

    def __init__(self, system: System, seen: ObservedSteps, observer: Observer) -> None:
        self._system, self._seen = system, seen
        self._peaks = {name: seen.peaks[name] for name in PEAKS.names or ()}
        self._asleep = 0.0  # elastic energy [J] of the elements that the kernel leaves out
        self._peaks["keep_above"][0] = least_energy_beyond(system)
        # Elements that other terms have are looked at here too; their energy is not among the elements'.
        each = observer.asks_for_elements or system.forces.cable.leaves_some
        self._peaks["look_above"][0] = -1.0 if each else 0.0

    def begin(self) -> None:
        """Begin an interval whose extremes are reported together."""
        peaks = self._peaks
        peaks["elastic"][0], peaks["kinetic"][0] = 0.0, np.inf

    @property
    def extremes(self) -> Extremes:
        """Energies of the steps since `begin`, tensions of all steps."""
        elastic, kinetic = (float(self._peaks[name][0]) for name in ("elastic", "kinetic"))
        largest = largest_tensions_of(self._seen.largest)
        return Extremes(elastic + self._asleep, kinetic, largest, self._seen.of_elements)

    def remember(self, memory: Arrays, x: Floats) -> None:
        """Take all memories into account, in a state x (n_x,)."""
        self._count_asleep(memory, x)
        cable, seen = self._system.forces.cable, self._seen
        carrying = cable.carrying(memory)
        if carrying is not None:
            seen.stiffness[:] = cable.law.stiffness * carrying
        for number, winding in enumerate(cable.reels):
            self._see_outlet(number, winding, memory)
        seen.highest[:] = np.where(seen.twice_time > 0.0, 0.0, seen.length**2)

    def _see_outlet(self, number: int, winding: Winding, memory: Arrays) -> None:
        """Observe the outlet as an element from the drum to the first node outside."""
        seen, wound_up = self._seen, list(winding.reel.elements)
        nodes = self._system.net.element_nodes[wound_up]
        seen.first[wound_up], seen.second[wound_up] = 3 * nodes.T
        seen.length[wound_up] = self._system.forces.cable.law.natural_length[wound_up]
        seen.jumps[wound_up], seen.winding[wound_up] = seen.twice_time[wound_up], 0.0
        element, outlet = winding.outlet_now(memory)
        seen.first[element], seen.second[element] = outlet.drum[0], outlet.far[0]
        seen.stiffness[element], seen.jumps[element] = outlet.stiffness, 0.0
        places = element, outlet.state[0], outlet.rate[0]
        seen.outlets[number] = *places, outlet.base, outlet.least, outlet.ratio

    def _count_asleep(self, memory: Arrays, x: Floats) -> None:
        """The kernel leaves out elements between points that sleep; they count with the extremes."""
        cable, before = self._system.forces.cable, self._asleep
        moving = cable.moving(memory)
        if moving is not None:
            position = x[: 3 * self._system.blocks.n_points].reshape(-1, 3)
            law = law_of(self._system.forces, memory).of_intact((~moving).astype(float))
            self._asleep = float(elastic_energy(law, lengths(self._system.net, position)))
            self._peaks["elastic"] += before - self._asleep

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that was seen and what is looked for, for a snapshot; not copies."""
        return {
            f"{group}/{name}": record[name]
            for group, record in self._records
            for name in record.dtype.names or ()
        }

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave."""
        for group, record in self._records:
            for name in record.dtype.names or ():
                record[name] = arrays[f"{group}/{name}"]

    @property
    def _records(self) -> tuple[tuple[str, NDArray[np.void]], ...]:
        return ("seen", self._seen.peaks), ("largest", self._seen.largest)


def least_energy_beyond(system: System) -> float:
    """Elastic energy [J], eq. (19), without which no element can be longer than its law is meant for."""
    law = system.forces.cable.law
    least = energy(law.strain(law.longest)) * (law.stiffness * law.natural_length)
    return float(least.min(initial=math.inf))


WITHOUT_LIMIT = 2**62


def loop_kernel(system: System, *, compiled: bool = True) -> Kernel:
    """The system's forces and the loop around them; raises MissingExtra without Numba.

    compiled : False: in plain Python
    """
    require_numba('engine.backend = "compiled"')
    return Kernel(
        system.forces,
        LOOP,
        STEPS,
        bodies=bool(system.bodies),
        first_order=bool(system.blocks.states),
        imports=IMPORTS,
        compiled=compiled,
    )


class CompiledIntegration:
    """The state of one system and how far it has got.

    plan   : its method is one that the compiled loop has
    kernel : what `loop_kernel` gives for the system, which several integrations may share
    """

    def __init__(self, system: System, state: State, plan: Plan, kernel: Kernel) -> None:
        self._system, self._layout, self._plan = system, system.layout, plan
        self._chosen = METHODS[plan.method].kind == Kind.ADAPTIVE
        self._verlet = plan.method == Method.VELOCITY_VERLET
        self._kernel, self._module = kernel, kernel.module
        self._memory: Arrays = state.memory
        self._table = kernel.table(state.memory)
        self._motion = motion_of(system, state, self._table)
        self._clock = clock_at(state.time, plan.first_step)
        self._time, self._tiny, self._steps = (self._clock[name] for name in ("time", "tiny", "steps"))
        self._seen = self._with_stresses(no_extremes(system))
        self._control = StepLimits(plan.tolerance or 0.0, plan.longest_step, plan.least_step)
        self._module.begin(state.time, self._verlet, self._motion)

    @property
    def _stresses(self) -> Floats:
        """What the last evaluation of the forces left of viscous stresses (`ViscousElements.viscous`)."""
        return next(
            (data.viscous for data in self._table.data if isinstance(data, ViscousElements)), _NO_STRESS
        )

    def _with_stresses(self, seen: ObservedSteps) -> ObservedSteps:
        """Take slack elements from the forces' stresses, if these are of all elements."""
        stresses, number = self._stresses, self._system.net.n_elements
        return seen._replace(taut=stresses if len(stresses) == number else np.ones(number))

    def look_at_tensions(self) -> None:
        """Look for the largest tensions in the steps to come, each of them."""
        self._seen.peaks["look_above"] = 0.0

    @property
    def largest_tensions(self) -> tuple[Largest, ...]:
        """Of each group of elements, of the steps looked at."""
        return largest_tensions_of(self._seen.largest)

    def through(self, times: Floats, most: int = WITHOUT_LIMIT) -> States:
        """From times[0], the state's time, through all times [s] without a look at keyboard, guards, events.

        most : attempts of steps whose size is chosen, about, from the state's first on
        There are fewer states than times if the steps collapsed (see `collapse`), or were more.
        """
        kept, at = empty_states(len(times), self._system), np.array(times, dtype=float)
        run = Run(self._motion, self._clock, self._seen, kept, no_samples())
        if self._chosen:
            rows = self._module.through_chosen(at, self._control, TINY_IN_A_ROW, np.int64(most), run)
        else:
            rows = self._module.through_equal(self._verlet, at, self._plan.step, run)
        return self._states(kept, rows)

    def _states(self, kept: Kept, rows: int) -> States:
        time, x, v, taken = (values[:rows] for values in kept)
        return States(self._system, time, x, v, self._memory, taken).completed()

    def collapse(self) -> str:
        """What to say when no step is small enough for the tolerance; "" if that is not so."""
        if self._tiny[0] <= TINY_IN_A_ROW:
            return ""
        step = self._clock["step"][0]
        return (
            f"the steps collapsed to {step:.1g} s at t = {self.time:.6g} s: the tolerance "
            f"{self._plan.tolerance:.2g} cannot be met"
        )

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return float(self._time[0])

    @property
    def counts(self) -> StepCounts:
        """Steps and evaluations of the forces so far."""
        steps, rejected = int(self._clock["steps"][0]), int(self._clock["rejections"][0])
        stages = METHODS[self._plan.method].compiled_stages
        return StepCounts(steps, rejected, right_hand_sides=1 + stages * (steps + rejected))


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

    One state in `OUTPUT_EVERY` goes to the observer, and each one in which an element may be stretched
    beyond the law's validity; energies and tensions of the others are reported as extremes.
    """

    items: dict[str, int] = {}  # noqa: RUF012 - it has none
    can_restart = True
    _row: int  # of the next state that is kept

    def __init__(
        self, system: System, state: State, plan: Plan, observer: Observer, kernel: Kernel | None = None
    ) -> None:
        super().__init__(system, state, plan, kernel or loop_kernel(system))
        self._observer = observer
        self._events = Events(system, state.memory, observer)
        outlets = np.zeros(len(system.forces.cable.reels), dtype=OUTLET)
        self._seen = self._seen._replace(outlets=outlets)
        self._extremes = StepExtremes(system, self._seen, observer)
        rows = max(16, min(_ROWS, 2**19 // max(1, len(self._motion.v))))
        self._kept = empty_states(rows, system)
        self._looks = samples_of(self._events.watch, system, self._table)
        self._hold()
        self._moving = self._layout.unpack(self._motion.x, self._motion.v)  # views
        self._looks_to_come: list[int] = []  # after how many steps, the next one last; none: as many as fit
        self._ports = _steady_ports(system, state)
        if state.memory:
            self._remember(state.memory)
        self._steer_all()
        self._keep_first()

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

    def set_inputs(self, inputs: Arrays) -> None:
        self._recall()
        for name, values in inputs.items():
            self._events.memory[name] = values.copy()
        self._remember(self._events.memory)
        self._module.begin(self.time, self._verlet, self._motion)

    def steer(self, port: str, piece: Piece) -> None:
        self.steered(port)  # raises without the port
        self._ports[port] = piece
        steer(self._sites[port], piece)
        if self._bears:
            self._module.begin(self.time, self._verlet, self._motion)

    def steered(self, port: str) -> Piece:
        found = self._ports.get(port) if isinstance(port, str) else None
        if found is None:
            there = ", ".join(self._ports) or "none"
            raise InputError(f'unknown port {port!r} (bodies with motion = "port": {there})')
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
        self._extremes.begin()
        if self._events.is_due(self.time):
            self._look_for_events()
        with postponed() as check_interrupt:
            while self.time < until and not self.stopped:
                stop = self._events.next_instant(self.time, until)
                advance = self._advance_chosen if self._chosen else self._advance_equal
                if advance(stop, check_interrupt) == EventsFound.MORE:
                    self._look_for_events()
            until = min(until, self.time)
            self._observer.between(until, self._extremes.extremes)
            self._events.report(until, self._table.kept.items(), self.flush)
            if not math.isfinite(np.dot(self._motion.x, self._motion.x)):  # a square may overflow; no harm
                self.flush()
            check_interrupt()  # after the reports, which belong to a state at `until`

    @property
    def stopped(self) -> bool:
        return self._events.stopped

    def _advance_chosen(self, until: float, check_interrupt: Callable[[], None]) -> EventsFound:
        """Steps to a time [s], or until an event plans something before it; what was found at their end."""
        found = EventsFound.NOTHING
        while self.time < until:
            before = self._before()
            limit, every = self._stretch
            self._row = self._module.chosen_stretch(self._control, until, limit, self._row, every, self._held)
            self._locate(before)
            self._make_room()
            if (found := self._look_for_events()) and self._is_otherwise(until):
                return found
            if words := self.collapse():
                self.flush()
                raise StepsCollapsed(words)
            if self.time < until:
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
            if done < number:
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
            self.flush()
        m = self._motion
        held = (m.taken, m.work[_A1], self._stresses, self._clock, self._seen.peaks, self._seen.largest)
        arrays = (*held, self._seen.of_elements, self._seen.highest, *self._table.kept.values())
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
        steps = self._events.seen(looks.time[rows], x, v, looks.reported[rows], mean)
        first = self._events.comes_true(steps)
        if first is None:
            self._events.steps_done(steps)
            return False
        if self._looks.at[1] != 1:
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
        """How many steps to take without a look at events, and of how many one state goes to the observer."""
        return _ATTEMPTS, 1 if self._looks.at[1] == 1 else OUTPUT_EVERY

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
            self.flush()  # so that no batch has states from before and after
            m.taken[0] += change.energy_lost or 0.0
            if change.x is not None:
                m.x[:] = change.x
            if change.v is not None:
                m.v[:] = change.v
            self._keep_first()
            self._remember(self._events.memory_after(name, change))
            self._module.begin(self.time, self._verlet, self._motion)
        return found

    def _remember(self, memory: Arrays) -> None:
        """Let the forces, and what looks at tensions, take all memories into account."""
        self._memory = memory
        self._table = self._kernel.table(memory)
        self._motion = self._motion._replace(data=self._table.rows)
        self._seen = self._with_stresses(self._seen)
        self._looks = self._looks._replace(memory=self._table.changed)
        self._steer_all()
        self._motion.inverse[:] = self._layout.inverse_mass(self._system, memory)
        self._hold()
        self._extremes.remember(memory, self._motion.x)

    def _hold(self) -> None:
        self._held = self._module.hold(Run(self._motion, self._clock, self._seen, self._kept, self._looks))

    def _keep_first(self) -> None:
        """Store the state as the first row."""
        kept, m = self._kept, self._motion
        kept.time[0], kept.x[0], kept.v[0], kept.taken[0] = self.time, m.x, m.v, m.taken[0]
        self._row = 1

    def _make_room(self) -> None:
        if self._row == len(self._kept.time):
            self.flush()

    def flush(self) -> None:
        rows = self._row
        if rows > 1:
            states = self._states(Kept(*(values[:rows].copy() for values in self._kept)), rows)
            for values in self._kept:
                values[0] = values[rows - 1]
            self._row = 1
            self._observer.take(states)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        self._recall()
        m = self._motion
        arrays = {"x": m.x, "v": m.v, "a": m.work[_A1], "push": m.push, "taken": m.taken}
        arrays["viscous"] = self._stresses
        arrays |= {f"clock/{name}": self._clock[name] for name in CLOCK.names or ()}
        arrays |= self._extremes.arrays()
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
        self._extremes.restore(arrays)
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
        self._stresses[:] = arrays["viscous"]


_A1 = Stages._fields.index("a1")  # in the rows of `Motion.work`


def _steady_ports(system: System, state: State) -> dict[str, Piece]:
    """The ports by name, each going on as it moves in a state."""
    found, bodies = {}, state.bodies
    for number in system.kinematics.ports:
        parts = (part[number] for part in bodies.parts())
        found[system.blocks.rigid[number]] = Piece.steady(state.time, *parts)
    return found
