"""Compiled loop as a stepper: one state in many, with extremes and watched entries of each step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.bodies.kinematics import OnPrescribed, sites_of, steer
from exunet.bodies.port import Piece
from exunet.forces.cable import elastic_energy, lengths
from exunet.forces.law import energy
from exunet.forces.loops import ViscousElements
from exunet.forces.reel import Winding
from exunet.forces.terms import Change, DiscreteStates, Seen, Watch
from exunet.integrators.compiled.steps import IMPORTS, LOOP, STEPS, TINY_IN_A_ROW
from exunet.integrators.compiled.workspace import (
    CLOCK,
    OUTLET,
    PEAKS,
    EqualSteps,
    Kept,
    ObservedSteps,
    Stages,
    StepInterval,
    StepLimits,
    clock_at,
    empty_states,
    largest_tensions_of,
    motion_of,
    no_extremes,
    samples_of,
)
from exunet.integrators.protocol import Arrays, Extremes, StepCounts, Steps, StepsCollapsed
from exunet.kernels.compile import require_numba
from exunet.kernels.kernel import Kernel
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model.energy import law_of
from exunet.model.states import States
from exunet.model.system import State, System

_NO_STRESS = np.zeros(0)
NO_ENERGIES = np.array([0.0, np.inf])  # of `Extremes`
OUTPUT_EVERY = 64  # one state in so many steps is returned


class StepExtremes:
    """Sets what compiled steps observe (`ObservedSteps`), and reports extremes.

    No step is left out in which an element may be stretched beyond the law's validity (`keep_above`).

    elements : the largest tension of each element is observed
    """

    def __init__(self, system: System, seen: ObservedSteps, *, elements: bool) -> None:
        self._system, self._seen = system, seen
        self._peaks = {name: seen.peaks[name] for name in PEAKS.names or ()}
        self._elements = elements
        self._inactive = 0.0  # elastic energy [J] of the elements that the kernel leaves out
        self._peaks["keep_above"][0] = least_energy_beyond(system)
        # Elements that other terms have are looked at here too; their energy is not among the elements'.
        each = elements or system.forces.cable.leaves_some
        self._peaks["look_above"][0] = -1.0 if each else 0.0

    def begin(self) -> None:
        """Begin an interval whose extremes are reported together."""
        peaks = self._peaks
        peaks["elastic"][0], peaks["kinetic"][0] = 0.0, np.inf

    @property
    def extremes(self) -> Extremes:
        """Energies of the steps since `begin`, tensions of all steps."""
        energies = np.array([self._peaks["elastic"][0] + self._inactive, self._peaks["kinetic"][0]])
        each = self._seen.of_elements.copy() if self._elements else _NO_STRESS
        return Extremes(energies, largest_tensions_of(self._seen.largest), each)

    def remember(self, discrete: Arrays, x: Floats) -> None:
        """Take all discrete states into account, in a state x (n_x,)."""
        self._count_inactive(discrete, x)
        cable, seen = self._system.forces.cable, self._seen
        carrying = cable.carrying(discrete)
        if carrying is not None:
            seen.stiffness[:] = cable.law.stiffness * carrying
        for number, winding in enumerate(cable.reels):
            self._see_outlet(number, winding, discrete)
        seen.highest[:] = np.where(seen.twice_time > 0.0, 0.0, seen.length**2)

    def _see_outlet(self, number: int, winding: Winding, discrete: Arrays) -> None:
        """Observe the outlet as an element from the drum to the first node outside."""
        seen, wound_up = self._seen, list(winding.reel.elements)
        nodes = self._system.net.element_nodes[wound_up]
        seen.first[wound_up], seen.second[wound_up] = 3 * nodes.T
        seen.length[wound_up] = self._system.forces.cable.law.natural_length[wound_up]
        seen.jumps[wound_up], seen.winding[wound_up] = seen.twice_time[wound_up], 0.0
        element, outlet = winding.outlet_now(discrete)
        seen.first[element], seen.second[element] = outlet.drum[0], outlet.far[0]
        seen.stiffness[element], seen.jumps[element] = outlet.stiffness, 0.0
        places = element, outlet.state[0], outlet.rate[0]
        seen.outlets[number] = *places, outlet.base, outlet.least, outlet.ratio

    def _count_inactive(self, discrete: Arrays, x: Floats) -> None:
        """The kernel leaves out elements between inactive points; they count with the extremes."""
        cable, before = self._system.forces.cable, self._inactive
        moving = cable.moving(discrete)
        if moving is not None:
            position = x[: 3 * self._system.blocks.n_points].reshape(-1, 3)
            law = law_of(self._system.forces, discrete).of_intact((~moving).astype(float))
            self._inactive = float(elastic_energy(law, lengths(self._system.net, position)))
            self._peaks["elastic"] += before - self._inactive


def least_energy_beyond(system: System) -> float:
    """Elastic energy [J], eq. (19), without which no element can be longer than its law is meant for."""
    law = system.forces.cable.law
    least = energy(law.strain(law.longest)) * (law.stiffness * law.natural_length)
    return float(least.min(initial=math.inf))


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


_ROWS = 256  # states that a call returns at most
_ATTEMPTS = 2000  # steps of a call


class CompiledStepper:
    """Stepper without an engine; see `exunet.integrators.protocol.Stepper`.

    One state in `every` is returned, and each one in which an element may be stretched beyond the law's
    validity; energies and tensions of the others are reported as extremes.

    plan     : its method is one that the compiled loop has
    kernel   : what `loop_kernel` gives for the system, which several steppers may share
    elements : the largest tension of each element is observed
    every    : 1: each state is returned; None: those at the given times alone, with largest tensions of all
    """

    items: dict[str, int] = {}  # noqa: RUF012 - it has none
    can_restart = True

    def __init__(
        self,
        system: System,
        state: State,
        plan: Plan,
        kernel: Kernel | None = None,
        *,
        elements: bool = False,
        every: int | None = OUTPUT_EVERY,
    ) -> None:
        self._system, self._layout, self._plan, self._every = system, system.layout, plan, every
        self._chosen = METHODS[plan.method].kind == Kind.ADAPTIVE
        self._verlet = plan.method == Method.VELOCITY_VERLET
        self._kernel = kernel or loop_kernel(system)
        self._module = self._kernel.module
        self._discrete = {name: np.array(values, dtype=float) for name, values in state.discrete.items()}
        self._table = self._kernel.table(state.discrete)
        self._motion = motion_of(system, state, self._table)
        self._clock, self.time = clock_at(state.time, plan.first_step), float(state.time)
        self._tiny, self._steps = self._clock["tiny"], self._clock["steps"]
        self._seen = self._with_stresses(no_extremes(system))
        self._control = StepLimits(plan.tolerance or 0.0, plan.longest_step, plan.least_step)
        self._module.begin(state.time, self._verlet, self._motion)
        # Equal steps between two times: begin, end, number, steps before; number 0: none to go on with.
        self._equal = np.zeros(4)
        self._extremes: StepExtremes | None = None
        watch: Watch | None = None
        if every is None:
            self._seen.peaks["look_above"] = 0.0
        else:
            outlets = np.zeros(len(system.forces.cable.reels), dtype=OUTLET)
            self._seen = self._seen._replace(outlets=outlets)
            self._extremes = StepExtremes(system, self._seen, elements=elements)
            script = system.forces.script
            switch = None if script is None else script.switch
            watch = switch if isinstance(switch, Watch) else None
        rows = max(16, min(_ROWS, 2**19 // max(1, len(self._motion.v)))) if every else 0
        self._kept = empty_states(rows, system)
        self._looks = samples_of(watch, system, self._table)
        self._hold()
        self._moving = self._layout.unpack(self._motion.x, self._motion.v)  # views
        self._ports = _steady_ports(system, state)
        if state.discrete:
            self._remember(self._discrete)
        self._steer_all()

    @property
    def _stresses(self) -> Floats:
        """Return the viscous stresses of the last evaluation of the forces (`ViscousElements.viscous`)."""
        return next(
            (data.viscous for data in self._table.data if isinstance(data, ViscousElements)), _NO_STRESS
        )

    def _with_stresses(self, seen: ObservedSteps) -> ObservedSteps:
        """Take slack elements from the forces' stresses, if these are of all elements."""
        stresses, number = self._stresses, self._system.net.n_elements
        return seen._replace(taut=stresses if len(stresses) == number else np.ones(number))

    @property
    def counts(self) -> StepCounts:
        steps, rejected = int(self._clock["steps"][0]), int(self._clock["rejections"][0])
        stages = METHODS[self._plan.method].compiled_stages
        return StepCounts(steps, rejected, right_hand_sides=1 + stages * (steps + rejected))

    @property
    def discrete(self) -> dict[str, Floats]:
        for name, values in self._table.kept.items():
            self._discrete[name][:] = values
        return self._discrete

    @property
    def kept(self) -> dict[str, Floats]:
        return {name: values.copy() for name, values in self._table.kept.items()}

    def flat(self) -> tuple[Floats, Floats]:
        return self._motion.x, self._motion.v

    def state(self) -> State:
        discrete = {name: values.copy() for name, values in self.discrete.items()}
        moving = self._layout.unpack(self._motion.x.copy(), self._motion.v.copy())
        return State.of(self.time, moving.completed(self._system.kinematics, self.time, discrete), discrete)

    def view(self) -> State:
        return State.of(self.time, self._moving, self.discrete)

    def step(
        self, times: Sequence[float], most: int | None = None, until_true: Callable[[], bool] | None = None
    ) -> Steps:
        kept, looks = self._kept, self._looks
        looks.at[:] = 0, 0 if most is None or until_true is None else min(most, len(looks.time))
        if self._extremes is None:
            kept, rows = self._through(np.array([self.time, *times]))
            extremes = Extremes(NO_ENERGIES, largest_tensions_of(self._seen.largest), _NO_STRESS)
        else:
            every = 1 if most == 1 else self._every or OUTPUT_EVERY
            limit = 1 if most == 1 and until_true is None else _ATTEMPTS
            self._extremes.begin()
            if self._chosen:
                until = float(times[-1])
                end = self._module.chosen_stretch(self._control, until, limit, 0, every, self._held)
            else:
                end = self._equal_steps(float(times[-1]), limit, every)
            rows, extremes = slice(end), self._extremes.extremes
        self.time = float(self._clock["time"][0])
        states = kept.time[rows], kept.x[rows], kept.v[rows], self._discrete, kept.taken[rows]
        steps = Steps(States(self._system, *states), extremes)
        if looks.at[1]:
            seen = slice(int(looks.at[0]))
            mean = looks.mean[seen] if looks.weights.size else None
            parts = looks.time[seen], looks.x[:, seen].T, looks.v[:, seen].T, _NO_STRESS, looks.reported[seen]
            steps = steps._replace(watched=Seen(*parts, mean))
        if self._tiny[0] > TINY_IN_A_ROW:
            words = f"the steps collapsed to {self._clock['step'][0]:.1g} s at t = {self.time:.6g} s"
            raise StepsCollapsed(f"{words}: the tolerance {self._plan.tolerance:.2g} cannot be met", steps)
        return steps

    def _equal_steps(self, until: float, limit: int, every: int) -> int:
        """Go on with equal steps to a time [s], laid out at the state where they begin; return the rows."""
        done = float(self._steps[0])
        if not (self._equal[2] and self._equal[1] == until):
            number = max(1, math.ceil((until - self.time) / (self._plan.step or math.inf) * (1 - 1e-9)))
            self._equal[:] = self.time, until, number, done
        begin, _, parts, before = self._equal.tolist()
        steps = EqualSteps(begin, until, int(parts), int(done - before), limit)
        rows = int(self._module.equal_stretch(self._verlet, steps, 0, every, self._held))
        if int(self._steps[0]) - before >= parts:
            self._equal[2] = 0.0
        return rows

    def _through(self, times: Floats) -> tuple[Kept, slice]:
        """Go from times[0], the state's time, through all times [s] in one call of compiled code."""
        kept = empty_states(len(times), self._system)
        run = StepInterval(self._motion, self._clock, self._seen, kept, self._looks)
        if self._chosen:
            never = np.int64(2**62)
            end = self._module.through_chosen(times, self._control, TINY_IN_A_ROW, never, run)
        else:
            end = self._module.through_equal(self._verlet, times, self._plan.step, run)
        return kept, slice(1, end)

    def change(self, change: Change, discrete: DiscreteStates) -> None:
        if change.quiet:
            for name, values in self._table.kept.items():
                values[:] = discrete[name]
            self._discrete = dict(discrete)
        else:
            m = self._motion
            m.taken[0] += change.energy_lost or 0.0
            if change.x is not None:
                m.x[:] = change.x
            if change.v is not None:
                m.v[:] = change.v
            self._remember(discrete)
        self._module.begin(self.time, self._verlet, self._motion)

    def _remember(self, discrete: DiscreteStates) -> None:
        """Let the forces, and what looks at tensions, take all discrete states into account."""
        self._discrete = {name: np.array(values, dtype=float) for name, values in discrete.items()}
        self._table = self._kernel.table(discrete)
        self._motion = self._motion._replace(data=self._table.rows)
        self._seen = self._with_stresses(self._seen)
        self._looks = self._looks._replace(discrete=self._table.changed)
        self._steer_all()
        self._motion.inverse[:] = self._layout.inverse_mass(self._system, discrete)
        self._hold()
        if self._extremes is not None:
            self._extremes.remember(discrete, self._motion.x)

    def _hold(self) -> None:
        self._held = self._module.hold(
            StepInterval(self._motion, self._clock, self._seen, self._kept, self._looks)
        )

    def set_external_force(self, force: Floats) -> None:
        self._motion.external[: force.size] = force.ravel()
        self._motion.has_external[0] = float(self._motion.external.any())
        self._module.begin(self.time, self._verlet, self._motion)

    def set_inputs(self, inputs: Arrays) -> None:
        self._remember({**self.discrete, **inputs})
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
        # A prescribed body that holds masses has forces on it that jump with its acceleration.
        self._bears = any(isinstance(part, OnPrescribed) for part in data)
        self._sites = {name: sites_of(data, blocks.centre(name)) for name in self._ports}
        for name, piece in self._ports.items():
            steer(self._sites[name], piece)

    @property
    def _own(self) -> dict[str, NDArray[Any]]:
        """The arrays that steps change, beside discrete states."""
        m, seen = self._motion, self._seen
        arrays = {
            "x": m.x,
            "v": m.v,
            "a": m.work[_A1],
            "external": m.external,
            "taken": m.taken,
            "equal": self._equal,
        }
        arrays |= {f"clock/{name}": self._clock[name] for name in CLOCK.names or ()}
        arrays |= {f"seen/{name}": seen.peaks[name] for name in PEAKS.names or ()}
        arrays |= {f"largest/{name}": seen.largest[name] for name in seen.largest.dtype.names or ()}
        arrays |= {"equal": self._equal, "viscous": self._stresses}
        return arrays | {"elements": seen.of_elements, "highest": seen.highest}

    def save(self) -> dict[str, NDArray[Any]]:
        arrays = {name: np.array(value) for name, value in self._own.items()}
        arrays |= {f"discrete/{name}": value.copy() for name, value in self.discrete.items()}
        return arrays | {f"port/{name}": piece.numbers() for name, piece in self._ports.items()}

    def load(self, arrays: Arrays, rejected: int | None = None) -> None:
        discrete = {name: arrays[f"discrete/{name}"] for name in self._discrete}
        if rejected is None:
            self._motion.x[:] = arrays["x"]
            self._ports = {name: Piece.of_numbers(arrays[f"port/{name}"]) for name in self._ports}
            self._remember(discrete)
        else:  # within the steps since `save`, which change discrete states alone that are kept in the data
            self._discrete = {name: np.array(values) for name, values in discrete.items()}
            for name, values in self._table.kept.items():
                values[:] = discrete[name]
        for name, held in self._own.items():
            held[:] = arrays[name]
        self.time = float(self._clock["time"][0])
        self._motion.has_external[0] = float(self._motion.external.any())
        if rejected is not None:
            self._clock["rejections"] = rejected


_A1 = Stages._fields.index("a1")  # in the rows of `Motion.work`


def _steady_ports(system: System, state: State) -> dict[str, Piece]:
    """The ports by name, each going on as it moves in a state."""
    found, bodies = {}, state.bodies
    for number in system.kinematics.ports:
        parts = (part[number] for part in bodies.parts())
        found[system.blocks.rigid[number]] = Piece.steady(state.time, *parts)
    return found
