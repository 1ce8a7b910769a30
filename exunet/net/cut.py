"""Cut nets: lattices of square, triangular or hexagonal meshes, cut to a convex outline.

Knots have whole coordinates (u, v), so that those that mirror each other have exactly mirrored positions.

A cut leaves stubs. What is nearer than STUB mesh sides to the outline, or to a corner of it, is moved there,
so that no side is shorter than SHORTEST mesh sides; see `_cut`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.net.arrays import Floats, Ints, Mesh
from exunet.net.base import MAX_ELEMENTS, Cable, ThrownNetConfig
from exunet.net.weave import openings


class OutlineShape(StrEnum):
    """The shape of an outline."""

    SQUARE = "square"
    HEXAGON = "hexagon"
    OCTAGON = "octagon"
    CIRCLE = "circle"


# Number of corners, and angle of the first in sixteenths of a turn: sides of squares and octagons are normal
# to x and y, those of hexagons to y.
_CORNERS = {OutlineShape.SQUARE: (4, 2), OutlineShape.HEXAGON: (6, 0), OutlineShape.OCTAGON: (8, 1)}


@dataclass(frozen=True)
class Polygon:
    """A regular polygon.

    apothem : distance of the sides from the origin [m]
    normals : (n, 2) outward, of the side after each corner
    corners : (n, 2) [m], anticlockwise
    """

    apothem: float
    normals: Floats
    corners: Floats

    def nearest(self, points: Floats) -> tuple[Floats, Floats]:
        """For points (k, 2) [m] the nearest point of the outline (k, 2) and its distance (k,) [m]."""
        beyond = self._beyond(points)
        feet = points[:, None] - beyond[..., None] * self.normals
        along = np.abs(points @ (self.normals[:, ::-1] * [-1.0, 1.0]).T)
        half_side = self.apothem * math.tan(math.pi / len(self.corners))
        distance = np.where(along <= half_side, np.abs(beyond), np.inf)
        to_corners = np.linalg.norm(points[:, None] - self.corners, axis=2)
        distance = np.concatenate([distance, to_corners], axis=1)
        places = np.concatenate([feet, np.broadcast_to(self.corners, feet.shape)], axis=1)
        best, rows = distance.argmin(axis=1), np.arange(len(points))
        return places[rows, best], distance[rows, best]

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """(k,) whether points (k, 2) lie inside or on the outline."""
        return np.asarray(self._beyond(points).max(axis=1) <= 0.0)

    def crossing(self, inside: Floats, outside: Floats) -> Floats:
        """(k, 2) where the lines from points inside (k, 2) to points outside leave the outline [m]."""
        here, there = self._beyond(inside), self._beyond(outside)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(there > 0.0, here / (here - there), np.inf).min(axis=1)
        return inside + part[:, None] * (outside - inside)

    def _beyond(self, points: Floats) -> Floats:
        """(k, n) how far points lie beyond the line of each side [m]."""
        x, y = points[:, 0, None], points[:, 1, None]
        return x * self.normals[:, 0] + y * self.normals[:, 1] - self.apothem


@dataclass(frozen=True)
class Circle:
    """A circle, with strings at equally spaced corners.

    corners : (n, 2) [m], anticlockwise
    """

    radius: float
    corners: Floats

    def nearest(self, points: Floats) -> tuple[Floats, Floats]:
        """As of `Polygon`; the centre has no nearest point."""
        away = np.hypot(*points.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            return points * (self.radius / away)[:, None], np.abs(away - self.radius)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        return np.asarray(np.hypot(*points.T) <= self.radius)

    def crossing(self, inside: Floats, outside: Floats) -> Floats:
        way = outside - inside
        a, b = _dot(way, way), _dot(inside, way)
        c = _dot(inside, inside) - self.radius**2
        part = (np.sqrt(b * b - a * c) - b) / a
        return self.nearest(inside + part[:, None] * way)[0]


Outline = Polygon | Circle


def outline_of(shape: OutlineShape, size: float, corners: int | None) -> Outline:
    """The outline whose opposite sides are `size` [m] apart, or which has that diameter.

    corners : of a circle, from the x axis on
    """
    if shape == OutlineShape.CIRCLE:
        return Circle(0.5 * size, 0.5 * size * _directions(corners or 0, 0))
    number, first = _CORNERS[shape]
    apothem = 0.5 * size
    return Polygon(
        apothem,
        _directions(number, first, between=True),
        apothem / math.cos(math.pi / number) * _directions(number, first),
    )


def corner_count(shape: OutlineShape, corners: int | None) -> int:
    """How many corners an outline has."""
    return corners or 0 if shape == OutlineShape.CIRCLE else _CORNERS[shape][0]


def side_length(shape: OutlineShape, size: float, corners: int) -> float:
    """Distance between neighbouring corners [m]."""
    half = math.pi / corners
    return size * (math.sin(half) if shape == OutlineShape.CIRCLE else math.tan(half))


def _directions(number: int, first: int, *, between: bool = False) -> Floats:
    """(number, 2) unit vectors, equally spaced from `first` sixteenths of a turn on, or between these.

    Whole parts of a turn: directions that mirror each other have exactly mirrored components.
    """
    whole = 16 * number
    part = 16 * np.arange(number) + first * number + 8 * between
    return np.stack([_cosine(part, whole), _cosine(part - whole // 4, whole)], axis=1)


def _cosine(part: Ints, whole: int) -> Floats:
    """cos(2 pi part / whole) by an angle of at most an eighth of a turn; `whole` divides by 8."""
    off = part % whole
    off = np.minimum(off, whole - off)
    sign = np.where(off > whole // 4, -1.0, 1.0)
    off = np.minimum(off, whole // 2 - off)
    turn = 2 * np.pi / whole
    return sign * np.where(off > whole // 8, np.sin(turn * (whole // 4 - off)), np.cos(turn * off))


def _dot(a: Floats, b: Floats) -> Floats:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]


class MeshShape(StrEnum):
    """The shape of a lattice's meshes."""

    SQUARE = "square"
    TRIANGLE = "triangle"
    HEXAGON = "hexagon"


