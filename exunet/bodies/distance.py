"""Distance of bodies, surface to surface, at instants and between them; overlap, threads inside a body.

Each solid is a convex core with a radius around it: the middle of a sphere, the axis of a capsule, and all of
a box, cylinder or frustum. Of two cores that do not meet, the nearest points are found by the method of
Gilbert, Johnson and Keerthi, IEEE J. Robot. Autom. 4 (1988) 193, doi 10.1109/56.2083: the point of their
difference that is nearest to the origin, from simplexes of points of its surface. It is a point of the
difference at every iteration, so its length is never below the distance; a plane through the farthest point
against it gives a bound from below. Iterations end once these two are within 1e-10 of the size of the
difference, or at a length that round-off does not let become less.

A mesh counts as the convex hull of its vertices: its distance is never above that of the mesh, and the same
if the mesh is convex.

Places are cubics through places and velocities at both ends (Hermite's); attitudes the same of quaternions,
whose rates follow from angular velocities, brought to length 1. Of a body that makes less than half a
turn from one instant to the next both are exact to the fourth order of the time between.

The distance changes no faster than the surfaces move against each other, which bounds it from below in each
piece of a step (Piyavskii, USSR Comput. Math. Math. Phys. 12 (1972) 57, doi 10.1016/0041-5553(72)90115-2).
Pieces in which the bodies may be nearer than is known are halved, down to a way that is short beside the
bodies; those at the least distance, or where the bodies begin or end to touch, down to a much shorter one.

They do if an edge of one goes through a triangle of the other, or if one contains a piece of the other.
Pairs of triangles that may meet are found by trees of boxes, both of which are descended at once (Gottschalk,
Lin, Manocha, Proc. SIGGRAPH 1996, 171, doi 10.1145/237170.237244, with boxes along the axes).

Surfaces that touch, or have faces in one plane, leave it to round-off which side an edge is on. Both are
therefore looked at drawn in by a hair, one by twice as much as the other: what touches comes apart, and faces
in one plane of bodies that share points come to lie one behind the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, product

import numpy as np
import scipy

from exunet.base.arrays import Bools, Floats, Ints
from exunet.bodies.rotations import rotation_matrix, turning
from exunet.bodies.shapes import Shape, Solid, TriangleMesh, Vector, core_of, farthest_of_core

ACCURACY = 1e-10  # of the size of the difference of two cores
_NEAR = 1e-13  # of that size, below which a distance counts as zero
_ITERATIONS = 200  # iterations
_ROWS = 4096  # instants that are looked at in one go


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """A convex part of a body, in its frame.

    solid    : that it is; None: the hull of `vertices`
    vertices : (n, 3) [m]
    radius   : around the core [m]
    middle, reach : of a sphere around all of it: centre (3,) and radius [m]
    """

    solid: Solid | None
    vertices: Floats
    radius: float
    middle: Floats
    reach: float

    def farthest(self, direction: Floats) -> Floats:
        """(n, 3) the points of its core that are farthest in directions (n, 3)."""
        if self.solid is None:
            return np.asarray(self.vertices[(direction @ self.vertices.T).argmax(axis=1)])
        turn = self.solid.rotation
        own = farthest_of_core(self.solid.kind, self.solid.numbers, direction @ turn)
        return np.asarray(own @ turn.T + self.solid.position)


@lru_cache(maxsize=256)
def parts_of(shape: Shape, scale: float = 1.0) -> tuple[ConvexPart, ...]:
    """The convex parts of a shape, each made smaller by a factor about its origin (a mesh: its middle)."""
    found = [part_of(replace(solid, numbers=_times(scale, solid.numbers))) for solid in shape.solids]
    return (*found, *([] if shape.mesh is None else [_hull(shape.mesh.vertices, scale)]))


def _times(scale: float, numbers: Vector) -> Vector:
    a, b, c = numbers
    return scale * a, scale * b, scale * c


def part_of(solid: Solid) -> ConvexPart:
    """A solid as a part."""
    radius, around = core_of(solid.kind, solid.numbers)
    return ConvexPart(solid, np.zeros((0, 3)), radius, np.array(solid.position), around + radius)


def _hull(vertices: Floats, scale: float) -> ConvexPart:
    from scipy.spatial import ConvexHull

    corners = vertices[ConvexHull(vertices).vertices]
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    corners = middle + scale * (corners - middle)
    return ConvexPart(None, corners, 0.0, middle, float(np.linalg.norm(corners - middle, axis=1).max()))


def distances(
    one: Shape, poses_of_one: Floats, other: Shape, poses_of_other: Floats, scale: float = 1.0
) -> Floats:
    """(n,) distances of two shapes [m], 0 where they share points; that of the nearest of their parts.

    poses : (n, 7) place of the shape's frame [m] and attitude (w, x, y, z), in the scene
    scale : all parts are smaller by this factor
    """
    found = [np.zeros(0)]
    for start in range(0, len(poses_of_one), _ROWS):
        rows = slice(start, start + _ROWS)
        found.append(_distances(one, poses_of_one[rows], other, poses_of_other[rows], scale))
    return np.concatenate(found)


def _distances(one: Shape, a: Floats, other: Shape, b: Floats, scale: float) -> Floats:
    """Parts whose surrounding spheres are nearest come first; those that cannot be nearer are left out."""
    turn_a, turn_b = rotation_matrix(a[:, 3:]), rotation_matrix(b[:, 3:])
    # The frame of `other` in that of `one`, where rounding is that of their distance.
    turn = np.swapaxes(turn_a, 1, 2) @ turn_b
    shift = np.einsum("nij,ni->nj", turn_a, b[:, :3] - a[:, :3])
    pairs = list(product(parts_of(one, scale), parts_of(other, scale)))
    apart = (
        np.stack([_apart(p, q, turn, shift) for p, q in pairs], axis=1) if pairs else np.zeros((len(a), 0))
    )
    found = np.full(len(a), np.inf)
    for k in np.argsort(apart.sum(axis=0)).tolist():
        p, q = pairs[k]
        rows = np.flatnonzero(apart[:, k] < found)
        if len(rows):
            cores = _of_cores(p, q, turn[rows], shift[rows])
            found[rows] = np.minimum(found[rows], np.maximum(cores - p.radius - q.radius, 0.0))
    return found


def _apart(p: ConvexPart, q: ConvexPart, turn: Floats, shift: Floats) -> Floats:
    """(n,) of the spheres around two parts, which may be negative."""
    between = turn @ q.middle + shift - p.middle
    return np.asarray(np.linalg.norm(between, axis=1) - p.reach - q.reach)


def _of_cores(p: ConvexPart, q: ConvexPart, turn: Floats, shift: Floats) -> Floats:
    """(n,) distances of the cores of two parts, the second turned and shifted."""
    found = np.zeros(len(turn))
    way = turn @ q.middle + shift - p.middle
    way[np.linalg.norm(way, axis=1) == 0.0] = [1.0, 0.0, 0.0]
    nearest = _difference(p, q, turn, shift, way)
    length = np.linalg.norm(nearest, axis=1)
    corners, used = np.zeros((len(turn), 4, 3)), np.zeros((len(turn), 4), dtype=bool)
    corners[:, 0], used[:, 0] = nearest, True
    state = (np.arange(len(turn)), turn, shift, corners, used, nearest, length, length)
    for _ in range(_ITERATIONS):
        rows, turn, shift, corners, used, nearest, length, size = (
            part[state[6] > _NEAR * state[7]] for part in state
        )
        if not len(rows):
            break
        found[rows] = length
        new = _difference(p, q, turn, shift, nearest)
        size = np.maximum(size, np.linalg.norm(new, axis=1))
        below = np.einsum("na,na->n", nearest, new) / length  # no point is nearer than this plane
        at = np.arange(len(rows)), np.argmin(used, axis=1)
        corners[at], used[at] = new, True
        nearest, used = _nearest(corners, used)
        shorter = np.linalg.norm(nearest, axis=1)
        going = (length - below > ACCURACY * size) & (shorter < length)
        found[rows[going]] = np.where(shorter > _NEAR * size, shorter, 0.0)[going]
        state = tuple(part[going] for part in (rows, turn, shift, corners, used, nearest, shorter, size))
    return found


def _difference(p: ConvexPart, q: ConvexPart, turn: Floats, shift: Floats, way: Floats) -> Floats:
    """(n, 3) points of the difference of two cores, second less first, farthest against directions (n, 3)."""
    theirs = q.farthest(-np.einsum("nij,ni->nj", turn, way))
    return np.asarray(np.einsum("nij,nj->ni", turn, theirs) + shift - p.farthest(way))


def _nearest(corners: Floats, used: Bools) -> tuple[Floats, Bools]:
    """(n, 3) the points of simplexes that are nearest to the origin, and (n, 4) the fewest corners they need.

    corners : (n, 4, 3), of which those that are used (n, 4) count, at least one of each
    Of every corner, edge, triangle and of the whole: the point of its plane nearest to the origin, if it is
    within. What is without extent has none; its parts have.
    """
    best = np.full(len(corners), np.inf)
    point, which = np.zeros((len(corners), 3)), np.zeros_like(used)
    for count in range(1, 5):
        for some in combinations(range(4), count):
            rows = np.flatnonzero(used[:, some].all(axis=1))
            if not len(rows):
                continue
            these = corners[rows][:, some]
            weights = _weights(these)
            within = (weights >= 0.0).all(axis=1)
            rows, found = rows[within], np.einsum("nk,nka->na", weights[within], these[within])
            square = np.einsum("na,na->n", found, found)
            better = square < best[rows] * (1.0 - 1e-14)
            rows = rows[better]
            best[rows], point[rows] = square[better], found[better]
            which[rows] = np.isin(np.arange(4), some)
    return point, which


def _weights(corners: Floats) -> Floats:
    """(n, k) weights of the corners (n, k, 3) that give the point of their plane nearest to the origin.

    Negative ones where that is outside, or where the corners span no such plane.
    """
    first, edges = -corners[:, 0], corners[:, 1:] - corners[:, :1]
    count = edges.shape[1]
    if count == 0:
        return np.ones((len(corners), 1))
    if count == 1:
        (a,) = np.moveaxis(edges, 1, 0)
        parts, whole = [_dot(first, a)], _dot(a, a)
    elif count == 2:
        a, b = np.moveaxis(edges, 1, 0)
        normal = np.cross(a, b)
        parts = [_dot(normal, np.cross(first, b)), _dot(normal, np.cross(a, first))]
        whole = _dot(normal, normal)
    else:
        a, b, c = np.moveaxis(edges, 1, 0)
        crosses = np.cross(b, c), np.cross(c, a), np.cross(a, b)
        parts, whole = [_dot(first, cross) for cross in crosses], _dot(a, crosses[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        others = np.stack(parts, axis=1) / whole[:, None]
    others = np.where(np.isfinite(others), others, -1.0)
    return np.concatenate([1.0 - others.sum(axis=1, keepdims=True), others], axis=1)


def _dot(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.einsum("na,na->n", one, other))


_SHORTEST = 0.9  # length of a quaternion between two of length 1, less than half a turn apart: 0.98 and more


def cubic(values: Floats, rates: Floats, step: Floats, part: Floats) -> Floats:
    """(n, m) values at parts (n,) of steps (n,) [s], of values and rates (2, n, m) at both ends of each."""
    s, h = part[:, None], step[:, None]
    a, b = values
    v, w = h * rates
    return np.asarray(a + s * (v + s * (3.0 * (b - a) - 2.0 * v - w + s * (2.0 * (a - b) + v + w))))


def rates_around(values: Floats, rates: Floats, step: Floats) -> Floats:
    """(3, n, ..., m) rates of which those of such a cubic are weighted means: points of control (Bezier's).

    values, rates : (n + 1, ..., m) at the ends of the steps (n,) [s]
    """
    h = step.reshape(-1, *(1,) * (values.ndim - 1))
    middle = 3.0 * np.diff(values, axis=0) / h - rates[:-1] - rates[1:]
    return np.stack([rates[:-1], middle, rates[1:]])


@dataclass(frozen=True, eq=False)
class Path:
    """The motion of a body through instants.

    time     : (t,) [s], increasing
    place    : (t, 3) of the centre of mass [m]
    velocity : (t, 3) [m/s]
    attitude : (t, 4) unit quaternions (w, x, y, z); signs are brought to the shorter way
    spin     : (t, 3) angular velocities in the body's axes [rad/s]
    """

    time: Floats
    place: Floats
    velocity: Floats
    attitude: Floats
    spin: Floats

    @cached_property
    def step(self) -> Floats:
        """(t - 1,) between instants [s]."""
        return np.diff(self.time)

    @cached_property
    def quaternions(self) -> tuple[Floats, Floats]:
        """(t, 4) each: attitudes whose signs do not change from one to the next, and their rates."""
        turned = np.einsum("tq,tq->t", self.attitude[1:], self.attitude[:-1]) < 0.0
        sign = np.concatenate([[1.0], np.cumprod(np.where(turned, -1.0, 1.0))])[: len(self.time)]
        attitude = sign[:, None] * self.attitude
        return attitude, turning(attitude, self.spin)

    @cached_property
    def poses(self) -> Floats:
        """(t, 7) places and attitudes at the instants."""
        return np.concatenate([self.place, self.attitude], axis=1)

    def at(self, row: Ints, part: Floats) -> Floats:
        """(n, 7) places [m] and attitudes at parts (n,) of the steps of these numbers (n,)."""
        ends, step = np.stack([row, row + 1]), self.step[row]
        attitude, rate = self.quaternions
        place = cubic(self.place[ends], self.velocity[ends], step, part)
        turned = cubic(attitude[ends], rate[ends], step, part)
        return np.concatenate([place, turned / np.linalg.norm(turned, axis=1, keepdims=True)], axis=1)

    @cached_property
    def velocities(self) -> Floats:
        """(3, t - 1, 3) of which those in each step are weighted means [m/s]."""
        return rates_around(self.place, self.velocity, self.step)

    @cached_property
    def fastest_turn(self) -> Floats:
        """(t - 1,) angular velocity in each step, at most [rad/s]."""
        rates = rates_around(*self.quaternions, self.step)
        return np.asarray(2.0 * np.linalg.norm(rates, axis=-1).max(axis=0) / _SHORTEST)

    def through(self, rows: slice | Ints) -> Path:
        """Through some of the instants."""
        states = (self.time, self.place, self.velocity, self.attitude, self.spin)
        return Path(*(values[rows] for values in states))

    def when(self, time: Floats) -> Floats:
        """(n, 7) places [m] and attitudes at times (n,) [s] from the first instant to the last."""
        row = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, max(0, len(self.step) - 1))
        if not len(self.step):
            return self.poses[row]
        return self.at(row, (time - self.time[row]) / self.step[row])


def seen_from(poses: Floats, points: Floats) -> Floats:
    """(n, 3) points of the scene (n, 3) [m], from bodies at poses (n, 7) and in their axes."""
    return np.asarray(np.einsum("nij,ni->nj", rotation_matrix(poses[:, 3:]), points - poses[:, :3]))


Measure = Callable[[Floats, Floats], Floats]  # of poses (n, 7) of two bodies

COARSE, FINE = 0.05, 1e-4  # ways, in least dimensions of the bodies, down to which pieces are halved
_HALVINGS = 40  # halvings
_SAME = 1e-9  # of a step, within which instants are one


@dataclass(frozen=True, eq=False)
class Mover:
    """A body in motion: its path, and its shape from its centre of mass."""

    path: Path
    shape: Shape

    @property
    def reach(self) -> float:
        """Radius of a sphere about the centre of mass that has all of it in it [m]."""
        return reach_of(self.shape)

    @property
    def swing(self) -> float:
        """Return the largest displacement by a rotation: the reach, of a sphere that of its middle [m]."""
        found = [0.0]
        for part in parts_of(self.shape):
            round_ = part.solid is not None and part.solid.kind == "sphere"
            found.append(float(np.linalg.norm(part.middle)) + (0.0 if round_ else part.reach))
        return max(found)

    @property
    def least(self) -> float:
        """The smallest dimension, of all its parts [m]."""
        return least_of(self.shape)


def least_of(shape: Shape) -> float:
    """The smallest dimension of a shape, of all its parts; of a mesh along the axes of its frame [m]."""
    found = [solid.least for solid in shape.solids]
    if shape.mesh is not None:
        found.append(float(np.ptp(shape.mesh.vertices, axis=0).min()))
    return min(found)


def approach(one: Mover, other: Mover, measure: Measure, *, touching: bool = False) -> tuple[Floats, Floats]:
    """Times (m,) [s], increasing, the instants among them, and what was measured at each (m,) [m].

    measure  : distances, or bounds of them from below where they are above 0; 0: the bodies touch
    touching : look for where they touch only, not for where they are nearest
    """
    a, b = one.path, other.path
    speed = np.linalg.norm(a.velocities - b.velocities, axis=-1).max(axis=0)
    speed = speed + one.swing * a.fastest_turn + other.swing * b.fastest_turn
    size = min(one.least, other.least)
    time, value = a.time, measure(a.poses, b.poses)
    row = np.arange(len(time) - 1)
    begin, end = np.zeros(len(row)), np.ones(len(row))
    at_begin, at_end = value[:-1], value[1:]
    for _ in range(_HALVINGS):
        way = speed[row] * a.step[row] * (end - begin)
        least = float(value.min())
        below = 0.5 * (at_begin + at_end - way) < (0.0 if touching else least)
        edge = (at_begin == 0.0) != (at_end == 0.0)
        beside = _ends_at(a, row, begin, end, float(time[value == least].min())) & (not touching)
        still = way > FINE * size
        kept = still & (below | edge)
        whole = (at_begin == 0.0) & (at_end == 0.0)
        halved = kept & ~whole & ((way > COARSE * size) | edge | beside)
        if not halved.any():
            break
        rows, middle = row[halved], 0.5 * (begin + end)[halved]
        found = measure(a.at(rows, middle), b.at(rows, middle))
        time = np.append(time, a.time[rows] + middle * a.step[rows])
        value = np.append(value, found)
        left = kept & ~halved
        row = np.concatenate([row[left], rows, rows])
        begin, end = (
            np.concatenate([begin[left], begin[halved], middle]),
            np.concatenate([end[left], middle, end[halved]]),
        )
        at_begin, at_end = (
            np.concatenate([at_begin[left], at_begin[halved], found]),
            np.concatenate([at_end[left], found, at_end[halved]]),
        )
    order = np.argsort(time, kind="stable")
    return time[order], value[order]


def _ends_at(path: Path, row: Ints, begin: Floats, end: Floats, time: float) -> Bools:
    """The pieces that begin or end at a time [s]."""
    part, step = time - path.time[row], path.step[row]
    return np.asarray(
        (np.abs(part - begin * step) <= _SAME * step) | (np.abs(part - end * step) <= _SAME * step)
    )


def reach_of(shape: Shape) -> float:
    """Radius of a sphere about the origin of the frame that has all of a shape in it [m]."""
    return max(float(np.linalg.norm(part.middle)) + part.reach for part in parts_of(shape))


def distances_to(shape: Shape, points: Floats) -> Floats:
    """Return the distances (k,) of points (k, 3) in a shape's frame, 0 inside [m]; a mesh is its hull."""
    apart = np.full(len(points), np.inf)
    for solid in shape.solids:
        apart = np.minimum(apart, solid.distance(points))
    if shape.mesh is not None:
        hull = scipy.spatial.ConvexHull(shape.mesh.vertices)
        depth = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        apart = np.minimum(apart, np.maximum(depth.max(axis=1), 0.0))
    return apart


DRAWN_IN = 1e-9  # of the larger of two surfaces
AROUND = 64  # corners of a polygon in place of a circle
_PAIRS = 1 << 15  # that are looked at in one go


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed surface and its tree.

    corners  : (m, 3, 3) of its triangles [m]
    inwards  : (m, 3, 3) unit vectors at the corners
    pieces   : (k, 3) a corner of each piece that hangs together, (k, 3) its vector inwards
    size     : the diagonal of the box around it [m]
    leaves   : (2^levels,) numbers of triangles, of which some stand there more than once
    middles, halves : of the boxes around the branches, level by level, the whole first: (2^level, 3) [m]
    """

    corners: Floats
    inwards: Floats
    pieces: tuple[Floats, Floats]
    size: float
    leaves: Ints
    middles: tuple[Floats, ...]
    halves: tuple[Floats, ...]


@lru_cache(maxsize=64)
def surfaces_of(shape: Shape) -> tuple[ClosedSurface, ...]:
    """Those of a shape in its frame: of its mesh, and of polyhedra inside its solids."""
    meshes = [polyhedron(solid) for solid in shape.solids]
    return tuple(_surface(mesh) for mesh in (*meshes, *([] if shape.mesh is None else [shape.mesh])))


def polyhedron(solid: Solid) -> TriangleMesh:
    """A convex one with its corners on the surface of a solid, in the body's frame; a box itself."""
    a, b, c = solid.numbers
    turn = np.arange(AROUND) * (2.0 * np.pi / AROUND)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if solid.kind == "box":
        around = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * [a, b]
        profile = [(1.0, -0.5 * c), (1.0, 0.5 * c)]
    elif solid.kind in ("cylinder", "frustum"):
        low, high, half = (a, a, 0.5 * b) if solid.kind == "cylinder" else (a, b, 0.5 * c)
        profile = [(low, -half), (high, half)]
    else:
        angles = np.linspace(0.0, 0.5 * np.pi, AROUND // 4 + 1)[:-1].tolist()
        upper = [(a * math.cos(angle), a * math.sin(angle) + 0.5 * b) for angle in angles] + [
            (0.0, a + 0.5 * b)
        ]
        profile = [(across, -along) for across, along in upper[::-1]] + upper
    points, triangles = _turned(profile, around)
    return TriangleMesh(points @ solid.rotation.T + solid.position, triangles)


def _turned(profile: list[tuple[float, float]], around: Floats) -> tuple[Floats, Ints]:
    """Vertices and triangles of rings (n, 2) of widths at increasing heights, closed below and above."""
    rings = [np.concatenate([w * around, np.full((len(around), 1), height)], axis=1) for w, height in profile]
    vertices, same = np.unique(np.concatenate(rings), axis=0, return_inverse=True)
    this = np.arange(len(around))
    after = np.roll(this, -1)
    found = [np.stack([0 * this, after, this], axis=1)]
    for k in range(1, len(rings)):
        low, high = (k - 1) * len(around), k * len(around)
        found.append(np.stack([low + this, low + after, high + after], axis=1))
        found.append(np.stack([low + this, high + after, high + this], axis=1))
    last = (len(rings) - 1) * len(around)
    found.append(last + np.stack([0 * this, this, after], axis=1))
    triangles = same.reshape(-1)[np.concatenate(found)]
    a, b, c = triangles.T
    return vertices, triangles[(a != b) & (b != c) & (c != a)]


def _surface(mesh: TriangleMesh) -> ClosedSurface:
    corners, inwards = mesh.vertices[mesh.triangles], -normals_of(mesh)
    edges = mesh.triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = scipy.sparse.coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=(len(mesh.vertices),) * 2)
    used = np.unique(mesh.triangles)
    _, first = np.unique(
        scipy.sparse.csgraph.connected_components(graph, directed=False)[1][used], return_index=True
    )
    some = used[first]
    leaves, low, high = tree_of(corners)
    middles = tuple(0.5 * (a + b) for a, b in zip(low, high, strict=True))
    halves = tuple(0.5 * (b - a) for a, b in zip(low, high, strict=True))
    size = 2.0 * float(np.linalg.norm(halves[0]))
    pieces = mesh.vertices[some], inwards[some]
    return ClosedSurface(corners, inwards[mesh.triangles], pieces, size, leaves, middles, halves)


def tree_of(corners: Floats) -> tuple[Ints, list[Floats], list[Floats]]:
    """The leaves of a box tree around triangles (m, 3, 3), as of `ClosedSurface`, and each level's boxes.

    These are their least and their largest coordinates, (2^level, 3) [m], the whole first.
    """
    leaves = _leaves(corners.mean(axis=1))
    low, high = [corners[leaves].min(axis=1)], [corners[leaves].max(axis=1)]
    while len(low[0]) > 1:
        low.insert(0, low[0].reshape(-1, 2, 3).min(axis=1))
        high.insert(0, high[0].reshape(-1, 2, 3).max(axis=1))
    return leaves, low, high


def normals_of(mesh: TriangleMesh) -> Floats:
    """(n, 3) of the vertices, outwards: means over their triangles, by the angles there."""
    corners = mesh.vertices[mesh.triangles]
    ways = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(ways[:, 0], ways[:, 1])
    found = np.zeros_like(mesh.vertices)
    size = np.linalg.norm(normal, axis=1)
    for k in range(3):
        angle = np.arctan2(size, -np.einsum("ma,ma->m", ways[:, k], ways[:, k - 1]))
        weight = np.divide(angle, size, out=np.zeros_like(size), where=size > 0.0)
        np.add.at(found, mesh.triangles[:, k], weight[:, None] * normal)
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return np.divide(found, length, out=np.zeros_like(found), where=length > 0.0)


def _leaves(middles: Floats) -> Ints:
    """(2^levels,) numbers of points (m, 3): the halves of each branch lie beside each other along an axis."""
    levels = max(0, int(np.ceil(np.log2(len(middles)))))
    order = np.arange(2**levels) % len(middles)
    for level in range(levels):
        rows = order.reshape(2**level, -1)
        places = middles[rows]
        axis = np.ptp(places, axis=1).argmax(axis=1)
        along = np.take_along_axis(places, axis[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(rows, along.argsort(axis=1, kind="stable"), axis=1).ravel()
    return order


def share_points(one: ClosedSurface, other: ClosedSurface, turn: Floats, shift: Floats) -> bool:
    """True where the insides of two surfaces have common points; those that touch have none.

    turn (3, 3), shift (3,) : from the frame of `other` to that of `one` [m]
    """
    hair = DRAWN_IN * max(one.size, other.size)
    if _cross(one, other, turn, shift, hair):
        return True
    corners = other.corners + 2.0 * hair * other.inwards
    places = (one.pieces[0] + hair * one.pieces[1] - shift) @ turn
    if _inside(places, corners).any():
        return True
    places = (other.pieces[0] + 2.0 * hair * other.pieces[1]) @ turn.T + shift
    return bool(_inside(places, one.corners + hair * one.inwards).any())


def _cross(one: ClosedSurface, other: ClosedSurface, turn: Floats, shift: Floats, hair: float) -> bool:
    """True if an edge of one goes through a triangle of the other, both drawn in by a hair or two."""
    for m, n in _near(one, other, turn, shift, 3.0 * hair):
        first = one.corners[m] + hair * one.inwards[m]
        second = (other.corners[n] + 2.0 * hair * other.inwards[n]) @ turn.T + shift
        if _meet(first, second).any():
            return True
    return False


def _near(
    one: ClosedSurface, other: ClosedSurface, turn: Floats, shift: Floats, room: float
) -> Iterator[tuple[Ints, Ints]]:
    """Triangles (n,) of both whose boxes are no further than `room` [m] from each other."""
    span = np.abs(turn)
    most = len(one.middles) - 1, len(other.middles) - 1
    waiting = [((0, 0), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))]
    while waiting:
        (p, q), a, b = waiting.pop()
        apart = np.abs(other.middles[q][b] @ turn.T + shift - one.middles[p][a])
        reach = one.halves[p][a] + other.halves[q][b] @ span.T + room
        near = (apart <= reach).all(axis=1)
        a, b = a[near], b[near]
        if not len(a):
            continue
        if (p, q) == most:
            yield one.leaves[a], other.leaves[b]
            continue
        if p < most[0]:
            p, a, b = p + 1, np.concatenate([2 * a, 2 * a + 1]), np.concatenate([b, b])
        if q < most[1]:
            q, a, b = q + 1, np.concatenate([a, a]), np.concatenate([2 * b, 2 * b + 1])
        for start in range(0, len(a), _PAIRS):
            some = slice(start, start + _PAIRS)
            waiting.append(((p, q), a[some], b[some]))


def _meet(one: Floats, other: Floats) -> Bools:
    """(n,) True where an edge of one triangle goes through the other, (n, 3, 3) each."""
    found = np.zeros(len(one), dtype=bool)
    rows = np.flatnonzero(_both_sides(one, other) & _both_sides(other, one))
    for these, those in ((one[rows], other[rows]), (other[rows], one[rows])):
        for k in range(3):
            found[rows] |= _goes_through(these[:, k], these[:, (k + 1) % 3], those)
    return found


def _both_sides(triangle: Floats, points: Floats) -> Bools:
    """(n,) True where of points (n, 3, 3) some are on either side of a triangle's plane."""
    a, b, c = np.moveaxis(triangle, 1, 0)
    height = np.einsum("nka,na->nk", points - a[:, None], np.cross(b - a, c - a))
    return np.asarray((height.min(axis=1) <= 0.0) & (height.max(axis=1) >= 0.0))


def _goes_through(start: Floats, end: Floats, triangle: Floats) -> Bools:
    """(n,) True for segments that go through a triangle: of the volumes with its edges all have one sign."""
    a, b, c = (corner - start for corner in np.moveaxis(triangle, 1, 0))
    way = end - start
    normal = np.cross(b - a, c - a)
    low, high = np.einsum("na,na->n", a, normal), np.einsum("na,na->n", a - way, normal)
    volumes = np.stack([_volume(way, p, q) for p, q in ((a, b), (b, c), (c, a))], axis=1)
    around = (volumes >= 0.0).all(axis=1) | (volumes <= 0.0).all(axis=1)
    return np.asarray((low * high < 0.0) & around & volumes.any(axis=1))


def _volume(way: Floats, p: Floats, q: Floats) -> Floats:
    return np.asarray(np.einsum("na,na->n", way, np.cross(p, q)))


def goes_through_itself(mesh: TriangleMesh) -> bool:
    """True of a closed mesh whose triangles go through others, or which does not enclose space just once.

    Pieces that touch do not go through each other; each piece is drawn in by a hair of its own.
    """
    surface, piece = _surface(mesh), pieces_of(mesh)
    hair = DRAWN_IN * surface.size * (1.0 + piece / (1.0 + piece.max()))
    drawn = surface.corners + hair[:, None, None] * surface.inwards
    for m, n in _near(surface, surface, np.eye(3), np.zeros(3), 4.0 * DRAWN_IN * surface.size):
        a, b = mesh.triangles[m], mesh.triangles[n]
        strange = (m < n) & (a[:, :, None] != b[:, None, :]).all(axis=(1, 2))
        if _meet(drawn[m[strange]], drawn[n[strange]]).any():
            return True
    if not piece.any():
        return False
    _, first = np.unique(piece, return_index=True)
    places = drawn[first, 0] + 0.5 * DRAWN_IN * surface.size * surface.inwards[first, 0]
    return bool((np.round(times_round(places, drawn)) != 1.0).any())


def pieces_of(mesh: TriangleMesh) -> Ints:
    """(m,) numbers of the pieces that triangles belong to, which hang together by their corners."""
    edges = mesh.triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = scipy.sparse.coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=(len(mesh.vertices),) * 2)
    labels = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][mesh.triangles[:, 0]]
    return np.asarray(np.unique(labels, return_inverse=True)[1].reshape(-1))


