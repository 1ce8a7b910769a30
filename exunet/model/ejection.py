"""Ejection of a packed net from the body that carries it, and the momenta that bodies and points exchange."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from exunet.base.arrays import Floats, Ints
from exunet.base.run_events import NetEjected
from exunet.bodies.kinematics import Kinematics, first_given, given_states
from exunet.bodies.rigid import RigidStates, kinetic
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.blocks import Blocks
from exunet.forces.on_bodies import Held, held_by, mass_matrix
from exunet.forces.terms import Change, Constraint, DiscreteState, DiscreteStates, Switch
from exunet.model.initial import BodiesAtStart
from exunet.model.system import InitialEjection, Layout, Moving
from exunet.net.arrays import Net
from exunet.scene.scene import NetFrame

HELD = "net/held"  # discrete state of a packed net
NODES, LET_GO = 0, 1  # its entries: number of held nodes; 1.0 once a script releases them


@dataclass(frozen=True, eq=False)
class NetAxes:
    """Frame in which the net starts; without a body the scene's.

    body   : number of the body that carries the net, or None
    origin : (3,) origin of the net [m]
    turn   : (3, 3) rotation from the net's axes to the scene's
    """

    body: int | None = None
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    turn: Floats = field(default_factory=lambda: np.eye(3))


def net_axes(frame: NetFrame | None, rigid: BodiesAtStart) -> NetAxes:
    """Return the frame of `[initial.frame]`."""
    if frame is None:
        return NetAxes()
    number = [body.name for body in rigid.bodies].index(frame.body)
    body, states = rigid.bodies[number], rigid.states
    turn = rotation_matrix(states.attitude[number]) @ body.rotation.T  # of the body's frame
    origin = states.position[number] - turn @ np.array(body.centre) + turn @ np.array(frame.position)
    return NetAxes(number, origin, turn @ rotation_matrix(np.array(frame.quaternion)))


def in_frame(axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats) -> tuple[Floats, Floats]:
    """Return positions and velocities (n, 3) in the scene's axes of a net that moves with its body.

    position : (n, 3) of the net's nodes in the net's axes [m]
    Fixed nodes are at rest.
    """
    assert axes.body is not None
    states = rigid.states
    placed = axes.origin + position @ axes.turn.T
    spin = rotation_matrix(states.attitude[axes.body]) @ states.angular_velocity[axes.body]
    arms = placed - states.position[axes.body]
    moving = states.velocity[axes.body] + np.cross(spin, arms)
    moving[net.fixed_nodes] = 0.0
    return placed, moving


def eject_at_start(
    axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats, added: Floats
) -> tuple[Floats, BodiesAtStart, InitialEjection | None]:
    """Eject a net at time 0: return the added velocities (n, 3) in the scene's axes, and the bodies after it.

    position : (n_nodes, 3) in the scene's axes [m]
    added    : (n, 3) added velocities in the net's axes [m/s]

    A free body that carries the net, with what it holds on drums, takes the opposite impulse and angular
    impulse, which conserves momentum and angular momentum. A prescribed body or port supplies them. Points
    attached to bodies are not ejected.
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
    ejection = InitialEjection(number, impulse, about_origin, float(work))
    if number >= rigid.kinematics.n_free:  # whose motion is given
        already = (*impulse.tolist(), *about_origin.tolist(), float(work))
        mine = {state.name: state for state in given_states(body.name, already)}
        return (
            gained,
            replace(rigid, given=tuple(mine.get(item.name, item) for item in rigid.given)),
            ejection,
        )
    whole = mass_matrix(body.mass, np.array(body.inertia), *held_by(rigid.kinematics.held, number, {}))
    back = np.linalg.solve(whole, np.concatenate([impulse @ turn, angular @ turn]))
    velocities, spins = states.velocity.copy(), states.angular_velocity.copy()
    velocities[number] -= turn @ back[:3]
    spins[number] -= back[3:]
    after = RigidStates(states.position, velocities, states.attitude, spins)
    return gained, replace(rigid, states=after), ejection


def with_energy(
    ejection: InitialEjection | None,
    before: BodiesAtStart,
    after: BodiesAtStart,
    net: Net,
    position: Floats,
    velocities: tuple[Floats, Floats],
) -> InitialEjection | None:
    """Complete an ejection with its energy and event.

    position, velocities : (n_nodes, 3) in the scene's axes [m], before and after it [m/s]
    """
    if ejection is None:
        return None
    mass = net.mass.copy()
    mass[before.kinematics.point] = 0.0  # included in their bodies
    gains = gained_by_net(mass, position, *velocities)
    free = before.free_inertia
    energies = (kinetic(*free, of.states[: len(free[0])]).sum() for of in (after, before))
    energy_gained = gains["net_kinetic_energy_gained_J"] + float(next(energies) - next(energies))
    given = ejection.work if ejection.body >= before.kinematics.n_free else 0.0
    carrier = before.bodies[ejection.body].name
    speeds = launch_speeds(net, position, *velocities, after.states, ejection.body)
    nodes = np.setdiff1d(np.arange(net.n_net_nodes), before.kinematics.tied)
    event = NetEjected(
        time_s=0.0,
        nodes=len(nodes),
        body=carrier,
        **speeds,
        **gains,
        energy_lost_J=given - energy_gained,
    )
    return ejection._replace(energy_gained=energy_gained, event=event)


