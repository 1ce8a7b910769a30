"""Solids of uniform density: weighted points with the same volume, centroid and second moments.

A rounded box is all points within rho of a smaller box, its core, whose faces lie rho deeper; a ball is one
whose core has no size.  So both are cores with three half-widths, of which some may be zero.

Each solid is cut into slices across its z axis.  A slice, rectangle or disc, stands as four points that have
its area and its moments up to degree 3 (Abramowitz & Stegun, 25.4.61 and 25.4.62); three slices by Gauss and
Legendre's rule, exact up to degree 5 in z, are a segment.  What is summed is of degree 4: a half-width is
linear in z, or its square quadratic.  So mass properties are sums over points, without a formula for any
solid; points of several solids are one solid, and no weight of theirs is negative, so that no moment is lost
to cancellation (in a `surface` some are).

Each triangle and one point inside make a tetrahedron, whose volume has a sign: the union is what the surface
encloses, holes left out.  A tetrahedron stands as four points that have its volume and its moments up to
degree two: a quarter of the volume at each b of the way to a corner, a of it, from the centroid (Hammer &
Stroud, Math. Tables Aids Comput. 10 (1956), doi:10.1090/S0025-5718-1956-0086390-2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from reference_impl.arrays import Floats, Ints, skew


@dataclass(frozen=True, eq=False)
class Block:
    """A solid of a body by its kind; of boxes and spheres half the widths (3,) [m] along its own axes."""

    kind: str
    half: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))  # columns, in the body's frame
    centre: Floats = field(default_factory=lambda: np.zeros(3))  # [m] in the body's frame

    def moved(self, attitude: Floats, position: Floats) -> Block:
        """Turned by a rotation (3, 3), then shifted by (3,) [m]."""
        return replace(self, axes=attitude @ self.axes, centre=attitude @ self.centre + position)

    def rounding(self, edge_radius: float) -> float:
        """rho [m], that of a body's `edge_radius` [m]."""
        return float(self.half[0]) if self.kind == "sphere" else edge_radius


_SIGNS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
_SQUARE = _SIGNS / np.sqrt(3.0), 1.0  # of [-1, 1]^2: points (4, 2), weight of each
_DISC = _SIGNS / 2.0, np.pi / 4.0  # of the unit disc

