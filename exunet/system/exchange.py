"""What a body, with the points that it holds, gets and gives when points come to it or leave it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import GIVEN, Kinematics
from exunet.bodies.rigid import RigidStates, rotation_matrix
from exunet.forces.blocks import Blocks
from exunet.forces.held import held_by, mass_matrix
from exunet.forces.terms import Memories
from exunet.system.system import Moving

Floats = NDArray[np.float64]


def exchanged(
    moving: Moving,
    blocks: Blocks,
    kinematics: Kinematics,
    body: int,
    memories: tuple[Memories, Memories],
    points: tuple[Floats, Floats],
) -> Moving:
    """The state after a body has taken points, or let them go.

    memories : before and after, which say what the body holds
    points   : places (n, 3) [m] and momenta (n, 3) [kg m/s] of points that it holds afterwards; of those that
               it no longer holds, the momenta with which they leave, with the opposite sign
    A free body, what it holds and these points keep their momentum and angular momentum; the support of a
    fixed one takes both. Points are left where they are.
    """
    place, momentum = points
    if body >= kinematics.n_free:
        return moving._replace(first_order=_supported(moving.first_order, blocks, body, place, momentum))
    states, (before, after) = moving.bodies, memories
    turn, centre = rotation_matrix(states.attitude[body]), states.position[body]
    own = blocks.inertia.mass[body], blocks.inertia.moments[body]
    motion = np.concatenate([states.velocity[body] @ turn, states.angular_velocity[body]])
    momenta = mass_matrix(*own, *held_by(kinematics.held, body, before)) @ motion
    coming = momentum @ turn
    momenta[:3] += coming.sum(axis=0)
    momenta[3:] += np.cross((place - centre) @ turn, coming).sum(axis=0)
    motion = np.linalg.solve(mass_matrix(*own, *held_by(kinematics.held, body, after)), momenta)
    velocity, spin = states.velocity.copy(), states.angular_velocity.copy()
    velocity[body], spin[body] = turn @ motion[:3], motion[3:]
    return moving._replace(bodies=RigidStates(states.position, velocity, states.attitude, spin))


def _supported(first_order: Floats, blocks: Blocks, body: int, place: Floats, momentum: Floats) -> Floats:
    """The first-order states, with what a support has given: the opposite of what came to it."""
    given, first = first_order.copy(), blocks.n_x - blocks.n_states
    at = blocks.state(f"{blocks.rigid[body]}/{GIVEN[0][0]}") - first
    given[at : at + 3] -= momentum.sum(axis=0)
    given[at + 3 : at + 6] -= np.cross(place, momentum).sum(axis=0)
    return given
