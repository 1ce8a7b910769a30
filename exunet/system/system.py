"""The system that is simulated: blocks (points, rigid bodies, first-order states), forces, memories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.forces.blocks import AWAKE, Blocks
from exunet.forces.terms import Input, Memories
from exunet.forces.total import Forces
from exunet.net.arrays import Net
from exunet.net.closing import ClosingLine

Floats = NDArray[np.float64]
_OF_BODIES = ("position", "velocity", "attitude", "angular_velocity")


class Throw(NamedTuple):
    """Ejection of a net at time 0; the initial state is the one after it.

    body     : number of the body that carries the net
    impulse, angular_impulse : (3,) given to what is ejected [N s], about the scene's origin [N m s]
    work     : of both on the moving body [J]: given by a body with prescribed motion
    brought  : change of the total energy [J]
    event    : as the record of a run reports it
    """

    body: int
    impulse: Floats
    angular_impulse: Floats
    work: float
    brought: float = 0.0
    event: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class System:
    """What has a state and what acts on it.

    blocks : the nodes of the net, point masses, rigid bodies and first-order states in one numbering
    forces : every term that acts on them
    bodies : the rigid bodies, in the order of `blocks.rigid`: free ones, then those that guides move
    kinematics : what of it has no equations of motion; the constraint among the forces states the same
    throw  : the ejection of a net at time 0; None: there is none
    line   : what runs through rings at the net's nodes; None: nothing does
    """

    blocks: Blocks
    forces: Forces
    bodies: tuple[RigidBody, ...] = ()
    kinematics: Kinematics = field(default_factory=Kinematics)
    throw: Throw | None = None
    line: ClosingLine | None = None

    @property
    def net(self) -> Net:
        return self.blocks.net

    @cached_property
    def mass(self) -> Floats:
        """(n_points,) [kg]; zero for points that are fixed to bodies, which have their mass."""
        return self.blocks.own_mass

    @cached_property
    def moves_freely(self) -> NDArray[np.bool_]:
        """(n_bodies,) False for the bodies that guides move."""
        return np.arange(len(self.bodies)) < len(self.bodies) - len(self.kinematics.guides)

    @cached_property
    def body_mass(self) -> Floats:
        """(n_bodies,) [kg]."""
        return np.array([body.mass for body in self.bodies], dtype=float)

    @cached_property
    def body_inertia(self) -> Floats:
        """(n_bodies, 3) principal moments [kg m2]."""
        return np.array([body.inertia for body in self.bodies], dtype=float).reshape(-1, 3)

    @property
    def layout(self) -> Layout:
        """Its states as flat arrays."""
        return Layout(self.blocks)

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """(n_bodies,) True for the free rigid bodies that a term acts on."""
        names = self.forces.on_bodies
        return np.array([name in names for name in self.blocks.rigid], dtype=bool) & self.moves_freely

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(n_points,) False for the nodes that are held still, and those that are fixed to bodies."""
        free = np.ones(self.blocks.n_points, dtype=bool)
        free[self.net.fixed_nodes] = False
        free[self.kinematics.point] = False
        return free

    def moving(self, memory: Memories) -> Floats | None:
        """(n_points,) 0.0 for points that sleep, or that a body holds, at these memories; None: all move."""
        awake = memory.get(AWAKE)
        if not self.kinematics.held:
            return awake
        moving = np.ones(self.blocks.n_points) if awake is None else awake.copy()
        moving[self.kinematics.holds(memory)] = 0.0
        return moving

    @cached_property
    def inert_mass(self) -> Floats:
        """(n_points,) [kg] no larger than what resists forces on all points at once; infinite for held ones.

        A unit force on a point of a body moves it by no more than the largest eigenvalue of its mobility,
        1/m + [p]x^T J^-1 [p]x; n points that pull one body together move each other by no more than n times
        as much.
        """
        mass, kinematics = self.blocks.mass.copy(), self.kinematics
        for point, number, arm in zip(kinematics.point, kinematics.body, kinematics.arm, strict=True):
            body, together = self.bodies[number], np.count_nonzero(kinematics.body == number)
            lever = np.cross(np.eye(3), arm)
            turns = lever @ np.diag(1.0 / np.array(body.inertia)) @ lever.T
            mass[point] = 1.0 / (together * (1.0 / body.mass + np.linalg.eigvalsh(turns)[-1]))
        mass[self.held] = np.inf
        return mass

    @cached_property
    def held(self) -> NDArray[np.int64]:
        """Points that nothing moves but their support: fixed nodes, those on bodies that guides move."""
        guided = self.kinematics.point[~self.moves_freely[self.kinematics.body]]
        return np.concatenate([self.net.fixed_nodes, guided])

    @property
    def lost_at_start(self) -> float:
        """Energy [J] that has left with what happens at time 0; negative: a throw has brought it."""
        return 0.0 if self.throw is None else -self.throw.brought

    def given_work(self, first_order: Floats) -> Floats:
        """(...,) energy [J] that was given from outside, less what was taken, by states (..., n).

        Of what terms count as first-order states themselves: work of guided bodies and of drives, what
        contact and the friction of a line take.
        """
        return self._sum_of(first_order, np.flatnonzero(self._gives))

    def put_in(self, first_order: Floats) -> Floats:
        """(...,) energy [J] that guided bodies and drives have given; nothing is counted against it."""
        return self._sum_of(first_order, np.flatnonzero(self._gives > 0.0))

    def _sum_of(self, first_order: Floats, columns: NDArray[np.int64]) -> Floats:
        return np.asarray((first_order[..., columns] * self._gives[columns]).sum(axis=-1))

    @cached_property
    def _gives(self) -> Floats:
        """`FirstOrder.gives` of each column of the states."""
        return np.array([one.gives for one in self.blocks.states for _ in one.initial], dtype=float)

    @cached_property
    def memory(self) -> dict[str, Floats]:
        """The memories of the terms, their inputs, and which points are awake, at the start, by name."""
        memories = (term.memory for term in self.forces.memories)
        found = {memory.name: memory.initial for memory in memories if memory is not None}
        if self.blocks.awake is not None:
            found[AWAKE] = self.blocks.awake
        found |= {one.memory: np.array([float(one.start)]) for one in self.kinematics.ties.values()}
        return found | {name: one.initial for name, one in self.inputs.items()}

    @cached_property
    def inputs(self) -> dict[str, Input]:
        """The inputs of the terms, by name; terms that name the same share it."""
        return {one.name: one for term in self.forces for one in term.inputs}

    @property
    def scripted(self) -> frozenset[str]:
        """The inputs that the script of the case gives."""
        return frozenset() if self.forces.script is None else self.forces.script.acts_with


