"""Threads in or through a body: which straight segments have points inside its shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import part_of, parts_of
from exunet.bodies.shapes import Shape, Solid, TriangleMesh

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TOUCH = 1e-6  # of a solid's least dimension: what is no deeper inside touches
_SECTIONS = 45  # that bring a length down to 1e-9 of itself
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_PRODUCTS = 1 << 20  # of segments and triangles that are looked at in one go


def reach_of(shape: Shape) -> float:
    """Radius of a sphere about the origin of the frame that has all of a shape in it [m]."""
    return max(float(np.linalg.norm(part.middle)) + part.reach for part in parts_of(shape))


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
