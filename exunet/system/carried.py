"""The axes that a net starts in, which a body may carry, and what a throw does to that body."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidStates, rotation_matrix
from exunet.case.scene import NetFrame
from exunet.forces.held import held_by, mass_matrix
from exunet.net.arrays import Net
from exunet.system.bodies import BodiesAtStart

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NetAxes:
    """The axes in which the net starts; without a body they are the scene's.

    body   : number of the body that carries them; None: none does
    origin : (3,) of the net [m]
    turn   : (3, 3) from the net's axes to the scene's
    """

    body: int | None = None
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    turn: Floats = field(default_factory=lambda: np.eye(3))


def net_axes(frame: NetFrame | None, rigid: BodiesAtStart) -> NetAxes:
    """The axes that `[initial.frame]` names."""
    if frame is None:
        return NetAxes()
    number = [body.name for body in rigid.bodies].index(frame.body)
    body, states = rigid.bodies[number], rigid.states
    turn = rotation_matrix(states.attitude[number]) @ body.rotation.T  # of the body's frame
    origin = states.position[number] - turn @ np.array(body.centre) + turn @ np.array(frame.position)
    return NetAxes(number, origin, turn @ rotation_matrix(np.array(frame.quaternion)))


def carried(
    axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats, velocity: Floats
) -> tuple[Floats, Floats]:
    """Positions and velocities (n, 3) in the scene's axes, before a throw.

    position, velocity : (n, 3) of the net's nodes in the net's axes, relative to the body [m], [m/s]
    The nodes move with the body. Fixed nodes rest.
    """
    if axes.body is None:
        return position, velocity
    states = rigid.states
    placed = axes.origin + position @ axes.turn.T
    spin = rotation_matrix(states.attitude[axes.body]) @ states.angular_velocity[axes.body]
    arms = placed - states.position[axes.body]
    moving = states.velocity[axes.body] + np.cross(spin, arms) + velocity @ axes.turn.T
    moving[net.fixed_nodes] = 0.0
    return placed, moving


class Recoil(NamedTuple):
    """What the host of a port that throws a net at time 0 is to take.

    body    : number of the port
    impulse, angular_impulse : (3,) that the net has got [N s], about the scene's origin [N m s]
    work    : of both on the net, as far as the body moved already [J]
    """

    body: int
    impulse: Floats
    angular_impulse: Floats
    work: float


def thrown(
    axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats, kicks: Floats
) -> tuple[Floats, BodiesAtStart, Recoil | None]:
    """What a throw adds to the velocities (n, 3) in the scene's axes, and the bodies after it.

    position : (n_nodes, 3) in the scene's axes [m]
    kicks    : (n, 3) what it adds in the net's axes [m/s]
    A free body that carries the net, with what it holds on drums, takes the opposite impulse and angular
    impulse, which leaves the momentum and the angular momentum of all together what they were; of a port, the
    host takes them. Points that are fixed to bodies are not thrown.
    """
    gained = kicks @ axes.turn.T
    gained[rigid.kinematics.point[rigid.kinematics.point < len(gained)]] = 0.0
    number = axes.body
    if number is None or not gained.any():
        return gained, rigid, None
    body, states = rigid.bodies[number], rigid.states
    impulse = net.mass[: len(gained), None] * gained
    angular = np.cross(position[: len(gained)] - states.position[number], impulse).sum(axis=0)
    turn = rotation_matrix(states.attitude[number])
    if number in rigid.kinematics.ports:
        return gained, rigid, _recoil(number, states, impulse.sum(axis=0), angular)
    if number >= rigid.kinematics.n_free:  # whose motion is given
        return gained, rigid, None
    whole = mass_matrix(body.mass, np.array(body.inertia), *held_by(rigid.kinematics.held, number, {}))
    back = np.linalg.solve(whole, np.concatenate([impulse.sum(axis=0) @ turn, angular @ turn]))
    velocities, spins = states.velocity.copy(), states.angular_velocity.copy()
    velocities[number] -= turn @ back[:3]
    spins[number] -= back[3:]
    after = RigidStates(states.position, velocities, states.attitude, spins)
    return gained, replace(rigid, states=after), None


def _recoil(number: int, states: RigidStates, impulse: Floats, angular: Floats) -> Recoil:
    """angular : (3,) about the centre of mass of the body [N m s]."""
    speed, spin = states.velocity[number], states.angular_velocity[number]
    work = impulse @ speed + angular @ rotation_matrix(states.attitude[number]) @ spin
    return Recoil(number, impulse, angular + np.cross(states.position[number], impulse), float(work))
