"""Distances from closed surfaces of triangles, and from what lies deep inside of them, as compiled loops.

A surface comes as its triangles, corners (m, 3, 3), and a tree of boxes around them: low, high (n, 3), the
whole first, those of branch k at 2k + 1 and 2k + 2; leaves: the triangle of each of the last boxes. The
outside follows from the normal of the face, edge or corner that is nearest, the means of which over the
triangles there are weighted by their angles: Baerentzen, Aanaes, IEEE Trans. Vis. Comput. Graph. 11 (2005)
243, doi 10.1109/TVCG.2005.49. normals (m, 7, 3): of the face, of the edges from its corners, of its corners.

Beside convex parts of the core its planes give the distance, and elsewhere grid points (`SampledDistance`).

The core is all that is inside the mesh by the edge radius or more; what is touched are the points no farther
from it than that. So plane faces stay where they are, and outer edges are rounded inside the mesh, like those
of solids. The core's surface is found by dual contouring (Ju, Losasso, Schaefer, Warren, ACM Trans. Graph.
21 (2002) 339, doi 10.1145/566654.566586): in each cell of the grid that it goes through a point, nearest to
the planes in which the edges of the cell meet it. So its own edges and corners are kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import CaseError, Fault
from exunet.bodies.distance import normals_of, tree_of
from exunet.bodies.shapes import Shape, TriangleMesh
from exunet.bodies.touched import SampledCore
from exunet.forces.contact.signed_distance import CONVEX, convex_distance, sampled_distance
from exunet.forces.cores import BLOCK, BRICK, PLANES, STENCIL, SampledDistance
from exunet.kernels.compile import compiled_module, interpreted_module, numba_installed
from exunet.kernels.source import loops_source


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


def planes_near(
    tree: Any, plane: Any, planes: Any, place: Any, radius: float, slack: float, work: Any, ids: Any
) -> int:
    """Planes (increasing) behind all of which a solid is within a radius of a place; how many, -1: unknown.

    plane  : (m,) number in planes (p, 4) of each triangle of the surface, -1: none
    slack  : [m] by which the surface may be above them
    work   : stack, room for triangles, (4, 3) and (3, 3) for a part of one; ids : found
    All of the surface in the ball is behind all planes that it has there. So it is the boundary of what is
    behind them in the ball, which is convex.
    """
    low, high, leaves, corners = tree
    stack, near, part, piece = work
    x, y, z = place[0], place[1], place[2]
    square = radius * radius
    last = leaves.size - 1
    stack[0] = 0
    m, n, found = 1, 0, 0
    while m > 0:
        m -= 1
        k = stack[m]
        if gap_of_box(low, high, k, x, y, z) >= square:
            continue
        if k < last:
            stack[m], stack[m + 1] = 2 * k + 1, 2 * k + 2
            m += 2
            continue
        triangle = leaves[k - last]
        own, _, _, _, _ = nearest_of_triangle(corners[triangle], x, y, z)
        if own >= square:
            continue
        which = plane[triangle]
        if which < 0 or n == near.size:
            return -1
        near[n] = triangle
        n += 1
        item = found
        while item > 0 and ids[item - 1] > which:
            item -= 1
        if item == 0 or ids[item - 1] != which:
            if found == ids.size:
                return -1
            for entry in range(found, item, -1):
                ids[entry] = ids[entry - 1]
            ids[item] = which
            found += 1
    for item in range(n):
        for entry in range(found):
            if ids[entry] != plane[near[item]]:
                count = part_above(corners[near[item]], planes[ids[entry]], slack, part)
                for third in range(2, count):
                    for axis in range(3):
                        piece[0, axis] = part[0, axis]
                        piece[1, axis] = part[third - 1, axis]
                        piece[2, axis] = part[third, axis]
                    own, _, _, _, _ = nearest_of_triangle(piece, x, y, z)
                    if own < square:
                        return -1
    return found


def part_above(corners: Any, plane: Any, slack: float, part: Any) -> int:
    """Corners into part (4, 3) of the part of a triangle that is more than `slack` above a plane; how many.

    Clipped as by Sutherland and Hodgman: Ericson, "Real-Time Collision Detection" (2005), section 8.3.4.
    """
    n = 0
    for k in range(3):
        m = (k + 1) % 3
        here, there = -plane[3] - slack, -plane[3] - slack
        for axis in range(3):
            here += plane[axis] * corners[k, axis]
            there += plane[axis] * corners[m, axis]
        if here > 0.0:
            for axis in range(3):
                part[n, axis] = corners[k, axis]
            n += 1
        if (here > 0.0) != (there > 0.0):
            for axis in range(3):
                way = corners[m, axis] - corners[k, axis]
                part[n, axis] = corners[k, axis] + here / (here - there) * way
            n += 1
    return n


def find_planes(
    tree: Any, plane: Any, planes: Any, middles: Any, radius: float, slack: float, ids: Any
) -> None:
    """Numbers of planes (n, k) around places (n, 3), then -1; all -1: unknown; see `planes_near`."""
    work = np.zeros(128, np.int64), np.zeros(256, np.int64), np.zeros((4, 3)), np.zeros((3, 3))
    for n in range(len(middles)):
        found = planes_near(tree, plane, planes, middles[n], radius, slack, work, ids[n])
        for item in range(max(found, 0), ids.shape[1]):
            ids[n, item] = -1


def find_behind(planes: Any, ids: Any, points: Any, distances: Any) -> None:
    """`convex_distance` (n,) of points (n, 3) from planes (n, k), then -1; infinite of none."""
    for n in range(len(points)):
        number = 0
        while number < ids.shape[1] and ids[n, number] >= 0:
            number += 1
        distances[n] = np.inf
        if number > 0:
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            distances[n], _, _, _ = convex_distance(planes, ids[n], number, x, y, z)


OF_TREE = (nearest_of_triangle, gap_of_box, nearest, signed_distance)
INSIDE = (*OF_TREE, planes_near, part_above, *CONVEX)
CALLED = (find_distances, find_level, fill_bricks, find_balls, find_planes, find_behind)


Tree = tuple[Floats, Floats, Ints, Floats]

MOST_BYTES = 256 * 1024**2  # of the distances from a body
_BYTES = 72.0  # of a brick without points
_MOST_PLANES = 2000  # of a mesh; bricks beside smaller faces have points
_COPLANAR = 5e-7  # of the extent of a mesh, up to which faces are in a plane: files have single precision
LOST = 3.0  # edge radii by which what is touched may be inside the mesh, at edges of less than 29 degrees
_PART = 4.0  # cells of an edge radius
_ROOM = 2.0  # cells of samples beyond the range of contact
_HALF = 0.5 * math.sqrt(3.0) * BRICK  # cells from the middle of a brick to its corner
_FLAT = 0.05  # of the largest eigenvalue, below which planes do not fix a direction
_AT_ONCE = 256  # bricks in a batch
_PLACES = 2000  # points of a surface sampled for its thickness
_CHECKED = 1000  # points at which the distance is compared


class _Outer(NamedTuple):
    """Mesh with its tree, normals and compiled loops."""

    tree: Tree
    normals: Floats
    loops: ModuleType

    def distances(self, points: Floats) -> tuple[Floats, Floats]:
        """Compute (n,) signed distances of points (n, 3), and the nearest points (n, 3) [m]."""
        found, feet = np.empty(len(points)), np.empty((len(points), 3))
        self.loops.find_distances(self.tree, self.normals, np.ascontiguousarray(points), found, feet)
        return found, feet


def core_of_mesh(name: str, shape: Shape, reach: float) -> SampledCore:
    """Compute the core of the mesh of a body, and distances from it.

    reach : largest radius of what touches it [m]
    Raises CaseError if the edge radius rounds away a part of the mesh, or if it takes too much memory.
    """
    assert shape.mesh is not None
    cell = shape.grid_spacing or shape.edge_radius / _PART
    try:
        return _core(_Content(shape.mesh), shape.edge_radius, cell, reach)
    except _Refused as refused:
        raise CaseError([Fault(f"bodies.{name}.edge_radius", str(refused))]) from None


class _Refused(Exception):
    """Mesh that contact cannot take, and why."""


class _Content:
    """Mesh that equals another mesh of the same numbers."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._key = mesh.vertices.tobytes(), mesh.triangles.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Content) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=4)
