"""Whether two bodies overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import distances
from exunet.bodies.rigid import rotation_matrix
from exunet.bodies.shapes import Shape

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SHRUNK = 1.0 - 1e-9  # so that bodies which touch do not overlap


def overlap(one: Shape, poses_of_one: Floats, other: Shape, poses_of_other: Floats) -> Bools:
    """(n,) True where two shapes surely share points, at poses (n, 7): place of the frame [m] and attitude.

    Of solids it is exact, and bodies that touch do not overlap. Of a mesh and a solid it is True if a vertex
    is inside the solid. Two meshes are not looked at.
    """
    found = distances(one, poses_of_one, other, poses_of_other, _SHRUNK) == 0.0
    if one.mesh is None and other.mesh is None:
        return found
    if one.mesh is not None and other.mesh is not None:
        return np.zeros(len(found), dtype=bool)
    pair = (one, poses_of_one, other, poses_of_other)
    mesh, poses, solids, poses_of_solids = pair if one.mesh is not None else (*pair[2:], *pair[:2])
    for row in np.flatnonzero(found):  # where not even the hull of the mesh meets the solids, it does not
        found[row] = _has_vertex_in(mesh, poses[row], solids, poses_of_solids[row])
    return found


def _has_vertex_in(mesh: Shape, pose: Floats, solids: Shape, pose_of_solids: Floats) -> bool:
    assert mesh.mesh is not None
    turn, turn_of_solids = rotation_matrix(pose[3:]), rotation_matrix(pose_of_solids[3:])
    points = (mesh.mesh.vertices @ turn.T + pose[:3] - pose_of_solids[:3]) @ turn_of_solids
    return any(solid.contains(points).any() for solid in solids.solids)
