"""Nodes on the drums of reels: they move with a point of a body, and press on it with what moves them.

The nodes on one drum are a point mass mu at a lever l of the body.  It takes from the forces P on it what its
acceleration needs, and the body gets the rest as a force at the point,

    C = P - mu a,  a = a0 + sum of W C over the body's drums,  W_qr = 1/M - [l_q]x I^-1 [l_r]x,

a0 the acceleration of the point without the C, I the body's matrix of inertia in the scene's axes.  W is the
inverse of the operational-space inertia (Khatib, IEEE J. Robotics Automation 3 (1987),
doi:10.1109/JRA.1987.1087068), zero for a body of given motion: it gets P - mu a0, a0 that of its motion.
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.bodies import turning, turning_rate
from reference_impl.reels import Reels
from reference_impl.system import System
from reference_impl.turns import skew


def nodes_of(reels: Reels, held: Floats) -> list[Ints]:
    """The nodes at each drum, for k (R,)."""
    return [nodes[: int(k)] for nodes, k in zip(reels.nodes, held, strict=True)]


def masses(system: System, held: Floats) -> Floats:
    """mu (R,) [kg] at each drum."""
    assert system.reels is not None
    return np.array([system.net.mass[nodes].sum() for nodes in nodes_of(system.reels, held)])


def place(system: System, x: Floats, held: Floats) -> None:
    """Gives the nodes at the drums, in an array x (..., N, 3), the values of the drums; held (..., R)."""
    assert system.reels is not None
    for reel, (drum, nodes) in enumerate(zip(system.reels.drum, system.reels.nodes, strict=True)):
        there = system.reels.on_drum(reel, held)[..., None]
        x[..., nodes, :] = np.where(there, x[..., drum, None, :], x[..., nodes, :])


def inverse_inertia(system: System, attitude: Floats) -> Floats:
    """I^-1 (r, 3, 3) [1/(kg m2)] in the scene's axes, zero for bodies of given motion."""
    bodies = system.bodies
    turned = attitude @ bodies.mobility @ np.swapaxes(attitude, -1, -2)
    return np.asarray(bodies.free[bodies.rigid, None, None] * turned)


def bearing(
    system: System,
    attitude: Floats,
    spin: Floats,
    held: Floats,
    borne: Floats,
    acceleration: Floats,
    torque: Floats,
) -> Floats:
    """C (R, 3) [N], from the forces P = borne (R, 3) [N] on the nodes at each drum.

    attitude (r, 3, 3) and spin (r, 3) of the rigid bodies; acceleration (r, 3) [m/s2] and torque (r, 3) [N m]
    are what they have without the C.
    """
    bodies, drums, mu = system.bodies, system.drums, masses(system, held)
    if not mu.any():
        return borne
    lever = drums.turned(attitude)
    w = turning(attitude, spin, bodies.mobility)
    angular = turning_rate(attitude, spin, torque, bodies) * bodies.free[bodies.rigid, None]
    inert = drums.accelerations(acceleration, angular, w, lever)
    r, arm = len(mu), skew(lever)
    inverse = inverse_inertia(system, attitude)[drums.body]
    lightness = bodies.free[bodies.rigid] / bodies.mass[bodies.rigid]
    same = drums.body[:, None] == drums.body
    light = (same * lightness[drums.body])[..., None, None] * np.eye(3)
    turned = same[..., None, None] * (arm[:, None] @ inverse[None] @ arm[None])
    coupled = (light - turned).transpose(0, 2, 1, 3).reshape(3 * r, 3 * r)
    weight = np.repeat(mu, 3)
    given = (borne - mu[:, None] * inert).ravel()
    try:
        return np.linalg.solve(np.eye(3 * r) + weight[:, None] * coupled, given).reshape(r, 3)
    except np.linalg.LinAlgError:  # of no rotation: a trial step far beyond what will be accepted
        return np.full((r, 3), np.nan)
