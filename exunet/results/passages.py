"""What went through what, in scenes without contact: bodies that overlapped, threads in or through a body.

Both are looked for at the stored times. What cannot meet, by the spheres around it, is not looked at closer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.crossing import crossing, reach_of
from exunet.bodies.overlap import overlap
from exunet.bodies.rigid import rotation_matrix
from exunet.bodies.shapes import Shape
from exunet.results.clearance import Pair, pairs_of, poses_of, shapes_of
from exunet.results.result import Result
from exunet.results.rows import row_ranges

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_ROWS = 4096  # instants of bodies that are looked at in one go
_VALUES = 1 << 20  # coordinates of elements that are looked at in one go


@dataclass(frozen=True)
class Overlap:
    """Two bodies that shared points.

    start, end : first and last stored time at which they did [s]
    times      : in how many stretches of stored times
    """

    bodies: Pair
    start: float
    end: float
    times: int


@dataclass(frozen=True)
class Passage:
    """Threads that were in or through a body: those that end at a node fixed to it do not count.

    elements    : how many, over all stored times
    time        : the first at which one was [s]
    element     : which one
    """

    body: str
    elements: int
    time: float
    element: int


def overlaps(result: Result) -> list[Overlap]:
    """The pairs of bodies with shapes that overlapped, see `exunet.bodies.overlap`."""
    shapes = shapes_of(result)
    poses = {name: poses_of(result.bodies[name]) for name in shapes}
    found = []
    for pair in pairs_of(list(shapes)):
        shared = _shared(pair, shapes, poses)
        rows = np.flatnonzero(shared)
        if len(rows):
            begun = int(np.count_nonzero(np.diff(shared.astype(int)) == 1)) + int(shared[0])
            ends = float(result.time[rows[0]]), float(result.time[rows[-1]])
            found.append(Overlap(pair, *ends, begun))
    return found


def _shared(pair: Pair, shapes: Mapping[str, Shape], poses: Mapping[str, Floats]) -> Bools:
    """(n_times,) True where the two overlap."""
    one, other = pair
    a, b = poses[one], poses[other]
    near = np.linalg.norm(a[:, :3] - b[:, :3], axis=1) < reach_of(shapes[one]) + reach_of(shapes[other])
    rows, found = np.flatnonzero(near), np.zeros(len(a), dtype=bool)
    for first, last in row_ranges(len(rows), _ROWS):
        some = rows[first:last]
        found[some] = overlap(shapes[one], a[some], shapes[other], b[some])
    return found


def passages(result: Result, but: Sequence[str] = ()) -> list[Passage]:
    """The bodies that threads of the net or of tethers were in or went through.

    but : of bodies that they touch, in which they are by no more than contact lets them
    """
    shapes = {name: shape for name, shape in shapes_of(result).items() if name not in but}
    poses = {name: poses_of(result.bodies[name]) for name in shapes}
    ends = result.net.element_nodes
    waiting, first = {}, {}
    for name in shapes:
        fixed = result.bodies[name].nodes
        tied = np.zeros(len(ends), dtype=bool) if fixed is None else np.isin(ends, fixed).any(axis=1)
        waiting[name], first[name] = np.flatnonzero(~tied), np.full(len(ends), -1, dtype=np.int64)
    size = max(1, _VALUES // max(1, 3 * len(ends)))
    for start, stop in row_ranges(len(result.time), size) if shapes else ():
        position = np.asarray(result.position[start:stop])
        for name, shape in shapes.items():
            rows, elements = _inside(position, ends[waiting[name]], poses[name][start:stop], shape)
            met, at = np.unique(waiting[name][elements], return_index=True)  # rows increase
            first[name][met] = start + rows[at]
            waiting[name] = np.setdiff1d(waiting[name], met)
    found = []
    for name, rows in first.items():
        met = np.flatnonzero(rows >= 0)
        if len(met):
            element = int(met[rows[met].argmin()])
            found.append(Passage(name, len(met), float(result.time[rows[element]]), element))
    return found


def _inside(position: Floats, ends: Ints, poses: Floats, shape: Shape) -> tuple[Ints, Ints]:
    """States and elements that are in or through a shape at poses (k, 7), in the order of the states.

    position : (k, n_nodes, 3) [m]; ends : (m, 2)
    """
    start, end = (position[:, ends[:, side]] - poses[:, None, :3] for side in (0, 1))
    middle, half = np.linalg.norm(0.5 * (start + end), axis=-1), 0.5 * np.linalg.norm(end - start, axis=-1)
    rows, elements = np.nonzero(middle < half + reach_of(shape))
    turn = rotation_matrix(poses[rows, 3:])
    own = (np.einsum("nij,ni->nj", turn, one[rows, elements]) for one in (start, end))
    inside = crossing(shape, *own)
    return rows[inside], elements[inside]
