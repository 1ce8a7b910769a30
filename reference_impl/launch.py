"""What leaves a body: bullets along the barrels of launch_force, and a packed net when it is ejected.

Barrels rest in the axes of a rigid body, the chaser.  With the body's rotation R and centre of mass X, a
barrel a and the place r0 of its bullet at the start, both in the body's axes, and l = x - X, the way and its
rate are (Goldstein, Classical Mechanics, ch. 4.9)

    s = a.(R^T l - r0),  s' = n.(v - V - w x l),  n = R a.

The virtual work F ds of a push F is that of F n on the bullet and of -F n on the body at the bullet's place.

Until then its nodes are point masses at points of the body (`held`), each where it is packed; then each gets
what `[initial]` and `[launch]` give it, in the axes that the net has then, and body and nodes keep their
momenta (`handover`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, cross, dot
from reference_impl.attachments import Levers
from reference_impl.bodies import Bodies, BodyStates
from reference_impl.case import Case
from reference_impl.net import Net
from reference_impl.start import initial_state, net_axes, spread, thrown


@dataclass(frozen=True, eq=False)
class Barrels:
    """k barrels of one chaser."""

    axis: Floats  # a (k, 3), unit vectors in the chaser's axes
    start: Floats  # r0 (k, 3) [m] of the bullets at t = 0, from its centre of mass, in these axes
    body: int  # which of the bodies it is

    def directions(self, attitude: Floats) -> Floats:
        """n (..., k, 3) in the scene's axes, of attitudes R (..., b, 3, 3)."""
        return np.asarray(np.einsum("...ij,kj->...ki", attitude[..., self.body, :, :], self.axis))

    def ways(self, lever: Floats, attitude: Floats) -> Floats:
        """s (..., k) [m] of bullets at l (..., k, 3) [m] from the chaser."""
        own = np.einsum("...ji,...kj->...ki", attitude[..., self.body, :, :], lever)
        return dot(own - self.start, self.axis)


def reaction(thrown: Floats, lever: Floats) -> tuple[Floats, Floats]:
    """Force [N] and torque about its centre of mass [N m] (3,) on what throws with forces (k, 3) at (k, 3).

    Sums without round-off, so that those of mirrored bullets cancel.
    """
    return _summed(-thrown), _summed(cross(lever, -thrown))


def _summed(rows: Floats) -> Floats:
    return np.array([math.fsum(column) for column in rows.T.tolist()])


def aimed(case: Case, net: Net, bodies: Bodies, states: BodyStates) -> Barrels | None:
    """The barrels of a case, from how it starts; None without launch_force."""
    launch = case.effects.launch_force
    if launch is None:
        return None
    body = bodies.names.index(launch.body)
    start = initial_state(case, net)[0][net.bullet_nodes] - states.position[body]
    attitude = states.attitude[body]
    axis = spread(net, launch.spread_angle) @ net_axes(case).T @ attitude
    return Barrels(axis, start @ attitude, body)


ROUND_OFF = 1e-15  # part of the time of an ejection within which another time is the same


@dataclass(frozen=True, eq=False)
class Packed:
    """q nodes that one body holds."""

    levers: Levers  # of the nodes (q,), from the body's centre of mass
    given: Floats  # (q, 3) [m/s] that they get beside the body's velocity, in the body's axes
    until: float  # [s]

    def holds(self, t: float) -> bool:
        """Whether they are still held at t [s]; a time that is `until` but for round-off is `until`."""
        return t < self.until * (1.0 - ROUND_OFF)

    @property
    def body(self) -> int:
        """Which of the bodies holds them."""
        return int(self.levers.body[0])


def packed(case: Case, net: Net, bodies: Bodies) -> Packed | None:
    """What a body holds until `eject_at`: all of the net but points of bodies; None if there is nothing."""
    carrier = case.start.carrier
    if carrier is None or not carrier.eject_at:
        return None
    node = np.setdiff1d(np.arange(net.woven), net.anchors.node)
    if not len(node):
        return None
    place, velocity = (values[node] @ carrier.attitude.T for values in thrown(case, net))
    body = bodies.names.index(carrier.body)
    arm = carrier.position + place - bodies.centre_of_mass[body]
    return Packed(Levers(node, np.full(len(node), body), arm, len(bodies.names)), velocity, carrier.eject_at)
