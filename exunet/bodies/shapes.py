"""Shapes of rigid bodies as frozen numbers, in the frame that a case draws them in, and as stored arrays.

A solid is one of these, about its own origin, its axis along z:

    box      : edges a, b, c along x, y, z; centre at the origin
    cylinder : radius r, length h; the middle of its axis at the origin
    sphere   : radius r
    capsule  : radius r, length h between the centres of its half-spheres, whose middle is the origin
    frustum  : of a circular cone: radius r1 at z = -h/2 and r2 at z = h/2
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.bodies.rotations import rotation_matrix

Vector = tuple[float, float, float]

SolidName = Literal["box", "cylinder", "sphere", "capsule", "frustum"]
SOLIDS: tuple[SolidName, ...] = get_args(SolidName)
ShapeName = Literal["box", "cylinder", "sphere", "capsule", "frustum", "mesh"]


@dataclass(frozen=True)
class Solid:
    """One solid of a shape.

    kind     : its name
    numbers  : box (a, b, c), cylinder and capsule (r, h, 0), sphere (r, 0, 0), frustum (r1, r2, h) [m]
    position : of its origin in the body's frame [m]
    attitude : unit quaternion (w, x, y, z) that turns its axes into those of the body's frame
    """

    kind: SolidName
    numbers: Vector
    position: Vector = (0.0, 0.0, 0.0)
    attitude: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @property
    def rotation(self) -> Floats:
        """(3, 3), from its axes to those of the body's frame."""
        return rotation_matrix(np.array(self.attitude))

    def place_of(self, along: float) -> Vector:
        """The point of its axis at z = along [m], in the body's frame."""
        x, y, z = self.rotation[:, 2] * along + self.position
        return float(x), float(y), float(z)

    @property
    def least(self) -> float:
        """The smallest of its dimensions, across [m]; a ball of this width is inside."""
        if self.kind == "box":
            return min(self.numbers)
        if self.kind == "frustum":
            low, high, length = self.numbers
            wide, slope = max(low, high), abs(high - low) / length
            # A ball of radius r on the wide end touches the side where wide = r (slope + sqrt(1 + slope^2)).
            return min(low + high, 2.0 * wide / (slope + math.hypot(1.0, slope)), length)
        radius, length, _ = self.numbers
        return min(2.0 * radius, length) if self.kind == "cylinder" else 2.0 * radius

    def farthest(self, direction: Floats) -> Floats:
        """The point of it that is farthest in a direction (3,), in the body's frame (3,) [m].

        Its support function: Ericson, Real-Time Collision Detection (2005), section 9.5.
        """
        turn = self.rotation
        own = direction @ turn
        radius, size = core_of(self.kind, self.numbers)[0], float(np.linalg.norm(own))
        around = radius / size * own if size else 0.0
        return np.asarray(turn @ (farthest_of_core(self.kind, self.numbers, own) + around) + self.position)

    def depth(self, points: Floats) -> Floats:
        """(n,) [m] of points (n, 3) of the body's frame: below 0 inside, above 0 outside, 0 on the surface.

        A convex function; inside it is the distance of the nearest face or, of a frustum, at least that.
        """
        x, y, z = ((points - self.position) @ self.rotation).T
        a, b, c = self.numbers
        if self.kind == "box":
            sides = [np.abs(x) - 0.5 * a, np.abs(y) - 0.5 * b, np.abs(z) - 0.5 * c]
            return np.asarray(np.maximum.reduce(sides))
        across = np.hypot(x, y)
        if self.kind == "frustum":
            return np.maximum(across - (a + (b - a) * (z / c + 0.5)), np.abs(z) - 0.5 * c)
        if self.kind == "cylinder":
            return np.maximum(across - a, np.abs(z) - 0.5 * b)
        return np.asarray(np.hypot(across, np.maximum(np.abs(z) - 0.5 * b, 0.0)) - a)

    def distance(self, points: Floats) -> Floats:
        """(n,) [m] from points (n, 3) of the body's frame to it; 0 inside."""
        x, y, z = ((points - self.position) @ self.rotation).T
        a, b, c = self.numbers
        if self.kind == "box":
            sides = [np.maximum(np.abs(one) - 0.5 * edge, 0.0) for one, edge in ((x, a), (y, b), (z, c))]
            return np.asarray(np.sqrt(sides[0] ** 2 + sides[1] ** 2 + sides[2] ** 2))
        if self.kind in ("sphere", "capsule"):
            return np.maximum(self.depth(points), 0.0)
        low, high, length = (a, b, c) if self.kind == "frustum" else (a, a, b)
        across, half = np.hypot(x, y), 0.5 * length
        ends = [
            np.hypot(np.maximum(across - radius, 0.0), z - at) for radius, at in ((low, -half), (high, half))
        ]
        slant = math.hypot(high - low, length)
        along = ((across - low) * (high - low) + (z + half) * length) / slant
        side = np.where(
            (along >= 0.0) & (along <= slant),
            np.abs((across - low) * length - (z + half) * (high - low)) / slant,
            np.inf,
        )
        return np.where(self.depth(points) < 0.0, 0.0, np.minimum.reduce([*ends, side]))

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """(n,) True for points (n, 3) of the body's frame that are inside it."""
        return self.depth(points) < 0.0


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A closed surface of triangles, anticlockwise as seen from outside.

    vertices  : (n, 3) [m] in the body's frame
    triangles : (m, 3) numbers of vertices
    """

    vertices: Floats
    triangles: Ints


@dataclass(frozen=True, eq=False)
class Shape:
    """The shape of a body: solids that together are the body, or a mesh.

    edge_radius : [m] by which edges and corners are rounded for contact, inside the sharp shape
    grid_spacing : [m] of the grid on which contact samples the distance from a mesh; None: the usual one
    """

    solids: tuple[Solid, ...] = ()
    mesh: TriangleMesh | None = None
    edge_radius: float = 0.0
    grid_spacing: float | None = None


def core_of(kind: str, numbers: Vector) -> tuple[float, float]:
    """Return radius and core's reach [m] of a solid that is all points within this radius of its core.

    The core is the middle of a sphere, the axis of a capsule, and all of every other solid, with radius 0.
    """
    a, b, c = numbers
    if kind in ("sphere", "capsule"):
        return a, 0.5 * b
    if kind == "box":
        return 0.0, 0.5 * math.hypot(a, b, c)
    return 0.0, math.hypot(a, 0.5 * b) if kind == "cylinder" else math.hypot(max(a, b), 0.5 * c)


def farthest_of_core(kind: str, numbers: Vector, direction: Floats) -> Floats:
    """(..., 3) the points of a solid's core that are farthest in directions (..., 3), in its own axes [m]."""
    a, b, c = numbers
    upward = np.where(direction[..., 2:] >= 0.0, 1.0, -1.0)
    if kind == "box":
        return np.asarray(0.5 * np.where(direction >= 0.0, 1.0, -1.0) * np.array(numbers))
    if kind in ("sphere", "capsule"):
        return np.asarray(0.5 * b * upward * [0.0, 0.0, 1.0])
    across = direction * [1.0, 1.0, 0.0]
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    across = np.divide(across, size, out=np.zeros_like(across), where=size > 0.0)
    if kind == "cylinder":
        return np.asarray(a * across + 0.5 * b * upward * [0.0, 0.0, 1.0])
    top = (b - a) * size + c * direction[..., 2:] > 0.0  # whose rim is farther
    return np.where(top, b * across + [0.0, 0.0, 0.5 * c], a * across - [0.0, 0.0, 0.5 * c])


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