def launch_speeds(
    net: Net, position: Floats, before: Floats, after: Floats, bodies: RigidStates, body: int
) -> dict[str, Any]:
    """Return the largest speeds of bullets, or of all nodes without bullets, relative to the launching body.

    A launch adds its speeds before the recoil of the body; after it the speed relative to the body is larger.

    position, before, after : (n, 3) [m], [m/s]
    """
    nodes = net.bullet_nodes if len(net.bullet_nodes) else np.arange(net.n_net_nodes)
    spin = rotation_matrix(bodies.attitude[body]) @ bodies.angular_velocity[body]
    of_body = bodies.velocity[body] + np.cross(spin, position[nodes] - bodies.position[body])
    added, relative = after[nodes] - before[nodes], after[nodes] - of_body
    return {
        "launch_speed_added_m_s": float(np.linalg.norm(added, axis=1).max()),
        "launch_speed_relative_m_s": float(np.linalg.norm(relative, axis=1).max()),
    }


def gained_by_net(mass: Floats, position: Floats, before: Floats, after: Floats) -> dict[str, Any]:
    """Return the changes of momenta and kinetic energy of a net with its tethers by an ejection.

    mass : (n,) of the nodes [kg]; position, before, after : (n, 3) [m], [m/s]
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
    discrete_states: tuple[DiscreteStates, DiscreteStates],
    points: tuple[Floats, Floats],
) -> Moving:
    """Return the state after a body has taken up or released points.

    discrete_states : discrete states before and after, which define the points that the body holds
    points   : positions (n, 3) [m] and momenta (n, 3) [kg m/s] of points taken up; of points released, the
               momenta with which they leave, with the opposite sign

    A free body with what it holds and these points conserves momentum and angular momentum. A prescribed
    body keeps its motion; its impulse and work count as input. Positions of points do not change.
    """
    states, (place, momentum) = moving.bodies, points
    turn, centre = rotation_matrix(states.attitude[body]), states.position[body]
    motion = np.concatenate([states.velocity[body] @ turn, states.angular_velocity[body]])
    own = 0.0, np.zeros(3)
    if body < kinematics.n_free:
        own = blocks.inertia.mass[body], blocks.inertia.moments[body]
    before, after = (
        mass_matrix(*own, *held_by(kinematics.held, body, discrete)) for discrete in discrete_states
    )
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
    """Add impulse, angular impulse and work (7,) of a prescribed body to the first-order states."""
    after, first = first_order.copy(), blocks.n_x - blocks.n_states
    at = blocks.state(first_given(blocks.rigid[body])) - first
    after[at : at + len(numbers)] += numbers
    return after


def holding(axes: NetAxes, rigid: BodiesAtStart, net: Net, position: Floats) -> BodiesAtStart:
    """Return the bodies with the nodes of the packed net held by the body that carries it.

    position : (n, 3) of the net's nodes, in the scene's axes [m]
    Nodes attached to bodies stay with these.
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
    """Return the constraint with the ejection of the net at a time [s]; infinite: by a script.

    speed : (n, 3) velocities of the net's nodes relative to the body, in the net's axes [m/s]
    """
    assert constraint is not None
    assert axes.body is not None
    (held,) = (group for group in rigid.kinematics.held if group.discrete == HELD)
    in_body = rotation_matrix(rigid.states.attitude[axes.body]).T @ axes.turn
    added = speed[held.points] @ in_body.T
    switch = Ejection((time,), held, added, blocks, rigid.kinematics)
    return replace(
        constraint, discrete=DiscreteState(HELD, np.array([float(held.start), 0.0])), switch=switch
    )


@dataclass(frozen=True, eq=False)
class Ejection(Switch):
    """Ejection of a packed net during a run; the body takes the opposite momenta.

    times : (1,) [s]; infinite: by a script
    held  : nodes of the net
    added : (n, 3) velocities relative to the body, in its principal axes [m/s]
    """

    times: tuple[float, ...] = field()  # without the default of `Switch`
    held: Held
    added: Floats
    blocks: Blocks
    kinematics: Kinematics

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Return the only item, from its time on."""
        return np.flatnonzero([(time >= self.times[0] or discrete[LET_GO] > 0.0) and discrete[NODES] > 0.0])

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Eject the net; momenta are conserved, the change of energy is the work of the ejection."""
        layout, nodes = Layout(self.blocks), self.held.points
        moving = layout.unpack(x.copy(), v.copy()).completed(self.kinematics, time, every)
        turn, before = rotation_matrix(moving.bodies.attitude[self.held.body]), moving.velocity.copy()
        ejected = moving.velocity[nodes] + self.added @ turn.T
        after = np.zeros(2)
        points = moving.position[nodes], -self.held.mass[:, None] * ejected
        both = every, {**every, HELD: after}
        moved = exchanged(moving, self.blocks, self.kinematics, self.held.body, both, points)
        moved.velocity[nodes] = ejected
        moved = moved.completed(self.kinematics, time, both[1])
        x, v = layout.pack(moved)
        every_node = slice(self.blocks.net.n_nodes)
        net = (
            values[every_node] for values in (self.blocks.own_mass, moved.position, before, moved.velocity)
        )
        body = self.blocks.rigid[self.held.body]
        speeds = launch_speeds(
            self.blocks.net, moved.position, before, moved.velocity, moved.bodies, self.held.body
        )
        event = NetEjected(time_s=time, nodes=len(nodes), body=body, **speeds, **gained_by_net(*net))
        return Change(after, None, (event,), x=x, v=v)