def _core(content: _Content, rounding: float, cell: float, reach: float) -> SampledCore:
    mesh, room = content.mesh, rounding + reach + _ROOM * cell
    corner, number = _grid(mesh, cell, reach)
    _validate_memory(_min_bricks(mesh, rounding, cell, reach) * _BYTES, cell)
    outer = _outer(mesh)
    blocks, far, places, depth = _bricks(outer, corner, number, cell, rounding, room)
    plane, planes = _planes(mesh)
    half = _HALF * cell
    filled = np.flatnonzero((depth <= room + half) & (depth >= -_ROOM * cell - half))
    at = places[filled]
    ids = np.full((len(at), PLANES), -1)
    inwards = planes - [0.0, 0.0, 0.0, rounding]
    slack = _COPLANAR * float(np.ptp(mesh.vertices, axis=0).max())
    middles = corner + cell * BRICK * (at + 0.5)
    radius = half + room + rounding
    outer.loops.find_planes(outer.tree, plane, planes, middles, radius, slack, ids)
    behind = np.empty(len(at))
    outer.loops.find_behind(inwards, ids, middles, behind)
    ids[np.isneginf(behind)] = -1  # behind all of them is nothing
    sets, convex = np.unique(ids, axis=0, return_inverse=True)
    convex = np.where(ids[:, 0] < 0, -1, convex.reshape(-1))
    weight = _weights(at, convex >= 0)
    pointed = np.flatnonzero((weight == 0).any(axis=1))
    values = np.empty((len(pointed), STENCIL, STENCIL, STENCIL))
    size = values.nbytes + blocks.nbytes + far.nbytes + 8 * depth.size + _BYTES * len(at)
    _validate_memory(size, cell)
    points = np.full(len(at), -1)
    points[pointed] = np.arange(len(pointed))
    bricks = np.full(depth.size, -1)
    bricks[filled] = np.arange(len(at))
    samples = SampledDistance(
        corner, cell, BRICK * BLOCK * np.array(number, dtype=float), room, blocks, far,
        bricks.reshape(-1, BLOCK**3).astype(np.int32), depth.reshape(-1, BLOCK**3).astype(np.float32),
        convex.astype(np.int32), points.astype(np.int32), weight, sets, (sets >= 0).sum(axis=1), inwards,
        values.reshape(-1),
    )  # fmt: skip
    inner = None
    if len(pointed):
        crossed = places[np.abs(depth) <= half]
        apart, _ = scipy.spatial.cKDTree(at[pointed]).query(crossed)
        around = max(room, (LOST + 2.0) * rounding) / (BRICK * cell) + 2.0 * math.sqrt(3.0)
        inner = _inner(outer, corner, cell, crossed[apart <= around], rounding)
        outer.loops.fill_bricks(
            inner.tree, outer.tree, outer.normals, -rounding, corner, cell, at[pointed], values
        )
    least = _half_thickness(mesh, outer, _validate_thickness(mesh, samples, outer, inner, rounding), rounding)
    error = 0.0 if inner is None else _error(samples, inner, at[pointed], rounding + reach)
    return SampledCore(samples, max(rounding, least), _bends(values, cell, rounding + reach), error)


