"""Convex outlines round the origin, to which a net is cut: regular polygons and the circle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from exunet.net.arrays import Floats, Ints


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
