"""Surfaces of solids and compounds for tests of contact, and their distances by another route."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from exunet.bodies.rigid import RigidBody
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Shape, Solid
from exunet.bodies.touched import surface_of
from exunet.forces.contact.thread_contact import gauss_rules
from exunet.forces.cores import Surface

Floats = np.ndarray
EDGE = 0.08  # m
SOLIDS = {
    "box": Solid("box", (0.6, 1.0, 0.4)),
    "cylinder": Solid("cylinder", (0.4, 1.0, 0.0)),
    "sphere": Solid("sphere", (0.5, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.3, 0.9, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.3, 0.8)),
    "widening frustum": Solid("frustum", (0.2, 0.6, 0.7)),
    "cone": Solid("frustum", (0.5, 0.0, 0.9)),  # its core ends in a tip
    "cone upside down": Solid("frustum", (0.0, 0.5, 0.4)),
}
_HALF = np.sqrt(0.5)
COMPOUNDS = {
    "two boxes side by side": (
        Solid("box", (0.6, 1.0, 0.4), (-0.3, 0.0, 0.0)),
        Solid("box", (0.6, 1.0, 0.4), (0.3, 0.0, 0.0)),
    ),
    "box and lying cylinder": (
        Solid("box", (0.6, 1.0, 0.4)),
        Solid("cylinder", (0.3, 0.8, 0.0), (0.2, 0.1, 0.25), (_HALF, 0.0, _HALF, 0.0)),
    ),
    "sphere and cone": (
        Solid("sphere", (0.4, 0.0, 0.0), (0.1, 0.0, -0.3)),
        Solid("frustum", (0.5, 0.1, 0.8), (0.0, 0.1, 0.1), (0.8, 0.0, 0.6, 0.0)),
    ),
}
SHAPES = {name: (solid,) for name, solid in SOLIDS.items()} | COMPOUNDS


def body_of(solids: tuple[Solid, ...], edge: float = EDGE) -> RigidBody:
    """A body whose centre of mass and principal axes are not those of its frame."""
    return RigidBody(
        "b", 2.0, (1.0, 2.0, 2.5), (0.05, -0.02, 0.1), (0.8, 0.0, 0.6, 0.0), Shape(solids, edge_radius=edge)
    )


@lru_cache
def surface(solids: tuple[Solid, ...], edge: float = EDGE) -> Surface:
    found = surface_of(body_of(solids, edge))
    assert found is not None
    return found


def contact_of(
    touched: Surface, stiffness: float = 3.0, damping: float = 0.0, thick: float = 0.01, pieces: int = 1
) -> Any:
    """As much of a `ThreadContact` as the loops over one thread, of number 0, ask for."""
    number = len(touched.cores.kind)
    return SimpleNamespace(
        **touched.cores._asdict(),
        thick=np.array([thick]),
        pieces=np.array([pieces]),
        stiffness=stiffness,
        damping=damping,
        lines=np.zeros((number, 6)),
        spans=np.zeros((number, 2)),
        splits=np.zeros(max(16 * number, pieces)),
        found=np.zeros((pieces, 8)),
        sums=np.zeros(12),
        rule=gauss_rules(2, 4, 8),
    )


def in_solid(solid: Solid, points: Floats) -> Floats:
    """Places (..., 3) in the principal axes of `body_of`, in the solid's own axes."""
    body = body_of((solid,))
    in_frame = points @ body.rotation.T + body.centre
    return (in_frame - solid.position) @ rotation_matrix(np.array(solid.attitude))


def to_principal(solid: Solid, vectors: Floats) -> Floats:
    """Vectors (..., 3) in the solid's axes, in the principal axes of `body_of`."""
    turn = rotation_matrix(np.array(solid.attitude))
    return np.asarray(vectors @ turn.T @ body_of((solid,)).rotation)


