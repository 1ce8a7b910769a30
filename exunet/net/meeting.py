"""Threads that meet: how near straight elements come to each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from exunet.net.arrays import Floats, Ints, Net

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
    tree = cKDTree(middle)
    for start in range(0, len(pieces), _ROWS):
        around = tree.query_ball_point(middle[start : start + _ROWS], 1.0 + 1e-9, p=np.inf)
        a = np.repeat(np.arange(start, start + len(around)), [len(one) for one in around])
        b = np.concatenate([np.array(one, dtype=np.int64) for one in around])
        kept = a < b
        a, b = a[kept], b[kept]
        boxes = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        yield a[boxes], b[boxes]
