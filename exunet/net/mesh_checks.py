"""Openings of a flat net, validity of a topology's mesh, threads that meet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy

from exunet.net.arrays import Floats, Ints, Mesh, Net


def openings(knots: Floats, sides: Ints) -> tuple[Ints, ...]:
    """Loops round the openings, anticlockwise: one (n, corners) array for each number of corners.

    knots : (n_knots, 2) in a plane [m]; sides : (n_sides, 2), which meet at knots only; all are connected
    """
    ends = np.concatenate([sides, sides[:, ::-1]])  # each side, one way and the other
    way = knots[ends[:, 1]] - knots[ends[:, 0]]
    order = np.lexsort((np.arctan2(way[:, 1], way[:, 0]), ends[:, 0]))  # round each knot, anticlockwise
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    starts = np.searchsorted(ends[order, 0], np.arange(len(knots) + 1))
    back = np.roll(np.arange(len(ends)), len(sides))  # the same side, the other way
    # With the opening to the left, go on along the side that is next clockwise from the one that led here.
    at = place[back]
    here = ends[:, 1]
    onward = order[np.where(at == starts[here], starts[here + 1], at) - 1]
    return _by_length(_cycles(onward.tolist(), ends[:, 0].tolist()), knots)


def _cycles(onward: list[int], knot: list[int]) -> list[list[int]]:
    """Each cycle of a permutation, from its least item on, as the knots of its items."""
    seen = bytearray(len(onward))
    found = []
    for first in range(len(onward)):
        loop = []
        item = first
        while not seen[item]:
            seen[item] = 1
            loop.append(knot[item])
            item = onward[item]
        if loop:
            found.append(loop)
    return found


def _by_length(loops: list[list[int]], knots: Floats) -> tuple[Ints, ...]:
    """Loops grouped by their number of knots, without the one that goes round the whole net, clockwise."""
    groups: dict[int, list[list[int]]] = {}
    for loop in loops:
        groups.setdefault(len(loop), []).append(loop)
    found = []
    for _, group in sorted(groups.items()):
        nodes: Ints = np.array(group, dtype=np.int64)
        x, y = knots[nodes, 0], knots[nodes, 1]
        doubled = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
        if (doubled > 0.0).any():
            found.append(nodes[doubled > 0.0])
    return tuple(found)


_GUIDE = "see docs/extending.md, A topology"


def refuse_unsound(mesh: Mesh, topology: str) -> None:
    """Raise ValueError, for who writes a topology, if its faces or its mouth are not what `Mesh` says.

    Measures of deployment, contact and closing would take them as they are, and be wrong.
    """
    where = f"the mesh of the topology {topology!r}"
    corners = np.unique(mesh.anchors)
    if len(mesh.mouth) and not np.array_equal(np.sort(mesh.mouth), corners):
        words = f"its mouth has the knots {_few(mesh.mouth)}, its corners (anchors) are {_few(corners)}"
        raise ValueError(f"{where}: {words}: the mouth is the ring of corners, each once; {_GUIDE}")
    if len(mesh.mouth) and (_turning(mesh.knots, mesh.mouth[None]) < 0.0).any():
        raise ValueError(f"{where}: its mouth is not anticlockwise as seen from +z; {_GUIDE}")
    joined = np.sort(_names(np.sort(mesh.sides, axis=1), len(mesh.knots)))
    for loops in mesh.faces:
        pairs = np.stack([loops, np.roll(loops, -1, axis=1)], axis=-1)
        names = _names(np.sort(pairs.reshape(-1, 2), axis=1), len(mesh.knots))
        if (wrong := joined[np.searchsorted(joined[:-1], names)] != names).any():
            pair = pairs.reshape(-1, 2)[int(np.argmax(wrong))].tolist()
            raise ValueError(f"{where}: a face goes from knot {pair[0]} to {pair[1]}: no side; {_GUIDE}")
        if (turns := _turning(mesh.knots, loops) < 0.0).any():
            face = _few(loops[int(np.argmax(turns))])
            raise ValueError(f"{where}: the face {face} is not anticlockwise as seen from +z; {_GUIDE}")


def _names(pairs: Ints, n_knots: int) -> Ints:
    """(n,) a number for each pair of knots (n, 2)."""
    return np.asarray(pairs[:, 0] * n_knots + pairs[:, 1])


def _turning(knots: Floats, loops: Ints) -> Floats:
    """(n_loops,) twice the area of loops of knots (n_loops, k) as seen from +z, below 0 if clockwise."""
    with np.errstate(over="ignore", invalid="ignore"):  # a net beyond floats is refused elsewhere
        x, y = np.moveaxis(knots[loops][..., :2] - knots[loops[:, :1]][..., :2], -1, 0)
        return np.asarray((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))


def _few(knots: Ints) -> str:
    shown = ", ".join(map(str, knots[:8].tolist()))
    return f"[{shown}{', ...' if len(knots) > 8 else ''}]"


_ROWS = 2048  # elements whose neighbours are looked for in one go


class NearestElements(NamedTuple):
    """Two elements that share no node, and how near they come to each other.

    elements : (2,)
    distance : of their middles [m]
    place    : (3,) half way between the two points that are so near [m]
    """

    elements: Ints
    distance: float
    place: Floats


def between_segments(one: Floats, other: Floats) -> Floats:
    """(n,) least distances of straight pieces (n, 2, 3) [m].

    Ericson, Real-Time Collision Detection (2005), section 5.1.9; here the least of the nearest point of two
    lines and of each end from the other piece.
    """
    return np.asarray(np.linalg.norm(_closest(one, other)[0], axis=1))


def nearest(net: Net, position: Floats, within: float, *, strings: bool = True) -> NearestElements | None:
    """Of all elements that share no node, the two that come nearest.

    position : (n_nodes, 3) [m]
    within   : [m]; None if none are nearer
    strings  : whether elements of strings count
    """
    counted, found = np.flatnonzero(strings | ~net.is_string), None
    ends = net.element_nodes[counted]
    for a, b in _neighbours(position[ends], within):
        apart = (ends[a][:, :, None] != ends[b][:, None, :]).all(axis=(1, 2))
        a, b = a[apart], b[apart]
        pieces = position[ends[a]], position[ends[b]]
        distance = between_segments(*pieces)
        if not len(distance) or not distance.min() < within:
            continue
        k = int(distance.argmin())
        way, on_one = (part[0] for part in _closest(pieces[0][[k]], pieces[1][[k]]))
        within = float(distance[k])
        found = NearestElements(counted[[a[k], b[k]]], within, on_one - 0.5 * way)
    return found


def _closest(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """(n, 3) each: from the nearest point of the other piece to that of the one, and the latter [m]."""
    d, e, r = one[:, 1] - one[:, 0], other[:, 1] - other[:, 0], one[:, 0] - other[:, 0]
    dd, ee, de, dr, er = (np.einsum("na,na->n", p, q) for p, q in ((d, d), (e, e), (d, e), (d, r), (e, r)))
    across = dd * ee - de**2
    level = across <= 1e-14 * dd * ee
    s = np.clip(np.divide(de * er - dr * ee, across, out=np.zeros_like(dd), where=~level), 0.0, 1.0)
    t = (de * s + er) / ee
    s = np.where(t < 0.0, -dr / dd, np.where(t > 1.0, (de - dr) / dd, s))
    s, t = np.clip(s, 0.0, 1.0), np.clip(t, 0.0, 1.0)
    return r + s[:, None] * d - t[:, None] * e, one[:, 0] + s[:, None] * d


def _neighbours(pieces: Floats, near: float) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of pieces (n, 2, 3) whose boxes are nearer than `near` [m]."""
    low, high = pieces.min(axis=1) - 0.5 * near, pieces.max(axis=1) + 0.5 * near
    size = (high - low).max(axis=0)
    # Boxes that meet have middles within 1 of each other along each axis.
    middle = 0.5 * (low + high) / size
    tree = scipy.spatial.cKDTree(middle)
    for start in range(0, len(pieces), _ROWS):
        around = tree.query_ball_point(middle[start : start + _ROWS], 1.0 + 1e-9, p=np.inf)
        a = np.repeat(np.arange(start, start + len(around)), [len(item) for item in around])
        b = np.concatenate([np.array(entry, dtype=np.int64) for entry in around])
        kept = a < b
        a, b = a[kept], b[kept]
        boxes = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        yield a[boxes], b[boxes]
