"""The surface of a body as contact takes it: cores, and the rounding around them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.body import RigidBody
from exunet.bodies.shapes import SOLIDS, Solid
from exunet.forces.cores import BOX, CAPSULE, CYLINDER, FRUSTUM, SPHERE, Cores, Surface

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_KINDS = {"box": BOX, "cylinder": CYLINDER, "sphere": SPHERE, "capsule": CAPSULE, "frustum": FRUSTUM}
assert set(_KINDS) == set(SOLIDS)


def surface_of(
    body: RigidBody, attached: Ints | None = None, wound: tuple[tuple[int, ...], ...] = ()
) -> Surface | None:
    """That of a body; None without one: no shape, a mesh, or edges that are not rounded.

    attached : nodes that are fixed to it; wound : see `Surface`
    """
    shape = body.shape
    if shape is None or shape.mesh is not None:
        return None
    found = [core_of_solid(one, shape.edge_radius) for one in shape.solids]
    if any(rounding <= 0.0 for *_, rounding in found):
        return None
    back = body.rotation.T
    shifted = zip(shape.solids, found, strict=True)
    place = np.array([body.in_principal_axes(one.place_of(shift)) for one, (_, shift, _) in shifted])
    cores = Cores(
        np.array([_KINDS[one.kind] for one in shape.solids], dtype=np.int64),
        np.array([numbers for numbers, _, _ in found]),
        place,
        np.array([back @ one.rotation for one in shape.solids]),
        np.array([rounding for *_, rounding in found]),
        np.array([_box(body, one) for one in shape.solids]),
    )
    reach = [_reach(one) for one in shape.solids]
    middles = np.array([body.in_principal_axes(one.position) for one in shape.solids])
    middle = 0.5 * (np.min(middles.T - reach, axis=1) + np.max(middles.T + reach, axis=1))
    radius = float(np.max(np.linalg.norm(middles - middle, axis=1) + reach))
    least = 0.5 * min(one.least for one in shape.solids)
    allowed = min(0.5 * least, *(rounding for *_, rounding in found))
    nodes = np.zeros(0, dtype=np.int64) if attached is None else attached
    return Surface(cores, middle, radius, allowed, least, nodes, wound)


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


def _box(body: RigidBody, solid: Solid) -> Floats:
    """(6,) least and largest coordinates of a solid along the principal axes, from the centre of mass [m]."""
    axes = body.rotation.T  # a row each, in the frame
    ends = [[axis @ solid.farthest(sign * axis) for axis in axes] for sign in (-1.0, 1.0)]
    middle = axes @ np.array(body.centre)
    return np.concatenate([np.array(ends[0]) - middle, np.array(ends[1]) - middle])


def _reach(solid: Solid) -> float:
    """Radius of a ball about a solid's origin that has all of it [m]."""
    a, b, c = solid.numbers
    if solid.kind == "box":
        return 0.5 * math.hypot(a, b, c)
    if solid.kind in ("sphere", "capsule"):
        return a + 0.5 * b
    if solid.kind == "cylinder":
        return math.hypot(a, 0.5 * b)
    return math.hypot(max(a, b), 0.5 * c)
