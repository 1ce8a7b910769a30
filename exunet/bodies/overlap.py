"""Whether two bodies overlap: the distance of convex solids, by their support functions."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import rotation_matrix
from exunet.bodies.shapes import Shape, Solid

Floats = NDArray[np.float64]
Support = Callable[[Floats], Floats]

_SHRUNK = 1.0 - 1e-9  # so that bodies which touch do not overlap
_NEAR = 1e-12  # of the size, below which a distance is none
_TURNS = 200


def overlap(one: Shape, pose_of_one: Floats, other: Shape, pose_of_other: Floats) -> bool:
    """True if two shapes surely share points; poses (7,): place of the frame [m] and attitude (w, x, y, z).

    Of solids it is exact, and bodies that touch do not overlap. Of a mesh and a solid it is True if a vertex
    is inside the solid. Two meshes are not looked at.
    """
    if one.mesh is not None or other.mesh is not None:
        pairs = ((one, pose_of_one, other, pose_of_other), (other, pose_of_other, one, pose_of_one))
        return any(_has_vertex_in(*pair) for pair in pairs)
    return any(
        _distance(a, b) == 0.0 for a in _supports(one, pose_of_one) for b in _supports(other, pose_of_other)
    )


def _has_vertex_in(one: Shape, pose_of_one: Floats, other: Shape, pose_of_other: Floats) -> bool:
    if one.mesh is None:
        return False
    turn, turn_of_other = rotation_matrix(pose_of_one[3:]), rotation_matrix(pose_of_other[3:])
    points = (one.mesh.vertices @ turn.T + pose_of_one[:3] - pose_of_other[:3]) @ turn_of_other
    return any(solid.contains(points).any() for solid in other.solids)


def _supports(shape: Shape, pose: Floats) -> list[Support]:
    """Of each solid, placed in the scene."""
    turn, place = rotation_matrix(pose[3:]), pose[:3]

    def of_solid(solid: Solid) -> Support:
        middle = turn @ solid.position + place
        return lambda way: middle + _SHRUNK * (turn @ solid.farthest(way @ turn) + place - middle)

    return [of_solid(solid) for solid in shape.solids]


def _distance(one: Support, other: Support) -> float:
    """Of two convex sets [m], 0 if they overlap, else a lower bound or the distance.

    Gilbert, Johnson and Keerthi, IEEE J. Robot. Autom. 4 (1988) 193, doi 10.1109/56.2083: the point of the
    difference of the sets that is nearest to the origin, from simplexes of points of its surface.
    """

    def difference(way: Floats) -> Floats:
        return one(way) - other(-way)

    points = [difference(np.array([1.0, 0.0, 0.0]))]
    nearest = points[0]
    for _ in range(_TURNS):
        size = max(float(np.linalg.norm(point)) for point in points)
        length = float(np.linalg.norm(nearest))
        if length <= _NEAR * size:
            return 0.0
        new = difference(-nearest)
        if nearest @ new > 0.0:
            return float(nearest @ new) / length  # a plane is between them
        nearest, points = _nearest([*points, new])
    return length  # round surfaces that nearly touch


def _nearest(points: list[Floats]) -> tuple[Floats, list[Floats]]:
    """The point of the hull of up to five points nearest to the origin, and the fewest points it needs."""
    best: tuple[float, Floats, list[Floats]] | None = None
    for count in range(1, min(4, len(points)) + 1):
        for some in combinations(points, count):
            if (weights := _weights(some)) is None:
                continue
            point = weights @ np.array(some)
            square = float(point @ point)
            if best is None or square < best[0] * (1.0 - 1e-14):
                best = square, point, list(some)
    assert best is not None  # a single point has weights
    return best[1], best[2]


def _weights(points: tuple[Floats, ...]) -> Floats | None:
    """Of the point of their affine hull nearest to the origin; None if it is outside of their hull."""
    if len(points) == 1:
        return np.ones(1)
    edges = np.array(points[1:]) - points[0]
    found, _, rank, _ = np.linalg.lstsq(edges.T, -points[0], rcond=1e-14)
    weights = np.concatenate([[1.0 - found.sum()], found])
    return weights if rank == len(edges) and (weights >= 0.0).all() else None
