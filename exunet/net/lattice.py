"""Endless lattices of threads round the origin: square, triangular or hexagonal meshes.

Knots have whole coordinates (u, v), so that those that mirror each other have exactly mirrored positions.
"""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from exunet.net.arrays import Floats, Ints


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
