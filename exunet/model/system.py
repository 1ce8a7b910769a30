"""The model that is integrated: degrees of freedom, forces, discrete states; its state and their arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.files import group_of, grouped
from exunet.base.run_events import NetEjected
from exunet.bodies.kinematics import Kinematics
from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.forces.blocks import ACTIVE, Blocks
from exunet.forces.terms import DiscreteStates, Input
from exunet.forces.total import Forces
from exunet.net.arrays import Net
from exunet.net.closing import LineThroughRings

OF_BODY = ("position", "velocity", "attitude", "angular_velocity")


class InitialEjection(NamedTuple):
    """Ejection of a net at time 0; the initial state is the one after it.

    body     : number of the body that carries the net
    impulse, angular_impulse : (3,) given to what is ejected [N s], about the scene's origin [N m s]
    work     : of both on the moving body [J]: given by a body with prescribed motion
    energy_gained  : change of the total energy [J]
    event    : of the record of a run
    """

    body: int
    impulse: Floats
    angular_impulse: Floats
    work: float
    energy_gained: float = 0.0
    event: NetEjected | None = None


@dataclass(frozen=True, eq=False)
class System:
    """Degrees of freedom of a scene and the forces on them.

    Attributes
    ----------
    blocks : Blocks
        Nodes of the net, rigid bodies and first-order states in one numbering.
    forces : Forces
        Force terms.
    bodies : tuple of RigidBody
        In the order of `blocks.rigid`: free bodies, then prescribed ones.
    kinematics : Kinematics
        Degrees of freedom without equations of motion; the constraint among the forces states the same.
    ejection : InitialEjection or None
        Ejection of a net at time 0.
    line : LineThroughRings or None
        Closing line through rings at nodes of the net.
    """

    blocks: Blocks
    forces: Forces
    bodies: tuple[RigidBody, ...] = ()
    kinematics: Kinematics = field(default_factory=Kinematics)
    ejection: InitialEjection | None = None
    line: LineThroughRings | None = None

    @property
    def net(self) -> Net:
        return self.blocks.net

    @cached_property
    def alone(self) -> System:
        """The system without kernel terms such as contact, reels and the closing line."""
        return replace(self, forces=replace(self.forces, kernels=())) if self.forces.kernels else self

    @cached_property
    def mass(self) -> Floats:
        """(n_points,) masses [kg]; zero for points attached to bodies, which include their mass."""
        return self.blocks.own_mass

    @cached_property
    def moves_freely(self) -> NDArray[np.bool_]:
        """(n_bodies,) False for prescribed bodies."""
        return np.arange(len(self.bodies)) < len(self.bodies) - len(self.kinematics.motions)

    @cached_property
    def body_mass(self) -> Floats:
        """(n_bodies,) masses [kg]."""
        return np.array([body.mass for body in self.bodies], dtype=float)

    @cached_property
    def body_inertia(self) -> Floats:
        """(n_bodies, 3) principal moments [kg m2]."""
        return np.array([body.inertia for body in self.bodies], dtype=float).reshape(-1, 3)

    @cached_property
    def layout(self) -> Layout:
        """Layout of states as flat arrays."""
        return Layout(self.blocks)

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """(n_bodies,) True for free rigid bodies with a force term."""
        names = self.forces.on_bodies
        return np.array([name in names for name in self.blocks.rigid], dtype=bool) & self.moves_freely

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(n_points,) False for fixed nodes and nodes attached to bodies."""
        free = np.ones(self.blocks.n_points, dtype=bool)
        free[self.net.fixed_nodes] = False
        free[self.kinematics.point] = False
        return free

    def moving(self, discrete: DiscreteStates) -> Floats | None:
        """Return (n_points,) 0.0 for points that are inactive or held by bodies, else 1.0; None: all move."""
        active = discrete.get(ACTIVE)
        if not self.kinematics.held:
            return active
        moving = np.ones(self.blocks.n_points) if active is None else active.copy()
        moving[self.kinematics.holds(discrete)] = 0.0
        return moving

    @cached_property
    def inert_mass(self) -> Floats:
        """(n_points,) lower bound of the inertia against forces on all points at once [kg]; infinite if held.

        A unit force on a point p of a body accelerates it by at most the largest eigenvalue of its mobility,
        1/m + [p]x^T J^-1 [p]x; n points of one body by at most n times as much.
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
        """Points with prescribed motion: fixed nodes, and nodes attached to prescribed bodies."""
        prescribed = self.kinematics.point[~self.moves_freely[self.kinematics.body]]
        return np.concatenate([self.net.fixed_nodes, prescribed])

    @property
    def lost_at_start(self) -> float:
        """Energy lost at time 0 [J]; negative for an ejection, which adds energy."""
        return 0.0 if self.ejection is None else -self.ejection.energy_gained

    def given_work(self, first_order: Floats) -> Floats:
        """(...,) net energy input [J], from first-order states (..., n).

        Terms integrate it as first-order states: work of prescribed bodies and drives, dissipation of contact
        and of friction of a closing line.
        """
        columns = np.flatnonzero(self._gives)
        return np.asarray((first_order[..., columns] * self._gives[columns]).sum(axis=-1))

    @cached_property
    def _gives(self) -> Floats:
        """`FirstOrder.gives` of each first-order state."""
        return np.array([state.gives for state in self.blocks.states for _ in state.initial], dtype=float)

    @cached_property
    def discrete(self) -> dict[str, Floats]:
        """Discrete states of the terms, inputs, and points that are active, at the start, by name."""
        discrete_states = (term.discrete for term in self.forces.discrete_states)
        initial = {discrete.name: discrete.initial for discrete in discrete_states if discrete is not None}
        if self.blocks.active is not None:
            initial[ACTIVE] = self.blocks.active
        initial |= {tie.discrete: np.array([float(tie.start)]) for tie in self.kinematics.ties.values()}
        return initial | {name: value.initial for name, value in self.inputs.items()}

    @cached_property
    def inputs(self) -> dict[str, Input]:
        """Inputs of the terms, by name; terms share inputs of one name."""
        return {value.name: value for term in self.forces for value in term.inputs}

    @property
    def scripted(self) -> frozenset[str]:
        """Inputs that the script of the case sets."""
        return frozenset() if self.forces.script is None else self.forces.script.acts_with


@dataclass(frozen=True, eq=False)
class State:
    """State of a system at one instant.

    time               : [s]
    position, velocity : (n_points, 3) [m], [m/s]
    bodies             : states of the rigid bodies
    discrete           : discrete states of the terms, by name
    first_order        : (n_states,) first-order states of the terms
    """

    time: float
    position: Floats
    velocity: Floats
    bodies: RigidStates = field(default_factory=RigidStates.none)
    discrete: DiscreteStates = field(default_factory=dict)
    first_order: Floats = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, time: float, moving: Moving, discrete: DiscreteStates) -> State:
        """Make a state; the arrays are not copied."""
        return cls(time, moving.position, moving.velocity, moving.bodies, discrete, moving.first_order)

    @property
    def moving(self) -> Moving:
        """Continuous part of the state."""
        return Moving(self.position, self.velocity, self.bodies, self.first_order)

    def arrays(self) -> dict[str, Floats]:
        """Return the arrays of the state by name, for a snapshot."""
        parts = zip(OF_BODY, self.bodies.parts(), strict=True)
        return {
            "time": np.array(self.time),
            "position": self.position,
            "velocity": self.velocity,
            "first_order": self.first_order,
            **{f"bodies/{name}": part for name, part in parts},
            **grouped("discrete", self.discrete),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Floats]) -> State:
        """Make a state from `arrays`."""
        bodies = RigidStates(*(arrays[f"bodies/{name}"] for name in OF_BODY))
        moving = Moving(arrays["position"], arrays["velocity"], bodies, arrays["first_order"])
        return cls.of(float(arrays["time"]), moving, group_of("discrete", arrays))

    def at(self, position: Floats, velocity: Floats) -> State:
        """Return the state with other positions and velocities of the points."""
        return replace(self, position=position, velocity=velocity)


class Moving(NamedTuple):
    """Continuous state at one instant, or at (k,) instants as a leading axis.

    position, velocity : (..., n_points, 3) [m], [m/s]
    bodies             : states of the rigid bodies
    first_order        : (..., n_states) first-order states of the terms
    """

    position: Floats
    velocity: Floats
    bodies: RigidStates
    first_order: Floats

    def completed(self, kinematics: Kinematics, time: float | Floats, discrete: DiscreteStates) -> Moving:
        """Return the state at times (...) [s] with prescribed bodies and attached points set."""
        if not kinematics:
            return self
        return Moving(*kinematics.completed(np.asarray(time), *self[:3], discrete), self.first_order)


class Layout:
    """Layout of states and masses in the flat arrays x and v of `exunet.forces.blocks`."""

    def __init__(self, blocks: Blocks) -> None:
        self.blocks = blocks
        self.n_points, self._n_bodies, centres = blocks.n_points, len(blocks.rigid), blocks.centres
        self.points, self._centres = slice(3 * self.n_points), slice(3 * self.n_points, centres)
        self._attitudes, self._rotations = slice(centres, centres + 4 * self._n_bodies), slice(centres, None)
        self.first_order = slice(centres + 4 * self._n_bodies, None)

    def pack(self, moving: Moving) -> tuple[Floats, Floats]:
        """Return arrays x (..., n_x) and v (..., n_v); views of a system of points only."""
        position, velocity, bodies, first_order = moving

        def flat(values: Floats) -> Floats:
            return values.reshape(*values.shape[:-2], -1)

        if not self.blocks.rigid and not self.blocks.states:
            return flat(position), flat(velocity)
        place = (flat(position), flat(bodies.position), flat(bodies.attitude), first_order)
        speed = (flat(velocity), flat(bodies.velocity), flat(bodies.angular_velocity))
        return np.concatenate(place, axis=-1), np.concatenate(speed, axis=-1)

    def unpack(self, x: Floats, v: Floats) -> Moving:
        """Return the continuous state as views of x (..., n_x) and v (..., n_v)."""
        points, bodies = (*x.shape[:-1], self.n_points, 3), (*x.shape[:-1], self._n_bodies, 3)
        rigid = RigidStates(
            x[..., self._centres].reshape(bodies),
            v[..., self._centres].reshape(bodies),
            x[..., self._attitudes].reshape(*bodies[:-1], 4),
            v[..., self._rotations].reshape(bodies),
        )
        of_points = x[..., self.points].reshape(points), v[..., self.points].reshape(points)
        return Moving(*of_points, rigid, x[..., self.first_order])

    def inverse_mass(self, system: System, discrete: DiscreteStates) -> Floats:
        """Return (n_force,) 1 / mass or 1 / inertia: 0 if held or inactive, 1 for first-order states."""
        moving = system.moving(discrete)
        points = np.repeat(system.free * (1.0 if moving is None else moving) / self.blocks.mass, 3)
        moves = system.moves_freely
        bodies = np.repeat(moves / system.body_mass, 3), (moves[:, None] / system.body_inertia).ravel()
        return np.concatenate([points, *bodies, np.ones(self.blocks.n_states)])

    def half_mass(self, system: System) -> Floats:
        """Return (n_v,) half of mass or inertia; zero without equations of motion."""
        moves = system.moves_freely
        bodies = np.repeat(moves * system.body_mass, 3), (moves[:, None] * system.body_inertia).ravel()
        return 0.5 * np.concatenate([np.repeat(system.mass, 3), *bodies])