@dataclass(frozen=True, eq=False)
class State:
    """The whole state of a system at one instant.

    time               : [s]
    position, velocity : (n_points, 3) [m], [m/s]
    bodies             : of the rigid bodies
    memory             : of the terms that have one, by name
    first_order        : (n_states,) first-order states of the terms
    """

    time: float
    position: Floats
    velocity: Floats
    bodies: RigidStates = field(default_factory=RigidStates.none)
    memory: Memories = field(default_factory=dict)
    first_order: Floats = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, time: float, moving: Moving, memory: Memories) -> State:
        """A state that is kept as it is: the arrays are not copied."""
        return cls(time, moving.position, moving.velocity, moving.bodies, memory, moving.first_order)

    @property
    def moving(self) -> Moving:
        """All but time and memory."""
        return Moving(self.position, self.velocity, self.bodies, self.first_order)

    def arrays(self) -> dict[str, Floats]:
        """Its numbers by name, for a snapshot."""
        parts = zip(_OF_BODIES, self.bodies.parts(), strict=True)
        return {
            "time": np.array(self.time),
            "position": self.position,
            "velocity": self.velocity,
            "first_order": self.first_order,
            **{f"bodies/{name}": part for name, part in parts},
            **{f"memory/{name}": values for name, values in self.memory.items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Floats]) -> State:
        """The state whose numbers `arrays` gave."""
        bodies = RigidStates(*(arrays[f"bodies/{name}"] for name in _OF_BODIES))
        memory = {name[7:]: values for name, values in arrays.items() if name.startswith("memory/")}
        moving = Moving(arrays["position"], arrays["velocity"], bodies, arrays["first_order"])
        return cls.of(float(arrays["time"]), moving, memory)

    def at(self, position: Floats, velocity: Floats) -> State:
        """This state with the points elsewhere."""
        return replace(self, position=position, velocity=velocity)


