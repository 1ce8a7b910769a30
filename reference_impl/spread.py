"""How far apart layers of a folded net lie: a thread, or as much more as keeps its threads so far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.meeting import closest

_TRIES, _MORE = 12, 2.0  # distances of layers that are tried; most that one is over the one before
_ROUND_OFF = 1e-6  # of a thread
_ROWS = 64  # elements whose distances from all others are found in one go


def spread(lay: Callable[[float], Floats | None], ends: Ints, d: float) -> Floats | None:
    """Places (n, 3) [m] that `lay` gives for a distance of layers [m]; None if none keeps elements d apart.

    ends: (m, 2) nodes of the elements; what has a common node may meet
    """
    layer = d
    for _ in range(_TRIES):
        place = lay(layer)
        if place is None:
            return None
        gap = least_gap(place, ends, d)
        if gap >= d * (1.0 - _ROUND_OFF):
            return place
        layer *= min(_MORE, d / gap) if gap > 0.0 else _MORE
    return None


def least_gap(place: Floats, ends: Ints, enough: float) -> float:
    """Least distance [m] of elements (m, 2) without a common node between places (n, 3) [m].

    Only elements whose boxes are nearer than `enough` [m] are looked at; if none are, that is the distance.
    """
    first, way = place[ends[:, 0]], place[ends[:, 1]] - place[ends[:, 0]]
    low, high = place[ends].min(axis=1), place[ends].max(axis=1)
    found = enough
    for begin in range(0, len(ends), _ROWS):
        rows = np.arange(begin, min(begin + _ROWS, len(ends)))
        near = np.all(low[rows, None] < high + enough, axis=2) & np.all(
            low < high[rows, None] + enough, axis=2
        )
        near &= rows[:, None] < np.arange(len(ends))
        for k in range(2):
            for n in range(2):
                near &= ends[rows, k][:, None] != ends[:, n]
        one, other = np.nonzero(near)
        if len(one):
            one = rows[one]
            found = min(found, float(closest(first[one], way[one], first[other], way[other]).min()))
    return found
