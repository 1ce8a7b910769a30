"""Solids inside closed surfaces of triangles, as weighted points like all `solids`.

Each triangle and one point inside make a tetrahedron, whose volume has a sign: the union is what the surface
encloses, holes left out.  A tetrahedron stands as four points that have its volume and its moments up to
degree two: a quarter of the volume at each b of the way to a corner, a of it, from the centroid (Hammer &
Stroud, Math. Tables Aids Comput. 10 (1956), doi:10.1090/S0025-5718-1956-0086390-2).
"""

from __future__ import annotations

import math

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.blocks import Block
from reference_impl.solids import Solid

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
    return Solid(place.reshape(-1, 3), weight, float(np.min(np.ptp(points, axis=0))), (Block("mesh"),))


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
