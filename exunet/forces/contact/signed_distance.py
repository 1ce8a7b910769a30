"""Signed distances from the cores of a body and their blend, as compiled loops.

Each function gets a point in a core's own axes and returns its distance [m] from the core, below 0 inside,
and the direction in which it grows, a unit vector. The distance is convex. For cores that are sampled see
`sampled_distance`.

Between the grid's points it is that of cubic convolution (Keys, IEEE Trans. Acoust. Speech Signal Process. 29
(1981) 1153, doi 10.1109/TASSP.1981.1163711), which is exact for distances up to the second degree, and whose
gradient is continuous: over inner edges too, where that of the distance itself jumps.

Where the core of a mesh is convex, its distance is that from what is behind the planes of its faces: exact.

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
    """Return the distance of (x, y, z) from a point at the origin, and its gradient."""
    d = math.sqrt(x * x + y * y + z * z)
    if d == 0.0:
        return 0.0, 0.0, 0.0, 1.0
    return d, x / d, y / d, z / d


def box_distance(a: float, b: float, c: float, x: float, y: float, z: float) -> Any:
    """Return the signed distance from a box with half edges a, b, c, and its gradient."""
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
    """Compute the distance of (r, z) from the figure between z = -h, z = h and the line (a, -h) to (b, h).

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
    """Return the weights of the four points around a place, t in [0, 1] cells behind the second."""
    u, w = t * t, t * t * t
    return -0.5 * t + u - 0.5 * w, 1.0 - 2.5 * u + 1.5 * w, 0.5 * t + 2.0 * u - 1.5 * w, 0.5 * (w - u)


def slopes_at(t: float) -> Any:
    """Derivatives of `weights_at`."""
    u = t * t
    return -0.5 + 2.0 * t - 1.5 * u, -5.0 * t + 4.5 * u, 0.5 + 4.0 * t - 4.5 * u, 1.5 * u - t


