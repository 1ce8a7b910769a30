"""Ejection of a packed net from the body that carries it, and the momenta that bodies and points exchange."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import Kinematics, first_given, given_states
from exunet.bodies.rigid import RigidStates, kinetic
from exunet.bodies.rotations import rotation_matrix
from exunet.case.scene import NetFrame
from exunet.forces.blocks import Blocks
from exunet.forces.on_bodies import Held, held_by, mass_matrix
from exunet.forces.terms import Change, Constraint, Memories, Memory
from exunet.net.arrays import Net
from exunet.system.bodies import BodiesAtStart
from exunet.system.system import Layout, Moving, Throw

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


Ints = NDArray[np.int64]

HELD = "net/held"  # the memory of it
NODES, LET_GO = 0, 1  # in it: how many nodes are held, and 1.0 once a script lets them go


def holding(axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats) -> BodiesAtStart:
    """The bodies, of which the one that carries the net holds its nodes where they are packed.

    position : (n, 3) of the net's nodes, in the scene's axes [m]
    Nodes that are attached to bodies are left to these.
    """
    assert axes.body is not None
    nodes = np.setdiff1d(np.arange(len(position)), rigid.kinematics.tied)
    states = rigid.states
    turn = rotation_matrix(states.attitude[axes.body])
    arms = (position[nodes] - states.position[axes.body]) @ turn
    held = Held(HELD, len(nodes), nodes, axes.body, arms, net.mass[nodes])
    kinematics = replace(rigid.kinematics, held=(*rigid.kinematics.held, held))
    return replace(rigid, kinematics=kinematics)


def ejecting(
    constraint: Constraint | None,
    time: float,
    axes: NetAxes,
    rigid: BodiesAtStart,
    blocks: Blocks,
    speed: Floats,
) -> Constraint:
    """The constraint that lets the net go at a time [s]; infinite: when a script says so.

    speed : (n, 3) velocities of the net's nodes relative to the body, in the net's axes [m/s]
    """
    assert constraint is not None
    assert axes.body is not None
    (held,) = (one for one in rigid.kinematics.held if one.memory == HELD)
    in_body = rotation_matrix(rigid.states.attitude[axes.body]).T @ axes.turn
    added = speed[held.points] @ in_body.T
    switch = Ejection(time, held, added, blocks, rigid.kinematics)
    return replace(constraint, memory=Memory(HELD, np.array([float(held.start), 0.0])), switch=switch)


@dataclass(frozen=True, eq=False)
class Ejection:
    """The nodes get velocities beside those that they have with the body, which gives them their momenta.

    time  : [s]; infinite: when a script says so
    held  : the nodes
    added : (n, 3) these velocities, in the body's principal axes [m/s]
    """

    time: float
    held: Held
    added: Floats
    blocks: Blocks
    kinematics: Kinematics
    heading = "ejection"

    @property
    def times(self) -> tuple[float, ...]:
        """When it happens [s]."""
        return (self.time,)

    def in_steps(self, memory: Floats) -> bool:
        """The time is known."""
        return False

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The only item, from its time on."""
        return np.flatnonzero([(time >= self.time or memory[LET_GO] > 0.0) and memory[NODES] > 0.0])

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """Steps end at known times anyway."""
        return step

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Momentum and angular momentum stay; what all energy changes by is the work of the ejection."""
        layout, nodes = Layout(self.blocks), self.held.points
        moving = layout.unpack(x.copy(), v.copy()).completed(self.kinematics, time, every)
        turn, before = rotation_matrix(moving.bodies.attitude[self.held.body]), moving.velocity.copy()
        thrown = moving.velocity[nodes] + self.added @ turn.T
        after = np.zeros(2)
        points = moving.position[nodes], -self.held.mass[:, None] * thrown
        both = every, {**every, HELD: after}
        moved = exchanged(moving, self.blocks, self.kinematics, self.held.body, both, points)
        moved.velocity[nodes] = thrown
        moved = moved.completed(self.kinematics, time, both[1])
        x, v = layout.pack(moved)
        every_node = slice(self.blocks.net.n_nodes)
        net = (
            values[every_node] for values in (self.blocks.own_mass, moved.position, before, moved.velocity)
        )
        body = self.blocks.rigid[self.held.body]
        event = {"time_s": time, "nodes": len(nodes), "body": body, **gained_by_net(*net)}
        return Change(after, None, (event,), x=x, v=v)
