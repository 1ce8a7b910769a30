"""Where threads touch bodies; and without contact, bodies that overlapped, threads in or through a body.

Both are looked for at the stored times and, by interpolation, between them. What cannot meet, by the spheres
around it and by how fast it moves, is not looked at closer.

Results store how many threads touch a body, not which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Bools, Floats, Ints
from exunet.bodies.distance import (
    COARSE,
    FINE,
    Mover,
    approach,
    crossing,
    cubic,
    distance_from,
    distances,
    least_along,
    overlap,
    rates_around,
    seen_from,
)
from exunet.bodies.mesh_core import core_of_mesh
from exunet.bodies.rotations import rotation_matrix
from exunet.bodies.shapes import Solid
from exunet.bodies.touched import SampledCore, core_as_solid
from exunet.forces.contact.signed_distance import sampled_distance
from exunet.forces.contact.status import THREADS, ContactKey
from exunet.results.clearance import Pair, movers_of, pairs_of, rounded_shapes
from exunet.results.loads import attached_nodes
from exunet.results.observables import Observables, touching_pairs
from exunet.results.result import Result, row_ranges

_MOST = 40  # halvings of a step
_VALUES = 1 << 20  # coordinates of elements that are looked at in one go


@dataclass(frozen=True)
class Overlap:
    """Two bodies that shared points.

    start, end : when they did first and last [s]
    times      : in how many stretches of time
    """

    bodies: Pair
    start: float
    end: float
    times: int


@dataclass(frozen=True)
class ThreadsInside:
    """Threads that were in or through a body: those that end at a node fixed to it do not count.

    elements    : how many, over all the time
    time        : when one was first [s]
    element     : which one
    """

    body: str
    elements: int
    time: float
    element: int


def overlaps(result: Result) -> list[Overlap]:
    """The pairs of bodies with shapes that overlapped, see `exunet.bodies.distance`.

    Those that touch each other do by no more than contact lets them, and are left out.
    """
    movers, touching = movers_of(result), {frozenset(pair) for pair in touching_pairs(result)}
    found = []
    for pair in pairs_of(list(movers)):
        if frozenset(pair) in touching:
            continue
        time, shared = _shared(*(movers[name] for name in pair))
        rows = np.flatnonzero(shared)
        if len(rows):
            begun = int(np.count_nonzero(np.diff(shared.astype(int)) == 1)) + int(shared[0])
            found.append(Overlap(pair, float(time[rows[0]]), float(time[rows[-1]]), begun))
    return found


def _shared(one: Mover, other: Mover) -> tuple[Floats, Bools]:
    """Times (m,) [s], the stored ones among them, and True for those at which the two overlap.

    Between stored times a mesh is looked for where its convex hull begins to meet the other body.
    """
    bound = one.reach + other.reach

    def apart(a: Floats, b: Floats) -> Floats:
        """That of the spheres around them, and where these meet their own."""
        gap = np.linalg.norm(a[:, :3] - b[:, :3], axis=1) - bound
        near = np.flatnonzero(gap <= 0.0)
        gap[near] = distances(one.shape, a[near], other.shape, b[near])
        return gap

    time, found = approach(one, other, apart, touching=True)
    rows = np.flatnonzero(found == 0.0)
    a, b = (body.path.when(time[rows]) for body in (one, other))
    shared = np.zeros(len(time), dtype=bool)
    shared[rows] = overlap(one.shape, a, other.shape, b)
    return time, shared


def threads_inside(result: Result, but: Sequence[str] = ()) -> list[ThreadsInside]:
    """The bodies that threads of the net or of tethers were in or went through.

    but : of bodies that they touch, in which they are by no more than contact lets them
    """
    movers = {name: mover for name, mover in movers_of(result).items() if name not in but}
    ends = result.net.element_nodes
    first = {}
    for name in movers:
        tied = np.isin(ends, attached_nodes(result, name)).any(axis=1)
        first[name] = np.where(tied, -np.inf, np.inf)
    size = max(1, _VALUES // max(1, 3 * len(ends)))
    for start, stop in row_ranges(len(result.time), size) if movers else ():
        rows = slice(max(0, start - 1), stop)  # with the last state before, for what is between
        position, velocity = (np.asarray(item[rows]) for item in (result.position, result.velocity))
        for name, mover in movers.items():
            waiting = np.flatnonzero(first[name] == np.inf)
            stretch = _Stretch(
                replace(mover, path=mover.path.through(rows)), position, velocity, ends[waiting]
            )
            first[name][waiting] = stretch.first_inside()
    found = []
    for name, times in first.items():
        met = np.flatnonzero(np.isfinite(times))
        if len(met):
            element = int(met[times[met].argmin()])
            found.append(ThreadsInside(name, len(met), float(times[element]), element))
    return found


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Consecutive states of a body and of elements that may be in or through it.

    position, velocity : (k, n_nodes, 3) [m], [m/s]
    ends               : (m, 2) nodes of the elements
    """

    body: Mover
    position: Floats
    velocity: Floats
    ends: Ints

    def first_inside(self) -> Floats:
        """(m,) when each element was in or through the body first [s]; inf: it was not.

        The distance of an element from the body's centre changes no faster than its nodes move against that.
        """
        path, place = self.body.path, self.position - self.body.path.place[:, None]
        start, end = (place[:, self.ends[:, side]] for side in (0, 1))
        clear = distance_from(np.zeros(3), start, end) - self.body.reach
        inside = np.zeros(clear.shape, dtype=bool)
        row, element = np.nonzero(clear < 0.0)
        inside[row, element] = self._crossing(
            path.poses[row], self.position[row[:, None], self.ends[element]]
        )
        first = np.where(inside.any(axis=0), path.time[inside.argmax(axis=0)], np.inf)
        if len(path.time) < 2:
            return first
        rate = rates_around(place, self.velocity - path.velocity[:, None], path.step)
        speed = np.linalg.norm(rate, axis=-1).max(axis=0)[:, self.ends].max(axis=-1)
        may = clear[:-1] + clear[1:] < speed * path.step[:, None]
        row, element = np.nonzero(may & ~inside[:-1])
        found = row, element, speed[row, element], clear[row, element], clear[row + 1, element]
        return self._between(first, *found, inside[row + 1, element])

    def _between(
        self,
        first: Floats,
        row: Ints,
        element: Ints,
        speed: Floats,
        clear: Floats,
        after: Floats,
        within: Bools,
    ) -> Floats:
        """`first` with what is earlier, of pieces of steps (n,) that begin outside.

        speed         : of elements against the body's centre, at most [m/s]
        clear, after  : distances from the sphere around the body at the begin and at the end of a piece [m]
        within        : whether it ends inside
        """
        path, least = self.body.path, self.body.least
        turns = self.body.reach * path.fastest_turn
        begin, part = np.zeros(len(row)), np.ones(len(row))
        for _ in range(_MOST):
            time = path.time[row] + begin * path.step[row]
            way = (speed + turns[row]) * part * path.step[row]
            may = within | ((clear + after < speed * part * path.step[row]) & (way > COARSE * least))
            halved = may & (way > FINE * least) & (time < first[element])
            if not halved.any():
                break
            row, element, within = row[halved], element[halved], within[halved]
            speed, clear, after = speed[halved], clear[halved], after[halved]
            begin, part = begin[halved], 0.5 * part[halved]
            middle = begin + part
            here, nodes = self._at(row, element, middle)
            between = distance_from(here[:, :3], nodes[:, 0], nodes[:, 1]) - self.body.reach
            inside = np.zeros(len(row), dtype=bool)
            near = np.flatnonzero(between < 0.0)
            inside[near] = self._crossing(here[near], nodes[near])
            np.minimum.at(first, element[inside], (path.time[row] + middle * path.step[row])[inside])
            # Of a piece that begins inside the part before is all that counts.
            out = ~inside
            row, element = np.append(row, row[out]), np.append(element, element[out])
            speed, part = np.append(speed, speed[out]), np.append(part, part[out])
            clear, after = np.append(clear, between[out]), np.append(between, after[out])
            within, begin = np.append(inside, within[out]), np.append(begin, middle[out])
        return first

    def _at(self, row: Ints, element: Ints, part: Floats) -> tuple[Floats, Floats]:
        """Poses (n, 7), and places (n, 2, 3) of the nodes of elements [m], at parts of steps."""
        rows, nodes = np.stack([row, row + 1])[..., None], self.ends[element]
        x, v = (values[rows, nodes].reshape(2, -1, 6) for values in (self.position, self.velocity))
        step = self.body.path.step[row]
        return self.body.path.at(row, part), cubic(x, v, step, part).reshape(-1, 2, 3)

    def _crossing(self, poses: Floats, nodes: Floats) -> Bools:
        """Whether elements between nodes (n, 2, 3) are in or through the body at poses (n, 7)."""
        return crossing(self.body.shape, *(seen_from(poses, nodes[:, side]) for side in (0, 1)))


