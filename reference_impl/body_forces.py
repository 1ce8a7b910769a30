"""Forces on bodies: effects by the mass, and what nodes that bodies hold or touch do to them.

Each gives an element at X + l, which moves with V + w x l, an acceleration linear in l, A l with
A = G + C [w]x beside that of the centre: G the gradient of gravity and the turning frame, C what velocities
do (Coriolis, damping).  Its torque about the centre of mass is the sum of dm l x A l, which with the second
moments S = sum of dm l l^T = (tr J)/2 I - J of the mass is the axial vector of S A^T:

    t_i = e_ijk (S A^T)_jk.

The gravity gradient 3 n^2 r x J r, the gyroscopic torque of the turning frame and the damping of spin are all
of this form, and no formula for either is written down.  Of the two-body model the torque is that of its
linear gradient.  Potential of a field G in the attitude: -tr(G S)/2.
"""

from __future__ import annotations

import numpy as np

from reference_impl import held
from reference_impl.arrays import Floats, cross, skew
from reference_impl.attachments import Levers
from reference_impl.bodies import turning
from reference_impl.effects.orbit import coriolis, gradient, orbital_acceleration, orbital_potential
from reference_impl.state import Mode, Whole
from reference_impl.system import System


def act(system: System) -> bool:
    """Whether any effect acts by the mass on a body."""
    effects = system.effects
    by_mass = any(effects.gravity) or effects.orbit is not None or damping_rate(system) > 0.0
    return bool(len(system.bodies.names)) and by_mass


def turn(system: System) -> bool:
    """Whether any effect acts by the mass on the attitude of a body."""
    effects = system.effects
    return bool(len(system.bodies.names)) and (effects.orbit is not None or damping_rate(system) > 0.0)


def damping_rate(system: System) -> float:
    """alpha [1/s] of mass_damping and of Rayleigh's kind."""
    return system.effects.alpha + system.effects.mass_damping


def second_moments(inertia: Floats) -> Floats:
    """S (..., 3, 3) [kg m2] of matrices of inertia J (..., 3, 3)."""
    half_trace = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)
    return np.asarray(half_trace[..., None, None] * np.eye(3) - inertia)


def gradient_of(system: System) -> Floats:
    """G (3, 3) [1/s2] of the effects of a system."""
    effects = system.effects
    total = np.zeros((3, 3)) if effects.orbit is None else gradient(effects.orbit)
    return total if effects.j2 is None else total + system.oblate


def accelerations(system: System, x: Floats, v: Floats) -> Floats:
    """(b, 3) [m/s2] of bodies with centres of mass at x (b, 3) [m] that move with v (b, 3) [m/s]."""
    effects = system.effects
    total = np.broadcast_to(np.array(effects.gravity), x.shape) - damping_rate(system) * v
    if effects.orbit is not None:
        total = total + orbital_acceleration(effects.orbit, x, v)
    if effects.j2 is not None:
        total = total + x @ system.oblate.T
    return np.asarray(total)


def torques(system: System, attitude: Floats, turning: Floats) -> Floats:
    """(b, 3) [N m] on bodies of attitudes (b, 3, 3) that turn with (b, 3) [rad/s], in scene axes."""
    effects = system.effects
    by_velocity = -damping_rate(system) * np.eye(3)
    if effects.orbit is not None:
        by_velocity = by_velocity + coriolis(effects.orbit)
    field = gradient_of(system) + by_velocity @ skew(turning)
    second = attitude @ second_moments(system.bodies.inertia) @ np.swapaxes(attitude, -1, -2)
    moment = second @ np.swapaxes(field, -1, -2)
    above, below = moment[:, [1, 2, 0], [2, 0, 1]], moment[:, [2, 0, 1], [1, 2, 0]]
    return np.asarray(above - below)


def damping_power(system: System, v: Floats, attitude: Floats, turning: Floats) -> float:
    """Power [W] that damping takes from bodies: twice alpha times their kinetic energy."""
    bodies = system.bodies
    carried = attitude @ bodies.inertia @ np.swapaxes(attitude, -1, -2) @ turning[..., None]
    moving = bodies.free * bodies.mass @ np.sum(v * v, axis=-1)
    spinning = np.sum(turning * carried[..., 0], axis=-1) @ bodies.free
    return damping_rate(system) * float(moving + spinning)


def potential(system: System, x: Floats, attitude: Floats) -> Floats:
    """Potential (...) [J] of bodies at x (..., b, 3) [m] with attitudes (..., b, 3, 3)."""
    effects, bodies = system.effects, system.bodies
    mass = bodies.free * bodies.mass
    total = -(x @ np.array(effects.gravity)) @ mass
    if effects.orbit is not None:
        total = total + orbital_potential(effects.orbit, x) @ mass
    if effects.j2 is not None:
        total = total - 0.5 * np.einsum("...bc,cd,...bd->...b", x, system.oblate, x) @ mass
    second = bodies.free[:, None, None] * second_moments(bodies.inertia)
    turned = np.einsum("...bij,bjk,...blk->...il", attitude, second, attitude)
    return np.asarray(total - 0.5 * np.einsum("ij,...ji->...", gradient_of(system), turned))


