"""What went through what, where there is no contact: bodies that overlapped, threads in or through a body.

Both are looked for at the stored times and, by interpolation, between them. What cannot meet, by the spheres
around it and by how fast it moves, is not looked at closer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import COARSE, FINE, Mover, approach, cubic, distances, rates_around, seen_from
from exunet.bodies.overlap import crossing, distance_from, overlap
from exunet.results.clearance import Pair, movers_of, pairs_of
from exunet.results.loads import attached_nodes
from exunet.results.observables import touching_pairs
from exunet.results.result import Result, row_ranges

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

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
    """The pairs of bodies with shapes that overlapped, see `exunet.bodies.overlap`.

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
            stretch = _Stretch(mover.during(rows), position, velocity, ends[waiting])
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
