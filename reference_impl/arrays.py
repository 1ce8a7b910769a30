"""Types of arrays, products that keep mirror symmetries, rotations, and directions of parts of a turn."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])

Vector = tuple[float, float, float]


def cross(a: Floats, b: Floats) -> Floats:
    """Vector products a x b along the last axis (3), as np.cross, which takes ten times as long for a few."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT])


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products along the last axis (3).  x + y comes first: swapping x and y changes no bit of it."""
    c = a * b
    return np.asarray((c[..., 0] + c[..., 1]) + c[..., 2])


def skew(a: Floats) -> Floats:
    """Matrices (..., 3, 3) of the cross product a x, of vectors a (..., 3)."""
    result = np.zeros((*a.shape, 3))
    result[..., _LAST, _NEXT], result[..., _NEXT, _LAST] = a, -a
    return result


def turned(attitude: Floats, angle: Floats) -> Floats:
    """exp([angle]x) R: attitudes turned about axes of the scene by rotation vectors (b, 3) [rad]."""
    size = np.linalg.norm(angle, axis=-1)[..., None, None]
    cross = skew(angle)
    first = np.sinc(size / np.pi)  # sin(a)/a
    second = 0.5 * np.sinc(0.5 * size / np.pi) ** 2  # (1 - cos(a))/a^2
    return np.asarray(attitude + first * cross @ attitude + second * cross @ cross @ attitude)


def direction(k: int, n: int) -> tuple[float, float]:
    """Cosine and sine of k/n of a turn; mirrored directions agree to the last bit (reduced to one octant)."""
    eighths = 8 * k % (8 * n)  # the angle is eighths / n times 45 degrees
    below, eighths = eighths > 4 * n, min(eighths, 8 * n - eighths)
    behind, eighths = eighths > 2 * n, min(eighths, 4 * n - eighths)
    steep, eighths = eighths > n, min(eighths, 2 * n - eighths)
    angle = math.pi / 4.0 * eighths / n
    c, s = (math.sqrt(0.5), math.sqrt(0.5)) if eighths == n else (math.cos(angle), math.sin(angle))
    if steep:
        c, s = s, c
    return (-c if behind else c), (-s if below else s)


def rotation(quaternion: tuple[float, ...]) -> Floats:
    """Rotation matrix (3, 3) of a quaternion [w, x, y, z] of any length but 0: by 2 atan2(|(x, y, z)|, w)."""
    largest = max(map(abs, quaternion))
    w, x, y, z = (component / largest for component in quaternion)
    length = math.hypot(x, y, z)
    if not length:
        return np.eye(3)
    return turn(np.array([x, y, z]) / length, 2.0 * math.atan2(length, w))


def turn(axis: Floats, angle: float) -> Floats:
    """Rotation matrix (3, 3) about a unit axis (3,) by an angle a [rad], by Rodrigues' formula.

    I + sin(a) K + (1 - cos(a)) K^2, K the cross product with the axis.
    """
    cross = skew(axis)
    return np.asarray(np.eye(3) + math.sin(angle) * cross + 2.0 * math.sin(0.5 * angle) ** 2 * cross @ cross)


def orthonormal(attitude: Floats) -> Floats:
    """The rotations nearest to matrices (..., 3, 3): their polar factors (Higham, doi:10.1137/0907079)."""
    left, _, right = np.linalg.svd(attitude)
    return np.asarray(left @ right)
