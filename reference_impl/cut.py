"""Nets cut to an outline: regular polygons and circles, what of a lattice lies inside, the border round it.

Each gives its nearest point, whether it encloses a point, and where a segment leaves it.  A
polygon is the intersection of half-planes n.p <= h; a foot on one of its sides is h n + c t with the tangent
t and c held within half a side.  Terms are added in pairs only, x and y, so that mirrored points have
mirrored answers to the last bit.

The lattice is laid cell by cell, in whole numbers, so that a side of two cells is one to the last bit.  What
becomes of a side follows from its two ends alone; no knot is asked which sides it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Bools, Floats, Ints, direction
from reference_impl.topology import Cut


def planar(a: Floats, b: Floats) -> Floats:
    """Scalar products (...) of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def distance(a: Floats, b: Floats) -> Floats:
    """Distances (...) [m] of points (..., 2) [m]."""
    return np.asarray(np.sqrt(planar(a - b, a - b)))


@dataclass(frozen=True, eq=False)
class Polygon:
    """A regular polygon."""

    corners: Floats  # (k, 2) [m]
    normals: Floats  # (k, 2) unit vectors out of its sides
    apothem: float  # h [m]
    half_side: float  # [m]

    def nearest(self, point: Floats) -> Floats:
        """The nearest points of the outline (q, 2) [m]; of equally near ones that on the first side."""
        tangent = self.normals[:, ::-1] * np.array([-1.0, 1.0])
        along = np.clip(planar(point[:, None], tangent), -self.half_side, self.half_side)
        foot = self.apothem * self.normals + along[..., None] * tangent
        best = np.argmin(distance(point[:, None], foot), axis=1)
        return np.asarray(foot[np.arange(len(point)), best])

    def encloses(self, point: Floats) -> Bools:
        """Whether points (..., 2) [m] are inside."""
        return np.asarray(np.all(planar(point[..., None, :], self.normals) < self.apothem, axis=-1))

    def crossing(self, inside: Floats, outside: Floats) -> Floats:
        """Where segments from (q, 2) to (q, 2) [m] leave it: at the first line of a side."""
        way = outside - inside
        depth = self.apothem - planar(inside[:, None], self.normals)
        speed = planar(way[:, None], self.normals)
        part = np.min(np.where(speed > 0.0, depth / np.where(speed > 0.0, speed, 1.0), np.inf), axis=1)
        return np.asarray(inside + part[:, None] * way)


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle, of which some points are corners."""

    corners: Floats  # (k, 2) [m]
    radius: float  # [m]

    def nearest(self, point: Floats) -> Floats:
        """The nearest points of the outline (q, 2) [m]; of the centre itself any."""
        size = np.sqrt(planar(point, point))[:, None]
        away = np.where(size > 0.0, point / np.where(size > 0.0, size, 1.0), np.array([1.0, 0.0]))
        return np.asarray(self.radius * away)

    def encloses(self, point: Floats) -> Bools:
        """Whether points (..., 2) [m] are inside."""
        return np.asarray(np.sqrt(planar(point, point)) < self.radius)

    def crossing(self, inside: Floats, outside: Floats) -> Floats:
        """Where segments from (q, 2) to (q, 2) [m] leave it: the greater root of |p + s (q - p)| = R."""
        way = outside - inside
        a, b, c = planar(way, way), planar(inside, way), planar(inside, inside) - self.radius**2
        return np.asarray(inside + ((np.sqrt(b * b - a * c) - b) / a)[:, None] * way)


Outline = Polygon | Circle


_NEAR = 0.25 + 1e-9  # of a mesh
_SAME = 1e-6  # of a mesh: ends on the outline that are one


@dataclass(frozen=True, eq=False)
class CutNet:
    """Loose segments, in the plane of the net."""

    mesh: Floats  # (s, 2, 2) [m] ends
    mesh_length: Floats  # (s,) [m]
    border: Floats  # (b, 2, 2) [m] ends
    border_length: Floats  # (b,) [m]
    corners: Floats  # (k, 2) [m]


def cut(shape: Cut) -> CutNet:
    """The net of a shape, by the rules of the case format in their order."""
    outline, near = outline_of(shape), _NEAR * shape.mesh
    ends = _lattice(shape, float(np.max(distance(outline.corners, np.zeros(2)))))
    nearest = outline.nearest(ends.reshape(-1, 2)).reshape(ends.shape)
    moved = distance(ends, nearest) <= near
    inner = outline.encloses(ends) & ~moved
    kept = inner.any(axis=1)
    ends, nearest, moved, inner = ends[kept], nearest[kept], moved[kept], inner[kept]
    row, first = np.arange(len(ends)), np.argmax(inner, axis=1)  # an inner end, and the other one
    start, other = ends[row, first], ends[row, 1 - first]
    rim, shifted = ~inner[row, 1 - first], moved[row, 1 - first]
    stop, gone = other.copy(), rim & ~shifted
    stop[shifted] = nearest[row, 1 - first][shifted]
    stop[gone] = outline.crossing(start[gone], other[gone])
    stop[rim] = _cornered(stop[rim], outline.corners, near)
    border = _around(np.concatenate((outline.corners, stop[rim])), _SAME * shape.mesh)
    return CutNet(
        np.stack((start, stop), axis=1),
        np.where(rim, distance(start, stop), shape.mesh),
        border,
        distance(border[:, 0], border[:, 1]),
        outline.corners,
    )


def outline_of(shape: Cut) -> Outline:
    """The outline, its corners in the order in which the case format numbers them."""
    if shape.outline == "circle":
        rays = np.array([direction(k, shape.corners) for k in range(shape.corners)])
        return Circle(0.5 * shape.size * rays, 0.5 * shape.size)
    sides, apothem = shape.corners, 0.5 * shape.size
    ahead = 0 if shape.outline == "hexagon" else 1  # half sides from the x axis to the first corner
    halves = np.array([direction(k, 2 * sides) for k in range(2 * sides)])
    around = np.roll(halves, -ahead, axis=0)
    half_side = apothem * math.tan(math.pi / sides)
    return Polygon(apothem / math.cos(math.pi / sides) * around[::2], around[1::2], apothem, half_side)


def _lattice(shape: Cut, reach: float) -> Floats:
    """Ends (s, 2, 2) [m] of all sides, each once, of cells that come within `reach` [m] of the origin."""
    mesh = shape.mesh
    many = math.ceil(reach / mesh) + 2
    cells: list[tuple[tuple[int, int], ...]]
    if shape.mesh_shape == "square":
        unit, steps = np.array([0.5 * mesh, 0.5 * mesh]), ((2, 0), (0, 2))
        shift = math.floor(shape.size / mesh + 0.5 + 1e-9) % 2 + 1  # middles lie between knots
        cells = [((-1, -1), (1, -1), (1, 1), (-1, 1))]
    elif shape.mesh_shape == "triangle":
        unit, steps = np.array([0.5 * mesh, 0.5 * math.sqrt(3.0) * mesh]), ((2, 0), (1, 1))
        shift, many = 0, 2 * many
        cells = [((0, 0), (2, 0), (1, 1)), ((2, 0), (3, 1), (1, 1))]
    else:
        unit, steps = np.array([0.5 * math.sqrt(3.0) * mesh, 0.5 * mesh]), ((2, 0), (1, 3))
        shift = 0
        cells = [((0, 2), (-1, 1), (-1, -1), (0, -2), (1, -1), (1, 1))]
    counts = np.stack(np.meshgrid(*2 * [np.arange(-many, many + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    middles = counts @ np.array(steps) + shift
    middles = middles[np.all(np.abs(middles * unit) <= reach + 2.0 * mesh, axis=1)]
    loops = [middles[:, None] + np.array(cell) for cell in cells]
    sides = [np.stack((loop, np.roll(loop, -1, axis=1)), axis=2).reshape(-1, 2, 2) for loop in loops]
    return np.asarray(_distinct(np.concatenate(sides)) * unit)


def _distinct(sides: Ints) -> Ints:
    """Each of the sides (s, 2, 2) once, whichever way round it was laid."""
    one, two = sides[:, 0], sides[:, 1]
    turned = (one[:, 0] > two[:, 0]) | ((one[:, 0] == two[:, 0]) & (one[:, 1] > two[:, 1]))
    ordered = np.where(turned[:, None, None], sides[:, ::-1], sides)
    return np.unique(ordered.reshape(-1, 4), axis=0).reshape(-1, 2, 2)


def _cornered(point: Floats, corners: Floats, near: float) -> Floats:
    """Points (q, 2) [m] of the outline, those near a corner in it."""
    away = distance(point[:, None], corners)
    nearest = np.argmin(away, axis=1)
    close = away[np.arange(len(point)), nearest] <= near
    return np.where(close[:, None], corners[nearest], point)


def _around(point: Floats, same: float) -> Floats:
    """Sides (b, 2, 2) [m] that join points (q, 2) of the outline in order; within `same` [m] they are one."""
    angle = np.arctan2(point[:, 1], point[:, 0])
    point = point[np.argsort(angle, kind="stable")]
    point = point[distance(point, np.roll(point, 1, axis=0)) > same]
    return np.stack((point, np.roll(point, -1, axis=0)), axis=1)
