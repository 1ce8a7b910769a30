"""Shapes as the arrays that results store."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WIDTH = 11  # of a solid: its number in SOLIDS, its numbers, its position, its attitude


def packed(shape: Shape | None, centre: Floats) -> dict[str, Any]:
    """A shape from the centre of mass (3,) [m], in the axes of the body's frame; nothing of no shape.

    solids              : (k, 11) number of the kind in `SOLIDS`, numbers as of `Solid` [m], position of its
                          origin [m], and unit quaternion (w, x, y, z)
    vertices, triangles : (n, 3) [m] and (m, 3) of a mesh
    """
    if shape is None:
        return {}
    if shape.mesh is not None:
        return {"vertices": shape.mesh.vertices - centre, "triangles": shape.mesh.triangles}
    rows = [
        (SOLIDS.index(solid.kind), *solid.numbers, *(solid.position - centre), *solid.attitude)
        for solid in shape.solids
    ]
    return {"solids": np.array(rows, dtype=float)}


def from_centre(shape: Shape, centre: Floats) -> Shape:
    """A shape from the centre of mass (3,) [m], as results have it."""
    found = packed(shape, centre)
    moved = unpacked(found.get("solids"), found.get("vertices"), found.get("triangles"))
    assert moved is not None
    return moved


def unpacked(solids: Floats | None, vertices: Floats | None, triangles: Ints | None) -> Shape | None:
    """The shape of what `packed` gave. Raises ValueError for other arrays."""
    if vertices is not None and triangles is not None:
        if not len(triangles) or triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ValueError("triangles of a mesh that has not these vertices")
        return Shape(mesh=TriangleMesh(vertices, triangles))
    if solids is None:
        return None
    if solids.shape[1:] != (WIDTH,) or not np.isin(solids[:, 0], np.arange(len(SOLIDS))).all():
        raise ValueError("unknown kind of solid")
    rows = solids.tolist()
    return Shape(
        tuple(
            Solid(SOLIDS[int(kind)], (a, b, c), (x, y, z), (p, q, r, s))
            for kind, a, b, c, x, y, z, p, q, r, s in rows
        )
    )
