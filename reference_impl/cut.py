"""Nets cut to an outline: a lattice of threads, what of it lies inside, and the border round it.

The lattice is laid cell by cell, in whole numbers, so that a side of two cells is one to the last bit.  What
becomes of a side follows from its two ends alone; no knot is asked which sides it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.direction import direction
from reference_impl.outline import Circle, Outline, Polygon, distance
from reference_impl.shape import Cut

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
