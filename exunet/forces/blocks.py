"""The blocks that forces act on, in one numbering: points, rigid bodies, first-order states.

Every force, potential and event is a function of three flat arrays, in which the blocks stand in this order:

    x     = 3 n_points places | 3 n_bodies centres    | 4 n_bodies attitudes         | n_states values
    v     = 3 n_points speeds | 3 n_bodies velocities | 3 n_bodies angular velocities
    force = 3 n_points forces | 3 n_bodies forces     | 3 n_bodies torques           | n_states rates

Points are the nodes of the net. Attitudes are unit quaternions (w, x, y, z) that turn the
body's principal axes into the scene's; angular velocities and torques are in the principal axes. Those of its
frame, which a case and a result speak of, may be others (`exunet.bodies.rigid`). The power that a force takes
out is -force . v over the entries of v: what stands at a place in v stands there in force too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.cores import Surface
from exunet.net.arrays import Net

ACTIVE = "points/active"  # the discrete state of the system that says which points are active


@dataclass(frozen=True)
class FirstOrder:
    """Continuous states y of a term, whose rates y' are part of its force.

    name    : "term/quantity", by which results and snapshots know them
    initial : values at time 0
    units   : of the values, "1" if they have none
    gives   : 1.0 of an energy that the system was given, -1.0 of one that was taken out of it, which no force
              or rate depends on; else 0.0
    """

    name: str
    initial: tuple[float, ...]
    units: str = "1"
    gives: float = 0.0


@dataclass(frozen=True, eq=False)
class Inertia:
    """Inertia of the rigid bodies, for forces that depend on mass.

    mass    : (n,) of those that move freely, which come first among the rigid bodies [kg]
    moments : (n, 3) their principal moments of inertia [kg m2]
    points  : the points that are fixed to any body, whose mass is the body's
    """

    mass: Floats = field(default_factory=lambda: np.zeros(0))
    moments: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    points: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the rigid bodies are at the start, and in which axes the net starts.

    centre : (n, 3) of mass [m]
    turn   : (n, 3, 3) from principal axes to the scene's
    net    : (3, 3) from the net's axes to the scene's
    """

    centre: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    turn: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))
    net: Floats = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Speeds:
    """How all moves at the start, in the scene's axes, with what a throw that comes later will add.

    points : (n_points, 3) [m/s]; none where it does not matter
    bodies : (n, 3) centres of mass of the rigid bodies [m/s]
    spins  : (n, 3) [rad/s]
    """

    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    bodies: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    spins: Floats = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a scene.

    net      : the net
    position : (n_points, 3) at the start [m]
    rigid    : names of the rigid bodies, in their order
    states   : the first-order states, in their order
    active   : (n_points,) at the start, 1.0 for points that are active and 0.0 for inactive ones: these
               rest, whatever pulls them, until an event activates them. None: all are active
    inertia  : of the rigid bodies
    poses    : of the rigid bodies, and of the net's axes
    surfaces : of the rigid bodies that can be touched, by name
    carrier  : name of the body in whose canister the net starts; "": no such body
    speeds   : of all at the start, from which steps are judged
    """

    net: Net
    position: Floats
    rigid: tuple[str, ...] = ()
    states: tuple[FirstOrder, ...] = ()
    active: Floats | None = None
    inertia: Inertia = field(default_factory=Inertia)
    poses: Poses = field(default_factory=Poses)
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    carrier: str = ""
    speeds: Speeds = field(default_factory=Speeds)

    @classmethod
    def of_net(cls, net: Net, position: Floats | None = None) -> Blocks:
        """The nodes alone; at the reference configuration unless a position is given."""
        return cls(net, net.reference_position if position is None else position)

    @property
    def mass(self) -> Floats:
        """(n_points,) [kg]."""
        return self.net.mass

    @property
    def n_points(self) -> int:
        return self.net.n_nodes

    @cached_property
    def own_mass(self) -> Floats:
        """(n_points,) [kg], by which forces act on points: zero where a body has the mass."""
        if not len(self.inertia.points):
            return self.mass
        mass = self.mass.copy()
        mass[self.inertia.points] = 0.0
        return mass

    @property
    def free_bodies(self) -> tuple[str, ...]:
        """Names of the rigid bodies that move freely."""
        return self.rigid[: len(self.inertia.mass)]

    @cached_property
    def n_states(self) -> int:
        return sum(len(state.initial) for state in self.states)

    @cached_property
    def initial_states(self) -> Floats:
        """(n_states,) the first-order states at time 0."""
        return np.array([value for state in self.states for value in state.initial], dtype=float)

    @property
    def centres(self) -> int:
        """How many entries of x and v belong to points and centres."""
        return 3 * (self.n_points + len(self.rigid))

    @property
    def n_x(self) -> int:
        return self.centres + 4 * len(self.rigid) + self.n_states

    @property
    def n_v(self) -> int:
        return self.centres + 3 * len(self.rigid)

    @property
    def n_force(self) -> int:
        return self.n_v + self.n_states

    def centre(self, name: str) -> int:
        """Where in x, v and force the entries of the centre of a rigid body begin."""
        return 3 * (self.n_points + self.rigid.index(name))

    def attitude(self, name: str) -> int:
        """Where in x the quaternion of a rigid body begins."""
        return self.centres + 4 * self.rigid.index(name)

    def spin(self, name: str) -> int:
        """Where in v the angular velocity of a rigid body begins, and in force its torque."""
        return self.centres + 3 * self.rigid.index(name)

    def state(self, name: str) -> int:
        """Where in x a term's first-order states begin."""
        return self.n_x - self.n_states + self._before(name)

    def rate(self, name: str) -> int:
        """Where in force the rates of a term's first-order states begin."""
        return self.n_v + self._before(name)

    def _before(self, name: str) -> int:
        number = [item.name for item in self.states].index(name)
        return sum(len(state.initial) for state in self.states[:number])
