"""Distance of bodies, surface to surface, at instants and between them.

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
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rotations import rotation_matrix, turning
from exunet.bodies.shapes import Shape, Solid, Vector, core_of, farthest_of_core

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ACCURACY = 1e-10  # of the size of the difference of two cores
_NEAR = 1e-13  # of that size, below which a distance counts as zero
_ITERATIONS = 200  # iterations
_ROWS = 4096  # instants that are looked at in one go


@dataclass(frozen=True, eq=False)
class Part:
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
def parts_of(shape: Shape, scale: float = 1.0) -> tuple[Part, ...]:
    """The convex parts of a shape, each made smaller by a factor about its origin (a mesh: its middle)."""
    found = [part_of(replace(solid, numbers=_times(scale, solid.numbers))) for solid in shape.solids]
    return (*found, *([] if shape.mesh is None else [_hull(shape.mesh.vertices, scale)]))


def _times(scale: float, numbers: Vector) -> Vector:
    a, b, c = numbers
    return scale * a, scale * b, scale * c


def part_of(solid: Solid) -> Part:
    """A solid as a part."""
    radius, around = core_of(solid.kind, solid.numbers)
    return Part(solid, np.zeros((0, 3)), radius, np.array(solid.position), around + radius)


def _hull(vertices: Floats, scale: float) -> Part:
    from scipy.spatial import ConvexHull

    corners = vertices[ConvexHull(vertices).vertices]
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    corners = middle + scale * (corners - middle)
    return Part(None, corners, 0.0, middle, float(np.linalg.norm(corners - middle, axis=1).max()))


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


def _apart(p: Part, q: Part, turn: Floats, shift: Floats) -> Floats:
    """(n,) of the spheres around two parts, which may be negative."""
    between = turn @ q.middle + shift - p.middle
    return np.asarray(np.linalg.norm(between, axis=1) - p.reach - q.reach)


def _of_cores(p: Part, q: Part, turn: Floats, shift: Floats) -> Floats:
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


def _difference(p: Part, q: Part, turn: Floats, shift: Floats, way: Floats) -> Floats:
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


Ints = NDArray[np.int64]

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
        """What turning moves at most: the reach, of a sphere that of its middle [m]."""
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