def _inside(points: Floats, corners: Floats) -> Bools:
    """(n,) True for points (n, 3) round which triangles (m, 3, 3) go once or more."""
    return times_round(points, corners) > 0.5


def times_round(points: Floats, corners: Floats) -> Floats:
    """(n,) how many times triangles (m, 3, 3) go round points (n, 3); of an open surface a part.

    By the solid angles: Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125, doi
    10.1109/TBME.1983.325207.
    """
    found = []
    for point in points:
        a, b, c = np.moveaxis(corners - point, 1, 0)
        p, q, r = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        dots = [np.einsum("ma,ma->m", *pair) for pair in ((a, b), (b, c), (c, a))]
        below = p * q * r + dots[0] * r + dots[1] * p + dots[2] * q
        angle = 2.0 * np.arctan2(np.einsum("ma,ma->m", a, np.cross(b, c)), below).sum()
        found.append(angle / (4.0 * np.pi))
    return np.array(found)


_SHRUNK = 1.0 - 1e-9  # so that bodies which touch do not overlap


def overlap(one: Shape, poses_of_one: Floats, other: Shape, poses_of_other: Floats) -> Bools:
    """(n,) True where two shapes surely share points, at poses (n, 7): place of the frame [m] and attitude.

    Bodies that touch do not overlap. It is exact but for a mesh and a round solid: that overlaps if it has a
    vertex inside, or shares points with a polyhedron inside the solid.
    """
    found = distances(one, poses_of_one, other, poses_of_other, _SHRUNK) == 0.0
    if one.mesh is None and other.mesh is None:
        return found
    rows = np.flatnonzero(found)  # where not even the hull of a mesh meets the other, it does not
    poses = np.concatenate([poses_of_one[rows], poses_of_other[rows]], axis=1)
    different, which = np.unique(poses, axis=0, return_inverse=True)  # bodies that rest have one
    answers = [_share_points(one, pair[:7], other, pair[7:]) for pair in different]
    found[rows] = np.array(answers, dtype=bool)[which.reshape(-1)]
    return found