# x and y of a step of 1 in u and v, in mesh sides.
_SCALE = {
    MeshShape.SQUARE: (0.5, 0.5),
    MeshShape.TRIANGLE: (0.5, math.sqrt(3) / 2),
    MeshShape.HEXAGON: (math.sqrt(3) / 2, 0.5),
}
# Steps (u, v) to the knots that a knot is joined to, each side once; of hexagons from the knots of `_low`.
_STEPS = {
    MeshShape.SQUARE: ((2, 0), (0, 2)),
    MeshShape.TRIANGLE: ((2, 0), (1, 1), (-1, 1)),
    MeshShape.HEXAGON: ((1, 1), (-1, 1), (0, -2)),
}
# Sides for each square of one mesh side.
SIDES_PER_SQUARE = {
    MeshShape.SQUARE: 2.0,
    MeshShape.TRIANGLE: 2.0 * math.sqrt(3),
    MeshShape.HEXAGON: 2.0 / math.sqrt(3),
}


def scale(shape: MeshShape, mesh: float) -> Floats:
    """(2,) x and y of a step of 1 in u and v [m]; mesh : side of a mesh [m]."""
    return np.array(_SCALE[shape]) * mesh


def lattice(shape: MeshShape, mesh: float, reach: tuple[float, float], odd: bool) -> tuple[Floats, Ints]:
    """Knots (n, 2) [m], row by row from below, and sides (m, 2) with |x|, |y| up to `reach` [m] or beyond.

    A knot lies at the origin; of square meshes with `odd` the centre of a mesh, of hexagonal ones always.
    Triangular meshes have sides along x, hexagonal ones along y.
    """
    step = scale(shape, mesh)
    nu, nv = (math.ceil(far / one) + 2 for far, one in zip(reach, step.tolist(), strict=True))
    v, u = np.mgrid[-nv : nv + 1, -nu : nu + 1]
    if shape == MeshShape.SQUARE:
        knot = ((u - odd) % 2 == 0) & ((v - odd) % 2 == 0)
        first = knot
    elif shape == MeshShape.TRIANGLE:
        knot = (u - v) % 2 == 0
        first = knot
    else:
        # Cells are centred at (2 q + r, 3 r), with knots at (0, +-2) and (+-1, +-1) from there.
        row, within = np.divmod(v, 3)
        first = (within == 1) & ((u - row - 1) % 2 == 0)
        knot = first | ((within == 2) & ((u - row) % 2 == 0))
    number = np.where(knot, np.cumsum(knot).reshape(knot.shape) - 1, -1)
    sides = [_joined(number, first, steps) for steps in _STEPS[shape]]
    return np.stack([u[knot], v[knot]], axis=1) * step, np.concatenate(sides)