def half_planes(solid: Solid, edge: float) -> tuple[Floats, Floats]:
    """G, h: the core of a solid of revolution is where G (r, z) <= h, with r from its axis.

    The faces of a cylinder or frustum, moved inwards by the edge radius.
    """
    a, b, c = solid.numbers
    if solid.kind == "capsule":
        return np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.array([0.0, 0.5 * b, 0.5 * b])
    if solid.kind == "sphere":
        return np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.zeros(3)
    if solid.kind == "cylinder":
        a, b, c = a, a, b
    outwards = np.array([c, a - b]) / np.hypot(c, a - b)
    side = outwards @ [a, -0.5 * c] - edge
    return np.array([outwards, [0.0, 1.0], [0.0, -1.0]]), np.array([side, 0.5 * c - edge, 0.5 * c - edge])


def core_projection(solid: Solid, edge: float, point: Floats) -> float:
    """Distance of a point (3,), in the solid's axes, from the core: by least distance programming.

    Lawson, Hanson, "Solving Least Squares Problems" (1974), chapter 23: the least u with G (x + u) <= h.
    """
    if solid.kind == "box":
        limit = 0.5 * np.array(solid.numbers) - edge
        return float(np.linalg.norm(point - np.clip(point, -limit, limit)))
    at = np.array([np.hypot(point[0], point[1]), point[2]])
    g, h = half_planes(solid, edge)
    g, h = np.vstack([g, [-1.0, 0.0]]), np.append(h, 0.0)
    matrix = np.vstack([-g.T, (g @ at - h)[None]])
    weights, left = nnls(matrix, np.array([0.0, 0.0, 1.0]))
    rest = matrix @ weights - [0.0, 0.0, 1.0]
    return float(np.linalg.norm(rest[:2] / rest[2])) if left > 1e-14 else np.inf


def rounding_of(solid: Solid, edge: float) -> float:
    return solid.numbers[0] if solid.kind in ("sphere", "capsule") else edge


def from_core(solid: Solid, edge: float, points: Floats) -> tuple[Floats, Floats]:
    """(n,) distances of points (n, 3) from the core, 0 within, and directions (n, 3).

    All in the solid's axes. From the outline in the plane through the axis, segment by segment; of a box by
    clipping.
    """
    if solid.kind == "box":
        limit = 0.5 * np.array(solid.numbers) - edge
        apart = points - np.clip(points, -limit, limit)
        distance = np.linalg.norm(apart, axis=1)
        return distance, apart / np.maximum(distance, 1e-300)[:, None]
    g, h = half_planes(solid, edge)
    across = np.hypot(points[:, 0], points[:, 1])
    at = np.stack([across, points[:, 2]], axis=1)
    corners = outline(solid, edge)
    distance, apart = np.full(len(points), np.inf), np.zeros_like(at)
    for begin, end in pairwise(corners):
        way = end - begin
        part = np.clip((at - begin) @ way / (way @ way), 0.0, 1.0) if way.any() else np.zeros(len(points))
        this = at - begin - part[:, None] * way
        nearer = np.linalg.norm(this, axis=1) < distance
        apart[nearer] = this[nearer]
        distance = np.linalg.norm(apart, axis=1)
    apart[(at @ g.T <= h).all(axis=1)] = 0.0
    distance = np.linalg.norm(apart, axis=1)
    around = points[:, :2] / np.maximum(across, 1e-300)[:, None]
    return distance, np.column_stack([around * apart[:, :1], apart[:, 1]]) / np.maximum(distance, 1e-300)[
        :, None
    ]


def outline(solid: Solid, edge: float) -> Floats:
    """(n, 2) corners (r, z) of the core, from the axis below to the axis above."""
    g, h = half_planes(solid, edge)
    (c, s), high, low = g[0], h[1], -h[2]
    if h[0] - s * low < 0.0:  # the side meets the axis above the end
        low = h[0] / s
    if h[0] - s * high < 0.0:
        high = h[0] / s
    return np.array([[0.0, low], [(h[0] - s * low) / c, low], [(h[0] - s * high) / c, high], [0.0, high]])
