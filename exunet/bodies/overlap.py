"""Whether two bodies overlap."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import distances
from exunet.bodies.rigid import rotation_matrix
from exunet.bodies.shapes import Shape
from exunet.bodies.surfaces import share_points, surfaces_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SHRUNK = 1.0 - 1e-9  # so that bodies which touch do not overlap


def overlap(one: Shape, poses_of_one: Floats, other: Shape, poses_of_other: Floats) -> Bools:
    """(n,) True where two shapes surely share points, at poses (n, 7): place of the frame [m] and attitude.

    Bodies that touch do not overlap. It is exact but for a mesh and a round solid: that overlaps if it has a
    vertex inside, or shares points with a polyhedron inside the solid.
    """
    found = distances(one, poses_of_one, other, poses_of_other, _SHRUNK) == 0.0
    if one.mesh is None and other.mesh is None:
        return found
    rows = np.flatnonzero(found)  # where not even the hull of a mesh meets the other, it does not
    poses = np.concatenate([poses_of_one[rows], poses_of_other[rows]], axis=1)
    different, which = np.unique(poses, axis=0, return_inverse=True)  # bodies that rest have one
    answers = [_share_points(one, pair[:7], other, pair[7:]) for pair in different]
    found[rows] = np.array(answers, dtype=bool)[which.reshape(-1)]
    return found


def _share_points(one: Shape, pose_of_one: Floats, other: Shape, pose_of_other: Floats) -> bool:
    """Whether two shapes do, of which one is a mesh or both are, at poses (7,)."""
    turn_of_one = rotation_matrix(pose_of_one[3:])
    turn = turn_of_one.T @ rotation_matrix(pose_of_other[3:])
    shift = (pose_of_other[:3] - pose_of_one[:3]) @ turn_of_one
    return _has_vertex_in(one, other, turn, shift) or any(
        share_points(p, q, turn, shift) for p, q in product(surfaces_of(one), surfaces_of(other))
    )


def _has_vertex_in(one: Shape, other: Shape, turn: Floats, shift: Floats) -> bool:
    """True if a vertex of the mesh of one is in a solid of the other; turn, shift: from `other` to `one`."""
    points = np.zeros((0, 3)) if one.mesh is None else (one.mesh.vertices - shift) @ turn
    back = np.zeros((0, 3)) if other.mesh is None else other.mesh.vertices @ turn.T + shift
    return any(solid.contains(points).any() for solid in other.solids) or any(
        solid.contains(back).any() for solid in one.solids
    )
