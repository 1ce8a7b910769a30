"""How near bodies come to each other: distances from surface to surface, at stored times and between them.

Solids are sharp, without their `edge_radius`; a shape of parts is as near as the nearest of them, and a mesh
counts as its convex hull (see `exunet.bodies.distance`). Bodies that overlap have the distance 0. Between
stored times states are interpolated (see `exunet.bodies.distance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.bodies.distance import Mover, Path, approach, distances
from exunet.bodies.shapes import Shape, unpacked
from exunet.results.result import BodyStates, Result

Pair = tuple[str, str]

FIRST = ("chaser", "target")
MOST_PAIRS = 10  # of bodies, whose distances are metrics


@takes(result=Result, one=str, other=str)
def clearance(result: Result, one: str, other: str) -> Floats:
    """(n_times,) distance of two bodies from surface to surface [m]; 0: they overlap.

    It is exact to 1e-10 of the distance of their farthest points. Parts of a shape count one by one, a mesh
    as its convex hull, and edges as sharp. Raises InputError for an unknown body, or a body without
    a shape.
    """
    shapes = shapes_of(result)
    for name in (one, other):
        if name not in shapes:
            known = ", ".join(shapes) or "none"
            raise InputError(f"clearance: no body with a shape is named {name!r} (those are: {known})")
    return gaps_of(result, [(one, other)])[:, 0]


def gaps_of(result: Result, pairs: Sequence[Pair]) -> Floats:
    """(n_times, pairs) distances of bodies with shapes [m]."""
    movers = movers_of(result)
    found = [
        distances(movers[a].shape, movers[a].path.poses, movers[b].shape, movers[b].path.poses)
        for a, b in pairs
    ]
    return np.stack(found, axis=1) if found else np.zeros((len(result.time), 0))


class Nearest(NamedTuple):
    """The least distance of two bodies [m] and when [s]; the largest at instants whose states are known."""

    distance: float
    time: float
    largest: float


def nearest(one: Mover, other: Mover) -> Nearest:
    """Return the nearest approach of two bodies, between the instants of their paths too."""

    def measure(a: Floats, b: Floats) -> Floats:
        return distances(one.shape, a, other.shape, b)

    time, found = approach(one, other, measure)
    row = int(found.argmin())
    at = np.searchsorted(time, one.path.time)
    return Nearest(float(found[row]), float(time[row]), float(found[at].max()))


def movers_of(result: Result) -> dict[str, Mover]:
    """The bodies that have a shape, in motion."""
    return {
        name: Mover(rigid_path(result.time, result.bodies[name]), shape)
        for name, shape in shapes_of(result).items()
    }


def rigid_path(time: Floats, body: BodyStates) -> Path:
    """The motion of a rigid body."""
    states = (body.position, body.velocity, body.attitude, body.angular_velocity)
    return Path(time, *(np.asarray(state[:]) for state in states if state is not None))


def shapes_of(result: Result) -> dict[str, Shape]:
    """The shapes of the bodies that have one, from their centres of mass."""
    found = {
        name: unpacked(body.solids, body.vertices, body.triangles) for name, body in result.bodies.items()
    }
    return {name: shape for name, shape in found.items() if shape is not None}


def rounded_shapes(result: Result) -> dict[str, Shape]:
    """The same with the radii of their edges and the spacings of their grids, as contact takes them."""
    edges, grids = result.run.edge_radii, result.run.grid_spacings
    return {
        name: replace(shape, edge_radius=edges.get(name, 0.0), grid_spacing=grids.get(name))
        for name, shape in shapes_of(result).items()
    }


def pairs_of(names: Sequence[str]) -> list[Pair]:
    """The pairs of bodies: chaser and target first, then others with one of them, then the rest.

    Others by their names: a file has its bodies in that order, a run in that of the case.
    """
    order = [*(name for name in FIRST if name in names), *sorted(set(names).difference(FIRST))]
    return list(combinations(order, 2))
