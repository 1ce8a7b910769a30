"""The surface of a body as contact takes it: cores, and the rounding around them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
import scipy

from exunet.base.arrays import Floats, Ints
from exunet.bodies.distance import distances, polyhedron
from exunet.bodies.rigid import RigidBody
from exunet.bodies.shapes import SOLIDS, Shape, Solid, TriangleMesh, core_of
from exunet.forces.cores import (
    BOX,
    CAPSULE,
    CYLINDER,
    FRUSTUM,
    SAMPLED,
    SPHERE,
    Cores,
    SampledDistance,
    Surface,
    no_samples,
)

_KINDS = {"box": BOX, "cylinder": CYLINDER, "sphere": SPHERE, "capsule": CAPSULE, "frustum": FRUSTUM}
assert set(_KINDS) == set(SOLIDS)
_FLAT = 1e-12  # [m] least length of a core, so that a flat core has a side
_TOUCH = 1e-9  # of edge_radius: a distance below counts as none


def surface_of(
    body: RigidBody, attached: Ints | None = None, wound: tuple[tuple[int, ...], ...] = ()
) -> Surface | None:
    """That of a body; None without one: no shape, a mesh (see `surface_of_mesh`), or sharp edges.

    attached : nodes that are fixed to it; wound : see `Surface`
    """
    shape = body.shape
    if shape is None or shape.mesh is not None:
        return None
    found = [core_of_solid(solid, shape.edge_radius) for solid in shape.solids]
    if any(rounding <= 0.0 for *_, rounding in found):
        return None
    back = body.rotation.T
    shifted = zip(shape.solids, found, strict=True)
    place = np.array([body.in_principal_axes(one.place_of(shift)) for one, (_, shift, _) in shifted])
    cores = Cores(
        np.array([_KINDS[element.kind] for element in shape.solids], dtype=np.int64),
        np.array([numbers for numbers, _, _ in found]),
        place,
        np.array([back @ one.rotation for one in shape.solids]),
        np.array([rounding for *_, rounding in found]),
        np.array([_box(body, one) for one in shape.solids]),
        no_samples(),
    )
    reach = [sum(core_of(solid.kind, solid.numbers)) for solid in shape.solids]
    middles = np.array([body.in_principal_axes(entry.position) for entry in shape.solids])
    middle = 0.5 * (np.min(middles.T - reach, axis=1) + np.max(middles.T + reach, axis=1))
    radius = float(np.max(np.linalg.norm(middles - middle, axis=1) + reach))
    least = 0.5 * min(one.least for one in shape.solids)
    allowed = min(0.5 * least, *(rounding for *_, rounding in found))
    nodes = np.zeros(0, dtype=np.int64) if attached is None else attached
    return Surface(cores, middle, radius, allowed, least, nodes, wound)


@dataclass(frozen=True, eq=False)
class SampledCore:
    """The core of a mesh, in the body's frame.

    samples : distances from it
    least   : half of the least thickness of what is touched, the core and its rounding [m]
    bends   : as of `Surface`
    error   : largest difference of the distance from that of the core, of those that were looked at [m]
    """

    samples: SampledDistance
    least: float
    bends: float
    error: float


def surface_of_mesh(
    body: RigidBody, core: SampledCore, attached: Ints, wound: tuple[tuple[int, ...], ...] = ()
) -> Surface:
    """That of a body whose shape is a mesh with rounded edges; attached, wound : as of `surface_of`."""
    shape = body.shape
    assert shape is not None
    assert shape.mesh is not None
    rounding = shape.edge_radius
    corners = (shape.mesh.vertices - body.centre) @ body.rotation
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = 0.5 * (low + high)
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    cores = Cores(
        np.array([SAMPLED]),
        np.zeros((1, 3)),
        body.in_principal_axes((0.0, 0.0, 0.0))[None],
        body.rotation.T[None].copy(),
        np.array([rounding]),
        np.concatenate([low, high])[None],
        core.samples,
    )
    allowed = min(0.5 * core.least, rounding)
    return Surface(cores, middle, radius, allowed, core.least, attached, wound, core.bends, core.error)


def core_of_solid(solid: Solid, edge: float) -> tuple[tuple[float, float, float], float, float]:
    """Numbers of a core as of `Cores`, where its middle is along the solid's z [m], and its rounding [m]."""
    a, b, c = solid.numbers
    if solid.kind == "box":
        return (0.5 * a - edge, 0.5 * b - edge, 0.5 * c - edge), 0.0, edge
    if solid.kind == "sphere":
        return (0.0, 0.0, 0.0), 0.0, a
    if solid.kind == "capsule":
        return (0.5 * b, 0.0, 0.0), 0.0, a
    if solid.kind == "cylinder":
        return (a - edge, 0.5 * b - edge, 0.0), 0.0, edge
    # The side r = a + k (z + c/2), moved inwards by the edge radius; a tip ends where it meets the axis.
    k = (b - a) / c
    inwards = edge * math.sqrt(1.0 + k * k)
    low, high = -0.5 * c + edge, 0.5 * c - edge
    if k != 0.0:
        tip = -0.5 * c + (inwards - a) / k
        low, high = (max(low, tip), high) if k > 0.0 else (low, min(high, tip))
    radii = [max(0.0, a + k * (z + 0.5 * c) - inwards) for z in (low, high)]
    return (radii[0], radii[1], 0.5 * (high - low)), 0.5 * (low + high), edge