def _bricks(
    outer: _Outer, corner: Floats, number: tuple[int, int, int], cell: float, rounding: float, room: float
) -> tuple[Ints, Floats, Ints, Floats]:
    """Find the blocks that the range of contact may meet, and the depths of their bricks.

    blocks, far, depth : as in `SampledDistance`, depth of all bricks of the blocks (n,), which are at places
                         (n, 3)
    """
    size = cell * BRICK * BLOCK
    every = np.moveaxis(np.indices(number), 0, -1).reshape(-1, 3)
    far = outer.distances(corner + size * (every + 0.5))[0] + rounding
    half = _HALF * cell * BLOCK
    near = np.flatnonzero((far <= room + half) & (far >= -_ROOM * cell - half))
    _validate_memory(8.0 * len(near) * BLOCK**3, cell)
    blocks = np.full(len(every), -1)
    blocks[near] = np.arange(len(near))
    local = np.moveaxis(np.indices((BLOCK,) * 3), 0, -1).reshape(-1, 3)
    places = (BLOCK * every[near][:, None] + local).reshape(-1, 3)
    depth = outer.distances(corner + cell * BRICK * (places + 0.5))[0] + rounding
    return blocks.reshape(number), far.reshape(number), places, depth


def _planes(mesh: TriangleMesh) -> tuple[Ints, Floats]:
    """Find the plane (m,) of each triangle, -1: none, and the planes (p, 4) of all faces that are large."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    normal = np.divide(normal, area[:, None], out=np.zeros_like(normal), where=area[:, None] > 0.0)
    plane = np.full(len(area), -1)
    planes: list[list[float]] = []
    slack = 0.5 * _COPLANAR * float(np.ptp(mesh.vertices, axis=0).max())
    for triangle in np.argsort(-area).tolist():
        if plane[triangle] >= 0 or not area[triangle] > 0.0:
            continue
        if len(planes) == _MOST_PLANES:
            break
        own = normal[triangle]
        offset = float((corners[triangle] @ own).mean())
        level = (np.abs(corners @ own - offset) <= slack).all(axis=1) & (normal @ own > -0.5)
        plane[level & (plane < 0)] = len(planes)
        planes.append([*own.tolist(), offset])
    return plane, np.array(planes)


def _weights(places: Ints, convex: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Compute `SampledDistance.weight` of bricks at places (n, 3): 0 at corners of a brick without planes."""
    corners = np.moveaxis(np.indices((2, 2, 2)), 0, -1).reshape(-1, 3)
    size = places.max(axis=0, initial=0) + 2
    every = np.ravel_multi_index(tuple(np.moveaxis(places[:, None] + corners, -1, 0)), tuple(size))
    return np.where(np.isin(every, every[~convex]), 0, 1).astype(np.int8)


