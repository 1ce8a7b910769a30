"""Bodies whose motion is given: at rest, at constant velocities, or smoothly through a table of poses.

Positions of the frame's origin are natural cubic splines (de Boor, A Practical Guide to Splines, ch. IV);
rotations between neighbouring attitudes are cubic rotation vectors with continuous angular velocity and
acceleration (SciPy's RotationSpline).  After the last pose the last piece goes on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from reference_impl.arrays import Floats, Vector
from reference_impl.turns import turned


@dataclass(frozen=True, eq=False)
class Guided:
    """A given motion at times (...): of the centre of mass, and of the body's axes; in the scene's axes."""

    position: Floats  # (..., 3) [m]
    velocity: Floats  # (..., 3) [m/s]
    acceleration: Floats  # (..., 3) [m/s2]
    attitude: Floats  # (..., 3, 3)
    turning: Floats  # (..., 3) [rad/s]
    angular: Floats  # (..., 3) [rad/s2]


@dataclass(frozen=True, eq=False)
class Steady:
    """Constant velocity of the centre of mass and constant angular velocity, both maybe zero."""

    position: Floats  # (3,) [m] of the centre of mass at time 0
    velocity: Floats  # (3,) [m/s]
    attitude: Floats  # (3, 3) at time 0
    turning: Floats  # (3,) [rad/s] in the scene's axes

    def at(self, t: Floats) -> Guided:
        """The motion at times (...) [s]."""
        time = np.asarray(t)[..., None]
        shape = (*np.shape(t), 3)
        attitude = turned(np.broadcast_to(self.attitude, (*shape, 3)), time * self.turning)
        return Guided(
            self.position + time * self.velocity,
            np.broadcast_to(self.velocity, shape),
            np.zeros(shape),
            attitude,
            np.broadcast_to(self.turning, shape),
            np.zeros(shape),
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the body's frame at q times."""

    times: tuple[float, ...]  # [s]
    positions: tuple[Vector, ...]  # [m] of the frame's origin
    attitudes: Floats  # (q, 3, 3)
    centre: Floats = field(default_factory=lambda: np.zeros(3))  # (3,) [m] of mass, in the body's frame

    @cached_property
    def _path(self) -> CubicSpline:
        return CubicSpline(self.times, np.array(self.positions), bc_type="natural")

    @cached_property
    def _turn(self) -> RotationSpline:
        return RotationSpline(np.array(self.times), Rotation.from_matrix(self.attitudes))

    @cached_property
    def _latest(self) -> dict[float, Guided]:
        """The motion at the one time that was asked for last: a right-hand side needs it several times."""
        return {}

    def at(self, t: Floats) -> Guided:
        """The motion at times (...) [s]."""
        if np.ndim(t):
            return self._evaluated(t)
        if (time := float(t)) not in self._latest:
            self._latest.clear()
            self._latest[time] = self._evaluated(t)
        return self._latest[time]

    def _evaluated(self, t: Floats) -> Guided:
        shape, flat = np.shape(t), np.ravel(t)
        attitude = self._turn(flat).as_matrix()
        own, own_rate = (self._turn(flat, order) for order in (1, 2))  # in the body's axes
        w = np.einsum("tij,tj->ti", attitude, own)
        angular = np.einsum("tij,tj->ti", attitude, own_rate)
        lever = attitude @ self.centre
        position, velocity, acceleration = (self._path(flat, order) for order in (0, 1, 2))
        found = (
            position + lever,
            velocity + np.cross(w, lever),
            acceleration + np.cross(angular, lever) + np.cross(w, np.cross(w, lever)),
            attitude,
            w,
            angular,
        )
        return Guided(*(values.reshape(*shape, *values.shape[1:]) for values in found))


Drive = Steady | Poses