@lru_cache(maxsize=256)
def core_as_solid(solid: Solid, edge: float) -> tuple[Solid, float]:
    """Return the core of a solid as a solid, and its rounding [m]."""
    (a, b, c), shift, rounding = core_of_solid(solid, edge)
    numbers = {
        "box": (2.0 * a, 2.0 * b, 2.0 * c),
        "cylinder": (a, max(2.0 * b, _FLAT), 0.0),
        "sphere": (0.0, 0.0, 0.0),
        "capsule": (0.0, 2.0 * a, 0.0),
        "frustum": (a, b, max(2.0 * c, _FLAT)),
    }[solid.kind]
    return Solid(solid.kind, numbers, solid.place_of(shift), solid.attitude), rounding


def grooves(shape: Shape) -> Iterator[tuple[int, int, float]]:
    """Yield pairs of solids that touch, and the depth [m] of the groove that their rounding leaves.

    Between cores at a distance g, balls of the radius of the rounding leave r - sqrt(r^2 - g^2 / 4), at most
    r. Pairs that overlap by the rounding, of which 0.13 r is left, and by more are left out.
    """
    edge, pose = shape.edge_radius, np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    edged = [(k, solid) for k, solid in enumerate(shape.solids) if solid.kind not in ("sphere", "capsule")]
    for (k, one), (m, other) in combinations(edged, 2):
        pair = Shape((one,)), Shape((other,))
        if distances(pair[0], pose, pair[1], pose)[0] > _TOUCH * edge:
            continue
        cores = (Shape((core_as_solid(solid, edge)[0],)) for solid in (one, other))
        gap = float(distances(next(cores), pose, next(cores), pose)[0])
        if gap > (1.0 + _TOUCH) * edge:
            yield k, m, edge - math.sqrt(max(0.0, edge**2 - 0.25 * gap**2))


def _box(body: RigidBody, solid: Solid) -> Floats:
    """(6,) least and largest coordinates of a solid along the principal axes, from the centre of mass [m]."""
    axes = body.rotation.T  # a row each, in the frame
    ends = [[axis @ solid.farthest(sign * axis) for axis in axes] for sign in (-1.0, 1.0)]
    middle = axes @ np.array(body.centre)
    return np.concatenate([np.array(ends[0]) - middle, np.array(ends[1]) - middle])


def surface_shown(shape: Shape) -> TriangleMesh:
    """Return triangles that show a shape in its frame: its mesh, or its solids with their round edges."""
    meshes = [_rounded(solid, shape.edge_radius) for solid in shape.solids]
    meshes += [] if shape.mesh is None else [shape.mesh]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


@lru_cache(maxsize=256)
def _rounded(solid: Solid, edge: float) -> TriangleMesh:
    """Return the convex hull of balls of the edge radius about the corners of a core."""
    if edge <= 0.0 or solid.kind in ("sphere", "capsule"):
        return polyhedron(solid)
    core, radius = core_as_solid(solid, edge)
    corners = (polyhedron(core).vertices[:, None] + radius * _BALL).reshape(-1, 3)
    hull = scipy.spatial.ConvexHull(corners)
    points, number = corners[hull.vertices], np.empty(len(corners), dtype=np.int64)
    number[hull.vertices] = np.arange(len(points))
    triangles = number[hull.simplices]
    a, b, c = points[triangles].swapaxes(0, 1)
    inwards = np.einsum("ma,ma->m", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return TriangleMesh(points, np.where(inwards[:, None], triangles[:, ::-1], triangles))


def _ball() -> Floats:
    """Return points (n, 3) on a sphere of radius 1, with its axes among them."""
    height, turn = np.meshgrid(np.linspace(-0.5, 0.5, 9) * np.pi, np.arange(16) * np.pi / 8)
    across = np.cos(height) * np.array([np.cos(turn), np.sin(turn)])
    return np.unique(np.round([*across, np.sin(height)], 12).reshape(3, -1).T, axis=0)


_BALL = _ball()
