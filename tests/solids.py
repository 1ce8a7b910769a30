"""Solids, meshes and touched surfaces for tests, and their distances by a second route."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exunet.bodies.rigid import RigidBody
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape, Solid, TriangleMesh
from exunet.bodies.touched import surface_of
from exunet.forces.contact.law import Law
from exunet.forces.contact.thread_contact import gauss_rules
from exunet.forces.cores import Surface

Floats = np.ndarray
SOLID_NUMBERS: dict[str, tuple[float, float, float]] = {
    "box": (1.0, 2.0, 3.0),
    "sphere": (0.7, 0.0, 0.0),
    "capsule": (0.3, 1.5, 0.0),
    "cylinder": (0.5, 2.0, 0.0),
    "frustum": (0.6, 0.2, 1.0),
}
EDGE = 0.08  # edge radius of touched solids [m]
TOUCHED = {
    "box": Solid("box", (0.6, 1.0, 0.4)),
    "cylinder": Solid("cylinder", (0.4, 1.0, 0.0)),
    "sphere": Solid("sphere", (0.5, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.3, 0.9, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.3, 0.8)),
    "widening frustum": Solid("frustum", (0.2, 0.6, 0.7)),
    "cone": Solid("frustum", (0.5, 0.0, 0.9)),  # its core ends in a tip
    "cone upside down": Solid("frustum", (0.0, 0.5, 0.4)),
}
TWO_BOXES = "two boxes side by side"
COMPOUNDS = {
    TWO_BOXES: tuple(Solid("box", (0.6, 1.0, 0.4), (x, 0.0, 0.0)) for x in (-0.3, 0.3)),
    "box and lying cylinder": (
        Solid("box", (0.6, 1.0, 0.4)),
        Solid("cylinder", (0.3, 0.8, 0.0), (0.2, 0.1, 0.25), (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)),
    ),
    "sphere and cone": (
        Solid("sphere", (0.4, 0.0, 0.0), (0.1, 0.0, -0.3)),
        Solid("frustum", (0.5, 0.1, 0.8), (0.0, 0.1, 0.1), (0.8, 0.0, 0.6, 0.0)),
    ),
}
SHAPES = {name: (solid,) for name, solid in TOUCHED.items()} | COMPOUNDS
# An L with legs 0.2 m wide and 0.5 m long, anticlockwise from its inner corner.
OUTLINE = [(-0.05, -0.05), (-0.05, 0.25), (-0.25, 0.25), (-0.25, -0.25), (0.25, -0.25), (0.25, -0.05)]


def extruded(outline: list[tuple[float, float]], half: float) -> TriangleMesh:
    """A prism of an outline whose first corner sees all others; z = -half ... half [m]."""
    n = len(outline)
    vertices = np.array([(x, y, z) for z in (-half, half) for x, y in outline])
    found = [(n, n + k, n + k + 1) for k in range(1, n - 1)] + [(0, k + 1, k) for k in range(1, n - 1)]
    for k in range(n):
        m = (k + 1) % n
        found += [(k, m, n + m), (k, n + m, n + k)]
    return TriangleMesh(vertices, np.array(found))


def mesh_keys(mesh: TriangleMesh, folder: Path, name: str) -> dict[str, str]:
    """Write a mesh into a file in a folder: the keys of a body that name it."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(folder / f"{name}.stl")
    return {"shape": "mesh", "file": f"{name}.stl", "unit": "m"}


def body_of(solids: tuple[Solid, ...], edge: float = EDGE) -> RigidBody:
    """A body whose centre of mass and principal axes are not those of its frame."""
    shape = Shape(solids, edge_radius=edge)
    return RigidBody("b", 2.0, (1.0, 2.0, 2.5), (0.05, -0.02, 0.1), (0.8, 0.0, 0.6, 0.0), shape)


@lru_cache
def surface(solids: tuple[Solid, ...], edge: float = EDGE) -> Surface:
    """The touched surface of `body_of`."""
    found = surface_of(body_of(solids, edge))
    assert found is not None
    return found


