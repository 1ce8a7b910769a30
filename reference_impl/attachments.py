"""Nodes that are points of bodies: where they are, how they move, and what pulls them does to the bodies.

A point at the lever l = R a from a body's centre of mass X, a in the axes of the body, which turns with w
(Goldstein, Classical Mechanics, ch. 4.9):

    x = X + l,  v = V + w x l,  x'' = A + w' x l + w x (w x l);  a force p there has the torque l x p.

The levers are rows of an incidence matrix between bodies and nodes, as are the ends of the elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from reference_impl.arrays import Floats, Ints, cross


@dataclass(frozen=True, eq=False)
class Anchors:
    """a nodes, each at a point of a body."""

    node: Ints  # (a,)
    body: Ints  # (a,) numbers of the bodies
    point: Floats  # (a, 3) [m] in the bodies' frames

    def __len__(self) -> int:
        return len(self.node)


def none() -> Anchors:
    """No node is a point of a body."""
    return Anchors(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty((0, 3)))


@dataclass(frozen=True, eq=False)
class Levers:
    """The anchors of a system: `arm` from the centre of mass in the axes of the body; `bodies` is b."""

    node: Ints  # (a,)
    body: Ints  # (a,)
    arm: Floats  # (a, 3) [m]
    bodies: int

    def __len__(self) -> int:
        return len(self.node)

    def some(self, rows: Ints) -> Levers:
        """Those of these rows."""
        return Levers(self.node[rows], self.body[rows], self.arm[rows], self.bodies)

    @cached_property
    def gathering(self) -> csr_array:
        """(b, a): 1 where a node is a point of a body."""
        ones = (np.ones(len(self)), (self.body, np.arange(len(self))))
        return csr_array(ones, shape=(self.bodies, len(self)))

    def turned(self, attitude: Floats) -> Floats:
        """l (..., a, 3) [m] in the scene's axes, of attitudes (..., b, 3, 3)."""
        return np.asarray(np.einsum("...aij,aj->...ai", attitude[..., self.body, :, :], self.arm))

    def places(self, centre: Floats, lever: Floats) -> Floats:
        """x (..., a, 3) [m] of centres of mass (..., b, 3)."""
        return np.asarray(centre[..., self.body, :] + lever)

    def velocities(self, velocity: Floats, turning: Floats, lever: Floats) -> Floats:
        """v (..., a, 3) [m/s] of the centres' velocities and angular velocities (..., b, 3) of the scene."""
        return np.asarray(velocity[..., self.body, :] + cross(turning[..., self.body, :], lever))

    def accelerations(self, linear: Floats, angular: Floats, turning: Floats, lever: Floats) -> Floats:
        """x'' (..., a, 3) [m/s2] of accelerations A, w' and angular velocities w (..., b, 3) of the scene."""
        w = turning[..., self.body, :]
        curving = cross(angular[..., self.body, :], lever) + cross(w, cross(w, lever))
        return np.asarray(linear[..., self.body, :] + curving)

    def wrench(self, push: Floats, lever: Floats) -> tuple[Floats, Floats]:
        """Force [N] and torque about the centre of mass [N m], (b, 3) each, of forces (a, 3) on the nodes."""
        return self.gathering @ push, self.gathering @ cross(lever, push)