def sampled_distance(samples: Any, x: float, y: float, z: float) -> Any:
    """Distance of a place in the core's axes from the core, and its gradient; far away a lower bound, 0."""
    cell = samples.cell
    p = (x - samples.corner[0]) / cell
    q = (y - samples.corner[1]) / cell
    r = (z - samples.corner[2]) / cell
    ends = samples.ends
    if not (0.0 <= p < ends[0] and 0.0 <= q < ends[1] and 0.0 <= r < ends[2]):
        p = max(max(-p, p - ends[0]), 0.0)
        q = max(max(-q, q - ends[1]), 0.0)
        r = max(max(-r, r - ends[2]), 0.0)
        return samples.beyond + cell * math.sqrt(p * p + q * q + r * r), 0.0, 0.0, 0.0
    i, j, k = int(p), int(q), int(r)
    block = samples.blocks[i // 64, j // 64, k // 64]
    if block < 0:
        d = samples.far[i // 64, j // 64, k // 64]
        return bound_from(d, cell, p - 64 * (i // 64), q - 64 * (j // 64), r - 64 * (k // 64), 32.0)
    p -= 8 * (i // 8)
    q -= 8 * (j // 8)
    r -= 8 * (k // 8)
    place = (i // 8 % 8 * 8 + j // 8 % 8) * 8 + k // 8 % 8
    n = samples.bricks[block, place]
    if n < 0:
        return bound_from(float(samples.apart[block, place]), cell, p, q, r, 4.0)
    which = samples.convex[n]
    if which < 0:
        return interpolated(samples, samples.points[n], p, q, r)
    d, e, f, g = convex_distance(samples.planes, samples.sets[which], samples.sizes[which], x, y, z)
    if samples.points[n] < 0:
        return d, e, f, g
    own, own_e, own_f, own_g = interpolated(samples, samples.points[n], p, q, r)
    w, w_x, w_y, w_z = part_of_planes(samples.weight[n], 0.125 * p, 0.125 * q, 0.125 * r)
    change = (d - own) * 0.125 / cell
    return (
        own + w * (d - own),
        own_e + w * (e - own_e) + change * w_x,
        own_f + w * (f - own_f) + change * w_y,
        own_g + w * (g - own_g) + change * w_z,
    )


def bound_from(d: float, cell: float, p: float, q: float, r: float, half: float) -> Any:
    """Bound of a distance [m] that is d in the middle of a cube of 2 half cells, at p, q, r of these; 0."""
    p, q, r = p - half, q - half, r - half
    apart = cell * math.sqrt(p * p + q * q + r * r)
    return (d - apart if d > 0.0 else d + apart), 0.0, 0.0, 0.0


def interpolated(samples: Any, n: int, x: float, y: float, z: float) -> Any:
    """Distance and gradient between the grid points n of a brick; x, y, z in cells from its corner."""
    i, j, k = min(int(x), 7), min(int(y), 7), min(int(z), 7)
    of_x, of_y, of_z = weights_at(x - i), weights_at(y - j), weights_at(z - k)
    to_x, to_y, to_z = slopes_at(x - i), slopes_at(y - j), slopes_at(z - k)
    first = np.uint32(((n * 11 + i) * 11 + j) * 11 + k)  # an index that is not negative
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
    part = 1.0 / samples.cell
    return d, part * d_x, part * d_y, part * d_z


def part_of_planes(weight: Any, x: float, y: float, z: float) -> Any:
    """Weight of the planes at a place of a brick, in [0, 1] along each edge, and its gradient.

    Between its corners u^2 (3 - 2 u), so that it and its gradient are continuous between bricks.
    """
    p, q, r = x * x * (3.0 - 2.0 * x), y * y * (3.0 - 2.0 * y), z * z * (3.0 - 2.0 * z)
    w, w_x, w_y, w_z = 0.0, 0.0, 0.0, 0.0
    for corner in range(8):
        if weight[corner] == 1:
            of_x, to_x = (p, 1.0) if corner >= 4 else (1.0 - p, -1.0)
            of_y, to_y = (q, 1.0) if corner // 2 % 2 == 1 else (1.0 - q, -1.0)
            of_z, to_z = (r, 1.0) if corner % 2 == 1 else (1.0 - r, -1.0)
            w += of_x * of_y * of_z
            w_x += to_x * of_y * of_z
            w_y += of_x * to_y * of_z
            w_z += of_x * of_y * to_z
    return w, 6.0 * x * (1.0 - x) * w_x, 6.0 * y * (1.0 - y) * w_y, 6.0 * z * (1.0 - z) * w_z


def convex_distance(planes: Any, of: Any, number: int, x: float, y: float, z: float) -> Any:
    """Distance from what is behind all of some planes, below 0 inside, and its gradient.

    of : numbers of the planes, the first `number` count. The nearest point is on one, two or three of them:
    those for which the multipliers of the planes are positive and no other plane is violated.
    """
    worst, most = -1, -np.inf
    for item in range(number):
        height = height_over(planes, of[item], x, y, z)
        if height > most:
            worst, most = of[item], height
    e, f, g = planes[worst, 0], planes[worst, 1], planes[worst, 2]
    if most <= 0.0 or number == 1 or is_behind(planes, of, number, x - most * e, y - most * f, z - most * g):
        return most, e, f, g
    for first in range(number):
        i = of[first]
        one = height_over(planes, i, x, y, z)
        for second in range(first + 1, number):
            j = of[second]
            other = height_over(planes, j, x, y, z)
            both = cosine(planes, i, j)
            sine = 1.0 - both * both
            u, w = one - both * other, other - both * one
            if sine > 1e-12 and u > 0.0 and w > 0.0:
                u, w = u / sine, w / sine
                p = u * planes[i, 0] + w * planes[j, 0]
                q = u * planes[i, 1] + w * planes[j, 1]
                r = u * planes[i, 2] + w * planes[j, 2]
                if is_behind(planes, of, number, x - p, y - q, z - r):
                    d = math.sqrt(p * p + q * q + r * r)
                    return d, p / d, q / d, r / d
    for first in range(number):
        for second in range(first + 1, number):
            for third in range(second + 1, number):
                p, q, r = way_from_corner(planes, of[first], of[second], of[third], x, y, z)
                d = math.sqrt(p * p + q * q + r * r)
                if d > 0.0 and is_behind(planes, of, number, x - p, y - q, z - r):
                    return d, p / d, q / d, r / d
    return -np.inf, 0.0, 0.0, 0.0


def height_over(planes: Any, i: int, x: float, y: float, z: float) -> float:
    """Height [m] of a place over plane i."""
    return planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z - planes[i, 3]


def cosine(planes: Any, i: int, j: int) -> float:
    """Cosine of the angle between the normals of two planes."""
    return planes[i, 0] * planes[j, 0] + planes[i, 1] * planes[j, 1] + planes[i, 2] * planes[j, 2]


def is_behind(planes: Any, of: Any, number: int, x: float, y: float, z: float) -> bool:
    """True if a place is behind all planes, but for round-off."""
    behind = True
    for item in range(number):
        behind = behind and height_over(planes, of[item], x, y, z) <= 1e-11
    return behind


def way_from_corner(planes: Any, i: int, j: int, k: int, x: float, y: float, z: float) -> Any:
    """Way (3) [m] to a place from where three planes meet, if it is nearest to that, else zeros."""
    a, b, c = cosine(planes, i, j), cosine(planes, i, k), cosine(planes, j, k)
    s = height_over(planes, i, x, y, z)
    t = height_over(planes, j, x, y, z)
    u = height_over(planes, k, x, y, z)
    size = 1.0 + 2.0 * a * b * c - a * a - b * b - c * c  # determinant of the normals' products
    f = s * (1.0 - c * c) + t * (b * c - a) + u * (a * c - b)
    g = s * (b * c - a) + t * (1.0 - b * b) + u * (a * b - c)
    h = s * (a * c - b) + t * (a * b - c) + u * (1.0 - a * a)
    if not (size > 1e-12 and min(f, g, h) >= -1e-12):  # but for round-off
        return 0.0, 0.0, 0.0
    f, g, h = f / size, g / size, h / size
    return (
        f * planes[i, 0] + g * planes[j, 0] + h * planes[k, 0],
        f * planes[i, 1] + g * planes[j, 1] + h * planes[k, 1],
        f * planes[i, 2] + g * planes[j, 2] + h * planes[k, 2],
    )


CONVEX = (convex_distance, height_over, cosine, is_behind, way_from_corner)


def any_core_gradient(cores: Any, n: int, x: float, y: float, z: float) -> Any:
    """`core_gradient` of cores of all kinds."""
    if cores.kind[n] != 5:
        return core_gradient(cores, n, x, y, z)
    p, q, r = core_point(cores, n, x, y, z)
    d, i, j, k = sampled_distance(cores.samples, p, q, r)
    i, j, k = from_core(cores, n, i, j, k)
    return d, i, j, k


SAMPLED_DISTANCES = (
    weights_at,
    slopes_at,
    sampled_distance,
    bound_from,
    interpolated,
    part_of_planes,
    *CONVEX,
    any_core_gradient,
)


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


def apply_at_point(force: Any, n: int, c: int, s: int, turn: Any, p: Any, f: Any) -> None:
    """A force f (3) [N], in the body's axes, on the point at p (3), and its opposite on the body there."""
    force[s] -= p[1] * f[2] - p[2] * f[1]
    force[s + 1] -= p[2] * f[0] - p[0] * f[2]
    force[s + 2] -= p[0] * f[1] - p[1] * f[0]
    for axis in range(3):
        d = turn[axis, 0] * f[0] + turn[axis, 1] * f[1] + turn[axis, 2] * f[2]
        force[n + axis] += d
        force[c + axis] -= d


FRAMES = (turn_into, place_in_body, velocity_against_body, apply_at_point)