def lines(shape: MeshShape, mesh: float, reach: tuple[float, float], odd: bool) -> tuple[Floats, Floats]:
    """x, and y, of the lines through knots that no side of a lattice crosses, up to `reach` or beyond [m].

    Triangular meshes have none of the same x: their sides along x are crossed by all.
    """
    step = scale(shape, mesh)
    u, v = (
        np.arange(-n, n + 1) for n in (math.ceil(far / one) + 2 for far, one in zip(reach, step, strict=True))
    )
    if shape == MeshShape.SQUARE:
        u, v = u[(u - odd) % 2 == 0], v[(v - odd) % 2 == 0]
    elif shape == MeshShape.TRIANGLE:
        u = u[:0]
    else:
        v = v[v % 3 != 0]
    return u * step[0], v * step[1]


def _joined(number: Ints, first: np.ndarray, step: tuple[int, int]) -> Ints:
    """(m, 2) numbers of the knots `first` and of those a step (u, v) further, where there are some."""
    rows, columns = np.nonzero(first)
    to_row, to_column = rows + step[1], columns + step[0]
    height, width = number.shape
    inside = (to_row >= 0) & (to_row < height) & (to_column >= 0) & (to_column < width)
    ends = number[to_row[inside], to_column[inside]]
    pairs = np.stack([number[rows[inside], columns[inside]], ends], axis=1)
    return pairs[ends >= 0]


STUB = 0.25  # mesh sides; a knot as near to the outline as this is moved onto it
SHORTEST = STUB * math.sqrt(0.75)  # mesh sides; see `_cut`
LEAST_SIZE = 3.0  # mesh sides
_NEAR = 1e-9  # mesh sides; what two codes may disagree on counts as near

_Shape = Literal["square", "triangle", "hexagon"]
_Outline = Literal["square", "hexagon", "octagon", "circle"]


class CutNet(ThrownNetConfig):
    """Meshes cut to an outline, with a bullet at each of its corners."""

    topology: Literal["cut"] = Field(description="meshes cut to an outline, with a border")
    outline: _Outline = Field(description="shape of the net", examples=["hexagon"])
    size: Positive = Field(
        description="distance between opposite sides of the outline, or diameter of the circle [m]",
        examples=[5.0],
    )
    mesh_shape: _Shape = Field(description="shape of a mesh", examples=["triangle"])
    mesh: Positive = Field(description="side of a mesh [m]", examples=[0.5])
    corners: int | None = Field(
        None,
        ge=3,
        le=MAX_ELEMENTS,
        description="where strings are tied to a circle, equally spaced",
        examples=[8],
    )
    border: Cable = Field(description="the thread round the net")

    @property
    def n_sides(self) -> int:
        count = (
            SIDES_PER_SQUARE[MeshShape(self.mesh_shape)] * (self.size / self.mesh) * (self.size / self.mesh)
        )
        if count > 10 * MAX_ELEMENTS or self.n_corners > MAX_ELEMENTS:
            return round(min(count + self.n_corners, 1e18))  # too many, counted without construction
        if not self.n_corners or any(_unfit(self)):
            raise ValueError("no such net")
        return len(mesh(self).sides)

    @property
    def n_corners(self) -> int:
        return corner_count(OutlineShape(self.outline), self.corners)

    def faults(self) -> Iterator[Fault]:
        """Require the number of corners of a circle only, and meshes that are small enough."""
        circle = self.outline == OutlineShape.CIRCLE
        if circle and self.corners is None:
            yield Fault("corners", "missing: where strings are tied to a circle, equally spaced")
        elif not circle and self.corners is not None:
            number = corner_count(OutlineShape(self.outline), None)
            yield Fault("corners", f"is for circles; this outline is a {self.outline} and has {number}")
        yield from _unfit(self)
        yield from super().faults()


def _unfit(keys: CutNet) -> Iterator[Fault]:
    shape, corners = OutlineShape(keys.outline), keys.n_corners
    if not corners:
        return
    if keys.size < LEAST_SIZE * keys.mesh:
        words = f"must be at least {LEAST_SIZE:g} meshes of {keys.mesh:g} m, got {keys.size:g} m"
        yield Fault("size", words)
    elif keys.mesh > (side := side_length(shape, keys.size, corners)):
        words = f"must be at most the {side:.4g} m between neighbouring corners, got {keys.mesh:g} m"
        yield Fault("mesh", words)


def mesh(keys: CutNet) -> Mesh:
    """Inner knots row by row from below, then those of the border anticlockwise from its first corner."""
    return _cut(OutlineShape(keys.outline), MeshShape(keys.mesh_shape), keys.size, keys.mesh, keys.corners)


def fold_lines(keys: CutNet) -> tuple[Floats, Floats]:
    """x, and y, of the lattice's lines; where the cut moved knots, some may be crossed near the border."""
    reach = _reach(OutlineShape(keys.outline), keys.size)
    return lines(MeshShape(keys.mesh_shape), keys.mesh, reach, _odd(keys.size, keys.mesh))