def _share_points(one: Shape, pose_of_one: Floats, other: Shape, pose_of_other: Floats) -> bool:
    """Whether two shapes do, of which one is a mesh or both are, at poses (7,)."""
    turn_of_one = rotation_matrix(pose_of_one[3:])
    turn = turn_of_one.T @ rotation_matrix(pose_of_other[3:])
    shift = (pose_of_other[:3] - pose_of_one[:3]) @ turn_of_one
    return _has_vertex_in(one, other, turn, shift) or any(
        share_points(p, q, turn, shift) for p, q in product(surfaces_of(one), surfaces_of(other))
    )


def _has_vertex_in(one: Shape, other: Shape, turn: Floats, shift: Floats) -> bool:
    """True if a vertex of the mesh of one is in a solid of the other; turn, shift: from `other` to `one`."""
    points = np.zeros((0, 3)) if one.mesh is None else (one.mesh.vertices - shift) @ turn
    back = np.zeros((0, 3)) if other.mesh is None else other.mesh.vertices @ turn.T + shift
    return any(solid.contains(points).any() for solid in other.solids) or any(
        solid.contains(back).any() for solid in one.solids
    )


TOUCH = 1e-6  # of a solid's least dimension: what is no deeper inside touches
_SECTIONS = 45  # that bring a length down to 1e-9 of itself
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_PRODUCTS = 1 << 20  # of segments and triangles that are looked at in one go


