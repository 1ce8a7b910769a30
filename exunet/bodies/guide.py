"""The motion of a body that forces do not move: its pose as a function of time, piece by piece.

In the piece that begins at t_i the guided point is at c0 s^3 + c1 s^2 + c2 s + c3, s = t - t_i; the attitude
is that of t_i turned by the rotation vector phi(s), also a cubic, about axes of the body. Its angular
velocity, in axes of the body, is J(phi) phi' with

    J(phi) u = u - (1 - cos a) / a^2 phi x u + (a - sin a) / a^3 phi x (phi x u),  a = |phi|,

Bullo and Murray, "Proportional derivative (PD) control on the Euclidean group", ECC 1995, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import product, quaternion_of, rotation_matrix

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Guide:
    """The poses of a body over time, in its principal axes.

    time     : (n,) where the pieces begin [s]; the last one has no end
    position : (n, 4, 3) coefficients c0 ... c3 of the place of the guided point [m/s3 ... m]
    attitude : (n, 4) unit quaternions (w, x, y, z) where the pieces begin
    turning  : (n, 4, 3) coefficients of the rotation vector phi, in the body's axes
    offset   : (3,) of the centre of mass from the guided point, in the body's axes [m]
    """

    time: Floats
    position: Floats
    attitude: Floats
    turning: Floats
    offset: Floats

    @classmethod
    def steady(cls, place: Floats, velocity: Floats, attitude: Floats, spin: Floats) -> Guide:
        """The centre of mass moves at a constant velocity, the body turns at a constant one in its axes.

        place, velocity : (3,) at time 0 [m], [m/s]; attitude (4,); spin (3,) [rad/s]
        """
        position, turning = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
        position[0, 2:] = velocity, place
        turning[0, 2] = spin
        return cls(np.zeros(1), position, attitude[None], turning, np.zeros(3))

    @classmethod
    def through(cls, time: Floats, place: Floats, attitude: Floats, offset: Floats) -> Guide:
        """Smoothly through poses: splines whose velocities and accelerations have no jumps.

        time (n,) [s], increasing, n >= 2; place (n, 3) of the guided point [m]; attitude (n, 4), the shorter
        way between neighbours is taken; offset : as above. At both ends the accelerations are zero.
        """
        line = scipy.interpolate.CubicSpline(time, place, bc_type="natural")
        turns = scipy.spatial.transform.Rotation.from_quat(attitude, scalar_first=True)
        spline = scipy.spatial.transform.RotationSpline(time, turns)
        # The spline's rotation vectors are cubics, which three values beside zero determine.
        thirds = np.array([1.0, 2.0, 3.0]) / 3.0
        powers = thirds[:, None] ** np.array([3.0, 2.0, 1.0])
        turning = np.zeros((len(time) - 1, 4, 3))
        for k, step in enumerate(np.diff(time)):
            angles = (turns[k].inv() * spline(time[k] + thirds * step)).as_rotvec()
            turning[k, :3] = np.linalg.solve(powers, angles) / np.array([[step**3], [step**2], [step]])
        return cls(time[:-1], np.moveaxis(line.c, 1, 0).copy(), attitude[:-1], turning, offset)

    @property
    def is_finite(self) -> bool:
        """True if no number has overflowed."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.turning).all())

    @property
    def rests(self) -> bool:
        """True if the body does not move."""
        return not self.position[:, :3].any() and not self.turning[:, :3].any()

    def at(self, time: Floats) -> RigidStates:
        """States of the centre of mass, (k, ...) at times (k,) [s]."""
        piece = np.maximum(np.searchsorted(self.time, time, side="right") - 1, 0)
        s = (time - self.time[piece])[:, None]
        position, turning = self.position[piece], self.turning[piece]
        place, speed = _cubic(position, s)
        angle, rate = _cubic(turning, s)
        attitude = product(self.attitude[piece], quaternion_of(angle))
        spin = _jacobian(angle, rate)
        turn = rotation_matrix(attitude)
        place = place + turn @ self.offset
        speed = speed + np.einsum("kij,kj->ki", turn, np.cross(spin, self.offset))
        return RigidStates(place, speed, attitude, spin)


def _cubic(coefficients: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Values and rates (k, 3) of cubics (k, 4, 3) at s (k, 1)."""
    c0, c1, c2, c3 = np.moveaxis(coefficients, 1, 0)
    return ((c0 * s + c1) * s + c2) * s + c3, (3.0 * c0 * s + 2.0 * c1) * s + c2


def _jacobian(angle: Floats, rate: Floats) -> Floats:
    size = np.linalg.norm(angle, axis=-1, keepdims=True)
    near = size < 1e-3  # where the differences below lose digits, two terms of their series are exact
    a = np.where(near, 1.0, size)
    first = np.where(near, 0.5 - size**2 / 24.0, 2.0 * (np.sin(0.5 * a) / a) ** 2)
    second = np.where(near, 1.0 / 6.0 - size**2 / 120.0, (a - np.sin(a)) / a**3)
    across = np.cross(angle, rate)
    return np.asarray(rate - first * across + second * np.cross(angle, across))