def contact_of(
    touched: Surface, stiffness: float = 3.0, damping: float = 0.0, thick: float = 0.01, pieces: int = 1
) -> Any:
    """The part of a `ThreadContact` that the loops over one thread, number 0, read."""
    number = len(touched.cores.kind)
    work = SimpleNamespace(
        lines=np.zeros((number, 6)), spans=np.zeros((number, 2)), splits=np.zeros(max(16 * number, pieces)),
        found=np.zeros((pieces, 8)), sums=np.zeros(12), rule=gauss_rules(2, 4, 8),
    )  # fmt: skip
    threads = SimpleNamespace(thick=np.array([thick]), pieces=np.array([pieces]))
    law = Law(stiffness, damping, 1.0, 0.0, 0.0)
    return SimpleNamespace(cores=touched.cores, threads=threads, law=law, work=work)


def in_solid(solid: Solid, points: Floats) -> Floats:
    """Points (..., 3) in the principal axes of `body_of`, in the solid's own axes."""
    body = body_of((solid,))
    in_frame = points @ body.rotation.T + body.centre
    return (in_frame - solid.position) @ rotation_matrix(np.array(solid.attitude))


def to_principal(solid: Solid, vectors: Floats) -> Floats:
    """Vectors (..., 3) in the solid's axes, in the principal axes of `body_of`."""
    turn = rotation_matrix(np.array(solid.attitude))
    return np.asarray(vectors @ turn.T @ body_of((solid,)).rotation)


def in_principal(*point: float) -> Floats:
    """A point in the frame of `body_of`, in its principal axes."""
    return np.asarray(body_of(()).in_principal_axes(np.array(point)))


def rounding_of(solid: Solid, edge: float) -> float:
    """Distance [m] of the surface from the core."""
    return solid.numbers[0] if solid.kind in ("sphere", "capsule") else edge


def half_planes(solid: Solid, edge: float) -> tuple[Floats, Floats]:
    """G, h: the core of a solid of revolution is where G (r, z) <= h, with r from its axis.

    The faces of a cylinder or frustum, moved inwards by the edge radius.
    """
    a, b, c = solid.numbers
    ends = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    if solid.kind in ("sphere", "capsule"):
        return ends, np.array([0.0, 0.5 * b, 0.5 * b])
    if solid.kind == "cylinder":
        a, b, c = a, a, b
    ends[0] = np.array([c, a - b]) / np.hypot(c, a - b)
    return ends, np.array([ends[0] @ [a, -0.5 * c], 0.5 * c, 0.5 * c]) - edge


def from_core(solid: Solid, edge: float, points: Floats) -> tuple[Floats, Floats]:
    """(n,) distances of points (n, 3) from the core, 0 within, and directions (n, 3), in the solid's axes.

    From the outline in the plane through the axis, segment by segment; of a box by clipping.
    """
    if solid.kind == "box":
        limit = 0.5 * np.array(solid.numbers) - edge
        apart = points - np.clip(points, -limit, limit)
        distance = np.linalg.norm(apart, axis=1)
        return distance, apart / np.maximum(distance, 1e-300)[:, None]
    g, h = half_planes(solid, edge)
    (c, s), high, low = g[0], h[1], -h[2]
    if h[0] - s * low < 0.0:  # the side meets the axis above the end
        low = h[0] / s
    if h[0] - s * high < 0.0:
        high = h[0] / s
    outline = np.array([[0.0, low], [(h[0] - s * low) / c, low], [(h[0] - s * high) / c, high], [0.0, high]])
    across = np.hypot(points[:, 0], points[:, 1])
    at = np.stack([across, points[:, 2]], axis=1)
    distance, apart = np.full(len(points), np.inf), np.zeros_like(at)
    for begin, end in pairwise(outline):
        side = end - begin
        part = np.clip((at - begin) @ side / (side @ side), 0.0, 1.0) if side.any() else np.zeros(len(points))
        this = at - begin - part[:, None] * side
        nearer = np.linalg.norm(this, axis=1) < distance
        apart[nearer] = this[nearer]
        distance = np.linalg.norm(apart, axis=1)
    apart[(at @ g.T <= h).all(axis=1)] = 0.0
    distance = np.linalg.norm(apart, axis=1)
    around = points[:, :2] / np.maximum(across, 1e-300)[:, None]
    direction = np.column_stack([around * apart[:, :1], apart[:, 1]])
    return distance, direction / np.maximum(distance, 1e-300)[:, None]


def distance_from_solid(solid: Solid, points: Floats) -> Floats:
    """(n,) distances of points (n, 3) in the solid's axes, 0 within."""
    return np.maximum(from_core(solid, 0.0, points)[0] - rounding_of(solid, 0.0), 0.0)
