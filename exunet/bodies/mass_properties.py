"""Mass, centre and inertia: of solids in closed form, of closed meshes by integrals over their triangles."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
import scipy

from exunet.base.arrays import Floats
from exunet.bodies.shapes import Shape, Solid, TriangleMesh

_ROUND_OFF = 1e-12  # of the largest moment, below which products of inertia count as zero


@dataclass(frozen=True, eq=False)
class MassDistribution:
    """Mass, centre of mass and inertia, in axes that the context names.

    mass    : [kg]; of a shape of unit density: its volume [m3]
    centre  : (3,) of mass [m]
    inertia : (3, 3) about the centre [kg m2]
    """

    mass: float
    centre: Floats
    inertia: Floats

    def times(self, factor: float) -> MassDistribution:
        """The same with `factor` times the density."""
        return MassDistribution(factor * self.mass, self.centre, factor * self.inertia)

    def placed(self, rotation: Floats, position: Floats) -> MassDistribution:
        """In a frame in which its axes are turned by `rotation` (3, 3) and its origin is at `position`."""
        inertia = self.inertia if _is_unit(rotation) else rotation @ self.inertia @ rotation.T
        return MassDistribution(self.mass, rotation @ self.centre + position, inertia)


def sum_of(parts: Iterable[MassDistribution]) -> MassDistribution:
    """Several in one; Steiner's (parallel axes) theorem."""
    parts = tuple(parts)
    if len(parts) == 1:
        return parts[0]
    mass = math.fsum(part.mass for part in parts)
    centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        inertia += part.inertia + part.mass * _steiner(part.centre - centre)
    return MassDistribution(mass, centre, inertia)


def point_mass(mass: float, position: Sequence[float]) -> MassDistribution:
    """A mass [kg] at a point (3,) [m]."""
    return MassDistribution(mass, np.asarray(position, dtype=float), np.zeros((3, 3)))


def of_shape(shape: Shape) -> MassDistribution:
    """Return the mass and inertia of a shape of density 1 kg/m3, in its frame; overlaps count per solid."""
    if shape.mesh is not None:
        return of_mesh(shape.mesh)
    return sum_of(of_solid(solid) for solid in shape.solids)


def of_solid(solid: Solid) -> MassDistribution:
    """Return the mass and inertia of a solid of density 1 kg/m3, in the frame that it is placed in.

    Moments of box, cylinder, sphere and capsule as in textbooks (Meriam, Kraige and Bolton, Engineering
    Mechanics: Dynamics, table D/4); of the frustum by integration over its discs.
    """
    volume, height, across, along = _round(solid) if solid.kind != "box" else (0.0, 0.0, 0.0, 0.0)
    moments = np.array([across, across, along])
    if solid.kind == "box":
        squares = np.square(solid.numbers)
        volume = math.prod(solid.numbers)
        moments = volume / 12.0 * (squares.sum() - squares)
    own = MassDistribution(volume, np.array([0.0, 0.0, height]), np.diag(moments))
    return own.placed(solid.rotation, np.array(solid.position))


def _round(solid: Solid) -> tuple[float, float, float, float]:
    """Volume, height of the centre, moments across and along the axis, of a solid of revolution."""
    if solid.kind == "frustum":
        return _frustum(*solid.numbers)
    r, h, _ = solid.numbers
    ball, rod = 4.0 / 3.0 * math.pi * r**3, math.pi * r**2 * h
    if solid.kind == "sphere":
        return ball, 0.0, 0.4 * ball * r**2, 0.4 * ball * r**2
    across, along = rod * (r**2 / 4.0 + h**2 / 12.0), rod * r**2 / 2.0
    if solid.kind == "cylinder":
        return rod, 0.0, across, along
    # Each half ball has its centre 3 r / 8 beyond the end of the rod.
    across += ball * (0.4 * r**2 + h**2 / 4.0 + 3.0 / 8.0 * h * r)
    return rod + ball, 0.0, across, along + 0.4 * ball * r**2


def _frustum(a: float, b: float, h: float) -> tuple[float, float, float, float]:
    """As `_round`, with r = a + (b - a) s, z = h (s - 1/2), s from 0 to 1."""
    volume = math.pi * h / 3.0 * (a * a + a * b + b * b)
    centre = h / 4.0 * (a * a + 2.0 * a * b + 3.0 * b * b) / (a * a + a * b + b * b)  # above the lower end
    along = math.pi * h / 10.0 * (a**4 + a**3 * b + a * a * b * b + a * b**3 + b**4)
    at_end = 0.5 * along + math.pi * h**3 / 30.0 * (a * a + 3.0 * a * b + 6.0 * b * b)
    return volume, centre - 0.5 * h, at_end - volume * centre**2, along


def of_mesh(mesh: TriangleMesh) -> MassDistribution:
    """Return the mass and inertia of a closed mesh of density 1 kg/m3; a negative mass if it is inside out.

    Sums over the tetrahedra between triangles and one point: Tonon, J. Math. Stat. 1 (2005) 8, doi
    10.3844/jmssp.2005.8.11. The point is the mean of the vertices, far from which digits would cancel.
    """
    middle, corners, six_volumes = _tetrahedra(mesh)
    volume = six_volumes.sum() / 6.0
    total = corners.sum(axis=1)
    centre = six_volumes @ total / 24.0 / volume
    second = np.einsum("m,mci,mcj->ij", six_volumes, corners, corners)
    second = (second + np.einsum("m,mi,mj->ij", six_volumes, total, total)) / 120.0
    second -= volume * np.outer(centre, centre)
    return MassDistribution(float(volume), centre + middle, np.trace(second) * np.eye(3) - second)


def volume_of(mesh: TriangleMesh) -> float:
    """Inside a closed mesh [m3]; negative if it is inside out."""
    return float(_tetrahedra(mesh)[2].sum() / 6.0)


def _tetrahedra(mesh: TriangleMesh) -> tuple[Floats, Floats, Floats]:
    """The common point (3,), the other corners (m, 3 corners, 3) from there, and six times the volumes."""
    middle = mesh.vertices.mean(axis=0)
    corners = mesh.vertices[mesh.triangles] - middle
    return middle, corners, np.linalg.det(corners)


def principal(inertia: Floats) -> tuple[Floats, Floats]:
    """Principal moments (3,) [kg m2] of an inertia (3, 3), and the attitude (4,) of the principal axes.

    The attitude is a unit quaternion that turns the principal axes into those of the inertia. Of all orders
    and signs of the axes that with the least angle is taken; axes whose moments are equal stay as they are.
    """
    scale = np.abs(np.diag(inertia)).max()
    off = np.abs(inertia - np.diag(np.diag(inertia))).max()
    if off <= _ROUND_OFF * scale:
        return np.diag(inertia).copy(), np.array([1.0, 0.0, 0.0, 0.0])
    moments, axes = np.linalg.eigh(0.5 * (inertia + inertia.T))
    best = max(
        (
            axes[:, order] * signs
            for order in map(list, permutations(range(3)))
            for signs in map(np.array, product((1.0, -1.0), repeat=3))
            if np.linalg.det(axes[:, order] * signs) > 0.0
        ),
        key=np.trace,
    )
    moments = np.einsum("ik,ij,jk->k", best, inertia, best)
    quaternion = scipy.spatial.transform.Rotation.from_matrix(best).as_quat(canonical=True, scalar_first=True)
    return moments, np.asarray(quaternion)


def _steiner(arm: Floats) -> Floats:
    return np.asarray(arm @ arm * np.eye(3) - np.outer(arm, arm))


def _is_unit(rotation: Floats) -> bool:
    return bool((rotation == np.eye(3)).all())