_ROWS = 64  # states of one block
_PLACES = np.linspace(0.0, 1.0, 33)  # along a thread, of which the nearest to the body is chosen


def contacts_at(result: Result, k: int) -> dict[str, dict[str, int]]:
    """How many threads, nodes, bullets touch each body at stored time k, by body, as far as it is stored.

    And of each other body, under its name, how many corners, balls and edges do.
    """
    found: dict[str, dict[str, int]] = {}
    for key, series in result.contacts.items():
        if key.quantity == "touching":
            found.setdefault(key.body, {})[key.other] = int(series.values[k][0])
    return found


class Touch(NamedTuple):
    """Contact of the net, without tethers, with a body at stored times (t,).

    elements : number of elements in contact; of nodes, or bullets, where threads do not touch the body
    holds    : True where elements, nodes or bullets touch it
    first    : time of the first contact, between stored times too [s]; None: no contact
    """

    elements: Floats
    holds: Bools
    first: float | None


def net_contact(run: Observables, body: str) -> Touch:
    """Return the contact of the net with a body.

    Results store the number of all threads in contact. With tethers, those of the net are counted at stored
    times; the first contact is the net's if it touches at the first of these, or none touches at any.
    """
    counts = run.contacts(body, "touching") or [np.zeros(len(run.time))]
    firsts = [float(values[-1]) for values in run.contacts(body, "first")]
    rows = np.flatnonzero(counts[0]).tolist()
    if ContactKey(body, THREADS, "touching") in run.result.contacts and run.result.net.tethers and rows:
        places = contact_places(run.result, rows, body)[:, : run.result.net.n_net_elements]
        counts[0] = np.zeros(len(run.time))
        counts[0][rows] = np.count_nonzero(~np.isnan(places), axis=1)
        own = np.flatnonzero(counts[0]).tolist() or [-1]
        firsts[0] = firsts[0] if own[0] == rows[0] else float(run.time[own[0]]) if own[0] >= 0 else -1.0
    holds = np.any([values > 0.0 for values in counts], axis=0)
    return Touch(counts[0], holds, min((time for time in firsts if time >= 0.0), default=None))


