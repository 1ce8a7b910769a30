"""What a body, with the points that it holds, gets and gives when points come to it or leave it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics, first_given
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
    A free body, what it holds and these points keep their momentum and angular momentum. One that a guide
    moves goes on as before; what that takes counts as given by it, with its work. Points are left where they
    are.
    """
    states, (place, momentum) = moving.bodies, points
    turn, centre = rotation_matrix(states.attitude[body]), states.position[body]
    motion = np.concatenate([states.velocity[body] @ turn, states.angular_velocity[body]])
    own = 0.0, np.zeros(3)
    if body < kinematics.n_free:
        own = blocks.inertia.mass[body], blocks.inertia.moments[body]
    before, after = (mass_matrix(*own, *held_by(kinematics.held, body, one)) for one in memories)
    coming = momentum @ turn
    arriving = np.cross((place - centre) @ turn, coming).sum(axis=0)
    momenta = before @ motion + np.concatenate([coming.sum(axis=0), arriving])
    if body >= kinematics.n_free:
        given = after @ motion - momenta
        impulse, twist = turn @ given[:3], turn @ given[3:]
        numbers = np.concatenate([impulse, twist + np.cross(centre, impulse), [given @ motion]])
        return moving._replace(first_order=_given(moving.first_order, blocks, body, numbers))
    motion = np.linalg.solve(after, momenta)
    velocity, spin = states.velocity.copy(), states.angular_velocity.copy()
    velocity[body], spin[body] = turn @ motion[:3], motion[3:]
    return moving._replace(bodies=RigidStates(states.position, velocity, states.attitude, spin))


def _given(first_order: Floats, blocks: Blocks, body: int, numbers: Floats) -> Floats:
    """The first-order states, with impulse, angular impulse and work (7,) more that a guided body gives."""
    after, first = first_order.copy(), blocks.n_x - blocks.n_states
    at = blocks.state(first_given(blocks.rigid[body])) - first
    after[at : at + len(numbers)] += numbers
    return after
