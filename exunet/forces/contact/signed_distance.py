"""Signed distances from the cores of a body and their blend, as compiled loops.

Each function gets a point in a core's own axes and returns its distance [m] from the core, below 0 inside,
and the direction in which it grows, a unit vector. The distance is convex. For cores that are sampled see
`sampled_distance`.

Between the grid's points it is that of cubic convolution (Keys, IEEE Trans. Acoust. Speech Signal Process. 29
(1981) 1153, doi 10.1109/TASSP.1981.1163711), which is exact for distances up to the second degree, and whose
gradient is continuous: over inner edges too, where that of the distance itself jumps.

The force has the direction of its gradient: that of each solid counts with (p / sum)^7.
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


def gap_to_box(cores: Any, n: int, thick: float, a: Any, b: Any) -> float:
    """How far apart [m] a thread and the box along the principal axes around core n and its rounding are.

    Not above 0.0: they overlap.
    """
    box = cores.boxes[n]
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


def weights_at(t: float) -> Any:
    """Of the four points around a place, t in [0, 1] cells behind the second."""
    u, w = t * t, t * t * t
    return -0.5 * t + u - 0.5 * w, 1.0 - 2.5 * u + 1.5 * w, 0.5 * t + 2.0 * u - 1.5 * w, 0.5 * (w - u)


def slopes_at(t: float) -> Any:
    """Derivatives of `weights_at`."""
    u = t * t
    return -0.5 + 2.0 * t - 1.5 * u, -5.0 * t + 4.5 * u, 0.5 + 4.0 * t - 4.5 * u, 1.5 * u - t


def sampled_distance(samples: Any, x: float, y: float, z: float) -> Any:
    """Distance of a place in the core's axes from the core, and its gradient; far away a lower bound, 0."""
    cell = samples.cell
    x = (x - samples.corner[0]) / cell
    y = (y - samples.corner[1]) / cell
    z = (z - samples.corner[2]) / cell
    bricks = samples.bricks
    ends = 8.0 * bricks.shape[0], 8.0 * bricks.shape[1], 8.0 * bricks.shape[2]
    if not (0.0 <= x < ends[0] and 0.0 <= y < ends[1] and 0.0 <= z < ends[2]):
        p = max(max(-x, x - ends[0]), 0.0)
        q = max(max(-y, y - ends[1]), 0.0)
        r = max(max(-z, z - ends[2]), 0.0)
        return samples.beyond + cell * math.sqrt(p * p + q * q + r * r), 0.0, 0.0, 0.0
    i, j, k = int(x), int(y), int(z)
    n = bricks[i // 8, j // 8, k // 8]
    if n < 0:
        p = x - 8 * (i // 8) - 4.0
        q = y - 8 * (j // 8) - 4.0
        r = z - 8 * (k // 8) - 4.0
        apart = cell * math.sqrt(p * p + q * q + r * r)
        d = samples.far[i // 8, j // 8, k // 8]
        return (d - apart if d > 0.0 else d + apart), 0.0, 0.0, 0.0
    of_x, of_y, of_z = weights_at(x - i), weights_at(y - j), weights_at(z - k)
    to_x, to_y, to_z = slopes_at(x - i), slopes_at(y - j), slopes_at(z - k)
    first = np.uint32(((n * 11 + i % 8) * 11 + j % 8) * 11 + k % 8)  # an index that is not negative
    values = samples.values
    d, d_x, d_y, d_z = 0.0, 0.0, 0.0, 0.0
    for a in range(4):
        e, e_y, e_z = 0.0, 0.0, 0.0
        for b in range(4):
            row = first + np.uint32(121 * a + 11 * b)
            f, g, h, m = values[row], values[row + 1], values[row + 2], values[row + 3]
            along = of_z[0] * f + of_z[1] * g + of_z[2] * h + of_z[3] * m
            e += of_y[b] * along
            e_y += to_y[b] * along
            e_z += of_y[b] * (to_z[0] * f + to_z[1] * g + to_z[2] * h + to_z[3] * m)
        d += of_x[a] * e
        d_x += to_x[a] * e
        d_y += of_x[a] * e_y
        d_z += of_x[a] * e_z
    part = 1.0 / cell
    return d, part * d_x, part * d_y, part * d_z


def any_core_gradient(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """`core_gradient` of cores of all kinds."""
    if cores.kind[n] != 5:
        return core_gradient(cores, n, x, y, z)
    p, q, r = core_point(cores, n, x, y, z)
    d, i, j, k = sampled_distance(cores.samples, p, q, r)
    i, j, k = from_core(cores, n, i, j, k)
    return d, i, j, k


SAMPLED_DISTANCES = (weights_at, slopes_at, sampled_distance, any_core_gradient)


def deeper(found: Any, own: float, n: Any) -> Any:
    """A depth [m] and its direction (4) with those of one more solid, which is outside at own <= 0.

    found : depth and direction before, 0.0 of none; own, n : depth in this solid, and its direction (3)
    """
    if own <= 0.0:
        return found
    depth = found[0]
    most = max(own, depth)
    both = most * (1.0 + (min(own, depth) / most) ** 8) ** 0.125
    before = (depth / both) ** 7
    after = (own / both) ** 7
    return (
        both,
        before * found[1] + after * n[0],
        before * found[2] + after * n[1],
        before * found[3] + after * n[2],
    )


def turn_into(x: Any, q: int, turn: Any) -> None:
    """The rotation (3, 3) from the axes of a body, whose quaternion begins at x[q], to the scene's."""
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    turn[0, 0] = 1.0 - 2.0 * (j * j + k * k)
    turn[0, 1] = 2.0 * (i * j - w * k)
    turn[0, 2] = 2.0 * (i * k + w * j)
    turn[1, 0] = 2.0 * (i * j + w * k)
    turn[1, 1] = 1.0 - 2.0 * (i * i + k * k)
    turn[1, 2] = 2.0 * (j * k - w * i)
    turn[2, 0] = 2.0 * (i * k - w * j)
    turn[2, 1] = 2.0 * (j * k + w * i)
    turn[2, 2] = 1.0 - 2.0 * (i * i + j * j)


def place_in_body(x: Any, n: int, c: int, turn: Any) -> Any:
    """A point whose place begins at x[n], from the centre at x[c], in the body's axes."""
    d = x[n] - x[c]
    e = x[n + 1] - x[c + 1]
    f = x[n + 2] - x[c + 2]
    return (
        turn[0, 0] * d + turn[1, 0] * e + turn[2, 0] * f,
        turn[0, 1] * d + turn[1, 1] * e + turn[2, 1] * f,
        turn[0, 2] * d + turn[1, 2] * e + turn[2, 2] * f,
    )


def velocity_against_body(v: Any, n: int, c: int, s: int, turn: Any, p: Any) -> Any:
    """Its velocity less that of the body's point at the same place p (3), in the body's axes."""
    d, e, f = place_in_body(v, n, c, turn)
    return (
        d - (v[s + 1] * p[2] - v[s + 2] * p[1]),
        e - (v[s + 2] * p[0] - v[s] * p[2]),
        f - (v[s] * p[1] - v[s + 1] * p[0]),
    )


def push_point(force: Any, n: int, c: int, s: int, turn: Any, p: Any, f: Any) -> None:
    """A force f (3) [N], in the body's axes, on the point at p (3), and its opposite on the body there."""
    force[s] -= p[1] * f[2] - p[2] * f[1]
    force[s + 1] -= p[2] * f[0] - p[0] * f[2]
    force[s + 2] -= p[0] * f[1] - p[1] * f[0]
    for axis in range(3):
        d = turn[axis, 0] * f[0] + turn[axis, 1] * f[1] + turn[axis, 2] * f[2]
        force[n + axis] += d
        force[c + axis] -= d


FRAMES = (turn_into, place_in_body, velocity_against_body, push_point)
