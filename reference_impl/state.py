"""The state of a system as one array y = (x, v, R, h, W), and its parts.

x, v: positions and velocities of N = n + b particles, the net's nodes and the bodies' centres of mass; R, h:
rotation matrices and angular momenta of the r rigid bodies (`bodies`); W: the energy that has left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import Bodies, BodyStates, attitude_rate, orthonormal, own_turning
from reference_impl.system import System


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parts of y (..., 6 N + 12 r + 1) are."""

    nodes: int  # n
    bodies: Bodies

    @property
    def half(self) -> int:
        """Size 3 N of positions, and of velocities."""
        return 3 * (self.nodes + len(self.bodies.names))

    @property
    def turned(self) -> int:
        """Where attitudes end and angular momenta begin."""
        return 2 * self.half + 9 * len(self.bodies.rigid)

    def positions(self, y: Floats) -> Floats:
        """(..., N, 3) [m]."""
        return y[..., : self.half].reshape(*y.shape[:-1], -1, 3)

    def velocities(self, y: Floats) -> Floats:
        """(..., N, 3) [m/s]."""
        return y[..., self.half : 2 * self.half].reshape(*y.shape[:-1], -1, 3)

    def attitudes(self, y: Floats) -> Floats:
        """(..., r, 3, 3)."""
        return y[..., 2 * self.half : self.turned].reshape(*y.shape[:-1], len(self.bodies.rigid), 3, 3)

    def spins(self, y: Floats) -> Floats:
        """(..., r, 3) [kg m2/s]."""
        return y[..., self.turned : -1].reshape(*y.shape[:-1], len(self.bodies.rigid), 3)

    def pack(self, x: Floats, v: Floats, bodies: BodyStates | None) -> Floats:
        """y (6 N + 12 r + 1,) with W = 0."""
        if bodies is None:
            return np.concatenate((np.ravel(x), np.ravel(v), (0.0,)))
        rigid = self.bodies.rigid
        attitude = bodies.attitude[rigid]
        own = np.einsum("bij,bj->bi", self.bodies.resistance, bodies.angular_velocity[rigid])
        spin = np.einsum("bij,bj->bi", attitude, own)
        parts = (x, bodies.position, v, bodies.velocity, attitude, spin, 0.0)
        return np.concatenate([np.ravel(part) for part in parts])

    def rotation_rates(self, y: Floats) -> tuple[Floats, Floats]:
        """R' (9 r,) and h' (3 r,), flat."""
        spins = self.spins(y)
        rates = attitude_rate(self.attitudes(y), spins, self.bodies.mobility)
        return rates.ravel(), np.zeros(spins.size)

    def body_states(self, y: Floats) -> BodyStates:
        """States (..., b, ...) of the bodies, attitudes made orthonormal."""
        shape = (*y.shape[:-1], len(self.bodies.names))
        attitude, angular = np.broadcast_to(np.eye(3), (*shape, 3, 3)).copy(), np.zeros((*shape, 3))
        if len(rigid := self.bodies.rigid):
            attitude[..., rigid, :, :] = turned = orthonormal(self.attitudes(y))
            angular[..., rigid, :] = own_turning(turned, self.spins(y), self.bodies.mobility)
        return BodyStates(
            self.positions(y)[..., self.nodes :, :],
            self.velocities(y)[..., self.nodes :, :],
            attitude,
            angular,
        )


def layout(system: System) -> Layout:
    """The layout of a system's state."""
    return Layout(len(system.net.mass), system.bodies)