def _loops() -> ModuleType:
    source = loops_source(CALLED, INSIDE)
    return compiled_module(source) if numba_installed() else interpreted_module(source)


def _tree(corners: Floats) -> Tree:
    leaves, low, high = tree_of(corners)
    return np.concatenate(low), np.concatenate(high), leaves, corners


def _outer(mesh: TriangleMesh) -> _Outer:
    corners = mesh.vertices[mesh.triangles]
    normals = np.empty((len(corners), 7, 3))
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(face, axis=1, keepdims=True)
    normals[:, 0] = np.divide(face, size, out=np.zeros_like(face), where=size > 0.0)
    ends = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    sums = np.zeros((edge.max() + 1, 3))
    np.add.at(sums, edge, np.repeat(normals[:, 0], 3, axis=0))
    normals[:, 1:4] = sums[edge].reshape(-1, 3, 3)
    normals[:, 4:] = normals_of(mesh)[mesh.triangles]
    return _Outer(_tree(corners), normals, _loops())


def _grid(mesh: TriangleMesh, cell: float, reach: float) -> tuple[Floats, tuple[int, int, int]]:
    """Return the origin of the grid (3,) [m], and its number of blocks along x, y, z."""
    room = reach + (_ROOM + 1.0) * cell
    low, high = mesh.vertices.min(axis=0) - room, mesh.vertices.max(axis=0) + room
    size = BLOCK * BRICK * cell
    number = np.ceil((high - low) / size)
    _validate_memory(float(number.prod()) * 16.0, cell)
    nx, ny, nz = number.astype(int).tolist()
    return 0.5 * (low + high) - 0.5 * size * number, (nx, ny, nz)


def _min_bricks(mesh: TriangleMesh, rounding: float, cell: float, reach: float) -> float:
    """Return a lower bound of the number of bricks, from volume and area of the mesh alone.

    Bricks fill a layer of thickness t outside the core. By the Brunn-Minkowski inequality core and layer
    together have at least the volume of a ball whose radius is that of the core's ball increased by t.
    """
    corners = mesh.vertices[mesh.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = abs(float(np.einsum("na,na->", corners[:, 0], face))) / 6.0
    core = max(volume - 0.5 * float(np.linalg.norm(face, axis=1).sum()) * rounding, 0.0)
    thickness = rounding + reach + _ROOM * cell
    unit = (4.0 * math.pi / 3.0) ** (1.0 / 3.0)
    return ((core ** (1.0 / 3.0) + unit * thickness) ** 3 - core) / (BRICK * cell) ** 3


def _validate_memory(size: float, cell: float) -> None:
    """Raise _Refused if distances of this size [bytes] exceed the memory of a body."""
    if size > MOST_BYTES:
        raise _Refused(
            f"contact stores the distance from the mesh in cells of {cell:.3g} m, which takes "
            f"{size / 1024**2:.0f} MB, and at most {MOST_BYTES / 1024**2:.0f} MB are allowed: "
            f"give a larger grid_spacing, or edge_radius"
        )


def _inner(outer: _Outer, corner: Floats, cell: float, bricks: Ints, rounding: float) -> _Outer:
    """Compute the surface of the core; bricks : (n, 3) bricks that it may cross."""
    number = BRICK * (bricks.max(axis=0, initial=0) + 2)
    cells, places = [np.zeros((0, 4), dtype=np.int64)], [np.zeros((0, 6))]
    for which, place in _crossings(outer, corner, cell, bricks, rounding):
        cells.append(np.ravel_multi_index(tuple(np.moveaxis(which, 2, 0)), number))
        places.append(place)
    faces, place = np.concatenate(cells), np.concatenate(places)
    if not len(faces):
        raise _Refused("leaves nothing of the mesh, which is thinner than twice as much: give a smaller one")
    every, corners = np.unique(faces, return_inverse=True)
    corners = corners.reshape(-1, 4)
    middles = corner + cell * (np.stack(np.unravel_index(every, number), axis=1) + 0.5)
    points = _nearest_to_planes(corners, place, middles, 0.5 * cell)
    triangles = points[corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)]
    area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    triangles = triangles[np.linalg.norm(area, axis=1) > 1e-12 * cell * cell]
    return _Outer(_tree(triangles), np.zeros((len(triangles), 7, 3)), outer.loops)


