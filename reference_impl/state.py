"""The state of a system as one array y = (x, v, R, h, W), and its parts.

x, v: positions and velocities of N = n + b particles, the net's nodes and the bodies' centres of mass; R, h:
rotation matrices and angular momenta of the r rigid bodies (`bodies`); W: the energy that has left.

Nodes that are points of bodies have rows in x and v that rest; `Layout.whole` puts in what the bodies say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import (
    Bodies,
    BodyStates,
    attitude_rate,
    orthonormal,
    own_turning,
    turning,
    turning_rate,
)
from reference_impl.forces import Response, Whole
from reference_impl.system import System


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parts of y (..., 6 N + 12 r + 1) are."""

    system: System

    @property
    def nodes(self) -> int:
        """n."""
        return len(self.system.net.mass)

    @property
    def bodies(self) -> Bodies:
        return self.system.bodies

    @property
    def half(self) -> int:
        """Size 3 N of positions, and of velocities."""
        return 3 * (self.nodes + len(self.bodies.names))

    @property
    def turned(self) -> int:
        """Where attitudes end and angular momenta begin."""
        return 2 * self.half + 9 * len(self.bodies.rigid)

    @property
    def moved(self) -> int:
        """Where the motion ends and the books begin."""
        return self.turned + 3 * len(self.bodies.rigid)

    def held(self, y: Floats) -> Whole:
        """The rows of y as they stand."""
        lead, r = y.shape[:-1], len(self.bodies.rigid)
        return Whole(
            y[..., : self.half].reshape(*lead, -1, 3),
            y[..., self.half : 2 * self.half].reshape(*lead, -1, 3),
            y[..., 2 * self.half : self.turned].reshape(*lead, r, 3, 3),
            y[..., self.turned : self.moved].reshape(*lead, r, 3),
        )

    def whole(self, y: Floats) -> Whole:
        """x, v (..., N, 3), R (..., r, 3, 3) and h (..., r, 3) of all particles and rigid bodies."""
        held, levers = self.held(y), self.system.levers
        if not len(levers):
            return held
        x, v = held.x.copy(), held.v.copy()
        lever = levers.turned(held.attitude)
        w = turning(held.attitude, held.spin, self.bodies.mobility)
        rigid = self.nodes + self.bodies.rigid
        x[..., levers.node, :] = levers.places(x[..., rigid, :], lever)
        v[..., levers.node, :] = levers.velocities(v[..., rigid, :], w, lever)
        return Whole(x, v, held.attitude, held.spin)

    def positions(self, y: Floats) -> Floats:
        """(..., N, 3) [m]."""
        return self.whole(y).x

    def velocities(self, y: Floats) -> Floats:
        """(..., N, 3) [m/s]."""
        return self.whole(y).v

    def accelerations(self, y: Floats, rate: Floats) -> Floats:
        """(..., N, 3) [m/s2] in the states y, whose rates are dy/dt."""
        change, levers = self.held(rate), self.system.levers
        if not len(levers):
            return change.v
        whole, result = self.whole(y), change.v.copy()
        w = turning(whole.attitude, whole.spin, self.bodies.mobility)
        angular = turning_rate(whole.attitude, whole.spin, change.spin, self.bodies)
        linear = result[..., self.nodes + self.bodies.rigid, :]
        lever = levers.turned(whole.attitude)
        result[..., levers.node, :] = levers.accelerations(linear, angular, w, lever)
        return result

    def pack(self, x: Floats, v: Floats, bodies: BodyStates | None) -> Floats:
        """y (6 N + 12 r + 1,) with W = 0."""
        if bodies is None:
            return np.concatenate((np.ravel(x), np.ravel(v), (0.0,)))
        rigid = self.bodies.rigid
        attitude = bodies.attitude[rigid]
        own = np.einsum("bij,bj->bi", self.bodies.resistance, bodies.angular_velocity[rigid])
        spin = np.einsum("bij,bj->bi", attitude, own)
        moving = np.array(v, dtype=float)
        moving[self.system.levers.node] = 0.0
        parts = (x, bodies.position, moving, bodies.velocity, attitude, spin, 0.0)
        return np.concatenate([np.ravel(part) for part in parts])

    def rate(self, y: Floats, whole: Whole, response: Response) -> Floats:
        """dy/dt in a state y with these particles, whose forces have this response."""
        parts = [y[self.half : 2 * self.half], response.acceleration.ravel()]
        if len(self.bodies.rigid):
            parts.append(attitude_rate(whole.attitude, whole.spin, self.bodies.mobility).ravel())
            parts.append(response.torque.ravel())
        return np.concatenate((*parts, (response.power,)))

    def body_states(self, y: Floats) -> BodyStates:
        """States (..., b, ...) of the bodies, attitudes made orthonormal."""
        shape = (*y.shape[:-1], len(self.bodies.names))
        attitude, angular = np.broadcast_to(np.eye(3), (*shape, 3, 3)).copy(), np.zeros((*shape, 3))
        whole = self.whole(y)
        if len(rigid := self.bodies.rigid):
            attitude[..., rigid, :, :] = turned = orthonormal(whole.attitude)
            angular[..., rigid, :] = own_turning(turned, whole.spin, self.bodies.mobility)
        return BodyStates(whole.x[..., self.nodes :, :], whole.v[..., self.nodes :, :], attitude, angular)


def layout(system: System) -> Layout:
    """The layout of a system's state."""
    return Layout(system)
