"""The openings of a flat net: loops of knots, found from the directions in which sides leave each knot."""

from __future__ import annotations

import numpy as np

from exunet.net.arrays import Floats, Ints


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