def contact_places(result: Result, rows: Sequence[int], body_of: str | None = None) -> Floats:
    """Find where threads touch bodies whose contact is stored, or one of them, at stored times.

    A thread touches where its axis is nearer to a core than the rounding and its own radius together.

    Returns
    -------
    (k, n_elements) array
        For each stored time and element the place, from 0 at its first node to 1 at its last; NaN: none.
    """
    net, chosen = result.net, np.asarray(rows, dtype=np.int64)
    found = np.full((len(chosen), net.n_elements), np.nan)
    for name, shape in rounded_shapes(result).items():
        series = result.contacts.get(ContactKey(name, THREADS, "touching"))
        if series is None or body_of not in (None, name):
            continue
        counted = np.flatnonzero(np.asarray(series.values[chosen])[:, 0] > 0)
        body = result.bodies[name]
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
    for key in (key for key in result.contacts if key.quantity == "resultant"):
        body, states = key.body, result.bodies[key.body]
        keys = key, replace(key, quantity="torque")
        force, own = (np.asarray(result.contacts[of].values[chosen]) for of in keys)
        torque = np.einsum("kij,kj->ki", rotation_matrix(np.asarray(states.attitude[chosen])), own)
        torque += np.cross(np.asarray(states.position[chosen]), force)
        load = np.concatenate([force, torque], axis=1)
        loads[body] = loads.get(body, 0.0) + load
        if key.of_bodies:
            loads[key.other] = loads.get(key.other, 0.0) - load
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
