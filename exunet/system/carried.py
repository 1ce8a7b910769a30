"""The axes that a net starts in, which a body may carry, and what a throw does to that body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import given_states
from exunet.bodies.rigid import RigidStates, kinetic, rotation_matrix
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


def carried(axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats) -> tuple[Floats, Floats]:
    """Positions and velocities (n, 3) in the scene's axes of a net that moves with the body that carries it.

    position : (n, 3) of the net's nodes in the net's axes [m]
    Fixed nodes rest.
    """
    assert axes.body is not None
    states = rigid.states
    placed = axes.origin + position @ axes.turn.T
    spin = rotation_matrix(states.attitude[axes.body]) @ states.angular_velocity[axes.body]
    arms = placed - states.position[axes.body]
    moving = states.velocity[axes.body] + np.cross(spin, arms)
    moving[net.fixed_nodes] = 0.0
    return placed, moving


class Throw(NamedTuple):
    """The ejection of a net at time 0; the state at the start is the one after it.

    body     : number of the body that carries the net
    impulse, angular_impulse : (3,) that it has given what it throws [N s], about the scene's origin [N m s]
    work     : of both, as far as the body moved already [J]: what a body whose motion is given has given
    brought  : [J] that all energy has grown by
    event    : as the record of a run tells it
    """

    body: int
    impulse: Floats
    angular_impulse: Floats
    work: float
    brought: float = 0.0
    event: Mapping[str, Any] = MappingProxyType({})


def thrown(
    axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats, added: Floats
) -> tuple[Floats, BodiesAtStart, Throw | None]:
    """What a throw adds to the velocities (n, 3) in the scene's axes, and the bodies after it.

    position : (n_nodes, 3) in the scene's axes [m]
    added    : (n, 3) what it adds in the net's axes [m/s]
    A free body that carries the net, with what it holds on drums, takes the opposite impulse and angular
    impulse, which leaves the momentum and the angular momentum of all together what they were. One whose
    motion is given, by the case or a host, has given them. Points that are fixed to bodies are not thrown.
    """
    gained = added @ axes.turn.T
    gained[rigid.kinematics.tied[rigid.kinematics.tied < len(gained)]] = 0.0
    number = axes.body
    if number is None or not gained.any():
        return gained, rigid, None
    body, states = rigid.bodies[number], rigid.states
    turn = rotation_matrix(states.attitude[number])
    each = net.mass[: len(gained), None] * gained
    impulse = each.sum(axis=0)
    angular = np.cross(position[: len(gained)] - states.position[number], each).sum(axis=0)
    work = impulse @ states.velocity[number] + angular @ turn @ states.angular_velocity[number]
    about_origin = angular + np.cross(states.position[number], impulse)
    throw = Throw(number, impulse, about_origin, float(work))
    if number >= rigid.kinematics.n_free:  # whose motion is given
        already = (*impulse.tolist(), *about_origin.tolist(), float(work))
        mine = {one.name: one for one in given_states(body.name, already)}
        return gained, replace(rigid, given=tuple(mine.get(one.name, one) for one in rigid.given)), throw
    whole = mass_matrix(body.mass, np.array(body.inertia), *held_by(rigid.kinematics.held, number, {}))
    back = np.linalg.solve(whole, np.concatenate([impulse @ turn, angular @ turn]))
    velocities, spins = states.velocity.copy(), states.angular_velocity.copy()
    velocities[number] -= turn @ back[:3]
    spins[number] -= back[3:]
    after = RigidStates(states.position, velocities, states.attitude, spins)
    return gained, replace(rigid, states=after), throw


def booked(
    throw: Throw | None,
    before: BodiesAtStart,
    after: BodiesAtStart,
    net: Net,
    position: Floats,
    velocities: tuple[Floats, Floats],
) -> Throw | None:
    """A throw with the energy that it has brought, and its event.

    position, velocities : (n_nodes, 3) in the scene's axes [m], before and after it [m/s]
    """
    if throw is None:
        return None
    mass = net.mass.copy()
    mass[before.kinematics.point] = 0.0  # which their bodies have
    gains = gained_by_net(mass, position, *velocities)
    free = before.free_inertia
    energies = (kinetic(*free, of.states[: len(free[0])]).sum() for of in (after, before))
    brought = gains["net_kinetic_energy_gained_J"] + float(next(energies) - next(energies))
    given = throw.work if throw.body >= before.kinematics.n_free else 0.0
    carrier = before.bodies[throw.body].name
    nodes = np.setdiff1d(np.arange(net.n_net_nodes), before.kinematics.tied)
    event = {"time_s": 0.0, "nodes": len(nodes), "body": carrier, **gains, "energy_lost_J": given - brought}
    return throw._replace(brought=brought, event=event)


def gained_by_net(mass: Floats, position: Floats, before: Floats, after: Floats) -> dict[str, Any]:
    """What an ejection changes of the momenta and the kinetic energy of a net with its tethers.

    mass : (n,) of the nodes' own [kg]; position, before, after : (n, 3) [m], [m/s]
    """
    change = mass[:, None] * (after - before)
    squares = np.einsum("na,na->n", after, after) - np.einsum("na,na->n", before, before)
    return {
        "net_momentum_gained_kg_m_s": change.sum(axis=0).tolist(),
        "net_angular_momentum_gained_kg_m2_s": np.cross(position, change).sum(axis=0).tolist(),
        "net_kinetic_energy_gained_J": 0.5 * float(mass @ squares),
    }
