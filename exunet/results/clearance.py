"""How near bodies come to each other: distances from surface to surface.

Solids are sharp, without their `edge_radius`; a shape of parts is as near as the nearest of them, and a mesh
counts as its convex hull (see `exunet.bodies.distance`). Bodies that overlap have the distance 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.bodies.distance import distances
from exunet.bodies.packed import unpacked
from exunet.bodies.shapes import Shape
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]
Pair = tuple[str, str]

FIRST = ("chaser", "target")
MOST_PAIRS = 10  # of bodies, whose distances are headlines


def clearance(result: Result, one: str, other: str) -> Floats:
    """(n_times,) distance of two bodies from surface to surface [m]; 0: they overlap.

    It is exact to 1e-10 of the distance of their farthest points. Parts of a shape count one by one, a mesh
    as its convex hull, and edges as sharp. Raises InputError if there is no body of a name, or it has no
    shape.
    """
    shapes = shapes_of(result)
    for name in (one, other):
        if name not in shapes:
            known = ", ".join(shapes) or "none"
            raise InputError(f"clearance: there is no body {name!r} with a shape (bodies with one: {known})")
    return gaps_of(result, [(one, other)])[:, 0]


def gaps_of(result: Result, pairs: Sequence[Pair]) -> Floats:
    """(n_times, pairs) distances of bodies with shapes [m]."""
    shapes = shapes_of(result)
    wanted = {name for pair in pairs for name in pair}
    found = gaps(pairs, shapes, {name: poses_of(result.bodies[name]) for name in wanted})
    return found if pairs else np.zeros((len(result.time), 0))


def shapes_of(result: Result) -> dict[str, Shape]:
    """The shapes of the bodies that have one, from their centres of mass."""
    found = {
        name: unpacked(body.solids, body.vertices, body.triangles) for name, body in result.bodies.items()
    }
    return {name: shape for name, shape in found.items() if shape is not None}


def poses_of(body: BodyStates) -> Floats:
    """(n_times, 7) of a rigid body: place of its centre of mass [m] and its attitude."""
    assert body.attitude is not None
    return np.concatenate([np.asarray(body.position[:]), np.asarray(body.attitude[:])], axis=1)


def pairs_of(names: Sequence[str]) -> list[Pair]:
    """The pairs of bodies: chaser and target first, then others with one of them, then the rest."""
    order = [*(name for name in FIRST if name in names), *(name for name in names if name not in FIRST)]
    return list(combinations(order, 2))


def gaps(pairs: Sequence[Pair], shapes: Mapping[str, Shape], poses: Mapping[str, Floats]) -> Floats:
    """(n, pairs) distances [m] of the bodies with these shapes at poses (n, 7) of their frames."""
    found = [distances(shapes[a], poses[a], shapes[b], poses[b]) for a, b in pairs]
    return np.stack(found, axis=1) if found else np.zeros((0, 0))
