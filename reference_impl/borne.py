"""What forces on nodes do to the bodies that hold or touch these, and what driven bodies give."""

from __future__ import annotations

import numpy as np

from reference_impl import fields, held
from reference_impl.anchors import Levers
from reference_impl.arrays import Floats, cross
from reference_impl.bodies import turning
from reference_impl.system import System
from reference_impl.thrown import bullets_from_chaser
from reference_impl.whole import Whole


def press(
    system: System, whole: Whole, body: int, force: Floats, push: Floats, beside: Floats, torque: Floats
) -> None:
    """Adds forces (n, 3) [N] from a rigid body to those on the nodes, and their opposite to what moves it."""
    n, number = len(push), system.bodies.rigid[body]
    push += force
    beside[number] -= force.sum(axis=0) / system.bodies.mass[number]
    torque[body] -= cross(whole.x[:n] - whole.x[n + number], force).sum(axis=0)


def give_where_touched(
    system: System, whole: Whole, on_nodes: list[tuple[int, Floats]], given: Floats
) -> None:
    """Adds to what driven bodies give (d, 7) the forces (n, 3) [N] from them on the nodes.

    The power is that at the places of the nodes as these move with the body: a line shares its forces among
    its ends so that sums, moments and powers of a rigid motion are the same.
    """
    n = len(system.net.mass)
    for body, force in on_nodes:
        number = system.bodies.rigid[body]
        row = np.flatnonzero(system.bodies.driven == number)
        if not len(row):
            continue
        w = turning(whole.attitude, whole.spin, system.bodies.mobility)[body]
        moving = whole.v[n + number] + cross(w, whole.x[:n] - whole.x[n + number])
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
    bodies, rigid, node = system.bodies, system.bodies.rigid, carried.node
    borne = system.net.mass[node, None] * result[node]
    result[node] = 0.0
    push, turn = held.yielding(system, carried, whole.attitude, whole.spin, borne, beside[rigid], torque)
    beside[rigid] += push / bodies.mass[rigid, None]
    torque += turn
    if not len(bodies.driven):
        return
    w, lever = turning(whole.attitude, whole.spin, bodies.mobility), carried.turned(whole.attitude)
    missing = system.net.mass[node, None] * carried.accelerations(*bodies.accelerations(t), w, lever) - borne
    for row, k in zip(given, bodies.driven.tolist(), strict=True):
        mine = rigid[carried.body] == k
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
        mine = system.levers.node[system.bodies.rigid[system.levers.body] == k]
        force = -push[mine]
        row[:3] = force.sum(axis=0)
        row[3:6] = np.cross(whole.x[mine], force).sum(axis=0)
        row[6] = np.vdot(force, whole.v[mine])
        if thrown is not None and system.barrels is not None and k == system.barrels.body:
            w = turning(whole.attitude, whole.spin, system.bodies.mobility)[system.barrels.rigid]
            moving = whole.v[system.chaser] + cross(w, bullets_from_chaser(system, whole.x))
            row[:3] += thrown.sum(axis=0)
            row[3:6] += np.cross(whole.x[system.net.bullet_nodes], thrown).sum(axis=0)
            row[6] += np.vdot(thrown, moving)
    return given


def on_bodies(
    system: System, whole: Whole, push: Floats, beside: Floats, torque: Floats
) -> tuple[Floats, float]:
    """Torques (r, 3) [N m] on the bodies, and the power taken from them [W]; adds to accelerations `beside`.

    `torque` (r, 3) [N m] is that of launch_force.

    `push` (n, 3) [N] are the forces on the nodes, of which those on points of bodies act on these.
    """
    taken, rigid = 0.0, system.bodies.rigid
    if len(system.levers) and len(torque):
        levers = system.levers
        force, turn = levers.wrench(push[levers.node], levers.turned(whole.attitude))
        torque = torque + turn
        beside[rigid] += force / system.bodies.mass[rigid, None]
    if len(beside) and fields.act(system):
        n = len(push)
        beside += fields.accelerations(system, whole.x[n:], whole.v[n:])
        w = turning(whole.attitude, whole.spin, system.bodies.mobility)
        torque = torque + fields.torques(system, whole.attitude, w)
        taken = fields.taken(system, whole.v[n:], whole.attitude, w)
    if len(system.bodies.driven) and len(beside):
        beside *= system.bodies.free[:, None]
        torque = torque * system.bodies.free[rigid, None]
    return torque, taken
