"""Which threads touch bodies at stored times, and where, found from the stored states.

Results store how many threads touch a body, not which.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import seen_from
from exunet.bodies.overlap import least_along
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Solid
from exunet.bodies.touched import SampledCore, core_as_solid
from exunet.forces.contact.signed_distance import sampled_distance
from exunet.forces.contact.status import OF_BODY
from exunet.model.mesh_core import core_of_mesh
from exunet.results.clearance import rounded_shapes
from exunet.results.loads import attached_nodes
from exunet.results.observables import CONTACT, THREADS
from exunet.results.result import Result, row_ranges

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_ROWS = 64  # states of one block
_RESULTANT = "_resultant"  # at the end of the names of what is stored of contacts
_PLACES = np.linspace(0.0, 1.0, 33)  # along a thread, of which the nearest to the body is chosen


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


def contact_places(result: Result, rows: Sequence[int]) -> Floats:
    """Find where threads touch bodies whose contact is stored, at stored times.

    A thread touches where its axis is nearer to a core than the rounding and its own radius together.

    Returns
    -------
    (k, n_elements) array
        For each stored time and element the place, from 0 at its first node to 1 at its last; NaN: none.
    """
    net, chosen = result.net, np.asarray(rows, dtype=np.int64)
    found = np.full((len(chosen), net.n_elements), np.nan)
    for name, shape in rounded_shapes(result).items():
        series = result.states.get(f"{CONTACT}{name}/{THREADS}_touching")
        if series is None:
            continue
        counted = np.flatnonzero(np.asarray(series.values[chosen])[:, 0] > 0)
        body = result.bodies[name]
        assert body.attitude is not None
        free = np.flatnonzero(~np.isin(net.element_nodes, attached_nodes(result, name)).any(axis=1))
        edge, reach = shape.edge_radius, np.sqrt(net.area / np.pi)
        core = None if shape.mesh is None else core_of_mesh(name, shape, float(reach.max()))
        for first, last in row_ranges(len(counted), _ROWS):
            block = counted[first:last]
            k, size = chosen[block], net.n_nodes
            poses = np.concatenate([body.position[k], body.attitude[k]], axis=1)
            seen = seen_from(np.repeat(poses, size, axis=0), np.asarray(result.position[k]).reshape(-1, 3))
            ends = seen.reshape(len(k), size, 3)[:, net.element_nodes[free]].reshape(-1, 2, 3)
            start, end, thick = ends[:, 0], ends[:, 1], np.tile(reach[free], len(k))
            places = found[np.ix_(block, free)].reshape(-1)
            for solid in shape.solids:
                _touch_solid(solid, edge, thick, start, end, places)
            if core is not None:
                touched = touch_mesh(core, edge + thick, start, end)
                places = np.where(np.isnan(touched), places, touched)
            found[np.ix_(block, free)] = places.reshape(len(k), len(free))
    return found


def contact_forces(result: Result, rows: Sequence[int]) -> dict[str, tuple[Floats, Floats]]:
    """Return the resultant of all contact on each body, at stored times.

    Forces between two bodies act on both. Results store resultants of threads, nodes, bullets and bodies.

    Returns
    -------
    dict of str to ((k, 3) array, (k, 3) array)
        Force [N], and the point of its line of action nearest to the body's centre of mass [m], in the axes
        of the scene; without a force that centre.
    """
    chosen = np.asarray(rows, dtype=np.int64)
    loads: dict[str, Floats] = {}  # force and torque about the scene's origin (k, 6)
    for name, series in result.states.items():
        if not (name.startswith(CONTACT) and name.endswith(_RESULTANT)):
            continue
        body, _, other = name.removeprefix(CONTACT).removesuffix(_RESULTANT).rpartition("/")
        force, states = np.asarray(series.values[chosen]), result.bodies[body]
        assert states.attitude is not None
        own = np.asarray(result.states[name.removesuffix(_RESULTANT) + "_torque"].values[chosen])
        torque = np.einsum("kij,kj->ki", rotation_matrix(np.asarray(states.attitude[chosen])), own)
        torque += np.cross(np.asarray(states.position[chosen]), force)
        load = np.concatenate([force, torque], axis=1)
        loads[body] = loads.get(body, 0.0) + load
        if other.startswith(OF_BODY):
            loads[other.removeprefix(OF_BODY)] = loads.get(other.removeprefix(OF_BODY), 0.0) - load
    found = {}
    for body, load in loads.items():
        force, centre = load[:, :3], np.asarray(result.bodies[body].position[chosen])
        square = np.einsum("ki,ki->k", force, force)[:, None]
        arm = np.cross(force, load[:, 3:] - np.cross(centre, force))
        found[body] = force, centre + np.divide(arm, square, out=np.zeros_like(arm), where=square > 0.0)
    return found


def _touch_solid(
    solid: Solid, edge: float, reach: Floats, start: Floats, end: Floats, places: Floats
) -> None:
    """Write the places of contact with a solid into places (n,).

    The distance from the core changes by at most the way along a thread: most threads are too far away.
    """
    core, rounding = core_as_solid(solid, edge)
    middle, half = 0.5 * (start + end), 0.5 * np.linalg.norm(end - start, axis=1)
    near = np.flatnonzero(np.linalg.norm(middle - solid.position, axis=1) < _radius(solid) + reach + half)
    near = near[core.distance(middle[near]) < rounding + reach[near] + half[near]]
    near = near[least_along(core.distance, start[near], end[near]) < rounding + reach[near]]
    points = start[near, None] + _PLACES[:, None] * (end - start)[near, None]
    distance = core.distance(points.reshape(-1, 3)).reshape(len(near), len(_PLACES))
    places[near] = _PLACES[distance.argmin(axis=1)]


def _radius(solid: Solid) -> float:
    """Return the radius of a ball about the origin of a solid that contains it [m]."""
    return float(sum(solid.numbers))


def touch_mesh(core: SampledCore, reach: Floats, start: Floats, end: Floats) -> Floats:
    """Return where (n,) lines come nearer to a core than `reach` (n,) [m]; NaN: nowhere.

    start, end : (n, 3) in the core's axes [m]
    """
    samples, found = core.samples, np.full(len(start), np.nan)
    length = np.linalg.norm(end - start, axis=1)
    size = samples.cell * samples.ends
    low = samples.corner - 0.5 * length[:, None]
    middle = 0.5 * (start + end)
    around = ((middle > low) & (middle < low + size + length[:, None])).all(axis=1)
    for row in np.flatnonzero(around).tolist():
        s = 0.0
        while s <= 1.0 and np.isnan(found[row]):
            place = (start[row] + s * (end[row] - start[row])).tolist()
            gap = sampled_distance(samples, *place)[0] - reach[row]
            if gap < 0.0:
                found[row] = s
            s += max(gap, 0.5 * samples.cell) / max(length[row], samples.cell)
    return found
