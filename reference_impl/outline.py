"""Outlines that nets are cut to, round the origin in the plane z = 0: regular polygons and circles.

Each is asked for the nearest of its points, which points it encloses, and where a segment leaves it.  A
polygon is the intersection of half-planes n.p <= h; a foot on one of its sides is h n + c t with the tangent
t and c held within half a side.  Terms are added in pairs only, x and y, so that mirrored points have
mirrored answers to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Bools, Floats


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
