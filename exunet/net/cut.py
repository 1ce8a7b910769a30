"""The cut topology: square, triangular or hexagonal meshes, cut to an outline along which a border runs.

A cut leaves stubs. What is nearer than STUB mesh sides to the outline, or to a corner of it, is moved there,
so that no side is shorter than SHORTEST mesh sides; see `_cut`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.base.table import Positive
from exunet.net.arrays import Floats, Ints, Mesh
from exunet.net.base import MAX_ELEMENTS, Cable, ThrownNetTable
from exunet.net.lattice import SIDES_PER_SQUARE, MeshShape, lattice, lines
from exunet.net.loops import openings
from exunet.net.outline import Outline, OutlineShape, corner_count, outline_of, side_length

STUB = 0.25  # mesh sides; a knot as near to the outline as this is moved onto it
SHORTEST = STUB * math.sqrt(0.75)  # mesh sides; see `_cut`
LEAST_SIZE = 3.0  # mesh sides
_NEAR = 1e-9  # mesh sides; what two codes may disagree on counts as near

_Shape = Literal["square", "triangle", "hexagon"]
_Outline = Literal["square", "hexagon", "octagon", "circle"]
_ON_CIRCLES: dict[str, Any] = {"properties": {"outline": {"const": OutlineShape.CIRCLE.value}}}


class Keys(ThrownNetTable):
    """Meshes cut to an outline, with a bullet at each of its corners."""

    model_config = ConfigDict(
        json_schema_extra={
            "if": _ON_CIRCLES,
            "then": {"required": ["corners"]},
            "else": {"properties": {"corners": False}},
        }
    )

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
            return round(min(count + self.n_corners, 1e18))  # too many, which need not be made to be told
        if not self.n_corners or any(_unfit(self)):
            raise ValueError("no such net")
        return len(mesh(self).sides)

    @property
    def n_corners(self) -> int:
        return corner_count(OutlineShape(self.outline), self.corners)


def cross_checks(keys: Keys) -> Iterator[Fault]:
    """Circles, and only they, say how many corners they have; meshes are small enough for the outline."""
    yield from each(_corners_of_circles(keys), _unfit(keys))


def _corners_of_circles(keys: Keys) -> Iterator[Fault]:
    circle = keys.outline == OutlineShape.CIRCLE
    if circle and not keys.is_given("corners"):
        yield Fault("corners", "missing: where strings are tied to a circle, equally spaced")
    elif not circle and keys.is_given("corners"):
        number = corner_count(OutlineShape(keys.outline), None)
        yield Fault("corners", f"is for circles; this outline is a {keys.outline} and has {number}")


def _unfit(keys: Keys) -> Iterator[Fault]:
    shape, corners = OutlineShape(keys.outline), keys.n_corners
    if not corners:
        return
    if keys.size < LEAST_SIZE * keys.mesh:
        words = f"must be at least {LEAST_SIZE:g} meshes of {keys.mesh:g} m, got {keys.size:g} m"
        yield Fault("size", words)
    elif keys.mesh > (side := side_length(shape, keys.size, corners)):
        words = f"must be at most the {side:.4g} m between neighbouring corners, got {keys.mesh:g} m"
        yield Fault("mesh", words)


def mesh(keys: Keys) -> Mesh:
    """Inner knots row by row from below, then those of the border anticlockwise from its first corner."""
    return _cut(OutlineShape(keys.outline), MeshShape(keys.mesh_shape), keys.size, keys.mesh, keys.corners)


def fold_lines(keys: Keys) -> tuple[Floats, Floats]:
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
