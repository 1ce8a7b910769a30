"""Lines that show a shape: edges of boxes, circles and generators of round solids, sharp edges of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh, Vector

Floats = NDArray[np.float64]

AROUND = 24  # pieces of a circle
SHARP = np.cos(np.radians(20.0))  # neighbouring triangles of a mesh whose normals differ by more show an edge


def wireframe(shape: Shape) -> Floats:
    """(k, 2, 3) ends of straight lines [m], in the body's frame; k may be 0."""
    pieces = [_of_solid(solid) @ solid.rotation.T + solid.position for solid in shape.solids]
    if shape.mesh is not None:
        pieces.append(_of_mesh(shape.mesh))
    return np.concatenate(pieces) if pieces else np.zeros((0, 2, 3))


def _of_solid(solid: Solid) -> Floats:
    a, b, c = solid.numbers
    if solid.kind == "box":
        return _box(solid.numbers)
    if solid.kind == "cylinder":
        return _rings([(a, -0.5 * b), (a, 0.5 * b)])
    if solid.kind == "frustum":
        return _rings([(a, -0.5 * c), (b, 0.5 * c)])
    half = 0.5 * b  # of the length of a capsule; a sphere has none
    angles = np.linspace(0.0, np.pi, AROUND // 2 + 1)
    arc = np.stack([a * np.sin(angles), a * np.cos(angles)], axis=1)  # across and along, from pole to pole
    shift = np.array([0.0, half])
    top, bottom = arc[: AROUND // 4 + 1] + shift, arc[AROUND // 4 :] - shift
    return _rings([(a, -half), (a, half)] if half else [(a, 0.0)], np.concatenate([top, bottom]))


def _box(edges: Vector) -> Floats:
    found = []
    for along in range(3):
        for item in (-0.5, 0.5):
            for other in (-0.5, 0.5):
                ends = np.empty((2, 3))
                ends[:, along] = -0.5, 0.5
                ends[:, (along + 1) % 3], ends[:, (along + 2) % 3] = item, other
                found.append(ends * edges)
    return np.array(found)


def _rings(rings: list[tuple[float, float]], profile: Floats | None = None) -> Floats:
    """Circles of radii at heights about z, and four lines of a profile (n, 2), across and along, about it.

    profile : None: the straight one from ring to ring
    """
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    across = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    lines = [radius * across + [0.0, 0.0, height] for radius, height in rings if radius > 0.0]
    profile = np.array(rings) if profile is None else profile
    along = profile[:, 1:] * np.array([0.0, 0.0, 1.0])
    lines += [profile[:, :1] * direction + along for direction in across[: AROUND : AROUND // 4]]
    return np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])


def _of_mesh(mesh: TriangleMesh) -> Floats:
    """Edges between triangles that are not nearly in one plane."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0.0)
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    owner = np.repeat(np.arange(len(corners)), 3)
    order = np.lexsort(edges.T)  # a closed surface has each edge twice
    one, other = owner[order].reshape(-1, 2).T
    alike = np.einsum("ea,ea->e", normal[one], normal[other])
    return mesh.vertices[edges[order][::2][alike < SHARP]]


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
