"""Distances from closed surfaces of triangles, and from what lies deep inside of them, as compiled loops.

A surface comes as its triangles, corners (m, 3, 3), and a tree of boxes around them: low, high (n, 3), the
whole first, those of branch k at 2k + 1 and 2k + 2; leaves: the triangle of each of the last boxes. The
outside follows from the normal of the face, edge or corner that is nearest, the means of which over the
triangles there are weighted by their angles: Baerentzen, Aanaes, IEEE Trans. Vis. Comput. Graph. 11 (2005)
243, doi 10.1109/TVCG.2005.49. normals (m, 7, 3): of the face, of the edges from its corners, of its corners.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def nearest_of_triangle(corners: Any, x: float, y: float, z: float) -> Any:
    """Square of the distance of a point from a triangle (3, 3), the point there, and on what of it it is.

    Ericson, "Real-Time Collision Detection" (2005), section 5.1.5. 0: on the face, 1 ... 3: on the edge from
    that corner, 4 ... 6: on a corner.
    """
    a = (corners[0, 0], corners[0, 1], corners[0, 2])
    ab = (corners[1, 0] - a[0], corners[1, 1] - a[1], corners[1, 2] - a[2])
    ac = (corners[2, 0] - a[0], corners[2, 1] - a[1], corners[2, 2] - a[2])
    ap = (x - a[0], y - a[1], z - a[2])
    bb = ab[0] * ab[0] + ab[1] * ab[1] + ab[2] * ab[2]
    cc = ac[0] * ac[0] + ac[1] * ac[1] + ac[2] * ac[2]
    bc = ab[0] * ac[0] + ab[1] * ac[1] + ab[2] * ac[2]
    d_1 = ab[0] * ap[0] + ab[1] * ap[1] + ab[2] * ap[2]
    d_2 = ac[0] * ap[0] + ac[1] * ap[1] + ac[2] * ap[2]
    d_3, d_4 = d_1 - bb, d_2 - bc
    d_5, d_6 = d_1 - bc, d_2 - cc
    v_a, v_b, v_c = d_3 * d_6 - d_5 * d_4, d_5 * d_2 - d_1 * d_6, d_1 * d_4 - d_3 * d_2
    if d_1 <= 0.0 and d_2 <= 0.0:
        s, t, on = 0.0, 0.0, 4
    elif d_3 >= 0.0 and d_4 <= d_3:
        s, t, on = 1.0, 0.0, 5
    elif v_c <= 0.0 and d_1 >= 0.0 and d_3 <= 0.0:
        s, t, on = d_1 / (d_1 - d_3), 0.0, 1
    elif d_6 >= 0.0 and d_5 <= d_6:
        s, t, on = 0.0, 1.0, 6
    elif v_b <= 0.0 and d_2 >= 0.0 and d_6 <= 0.0:
        s, t, on = 0.0, d_2 / (d_2 - d_6), 3
    elif v_a <= 0.0 and d_4 >= d_3 and d_5 >= d_6:
        t = (d_4 - d_3) / ((d_4 - d_3) + (d_5 - d_6))
        s, on = 1.0 - t, 2
    else:
        all_of_it = v_a + v_b + v_c
        s, t, on = v_b / all_of_it, v_c / all_of_it, 0
    p = a[0] + s * ab[0] + t * ac[0]
    q = a[1] + s * ab[1] + t * ac[1]
    r = a[2] + s * ab[2] + t * ac[2]
    return (x - p) * (x - p) + (y - q) * (y - q) + (z - r) * (z - r), p, q, r, on


def gap_of_box(low: Any, high: Any, k: int, x: float, y: float, z: float) -> float:
    """Square of the distance of a point from box k."""
    p = max(max(low[k, 0] - x, x - high[k, 0]), 0.0)
    q = max(max(low[k, 1] - y, y - high[k, 1]), 0.0)
    r = max(max(low[k, 2] - z, z - high[k, 2]), 0.0)
    return p * p + q * q + r * r


def nearest(tree: Any, x: float, y: float, z: float, bound: float, stack: Any) -> Any:
    """As `nearest_of_triangle` of the nearest triangle, and its number; -1: all are beyond `bound`, squared.

    tree : low, high, leaves, corners; stack : (n,) work space of twice as many entries as it has levels
    """
    low, high, leaves, corners = tree
    last = leaves.size - 1
    best, p, q, r, on, which = bound, 0.0, 0.0, 0.0, 0, -1
    stack[0] = 0
    m = 1
    while m > 0:
        m -= 1
        k = stack[m]
        if gap_of_box(low, high, k, x, y, z) >= best:
            continue
        if k >= last:
            triangle = leaves[k - last]
            square, e, f, g, part = nearest_of_triangle(corners[triangle], x, y, z)
            if square < best:
                best, p, q, r, on, which = square, e, f, g, part, triangle
            continue
        one, other = 2 * k + 1, 2 * k + 2
        if gap_of_box(low, high, one, x, y, z) < gap_of_box(low, high, other, x, y, z):
            one, other = other, one
        stack[m] = one
        stack[m + 1] = other
        m += 2
    return best, p, q, r, on, which


def signed_distance(tree: Any, normals: Any, x: float, y: float, z: float, bound: float, stack: Any) -> Any:
    """Distance [m] of a point from a surface, below 0 inside, the nearest point, and its triangle.

    bound : see `nearest`
    """
    square, p, q, r, on, which = nearest(tree, x, y, z, bound, stack)
    n = normals[which, on]
    side = (x - p) * n[0] + (y - q) * n[1] + (z - r) * n[2]
    distance = math.sqrt(square)
    return (distance if side >= 0.0 else -distance), p, q, r, which


def find_distances(tree: Any, normals: Any, points: Any, distances: Any, feet: Any) -> None:
    """Signed distances (n,) of points (n, 3) and the nearest points (n, 3); quick where they are in order."""
    stack = np.zeros(128, dtype=np.int64)
    which = -1
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        bound = np.inf
        if which >= 0:  # no farther than the triangle before, as it is found once more
            bound, _, _, _, _ = nearest_of_triangle(tree[3][which], x, y, z)
            bound = bound * (1.0 + 1e-9) + 1e-300
        distances[k], feet[k, 0], feet[k, 1], feet[k, 2], which = signed_distance(
            tree, normals, x, y, z, bound, stack
        )


def find_level(
    tree: Any, normals: Any, level: float, begin: Any, axis: Any, cell: float, ends: Any, places: Any
) -> None:
    """Where the signed distance is `level` on lines of the length of a cell, by false position (Illinois).

    begin, axis : (n, 3), (n,) where they begin, and along which axis they are
    ends        : (n, 2) distance less the level at both ends, of different signs
    places      : (n, 6) found: the place, and the direction in which the distance grows
    """
    stack = np.zeros(128, dtype=np.int64)
    for k in range(len(begin)):
        low, high, at_low, at_high = 0.0, cell, ends[k, 0], ends[k, 1]
        side = 0
        place = places[k]
        for _ in range(60):
            s = (low * at_high - high * at_low) / (at_high - at_low)
            for m in range(3):
                place[m] = begin[k, m]
            place[axis[k]] += s
            now, p, q, r, _ = signed_distance(tree, normals, place[0], place[1], place[2], np.inf, stack)
            place[3], place[4], place[5] = (place[0] - p) / now, (place[1] - q) / now, (place[2] - r) / now
            now -= level
            if abs(now) < 1e-13 * cell or high - low < 1e-13 * cell:
                break
            if (now < 0.0) == (at_low < 0.0):
                low, at_low = s, now
                at_high = 0.5 * at_high if side == 1 else at_high
                side = 1
            else:
                high, at_high = s, now
                at_low = 0.5 * at_low if side == 2 else at_low
                side = 2


def fill_bricks(
    core: Any,
    tree: Any,
    normals: Any,
    level: float,
    corner: Any,
    cell: float,
    bricks: Any,
    samples: Any,
) -> None:
    """Signed distances from the inner surface, at which that from the outer one is `level`, at grid points.

    core    : the tree of the inner surface
    bricks  : (n, 3) places of bricks among all bricks
    samples : (n, k, k, k) found; the first point of a brick is one cell before where it begins
    """
    stack = np.zeros(128, dtype=np.int64)
    number = samples.shape[1]
    corners, which, beside = core[3], 0, 0
    for n in range(len(bricks)):
        for i in range(number):
            x = corner[0] + cell * (bricks[n, 0] * (number - 3) + i - 1)
            for j in range(number):
                y = corner[1] + cell * (bricks[n, 1] * (number - 3) + j - 1)
                before, side = np.inf, 1.0
                for k in range(number):
                    z = corner[2] + cell * (bricks[n, 2] * (number - 3) + k - 1)
                    bound, _, _, _, _ = nearest_of_triangle(corners[which], x, y, z)
                    square, _, _, _, _, which = nearest(core, x, y, z, bound * (1.0 + 1e-9) + 1e-300, stack)
                    now = math.sqrt(square)
                    if k == 0 or before + now <= cell * (1.0 + 1e-9):  # the surface may be between the two
                        bound, _, _, _, _ = nearest_of_triangle(tree[3][beside], x, y, z)
                        bound = bound * (1.0 + 1e-9) + 1e-300
                        outer, _, _, _, beside = signed_distance(tree, normals, x, y, z, bound, stack)
                        side = 1.0 if outer > level else -1.0
                    samples[n, i, j, k] = side * now
                    before = now


def find_balls(tree: Any, normals: Any, feet: Any, inwards: Any, radii: Any) -> None:
    """Radii (n,) of the largest balls inside that touch a surface at points (n, 3), each from the inside.

    Ma, Bae, Choi, Vis. Comput. 28 (2012) 7, doi 10.1007/s00371-011-0594-7. Infinite where the ball is stopped
    by what is less than 120 degrees away round it, as beside an edge that is not sharper than 60 degrees. In
    meshes of curved surfaces they may be 1 % too large.
    radii : the largest that they may have, at first
    """
    stack = np.zeros(128, dtype=np.int64)
    for k in range(len(feet)):
        a = (feet[k, 0], feet[k, 1], feet[k, 2])
        n = (inwards[k, 0], inwards[k, 1], inwards[k, 2])
        radius, opposite = radii[k], 1.0
        for _ in range(60):
            x, y, z = a[0] + radius * n[0], a[1] + radius * n[1], a[2] + radius * n[2]
            _, p, q, r, _, which = nearest(tree, x, y, z, 0.98 * radius * radius, stack)
            if which < 0:
                break
            d = (p - a[0], q - a[1], r - a[2])
            along = 2.0 * (d[0] * n[0] + d[1] * n[1] + d[2] * n[2])
            if along <= 0.0:
                break
            radius = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) / along
            e = (p - a[0] - radius * n[0], q - a[1] - radius * n[1], r - a[2] - radius * n[2])
            opposite = -(e[0] * n[0] + e[1] * n[1] + e[2] * n[2]) / radius
        radii[k] = radius if opposite < -0.5 else np.inf


INSIDE = (nearest_of_triangle, gap_of_box, nearest, signed_distance)
CALLED = (find_distances, find_level, fill_bricks, find_balls)