class Moving(NamedTuple):
    """What moves: at one instant, or at (k,) of them as a leading axis.

    position, velocity : (..., n_points, 3) [m], [m/s]
    bodies             : of the rigid bodies
    first_order        : (..., n_states) of the terms
    """

    position: Floats
    velocity: Floats
    bodies: RigidStates
    first_order: Floats

    def completed(self, kinematics: Kinematics, time: float | Floats, memory: Memories) -> Moving:
        """At times (...) [s], with what has no equations of motion put in; the free bodies suffice."""
        if not kinematics:
            return self
        return Moving(*kinematics.completed(np.asarray(time), *self[:3], memory), self.first_order)


@dataclass(frozen=True, eq=False)
class Layout:
    """States and masses as the flat arrays x and v of `exunet.forces.blocks`."""

    blocks: Blocks

    def pack(self, moving: Moving) -> tuple[Floats, Floats]:
        """Arrays x (..., n_x) and v (..., n_v); views where there are points only."""
        position, velocity, bodies, first_order = moving

        def flat(values: Floats) -> Floats:
            return values.reshape(*values.shape[:-2], -1)

        if not self.blocks.rigid and not self.blocks.states:
            return flat(position), flat(velocity)
        place = (flat(position), flat(bodies.position), flat(bodies.attitude), first_order)
        speed = (flat(velocity), flat(bodies.velocity), flat(bodies.angular_velocity))
        return np.concatenate(place, axis=-1), np.concatenate(speed, axis=-1)

    def unpack(self, x: Floats, v: Floats) -> Moving:
        """What moves, as views of x (..., n_x) and v (..., n_v)."""
        points, centres = 3 * self.blocks.n_points, self.blocks.centres
        turned = centres + 4 * len(self.blocks.rigid)

        def rows(values: Floats, width: int) -> Floats:
            return values.reshape(*values.shape[:-1], -1, width)

        bodies = RigidStates(
            rows(x[..., points:centres], 3),
            rows(v[..., points:centres], 3),
            rows(x[..., centres:turned], 4),
            rows(v[..., centres:], 3),
        )
        return Moving(rows(x[..., :points], 3), rows(v[..., :points], 3), bodies, x[..., turned:])

    def inverse_mass(self, system: System, memory: Memories) -> Floats:
        """(n_force,) 1 / mass or 1 / inertia; zero for what is held or sleeps, 1 for first-order states."""
        moving = system.moving(memory)
        points = np.repeat(system.free * (1.0 if moving is None else moving) / self.blocks.mass, 3)
        moves = system.moves_freely
        bodies = np.repeat(moves / system.body_mass, 3), (moves[:, None] / system.body_inertia).ravel()
        return np.concatenate([points, *bodies, np.ones(self.blocks.n_states)])

    def half_mass(self, system: System) -> Floats:
        """(n_v,) half the mass or inertia; zero for what has no equations of motion."""
        moves = system.moves_freely
        bodies = np.repeat(moves * system.body_mass, 3), (moves[:, None] * system.body_inertia).ravel()
        return 0.5 * np.concatenate([np.repeat(system.mass, 3), *bodies])
