"""Nodes that bodies hold, on the drums of reels or as a packed net: they move with points of a body.

They are point masses m at levers l of the body.  Each takes from the forces P on it what its acceleration
needs, and the body gets the rest, P - m a, as a force at the point.  With a0 the acceleration of the point
without these forces, and a = a0 + A + B x l, the changes A, B of the body's two accelerations are those that
the forces P - m a0 give to body and masses as one,

    (G + sum of m J^T J) (A, B) = sum of J^T (P - m a0),  J = [1, -[l]x],  G = diag(M 1, I),

M the body's mass and I its matrix of inertia in the scene's axes: the inertia of a composite rigid body
(Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6), here about the body's own centre of mass.  A body
at rest that is fixed does not yield: it gets P.
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats, Ints, cross, skew
from reference_impl.attachments import Levers
from reference_impl.bodies import turning, turning_rate
from reference_impl.reels import Reels
from reference_impl.system import System


def nodes_of(reels: Reels, held: Floats) -> list[Ints]:
    """The nodes at each drum, for k (R,)."""
    return [nodes[: int(k)] for nodes, k in zip(reels.nodes, held, strict=True)]


def load(system: System, held: Floats | None, packed: bool) -> Levers:
    """The nodes that bodies hold: those at drums, k (R,) of them, and those of a net that is still packed."""
    parts = []
    if system.reels is not None and held is not None:
        drums, row = system.drums, np.repeat(np.arange(len(held)), held.astype(np.intp))
        nodes = np.concatenate(nodes_of(system.reels, held))
        parts.append(Levers(nodes, drums.body[row], drums.arm[row], drums.bodies))
    if system.packed is not None and packed:
        parts.append(system.packed.levers)
    if len(parts) == 1:
        return parts[0]
    everything = [system.levers.some(np.empty(0, dtype=np.intp)), *parts]
    node, body, arm = (
        np.concatenate([getattr(part, key) for part in everything]) for key in ("node", "body", "arm")
    )
    return Levers(node, body, arm, system.levers.bodies)


def place(system: System, x: Floats, held: Floats) -> None:
    """Gives the nodes at the drums, in an array x (..., N, 3), the values of the drums; held (..., R)."""
    assert system.reels is not None
    for reel, (drum, nodes) in enumerate(zip(system.reels.drum, system.reels.nodes, strict=True)):
        there = system.reels.on_drum(reel, held)[..., None]
        x[..., nodes, :] = np.where(there, x[..., drum, None, :], x[..., nodes, :])


def place_packed(system: System, x: Floats, packed: Floats, values: Floats) -> None:
    """Gives nodes of the net, in an array x (..., N, 3), the values (..., q, 3) of points of the body.

    Only where it is `packed` (..., 1).
    """
    assert system.packed is not None
    node = system.packed.levers.node
    x[..., node, :] = np.where(packed[..., None] > 0.0, values, x[..., node, :])


def own_inertia(system: System, attitude: Floats, body: int) -> Floats:
    """I (3, 3) [kg m2] of a rigid body in the scene's axes, of attitudes (b, 3, 3)."""
    return np.asarray(attitude[body] @ system.bodies.inertia[body] @ attitude[body].T)


def inertia(system: System, held: Levers, attitude: Floats, body: int) -> Floats:
    """G + sum of m J^T J (6, 6) of a rigid body: takes V and w to P and H, about its centre of mass."""
    mine = held.some(np.flatnonzero(held.body == body))
    mass, arm = system.net.mass[mine.node], skew(mine.turned(attitude))
    first = np.einsum("q,qij->ij", mass, arm)
    matrix = np.empty((6, 6))
    matrix[:3, :3] = (system.bodies.mass[body] + mass.sum()) * np.eye(3)
    matrix[3:, :3], matrix[:3, 3:] = first, -first
    matrix[3:, 3:] = own_inertia(system, attitude, body) + np.einsum("q,qji,qjk->ik", mass, arm, arm)
    return matrix


def yielding(
    system: System,
    held: Levers,
    attitude: Floats,
    spin: Floats,
    borne: Floats,
    acceleration: Floats,
    torque: Floats,
) -> tuple[Floats, Floats]:
    """Changes of force [N] and torque [N m] (b, 3) on the bodies, by forces P = borne (q, 3) [N] on the held.

    attitude (b, 3, 3) and spin (b, 3) of the bodies; acceleration (b, 3) [m/s2] and torque (b, 3) [N m]
    are what they have without what they hold.
    """
    bodies, free = system.bodies, system.bodies.free
    force, turn = np.zeros_like(torque), np.zeros_like(torque)
    lever, w = held.turned(attitude), turning(attitude, spin, bodies.mobility)
    angular = turning_rate(attitude, spin, torque, bodies) * free[:, None]
    rest = held.accelerations(acceleration, angular, w, lever)
    given = borne - system.net.mass[held.node, None] * rest
    for body in np.unique(held.body[free[held.body] > 0.0]).tolist():
        mine = held.body == body
        pull = np.concatenate((given[mine].sum(axis=0), cross(lever[mine], given[mine]).sum(axis=0)))
        try:
            change = np.linalg.solve(inertia(system, held, attitude, body), pull)
        except np.linalg.LinAlgError:  # of no rotation: a trial step far beyond what will be accepted
            change = np.full(6, np.nan)
        force[body] = bodies.mass[body] * change[:3]
        turn[body] = own_inertia(system, attitude, body) @ change[3:]
    return force, turn