def _reach(shape: OutlineShape, size: float) -> tuple[float, float]:
    """How far an outline goes along x and y [m]."""
    return (size / math.sqrt(3) if shape == OutlineShape.HEXAGON else 0.5 * size), 0.5 * size


def _odd(size: float, side: float) -> bool:
    """Whether an odd number of meshes fits best."""
    return math.floor(size / side + 0.5 + _NEAR) % 2 == 1


@lru_cache(maxsize=4)  # a case is counted when it is read, and made when it is prepared
def _cut(shape: OutlineShape, meshes: MeshShape, size: float, side: float, corners: int | None) -> Mesh:
    """A lattice cut to an outline.

    1. Knots within STUB sides of the outline are moved to its nearest point; the others inside are inner.
    2. Of the threads those remain that have an inner knot. One that ends outside ends where it crosses.
    3. Ends within STUB sides of a corner are moved to it; threads that then join the same knots are one.
    4. The border joins all that lies on the outline, in order, by straight sides.

    From an inner knot to the outline are more than STUB sides. Two crossings nearer to each other belong to
    threads that share a knot, off the outline by more than STUB sides each, at 60 degrees or more: they are
    SHORTEST apart. What crosses is at least sqrt(3)/2 - STUB from a knot that was moved, of which two are
    1 - 2 STUB apart.
    """
    outline = outline_of(shape, size, corners)
    stub = (STUB + _NEAR) * side
    points, threads = lattice(meshes, side, _reach(shape, size), _odd(size, side))
    nearest, distance = outline.nearest(points)
    near = distance <= stub
    inner = outline.contains(points) & ~near
    threads, places = _ends(points, threads, inner, near, nearest, outline)
    rim, ends = _rim(outline, places, stub)

    number = np.cumsum(inner) - 1
    count = int(inner.sum())
    second = np.where(ends >= 0, count + ends, number[threads[:, 1]])
    sides = np.stack([number[threads[:, 0]], second], axis=1)
    _, first = np.unique(np.sort(sides, axis=1), axis=0, return_index=True)
    around = count + np.arange(len(rim))
    border = np.stack([around, np.roll(around, -1)], axis=1)
    knots = np.concatenate([points[inner], rim])
    all_sides = np.concatenate([sides[np.sort(first)], border])
    at_corners = count + np.flatnonzero((rim[:, None] == outline.corners).all(axis=2).any(axis=1))
    found = Mesh(
        knots=np.concatenate([knots, np.zeros((len(knots), 1))], axis=1),
        sides=all_sides,
        anchors=at_corners[:, None],
        faces=openings(knots, all_sides),
        mouth=at_corners,
        n_border=len(border),
    )
    for array in (found.knots, found.sides, found.anchors, found.mouth):
        array.flags.writeable = False
    return found


def _ends(
    points: Floats,
    threads: Ints,
    inner: np.ndarray,
    near: np.ndarray,
    nearest: Floats,
    outline: Outline,
) -> tuple[Ints, Floats]:
    """The threads that remain, from an inner knot on, and where on the outline they end.

    Returns knots (m, 2) of the threads and places (m, 2) [m], which are NaN where both knots are inner.
    """
    kept = threads[inner[threads].any(axis=1)]
    kept = np.where(inner[kept[:, :1]], kept, kept[:, ::-1])
    last = kept[:, 1]
    places = np.full((len(kept), 2), np.nan)
    places[near[last]] = nearest[last[near[last]]]
    out = ~inner[last] & ~near[last]
    places[out] = outline.crossing(points[kept[out, 0]], points[last[out]])
    return kept, places


def _rim(outline: Outline, places: Floats, stub: float) -> tuple[Floats, Ints]:
    """The knots (n, 2) of the border, and which of them (m,) each place is; -1: none, it is NaN."""
    corners = outline.corners
    there = np.flatnonzero(~np.isnan(places[:, 0]))
    ends = places[there] + 0.0  # no zeros of two signs
    apart = np.linalg.norm(ends[:, None] - corners, axis=2)
    to_corner = apart.min(axis=1, initial=math.inf) <= stub
    ends[to_corner] = corners[apart[to_corner].argmin(axis=1)]
    knots, which = np.unique(np.concatenate([corners, ends]), axis=0, return_inverse=True)
    angle = np.arctan2(knots[:, 1], knots[:, 0])
    first = np.arctan2(corners[0, 1], corners[0, 0])
    order = np.argsort(np.where(angle < first, angle + 2 * np.pi, angle))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    found = np.full(len(places), -1)
    found[there] = place[which.ravel()[len(corners) :]]
    return knots[order], found