Section = tuple[Floats, float]


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid as q points (SI units)."""

    place: Floats  # (q, 3) [m]
    volume: Floats  # (q,) [m3] that each point stands for
    blocks: tuple[Block, ...]  # its surface

    def moved(self, attitude: Floats, position: Floats) -> Solid:
        """Turned by a rotation (3, 3), then shifted by (3,) [m]."""
        blocks = tuple(block.moved(attitude, position) for block in self.blocks)
        return replace(self, place=self.place @ attitude.T + position, blocks=blocks)


def union(solids: list[Solid]) -> Solid:
    """Solids beside each other; what they share counts once for each."""
    return Solid(
        np.concatenate([solid.place for solid in solids]),
        np.concatenate([solid.volume for solid in solids]),
        tuple(block for solid in solids for block in solid.blocks),
    )


def moments(solid: Solid) -> tuple[float, Floats, Floats]:
    """Volume [m3], centroid (3,) [m], matrix of inertia about it (3, 3) over the mass [m2]."""
    volume = float(_total(solid.volume))
    part = (solid.volume / volume)[:, None]
    centroid = _total(part * solid.place)
    arm = skew(solid.place - centroid)
    return volume, centroid, _total(part[..., None] * (np.swapaxes(arm, 1, 2) @ arm))


def _total(terms: Floats) -> Floats:
    """Sums (...) of terms (q, ...), rounded once: what a symmetry makes zero is zero."""
    sums = [math.fsum(column) for column in terms.reshape(len(terms), -1).T.tolist()]
    return np.array(sums).reshape(terms.shape[1:])


def box(size: tuple[float, ...]) -> Solid:
    """Edges along x, y, z (3,) [m]."""
    x, y, z = size
    half = np.array([x / 2.0, y / 2.0])
    points = _segment(_SQUARE, -z / 2.0, z / 2.0, lambda z: np.broadcast_to(half, (len(z), 2)))
    return Solid(*points, (Block("box", 0.5 * np.array(size)),))


def cylinder(radius: float, length: float) -> Solid:
    """Along z [m]."""
    return replace(frustum((radius, radius), length), blocks=(Block("cylinder"),))


def sphere(radius: float) -> Solid:
    """Of a radius [m]."""
    points = _segment(_DISC, -radius, radius, _ball(radius, 0.0))
    return Solid(*points, (Block("sphere", np.full(3, radius)),))


def capsule(radius: float, length: float) -> Solid:
    """A cylinder along z of this length [m] between two half-spheres."""
    top = length / 2.0
    middle = cylinder(radius, length)
    pieces = (
        _segment(_DISC, -top - radius, -top, _ball(radius, -top)),
        (middle.place, middle.volume),
        _segment(_DISC, top, top + radius, _ball(radius, top)),
    )
    places, volumes = zip(*pieces, strict=True)
    return Solid(np.concatenate(places), np.concatenate(volumes), (Block("capsule"),))


def frustum(radii: tuple[float, ...], length: float) -> Solid:
    """Along z [m], radii (2,) [m] at its lower and upper end."""
    ends = (-length / 2.0, length / 2.0)
    return Solid(*_segment(_DISC, *ends, lambda z: _round(np.interp(z, ends, radii))), (Block("frustum"),))


def _segment(
    section: Section, bottom: float, top: float, half_widths: Callable[[Floats], Floats]
) -> tuple[Floats, Floats]:
    """Points (12, 3) [m], volumes (12,) [m3]; `half_widths` (k, 2) [m] along x and y are at heights (k,)."""
    corner, weight = section
    node, part = np.polynomial.legendre.leggauss(3)
    height = 0.5 * (bottom + top) + 0.5 * (top - bottom) * node
    half = half_widths(height)
    flat = half[:, None, :] * corner
    place = np.concatenate((flat, np.broadcast_to(height[:, None, None], (3, 4, 1))), axis=2)
    volume = 0.5 * (top - bottom) * part * weight * half[:, 0] * half[:, 1]
    return place.reshape(-1, 3), np.repeat(volume, 4)


def _ball(radius: float, middle: float) -> Callable[[Floats], Floats]:
    """Half-widths of a ball whose centre is at the height `middle`."""
    return lambda z: _round(np.sqrt((radius - (z - middle)) * (radius + (z - middle))))


def _round(radius: Floats) -> Floats:
    return np.stack((radius, radius), axis=-1)


_TOWARDS = 1.0 / math.sqrt(5.0)  # part of the way from the centroid to a corner


def enclosed(corner: Floats) -> Solid:
    """The solid inside triangles with corners (f, 3, 3) [m]; ValueError if they are no closed surface."""
    points, number = np.unique(corner.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    faces = number.reshape(-1, 3).astype(np.intp)
    flat = np.any(faces == np.roll(faces, 1, axis=1), axis=1)
    faces = faces[~flat]
    _check_closed(faces)
    apex = 0.5 * (points.min(axis=0) + points.max(axis=0))
    ends = np.concatenate((points[faces] - apex, np.zeros((len(faces), 1, 3))), axis=1)
    volume = np.linalg.det(ends[:, :3]) / 6.0
    total = math.fsum(volume.tolist())
    size = float(np.prod(np.ptp(points, axis=0)))
    if not abs(total) > 1e-12 * size:
        raise ValueError("its surface encloses no volume")
    middle = ends.mean(axis=1, keepdims=True)
    place = apex + middle + _TOWARDS * (ends - middle)
    weight = np.repeat(math.copysign(0.25, total) * volume, 4)
    return Solid(place.reshape(-1, 3), weight, (Block("mesh"),))


def _check_closed(faces: Ints) -> None:
    """Every side must be one of as many triangles in the one direction as in the other."""
    if not len(faces):
        raise ValueError("no triangles that have an area")
    sides = np.stack((faces, np.roll(faces, -1, axis=1)), axis=2).reshape(-1, 2)
    low, high = sides.min(axis=1), sides.max(axis=1)
    _, side = np.unique(np.column_stack((low, high)), axis=0, return_inverse=True)
    side = side.ravel()
    times = np.bincount(side)
    if np.any(times % 2):
        raise ValueError(
            f"its surface must be closed: {np.count_nonzero(times % 2)} sides of triangles are free"
        )
    if np.any(np.bincount(side, np.where(sides[:, 0] == low, 1.0, -1.0))):
        raise ValueError("its triangles must all turn the same way round, seen from outside")
