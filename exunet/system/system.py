"""The system that is simulated, as blocks: points, rigid bodies, forces and their memories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidBody, RigidStates
from exunet.forces.points import Points
from exunet.forces.total import Forces
from exunet.net.arrays import Net

Floats = NDArray[np.float64]
Memories = Mapping[str, Floats]
_OF_BODIES = ("position", "velocity", "attitude", "angular_velocity")


@dataclass(frozen=True, eq=False)
class System:
    """What has a state and what acts on it.

    points : the nodes of the net and the point masses, with their masses
    forces : every term that acts on the points
    bodies : the rigid bodies; no force acts on them yet
    """

    points: Points
    forces: Forces
    bodies: tuple[RigidBody, ...] = ()

    @property
    def net(self) -> Net:
        return self.points.net

    @property
    def mass(self) -> Floats:
        """(n_points,) [kg]."""
        return self.points.mass

    @cached_property
    def body_mass(self) -> Floats:
        """(n_bodies,) [kg]."""
        return np.array([body.mass for body in self.bodies], dtype=float)

    @cached_property
    def body_inertia(self) -> Floats:
        """(n_bodies, 3) principal moments [kg m2]."""
        return np.array([body.inertia for body in self.bodies], dtype=float).reshape(-1, 3)

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(n_points,) False for the nodes that are held still."""
        free = np.ones(self.points.n_points, dtype=bool)
        free[self.net.fixed_nodes] = False
        return free

    @cached_property
    def memory(self) -> dict[str, Floats]:
        """The memories of the terms at the start, by name."""
        memories = (term.memory for term in self.forces.memories)
        return {memory.name: memory.initial for memory in memories if memory is not None}


@dataclass(frozen=True, eq=False)
class State:
    """The whole state of a system at one instant.

    time               : [s]
    position, velocity : (n_points, 3) [m], [m/s]
    bodies             : of the rigid bodies
    memory             : of the terms that have one, by name
    """

    time: float
    position: Floats
    velocity: Floats
    bodies: RigidStates = field(default_factory=RigidStates.none)
    memory: Memories = field(default_factory=dict)

    def arrays(self) -> dict[str, Floats]:
        """Its numbers by name, for a snapshot."""
        parts = zip(_OF_BODIES, self.bodies.parts(), strict=True)
        return {
            "time": np.array(self.time),
            "position": self.position,
            "velocity": self.velocity,
            **{f"bodies/{name}": part for name, part in parts},
            **{f"memory/{name}": values for name, values in self.memory.items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Floats]) -> State:
        """The state whose numbers `arrays` gave."""
        bodies = RigidStates(*(arrays[f"bodies/{name}"] for name in _OF_BODIES))
        memory = {name[7:]: values for name, values in arrays.items() if name.startswith("memory/")}
        return cls(float(arrays["time"]), arrays["position"], arrays["velocity"], bodies, memory)

    def at(self, position: Floats, velocity: Floats) -> State:
        """This state with the points elsewhere."""
        return replace(self, position=position, velocity=velocity)


@dataclass(frozen=True)
class Layout:
    """Where the blocks of a state stand in flat arrays of an integrator.

    x = points, centres of the bodies (3 each); v = their velocities, then angular velocities (3 each body);
    z = attitudes (4 each body). x' = v for the part that x has, z' = attitude kinematics.
    """

    n_points: int
    n_bodies: int

    @classmethod
    def of(cls, system: System) -> Layout:
        return cls(system.points.n_points, len(system.bodies))

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Lengths of x, v and z."""
        centres = 3 * (self.n_points + self.n_bodies)
        return centres, centres + 3 * self.n_bodies, 4 * self.n_bodies

    def pack(self, state: State) -> tuple[Floats, Floats, Floats]:
        """New arrays x, v, z of a state."""
        bodies = state.bodies
        return (
            np.concatenate([state.position.ravel(), bodies.position.ravel()]),
            np.concatenate(
                [state.velocity.ravel(), bodies.velocity.ravel(), bodies.angular_velocity.ravel()]
            ),
            bodies.attitude.ravel().copy(),
        )

    def unpack(self, x: Floats, v: Floats, z: Floats) -> tuple[Floats, Floats, RigidStates]:
        """Position and velocity (..., n_points, 3) and the bodies, as views of x, v, z (..., n)."""
        points, centres = 3 * self.n_points, self.sizes[0]

        def rows(values: Floats, width: int) -> Floats:
            return values.reshape(*values.shape[:-1], -1, width)

        bodies = RigidStates(
            rows(x[..., points:], 3),
            rows(v[..., points:centres], 3),
            rows(z, 4),
            rows(v[..., centres:], 3),
        )
        return rows(x[..., :points], 3), rows(v[..., :points], 3), bodies

    def inverse_mass(self, system: System) -> Floats:
        """1 / mass or 1 / inertia of each entry of v; zero for what is held still."""
        points = np.repeat(system.free / system.mass, 3)
        return np.concatenate(
            [points, np.repeat(1.0 / system.body_mass, 3), (1.0 / system.body_inertia).ravel()]
        )

    def half_mass(self, system: System) -> Floats:
        """Half the mass or inertia of each entry of v."""
        return 0.5 * np.concatenate(
            [np.repeat(system.mass, 3), np.repeat(system.body_mass, 3), system.body_inertia.ravel()]
        )
