"""Distances from cores (see `exunet.forces.cores`), as compiled loops.

Each function gets a point in a core's own axes and returns its distance [m] from the core, below 0 inside,
and the direction in which it grows, a unit vector. The distance is convex. For cores that are sampled see
`grid_loops`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def core_distance(kind: int, a: float, b: float, c: float, x: float, y: float, z: float) -> Any:
    """Distance from a core and its gradient; a, b, c : its numbers, see `Cores`."""
    if kind == 0:
        return box_distance(a, b, c, x, y, z)
    if kind == 2:
        return ball_distance(x, y, z)
    if kind == 3:
        return ball_distance(x, y, z - min(max(z, -a), a))
    across = math.sqrt(x * x + y * y)
    i = x / across if across > 0.0 else 1.0
    j = y / across if across > 0.0 else 0.0
    if kind == 1:
        d, outwards, along = profile_distance(a, a, b, across, z)
    else:
        d, outwards, along = profile_distance(a, b, c, across, z)
    return d, outwards * i, outwards * j, along


def ball_distance(x: float, y: float, z: float) -> Any:
    """Of a point."""
    d = math.sqrt(x * x + y * y + z * z)
    if d == 0.0:
        return 0.0, 0.0, 0.0, 1.0
    return d, x / d, y / d, z / d


def box_distance(a: float, b: float, c: float, x: float, y: float, z: float) -> Any:
    """Of a box with half edges a, b, c."""
    p = abs(x) - a
    q = abs(y) - b
    r = abs(z) - c
    i = 1.0 if x >= 0.0 else -1.0
    j = 1.0 if y >= 0.0 else -1.0
    k = 1.0 if z >= 0.0 else -1.0
    if p <= 0.0 and q <= 0.0 and r <= 0.0:
        if p >= q and p >= r:
            return p, i, 0.0, 0.0
        return (q, 0.0, j, 0.0) if q >= r else (r, 0.0, 0.0, k)
    p = max(p, 0.0)
    q = max(q, 0.0)
    r = max(r, 0.0)
    if p + q == 0.0:  # beside a face: neither a root nor a division
        return r, 0.0, 0.0, k
    if q + r == 0.0:
        return p, i, 0.0, 0.0
    if r + p == 0.0:
        return q, 0.0, j, 0.0
    d = math.sqrt(p * p + q * q + r * r)
    part = 1.0 / d
    return d, i * p * part, j * q * part, k * r * part


def profile_distance(a: float, b: float, h: float, r: float, z: float) -> Any:
    """Of the figure between the lines z = -h, z = h and the one through (a, -h), (b, h), of a point (r, z).

    Returns the distance and the gradient along r and z; of a solid of revolution, r is from the axis.
    """
    length = math.sqrt((b - a) * (b - a) + 4.0 * h * h)
    slope = (b - a) / length
    rise = 2.0 * h / length
    side = (r - a) * rise - (z + h) * slope
    end = abs(z) - h
    up = 1.0 if z >= 0.0 else -1.0
    if side <= 0.0 and end <= 0.0:
        if side >= end:
            return side, rise, -slope
        return end, 0.0, up
    if end > 0.0 and r <= (b if z > 0.0 else a):
        return end, 0.0, up
    along = (r - a) * slope + (z + h) * rise
    if 0.0 < along < length:
        return side, rise, -slope
    p = r - (b if along > 0.0 else a)
    q = z - (h if along > 0.0 else -h)
    d = math.sqrt(p * p + q * q)
    return d, p / d, q / d


def is_flat(kind: int, a: float, b: float, c: float, x: float, y: float, z: float) -> bool:
    """True where the nearest part of a core is a flat face: there the distance is linear."""
    if kind == 0:
        return int(abs(x) > a) + int(abs(y) > b) + int(abs(z) > c) <= 1
    if kind == 1:
        return abs(z) > b and x * x + y * y <= a * a
    if kind == 4:
        end = b if z > 0.0 else a
        return abs(z) > c and x * x + y * y <= end * end
    return False


def core_point(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """A place in principal axes, from the centre of mass, in the axes of core n from its middle."""
    x -= cores.place[n, 0]
    y -= cores.place[n, 1]
    z -= cores.place[n, 2]
    return core_vector(cores, n, x, y, z)


def core_vector(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """A vector of principal axes in those of core n."""
    turn = cores.turn[n]
    return (
        turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z,
        turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z,
        turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z,
    )


def from_core(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """A vector of the axes of core n in principal axes."""
    turn = cores.turn[n]
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


def core_gradient(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """Distance from core n, not SAMPLED, and its gradient, of a place and in principal axes."""
    p, q, r = core_point(cores, n, x, y, z)
    a = cores.numbers[n]
    d, i, j, k = core_distance(cores.kind[n], a[0], a[1], a[2], p, q, r)
    i, j, k = from_core(cores, n, i, j, k)
    return d, i, j, k


def gap_to_box(c: Any, n: int, thick: float, a: Any, b: Any) -> float:
    """How far apart [m] a thread and the box along the principal axes around core n and its rounding are.

    Not above 0.0: they overlap.
    """
    box = c.boxes[n]
    gap = -np.inf
    for axis in range(3):
        gap = max(gap, box[axis] - thick - max(a[axis], b[axis]))
        gap = max(gap, min(a[axis], b[axis]) - (box[3 + axis] + thick))
    return gap


DISTANCES = (
    core_distance,
    ball_distance,
    box_distance,
    profile_distance,
    core_point,
    core_vector,
    from_core,
    core_gradient,
    gap_to_box,
)
