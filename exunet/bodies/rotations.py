"""Rotations: unit quaternions (w, x, y, z), matrices and rotation vectors, for arrays of them."""

from __future__ import annotations

import numpy as np
import scipy

from exunet.base.arrays import Floats


def rotation_matrix(attitude: Floats) -> Floats:
    """(..., 3, 3) matrices that take vectors from the body's axes to the scene's; attitude (..., 4).

    Schwab and Meijaard, "How to draw Euler angles and utilize Euler parameters", DETC2006-99307, eq. (8).
    """
    w, x, y, z = np.moveaxis(attitude, -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turning(attitude: Floats, angular_velocity: Floats) -> Floats:
    """(..., 4) rates of attitudes at angular velocities in the body's axes: half their quaternion product."""
    w, u = attitude[..., :1], attitude[..., 1:]
    real = -np.einsum("...a,...a->...", u, angular_velocity)[..., None]
    return 0.5 * np.concatenate([real, w * angular_velocity + np.cross(u, angular_velocity)], axis=-1)


def angular_velocity_of(attitude: Floats, rate: Floats) -> Floats:
    """(..., 3) [rad/s] in the body's axes, of attitudes (..., 4) of any length and their rates."""
    w, u = attitude[..., :1], attitude[..., 1:]
    square = np.einsum("...a,...a->...", attitude, attitude)[..., None]
    return 2.0 * (w * rate[..., 1:] - rate[..., :1] * u - np.cross(u, rate[..., 1:])) / square


def rotation_vector(attitude: Floats) -> Floats:
    """(..., 3) rotation vectors [rad], no longer than pi, of unit quaternions (..., 4)."""
    flat = scipy.spatial.transform.Rotation.from_quat(attitude.reshape(-1, 4), scalar_first=True).as_rotvec()
    return np.asarray(flat).reshape(*attitude.shape[:-1], 3)


def quaternion_of(vector: Floats) -> Floats:
    """(..., 4) unit quaternions of rotation vectors (..., 3) [rad]."""
    flat = scipy.spatial.transform.Rotation.from_rotvec(vector.reshape(-1, 3)).as_quat(scalar_first=True)
    return np.asarray(flat).reshape(*vector.shape[:-1], 4)


def product(one: Floats, other: Floats) -> Floats:
    """(..., 4) quaternion products: turning by `other`, then by `one`."""
    a, u = one[..., :1], one[..., 1:]
    b, w = other[..., :1], other[..., 1:]
    real = a * b - np.einsum("...i,...i->...", u, w)[..., None]
    return np.concatenate([real, a * w + b * u + np.cross(u, w)], axis=-1)
