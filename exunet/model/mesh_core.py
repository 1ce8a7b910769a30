"""Distances from closed surfaces of triangles, and from what lies deep inside of them, as compiled loops.

A surface comes as its triangles, corners (m, 3, 3), and a tree of boxes around them: low, high (n, 3), the
whole first, those of branch k at 2k + 1 and 2k + 2; leaves: the triangle of each of the last boxes. The
outside follows from the normal of the face, edge or corner that is nearest, the means of which over the
triangles there are weighted by their angles: Baerentzen, Aanaes, IEEE Trans. Vis. Comput. Graph. 11 (2005)
243, doi 10.1109/TVCG.2005.49. normals (m, 7, 3): of the face, of the edges from its corners, of its corners.

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
from numpy.typing import NDArray

from exunet.base.errors import CaseError, Fault
from exunet.bodies.overlap import normals_of, tree_of
from exunet.bodies.shapes import Shape, TriangleMesh
from exunet.bodies.touched import SampledCore
from exunet.forces.contact.signed_distance import sampled_distance
from exunet.forces.cores import BRICK, STENCIL, Samples
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


INSIDE = (nearest_of_triangle, gap_of_box, nearest, signed_distance)
CALLED = (find_distances, find_level, fill_bricks, find_balls)


Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Tree = tuple[Floats, Floats, Ints, Floats]

MOST_BYTES = 512 * 1024**2  # of the samples of a body
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
    return _core(name, _Content(shape.mesh), shape.edge_radius, cell, reach)


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
def _core(name: str, content: _Content, rounding: float, cell: float, reach: float) -> SampledCore:
    corner, number = _grid(name, content.mesh, rounding, cell, reach)
    _validate_samples(name, _min_samples(content.mesh, rounding, cell, reach), cell)
    outer = _outer(content.mesh)
    points = corner + cell * BRICK * (np.moveaxis(np.indices(number), 0, -1).reshape(-1, 3) + 0.5)
    depth = outer.distances(points)[0] + rounding
    near = np.flatnonzero(np.abs(depth) <= _HALF * cell)
    bricks = np.stack(np.unravel_index(near, number), axis=1)
    inner = _inner(name, outer, corner, cell, bricks, rounding)
    _validate_thickness(name, content.mesh, inner, rounding)
    away = np.copysign(np.abs(inner.distances(points)[0]), depth)
    half = _HALF * cell
    filled = (away <= rounding + reach + _ROOM * cell + half) & (away >= -_ROOM * cell - half)
    _validate_samples(name, int(filled.sum()), cell)
    values = np.empty((int(filled.sum()), STENCIL, STENCIL, STENCIL))
    bricks = np.stack(np.unravel_index(np.flatnonzero(filled), number), axis=1)
    outer.loops.fill_bricks(inner.tree, outer.tree, outer.normals, -rounding, corner, cell, bricks, values)
    which = np.full(len(points), -1)
    which[filled] = np.arange(len(values))
    beyond = rounding + reach + _ROOM * cell
    samples = Samples(corner, cell, beyond, which.reshape(number), away.reshape(number), values.reshape(-1))
    least = max(rounding, _half_thickness(outer, inner, rounding, corner, cell * BRICK * max(number)))
    return SampledCore(
        samples, least, _bends(values, cell, rounding + reach), _error(samples, inner, rounding + reach)
    )


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


def _grid(
    name: str, mesh: TriangleMesh, rounding: float, cell: float, reach: float
) -> tuple[Floats, tuple[int, int, int]]:
    """Return the origin of the grid (3,) [m], and its number of bricks along x, y, z."""
    room = reach + (_ROOM + 1.0) * cell
    low, high = mesh.vertices.min(axis=0) - room, mesh.vertices.max(axis=0) + room
    number = np.ceil((high - low) / (BRICK * cell))
    size = float(number.prod()) * 16.0
    if size > MOST_BYTES:
        _refuse(name, f"cells of {cell:.3g} m of the distance from the mesh take", size)
    low = 0.5 * (low + high) - 0.5 * BRICK * cell * number
    nx, ny, nz = number.astype(int).tolist()
    return low, (nx, ny, nz)


def _min_samples(mesh: TriangleMesh, rounding: float, cell: float, reach: float) -> float:
    """Return a lower bound of the number of bricks with samples, from volume and area of the mesh alone.

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


