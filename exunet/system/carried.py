"""A net that starts in axes that a body carries, and what its launch does to that body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidStates, rotation_matrix
from exunet.case.scene import NetFrame
from exunet.net.arrays import Net
from exunet.system.bodies import BodiesAtStart

Floats = NDArray[np.float64]


def carried(
    frame: NetFrame, rigid: BodiesAtStart, net: Net, position: Floats, velocity: Floats, kicks: Floats
) -> tuple[Floats, Floats, BodiesAtStart]:
    """Positions and velocities (n, 3) in the scene's axes, and the bodies after the launch.

    position, velocity : (n, 3) of the net's nodes in the net's axes, relative to the body [m], [m/s]
    kicks              : (n, 3) the part of the velocities that the launch has added, in the net's axes
    The nodes move with the body, at the velocity that it has before the launch, which leaves the momentum and
    the angular momentum of both together what they were. Fixed nodes rest.
    """
    number = [body.name for body in rigid.bodies].index(frame.body)
    body, states = rigid.bodies[number], rigid.states
    centre, speed = states.position[number], states.velocity[number]
    principal = rotation_matrix(states.attitude[number])
    turn = principal @ body.rotation.T  # of the body's frame
    origin = centre - turn @ np.array(body.centre)
    axes = turn @ rotation_matrix(np.array(frame.quaternion))
    placed = origin + turn @ np.array(frame.position) + position @ axes.T
    spin = principal @ states.angular_velocity[number]
    moving = speed + np.cross(spin, placed - centre) + velocity @ axes.T
    moving[net.fixed_nodes] = 0.0
    if not kicks.any() or number >= rigid.kinematics.n_free:  # whose motion is given
        return placed, moving, rigid
    impulse = net.mass[: len(kicks), None] * (kicks @ axes.T)
    angular = np.cross(placed - centre, impulse).sum(axis=0)
    velocities, spins = states.velocity.copy(), states.angular_velocity.copy()
    velocities[number] -= impulse.sum(axis=0) / body.mass
    spins[number] -= angular @ principal / np.array(body.inertia)
    after = RigidStates(states.position, velocities, states.attitude, spins)
    return placed, moving, replace(rigid, states=after)
