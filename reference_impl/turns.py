"""Vectors as matrices of their cross product, and attitudes that are turned."""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats


def skew(a: Floats) -> Floats:
    """Matrices (..., 3, 3) of the cross product a x, of vectors a (..., 3)."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turned(attitude: Floats, angle: Floats) -> Floats:
    """exp([angle]x) R: attitudes turned about axes of the scene by rotation vectors (r, 3) [rad]."""
    size = np.linalg.norm(angle, axis=-1)[..., None, None]
    cross = skew(angle)
    first = np.sinc(size / np.pi)  # sin(a)/a
    second = 0.5 * np.sinc(0.5 * size / np.pi) ** 2  # (1 - cos(a))/a^2
    return np.asarray(attitude + first * cross @ attitude + second * cross @ cross @ attitude)