_AROUND = np.array([[0, 0], [-1, 0], [-1, -1], [0, -1]])  # cells around an edge, in the two other directions


def _crossings(
    outer: _Outer, corner: Floats, cell: float, bricks: Ints, rounding: float
) -> Iterator[tuple[Ints, Floats]]:
    """Find the edges of cells that cross the surface of the core: cells (n, 4, 3) around each, and points.

    places : (n, 6) of the point and the normal there
    """
    local = np.moveaxis(np.indices((BRICK + 1,) * 3), 0, -1)
    for start in range(0, len(bricks), _AT_ONCE):
        some = bricks[start : start + _AT_ONCE]
        grid = (some * BRICK)[:, None, None, None] + local
        depth = outer.distances((corner + cell * grid).reshape(-1, 3))[0].reshape(grid.shape[:-1]) + rounding
        for axis in range(3):
            begin = depth[:, :-1, :-1, :-1]
            end = np.take(depth, np.arange(1, BRICK + 1), axis=axis + 1)
            for other in range(3):
                if other != axis:
                    end = np.take(end, np.arange(BRICK), axis=other + 1)
            rows = np.nonzero((begin < 0.0) != (end < 0.0))
            if not len(rows[0]):
                continue
            at = grid[rows]
            ends = np.stack([begin[rows], end[rows]], axis=1)
            places = np.empty((len(at), 6))
            along = np.full(len(at), axis)
            outer.loops.find_level(
                outer.tree, outer.normals, -rounding, corner + cell * at, along, cell, ends, places
            )
            shifts = np.zeros((4, 3), dtype=np.int64)
            shifts[:, [other for other in range(3) if other != axis]] = _AROUND
            yield at[:, None] + shifts, places


def _nearest_to_planes(corners: Ints, places: Floats, middles: Floats, half: float) -> Floats:
    """Compute (k, 3) points of cells nearest to the planes at their edges, else to the mean of the points.

    corners : (n, 4) the cells around each edge; places : (n, 6) its place and normal
    middles, half : of the cells (k, 3), and half of their edges [m]
    """
    owner, number = corners.reshape(-1), len(middles)
    at, normal = np.repeat(places[:, :3], 4, axis=0), np.repeat(places[:, 3:], 4, axis=0)

    def summed(values: Floats) -> Floats:
        rows = [np.bincount(owner, column, number) for column in values.reshape(len(owner), -1).T]
        return np.stack(rows, axis=1)

    mean = summed(at) / np.bincount(owner, minlength=number)[:, None]
    square = summed(normal[:, :, None] * normal[:, None, :]).reshape(-1, 3, 3)
    apart = np.einsum("na,na->n", normal, at - mean[owner])
    size, axes = np.linalg.eigh(square)
    along = np.einsum("kab,ka->kb", axes, summed(normal * apart[:, None]))
    steep = size > _FLAT * size[:, 2:]
    way = np.einsum("kab,kb->ka", axes, np.where(steep, along / np.where(steep, size, 1.0), 0.0))
    return np.asarray(np.clip(mean + way, middles - half, middles + half))