def _validate_samples(name: str, bricks: float, cell: float) -> None:
    """Raise CaseError if the samples of this many bricks exceed the memory of a body."""
    size = bricks * 8 * STENCIL**3
    if size > MOST_BYTES:
        _refuse(
            name, f"contact samples the distance from the mesh in cells of {cell:.3g} m, which takes", size
        )


def _refuse(name: str, words: str, size: float) -> None:
    words += f" {size / 1024**2:.0f} MB, and at most {MOST_BYTES / 1024**2:.0f} MB are allowed: "
    raise CaseError(
        [Fault(f"bodies.{name}.edge_radius", words + "give a larger grid_spacing, or edge_radius")]
    )


def _inner(name: str, outer: _Outer, corner: Floats, cell: float, bricks: Ints, rounding: float) -> _Outer:
    """Compute the surface of the core; bricks : (n, 3) bricks that it may cross."""
    number = BRICK * (bricks.max(axis=0, initial=0) + 2)
    cells, places = [np.zeros((0, 4), dtype=np.int64)], [np.zeros((0, 6))]
    for which, place in _crossings(outer, corner, cell, bricks, rounding):
        cells.append(np.ravel_multi_index(tuple(np.moveaxis(which, 2, 0)), number))
        places.append(place)
    faces, place = np.concatenate(cells), np.concatenate(places)
    if not len(faces):
        words = "leaves nothing of the mesh, which is thinner than twice as much: give a smaller one"
        raise CaseError([Fault(f"bodies.{name}.edge_radius", words)])
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


def _validate_thickness(name: str, mesh: TriangleMesh, inner: _Outer, rounding: float) -> None:
    """Raise CaseError for parts thinner than twice the edge radius, which the core does not contain."""
    places = np.concatenate(list(_places_on(mesh, rounding)))
    lost = inner.distances(places)[0] - rounding
    worst = int(lost.argmax())
    if lost[worst] > LOST * rounding:
        x, y, z = places[worst].tolist()
        words = f"rounds away {lost[worst]:.3g} m of the mesh at ({x:.4g}, {y:.4g}, {z:.4g}) m of its frame, "
        words += "where it is thinner than twice as much or has an edge too sharp for it: give a smaller one"
        raise CaseError([Fault(f"bodies.{name}.edge_radius", words)])


def _places_on(mesh: TriangleMesh, spacing: float, most: int = 64) -> Iterator[Floats]:
    """Yield points (n, 3) on a mesh, some `spacing` [m] apart, at most about `most` along an edge."""
    corners = mesh.vertices[mesh.triangles]
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.clip(np.ceil(size / spacing), 1, most).astype(np.int64)
    for count in np.unique(counts).tolist():
        i, j = (index.ravel() for index in np.indices((count + 1, count + 1)))
        within = i + j <= count
        weights = np.stack([i, j, count - i - j], axis=1)[within] / count
        yield np.einsum("pk,mka->mpa", weights, corners[counts == count]).reshape(-1, 3)


def _half_thickness(outer: _Outer, inner: _Outer, rounding: float, corner: Floats, size: float) -> float:
    """Compute the radius of the smallest ball inside the mesh that touches it on two sides [m]."""
    triangles = inner.tree[3]
    places = triangles[:: max(1, len(triangles) // _PLACES)].mean(axis=1)
    feet = outer.distances(places)[1]
    ways = places - feet
    length = np.linalg.norm(ways, axis=1)
    good = length > 0.9 * rounding
    radii = np.full(int(good.sum()), size)
    inwards = ways[good] / length[good][:, None]
    outer.loops.find_balls(outer.tree, outer.normals, np.ascontiguousarray(feet[good]), inwards, radii)
    return float(radii.min(initial=size))


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


def _error(samples: Samples, inner: _Outer, reach: float) -> float:
    """Compute the largest error of the interpolated distance in the range of contact [m]."""
    random = np.random.default_rng(1)
    number = int(samples.bricks.max()) + 1
    chosen = random.integers(0, max(number, 1), _CHECKED)
    where = np.stack(np.nonzero(samples.bricks >= 0), axis=1)[chosen]
    places = samples.corner + samples.cell * BRICK * (where + random.uniform(size=(_CHECKED, 3)))
    found: Any = np.array([sampled_distance(samples, *place)[0] for place in places.tolist()])
    known = inner.distances(places)[0]
    touched = (found > 0.5 * samples.cell) & (found < reach)
    return float(np.abs(found - known)[touched].max(initial=0.0))