def propel(system: System, t: float, whole: Whole, mode: Mode, beside: Floats, torque: Floats) -> float:
    """Adds thrust on bodies to accelerations `beside` (b, 3) [m/s2] and `torque` (b, 3) [N m].

    Returns the power [W] that it puts in.
    """
    bodies, power = system.bodies, 0.0
    w = turning(whole.attitude, whole.spin, bodies.mobility)
    segments = (None,) * len(system.propelled) if mode.burns is None else mode.burns
    for (body, thruster), segment in zip(system.propelled, segments, strict=True):
        force, turn = thruster.wrench(t, segment, whole.attitude[body], bodies.centre_of_mass[body])
        beside[body] += force / bodies.mass[body]
        torque[body] += turn
        power += float(force @ whole.v[len(system.net.mass) + body] + turn @ w[body])
    return power


def press(
    system: System, whole: Whole, body: int, force: Floats, push: Floats, beside: Floats, torque: Floats
) -> None:
    """Adds forces (n, 3) [N] from a rigid body to those on the nodes, and their opposite to what moves it."""
    n = len(push)
    push += force
    beside[body] -= force.sum(axis=0) / system.bodies.mass[body]
    torque[body] -= cross(whole.x[:n] - whole.x[n + body], force).sum(axis=0)


def give_where_touched(
    system: System, whole: Whole, on_nodes: list[tuple[int, Floats]], given: Floats
) -> None:
    """Adds to what driven bodies give (d, 7) the forces (n, 3) [N] from them on the nodes.

    The power is that at the places of the nodes as these move with the body: a line shares its forces among
    its ends so that sums, moments and powers of a rigid motion are the same.
    """
    n = len(system.net.mass)
    for body, force in on_nodes:
        row = np.flatnonzero(system.bodies.driven == body)
        if not len(row):
            continue
        w = turning(whole.attitude, whole.spin, system.bodies.mobility)[body]
        moving = whole.v[n + body] + cross(w, whole.x[:n] - whole.x[n + body])
        given[row[0], :3] += force.sum(axis=0)
        given[row[0], 3:6] += cross(whole.x[:n], force).sum(axis=0)
        given[row[0], 6] += np.vdot(force, moving)


def bear(
    system: System,
    t: float,
    whole: Whole,
    carried: Levers,
    result: Floats,
    beside: Floats,
    torque: Floats,
    given: Floats,
) -> None:
    """Lets bodies bear the nodes that they hold: changes accelerations, torques, and what driven bodies give.

    `result` (n, 3) [m/s2] are the accelerations that the nodes would have free; those held then rest.  A
    driven body gives them what is missing of the forces that they need for its motion.
    """
    bodies, node = system.bodies, carried.node
    borne = system.net.mass[node, None] * result[node]
    result[node] = 0.0
    push, turn = held.yielding(system, carried, whole.attitude, whole.spin, borne, beside, torque)
    beside += push / bodies.mass[:, None]
    torque += turn
    if not len(bodies.driven):
        return
    w, lever = turning(whole.attitude, whole.spin, bodies.mobility), carried.turned(whole.attitude)
    missing = system.net.mass[node, None] * carried.accelerations(*bodies.accelerations(t), w, lever) - borne
    for row, k in zip(given, bodies.driven.tolist(), strict=True):
        mine = carried.body == k
        row[:3] += missing[mine].sum(axis=0)
        row[3:6] += np.cross(whole.x[node[mine]], missing[mine]).sum(axis=0)
        row[6] += np.vdot(missing[mine], whole.v[node[mine]])


def given_by_driven(system: System, whole: Whole, push: Floats, thrown: Floats | None) -> Floats:
    """What driven bodies give (d, 7): the opposite of what pulls on their nodes, and what they throw with.

    The work of a push `thrown` (k, 3) [N] is that at the barrel's place, which moves with the body.
    """
    given = np.zeros((len(system.bodies.driven), 7))
    if not len(given):
        return given
    for row, k in zip(given, system.bodies.driven.tolist(), strict=True):
        mine = system.levers.node[system.levers.body == k]
        force = -push[mine]
        row[:3] = force.sum(axis=0)
        row[3:6] = np.cross(whole.x[mine], force).sum(axis=0)
        row[6] = np.vdot(force, whole.v[mine])
        if thrown is not None and system.barrels is not None and k == system.barrels.body:
            w = turning(whole.attitude, whole.spin, system.bodies.mobility)[k]
            moving = whole.v[system.chaser] + cross(w, system.bullets_from_chaser(whole.x))
            row[:3] += thrown.sum(axis=0)
            row[3:6] += np.cross(whole.x[system.net.bullet_nodes], thrown).sum(axis=0)
            row[6] += np.vdot(thrown, moving)
    return given


def on_bodies(
    system: System, whole: Whole, push: Floats, beside: Floats, torque: Floats
) -> tuple[Floats, float]:
    """Torques (b, 3) [N m] on the bodies, and the power taken from them [W]; adds to accelerations `beside`.

    `torque` (b, 3) [N m] is that of launch_force.

    `push` (n, 3) [N] are the forces on the nodes, of which those on points of bodies act on these.
    """
    taken = 0.0
    if len(system.levers) and len(torque):
        levers = system.levers
        force, turn = levers.wrench(push[levers.node], levers.turned(whole.attitude))
        torque = torque + turn
        beside += force / system.bodies.mass[:, None]
    if len(beside) and act(system):
        n = len(push)
        beside += accelerations(system, whole.x[n:], whole.v[n:])
        w = turning(whole.attitude, whole.spin, system.bodies.mobility)
        torque = torque + torques(system, whole.attitude, w)
        taken = damping_power(system, whole.v[n:], whole.attitude, w)
    if len(system.bodies.driven) and len(beside):
        beside *= system.bodies.free[:, None]
        torque = torque * system.bodies.free[:, None]
    return torque, taken
