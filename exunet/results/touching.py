"""Which threads touch bodies at a stored time, found from the stored states.

Results store how many threads touch a body, not which.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import seen_from
from exunet.bodies.overlap import least_along
from exunet.bodies.shapes import Solid
from exunet.bodies.touched import SampledCore, core_of_solid
from exunet.forces.contact.signed_distance import sampled_distance
from exunet.forces.cores import BRICK
from exunet.model.mesh_core import core_of_mesh
from exunet.results.clearance import shapes_of
from exunet.results.loads import attached_nodes
from exunet.results.observables import CONTACT, THREADS
from exunet.results.provenance import SceneProvenance
from exunet.results.result import Result

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEAST = 1e-12  # m, of a core's length: one that is flat has a side to be near to as well


def contacts_at(result: Result, k: int) -> dict[str, dict[str, int]]:
    """How many threads, nodes, bullets touch each body at stored time k, by body, as far as it is stored.

    And of each other body, under its name after `OF_BODY`, how many corners, balls and edges do.
    """
    found: dict[str, dict[str, int]] = {}
    for name, one in result.states.items():
        if name.startswith(CONTACT) and name.endswith("_touching"):
            body, _, series = name.removeprefix(CONTACT).rpartition("/")
            found.setdefault(body, {})[series.removesuffix("_touching")] = int(one.values[k][0])
    return found


def touching_threads(result: Result, k: int) -> Bools:
    """(n_elements,) True for those that touch a body at stored time k, of bodies whose contact is stored.

    A thread touches where its axis is nearer to a core than the rounding and its own radius together.
    """
    net, found = result.net, np.zeros(result.net.n_elements, dtype=bool)
    position, shapes = np.asarray(result.position[k]), shapes_of(result)
    thick, scene = np.sqrt(net.area / np.pi), SceneProvenance.of(result.provenance)
    for name, counts in contacts_at(result, k).items():
        if not counts.get(THREADS):
            continue
        body = result.bodies[name]
        assert body.attitude is not None
        pose = np.concatenate([body.position[k], body.attitude[k]])
        seen = seen_from(np.broadcast_to(pose, (len(position), len(pose))), position)
        start, end = (seen[net.element_nodes[:, side]] for side in (0, 1))
        near = np.zeros(len(found), dtype=bool)
        edge = scene.edge_radii.get(name, 0.0)
        for solid in shapes[name].solids:
            core, rounding = _core(solid, edge)
            near |= least_along(core.distance, start, end) < rounding + thick
        if shapes[name].mesh is not None:
            grid = scene.grid_spacings.get(name)
            shape = replace(shapes[name], edge_radius=edge, grid_spacing=grid)
            near |= touch_mesh(core_of_mesh(name, shape, float(thick.max())), edge + thick, start, end)
        near &= ~np.isin(net.element_nodes, attached_nodes(result, name)).any(axis=1)
        found |= near
    return found


def touch_mesh(core: SampledCore, reach: Floats, start: Floats, end: Floats) -> Bools:
    """(n,) True for lines that come nearer to a core than `reach` (n,) [m]; start, end (n, 3) in its axes."""
    samples, found = core.samples, np.zeros(len(start), dtype=bool)
    length = np.linalg.norm(end - start, axis=1)
    size = samples.cell * BRICK * np.array(samples.bricks.shape)
    low = samples.corner - 0.5 * length[:, None]
    middle = 0.5 * (start + end)
    around = ((middle > low) & (middle < low + size + length[:, None])).all(axis=1)
    for row in np.flatnonzero(around).tolist():
        s = 0.0
        while s <= 1.0 and not found[row]:
            place = (start[row] + s * (end[row] - start[row])).tolist()
            gap = sampled_distance(samples, *place)[0] - reach[row]
            found[row] = gap < 0.0
            s += max(gap, 0.5 * samples.cell) / max(length[row], samples.cell)
    return found


@lru_cache(maxsize=256)
def _core(solid: Solid, edge: float) -> tuple[Solid, float]:
    """The core of a solid, and its rounding [m]."""
    (a, b, c), shift, rounding = core_of_solid(solid, edge)
    numbers = {
        "box": (2.0 * a, 2.0 * b, 2.0 * c),
        "cylinder": (a, max(2.0 * b, _LEAST), 0.0),
        "sphere": (0.0, 0.0, 0.0),
        "capsule": (0.0, 2.0 * a, 0.0),
        "frustum": (a, b, max(2.0 * c, _LEAST)),
    }[solid.kind]
    return Solid(solid.kind, numbers, solid.place_of(shift), solid.attitude), rounding