def _validate_thickness(
    mesh: TriangleMesh, samples: SampledDistance, outer: _Outer, inner: _Outer | None, rounding: float
) -> tuple[Floats, Floats]:
    """Raise _Refused for parts thinner than twice the edge radius, which the core does not contain.

    Returns points of faces that are touched where they are (n, 3), and the outward normals there (n, 3).
    """
    parts = list(_places_on(mesh, rounding))
    places, normals = (np.ascontiguousarray(np.concatenate(part)) for part in zip(*parts, strict=True))
    i, j, k = ((places - samples.corner) / samples.cell).T.astype(np.int64) // BRICK
    block = samples.blocks[i // BLOCK, j // BLOCK, k // BLOCK]
    brick = samples.bricks[block, (i % BLOCK * BLOCK + j % BLOCK) * BLOCK + k % BLOCK]
    lost = np.empty(len(places))
    which = samples.convex[brick]
    ids = np.where(which[:, None] < 0, -1, samples.sets[which])
    outer.loops.find_behind(samples.planes, ids, places, lost)
    without = np.isinf(lost)
    if inner is not None and without.any():
        lost[without] = inner.distances(places[without])[0]
    lost -= rounding
    worst = int(lost.argmax())
    if lost[worst] > LOST * rounding:
        x, y, z = places[worst].tolist()
        words = f"rounds away {lost[worst]:.3g} m of the mesh at ({x:.4g}, {y:.4g}, {z:.4g}) m of its frame, "
        words += "where it is thinner than twice as much or has an edge too sharp for it: give a smaller one"
        raise _Refused(words)
    whole = np.abs(lost) < 0.1 * rounding
    return places[whole], normals[whole]


def _places_on(mesh: TriangleMesh, spacing: float, most: int = 64) -> Iterator[tuple[Floats, Floats]]:
    """Yield points (n, 3) on a mesh, `spacing` [m] apart, about `most` along an edge at most; normals."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.clip(np.ceil(size / spacing), 1, most).astype(np.int64)
    for count in np.unique(counts).tolist():
        i, j = (index.ravel() for index in np.indices((count + 1, count + 1)))
        within = i + j <= count
        weights = np.stack([i, j, count - i - j], axis=1)[within] / count
        some = counts == count
        yield (
            np.einsum("pk,mka->mpa", weights, corners[some]).reshape(-1, 3),
            np.repeat(normal[some], len(weights), axis=0),
        )


def _half_thickness(
    mesh: TriangleMesh, outer: _Outer, touched: tuple[Floats, Floats], rounding: float
) -> float:
    """Compute the radius of the smallest ball inside the mesh that touches it on two sides [m].

    touched : points and normals, as of `_validate_thickness`
    """
    step = max(1, len(touched[0]) // _PLACES)
    feet, normals = (np.ascontiguousarray(part[::step]) for part in touched)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    radii = np.full(len(feet), size)
    outer.loops.find_balls(outer.tree, outer.normals, feet, -normals, radii)
    return float(radii[radii > 0.9 * rounding].min(initial=size))  # where the core is, a ball of it fits


def _bends(values: Floats, cell: float, reach: float) -> float:
    """Compute `Surface.bends`: a bound from second differences, times 2 for cubic convolution."""
    inner = values[:, 1:-1, 1:-1, 1:-1]
    found = 0.0
    for start in range(0, len(values), _AT_ONCE):
        some, own = values[start : start + _AT_ONCE], inner[start : start + _AT_ONCE]
        bent = 6.0 * own
        for axis in (1, 2, 3):
            for low in (0, 2):
                index = [slice(None), *[slice(1, -1)] * 3]
                index[axis] = slice(low, low + STENCIL - 2)
                bent -= some[tuple(index)]
        touched = (own > cell) & (own < reach + cell)
        found = max(found, float(bent[touched].max(initial=0.0)))
    found *= 2.0 / cell**2
    return found if found * reach > 0.1 else 0.0


def _error(samples: SampledDistance, inner: _Outer, places: Ints, reach: float) -> float:
    """Compute the largest error of the distance from grid points in the range of contact [m].

    places : (n, 3) of the bricks that have some
    """
    random = np.random.default_rng(1)
    where = places[random.integers(0, len(places), _CHECKED)]
    points = samples.corner + samples.cell * BRICK * (where + random.uniform(size=(_CHECKED, 3)))
    found: Any = np.array([sampled_distance(samples, *place)[0] for place in points.tolist()])
    known = inner.distances(points)[0]
    touched = (found > 0.5 * samples.cell) & (found < reach)
    return float(np.abs(found - known)[touched].max(initial=0.0))