def crossing(shape: Shape, start: Floats, end: Floats) -> Bools:
    """(n,) True for segments, from start (n, 3) to end (n, 3) in the frame of a shape, with points inside it.

    Of a mesh, those that cross its surface: one that is inside as a whole is not among them.
    """
    found = np.zeros(len(start), dtype=bool)
    for solid in shape.solids:
        rows = np.flatnonzero(~found)
        found[rows] = _in_solid(solid, start[rows], end[rows])
    if shape.mesh is not None:
        found |= _through_surface(shape.mesh, start, end)
    return found


def _in_solid(solid: Solid, start: Floats, end: Floats) -> Bools:
    """Depth is convex, so along a segment it has one least value."""
    touch = -TOUCH * solid.least
    found = np.minimum(solid.depth(start), solid.depth(end)) < touch
    around = part_of(solid)
    rows = np.flatnonzero(~found & (distance_from(around.middle, start, end) < around.reach))
    found[rows] = least_along(solid.depth, start[rows], end[rows]) < touch
    return np.asarray(found)


def least_along(convex: Callable[[Floats], Floats], start: Floats, end: Floats) -> Floats:
    """(n,) least values of a convex function of points (n, 3) along segments from start to end (n, 3) each.

    By golden sections, to 1e-9 of the length: Kiefer, Proc. Amer. Math. Soc. 4 (1953) 502,
    doi 10.1090/S0002-9939-1953-0055639-3.
    """
    way = end - start
    low, high = np.zeros(len(start)), np.ones(len(start))

    def value(part: Floats) -> Floats:
        return convex(start + part[:, None] * way)

    one, other = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_one, at_other = value(one), value(other)
    least = np.minimum(at_one, at_other)
    for _ in range(_SECTIONS):
        nearer = at_one < at_other
        low, high = np.where(nearer, low, one), np.where(nearer, other, high)
        new = np.where(nearer, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        at_new = value(new)
        one, at_one, other, at_other = (
            np.where(nearer, new, other),
            np.where(nearer, at_new, at_other),
            np.where(nearer, one, new),
            np.where(nearer, at_one, at_new),
        )
        least = np.minimum(least, at_new)
    return least


def distance_from(point: Floats, start: Floats, end: Floats) -> Floats:
    """(...,) from points (..., 3) to segments (..., 3) [m]."""
    way = end - start
    square = np.einsum("...a,...a->...", way, way)
    along = np.einsum("...a,...a->...", point - start, way)
    part = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(start + part[..., None] * way - point, axis=-1))


def _through_surface(mesh: TriangleMesh, start: Floats, end: Floats) -> Bools:
    """Segments that meet a triangle: Moeller and Trumbore, J. Graphics Tools 2 (1997) 21,
    doi 10.1080/10867651.1997.10487468.
    """
    corner, *others = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    one, other = (each - corner for each in others)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    beside = (np.maximum(start, end) < low) | (np.minimum(start, end) > high)
    rows = np.flatnonzero(~beside.any(axis=1))
    found = np.zeros(len(start), dtype=bool)
    for few in np.array_split(rows, max(1, len(rows) * len(corner) // _PRODUCTS)):
        way = (end - start)[few, None]
        from_corner = start[few, None] - corner
        across, along = np.cross(way, other), np.cross(from_corner, one)
        area = np.einsum("nta,ta->nt", across, one)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("nta,nta->nt", across, from_corner) / area
            v = np.einsum("nta,nta->nt", along, np.broadcast_to(way, along.shape)) / area
            part = np.einsum("nta,ta->nt", along, other) / area
        meets = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (part >= 0.0) & (part <= 1.0)
        found[few] = meets.any(axis=1)
    return found
