"""A packed net that a body holds until it is ejected, `[initial.frame]` with `eject_at`.

Until then its nodes are point masses at points of the body (`held`), each where it is packed; then each gets
what `[initial]` and `[launch]` give it, in the axes that the net has then, and body and nodes keep their
momenta (`handover`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.anchors import Levers
from reference_impl.arrays import Floats
from reference_impl.bodies import Bodies
from reference_impl.case import Case
from reference_impl.net import Net
from reference_impl.start import thrown

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
        """Which of the rigid bodies holds them."""
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
    rigid = np.full(len(node), np.searchsorted(bodies.rigid, body))
    return Packed(Levers(node, rigid, arm, len(bodies.rigid)), velocity, carrier.eject_at)
