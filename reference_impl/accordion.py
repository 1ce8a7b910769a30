"""A net folded into an accordion: pleats along y, then pleats of the whole stack along x.

Pleated along one axis, layers lie on each other along z, a distance a apart, nodes on a crease half-way
between those that it joins.  Pleated along both, the net is a bellows: its m layers climb side by side along
x, at an angle alpha, each a/sin(alpha) beside the next, so that they nest at their creases a apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from reference_impl.arrays import Floats, Ints, dot
from reference_impl.pleats import Pleats, ways
from reference_impl.spread import spread

SHORTEST = 0.9  # least chord of an element over its reference length
_SLACK = 1.0 - 1e-12  # so that round-off stretches nothing
_SHIFTS = (0.5, 0.1)  # most that layers of a bellows are beside each other, over the shortest element
_STEEPEST, _DRAWN = 0.5, 0.95  # sin(alpha) at most; least factor of lengths for wider pleats of a bellows


def accordion(
    place: Floats, ends: Ints, length: Floats, d: float, room: Floats, holds: Callable[[Floats], bool]
) -> tuple[Floats | None, Floats]:
    """Places (n, 3) [m], or None if nothing that `holds` allows was found; the extent (3,) of the first try.

    Nodes lie flat at `place` (n, 3) [m], elements (m, 2) have a reference length (m,) [m]; `room` (3,) [m] is
    what nodes have along x, y, z.
    """
    shortest, tried = float(length.min()), []

    def laid(y: Pleats, most: float, a: float) -> Floats | None:
        """The first that fits, of layers a [m] apart that are beside each other by `most` elements."""
        climb = 0.0
        if y.count > 1 and np.ptp(place[:, 0]) > room[0]:
            climb = min(_STEEPEST, max(a / (most * shortest), float(room[2] / np.ptp(place[:, 0]))))
        beside = (y.count - 1) * a / climb if climb else 0.0
        widest = float(room[0] - beside) / (_DRAWN * math.sqrt(1.0 - climb**2) if climb else 1.0)
        for x in ways(place[:, 0], ends, shortest, widest):
            folded = _folded(place[:, 0], x, y, ends, length, a, climb, float(room[0]))
            if folded is None:
                continue
            tried.append(np.ptp(folded, axis=0) + d)
            if holds(folded):
                return folded
        return None

    for along_y in ways(place[:, 1], ends, shortest, float(room[1])):
        for most in _SHIFTS:
            folded = spread(partial(laid, along_y, most), ends, d)
            if folded is not None:
                return folded, tried[0]
    return None, tried[0] if tried else np.full(3, np.nan)


def _folded(
    u: Floats, x: Pleats, y: Pleats, ends: Ints, length: Floats, a: float, climb: float, room: float
) -> Floats | None:
    """Places (n, 3) round the origin; None where elements would become too short."""
    level, none = math.sqrt(1.0 - climb**2), np.zeros(len(u))
    flat = np.column_stack((level * x.place, y.place, climb * u))
    if climb:
        added = np.column_stack((-a / climb * y.layer, none, none))
        drawn = (room - (y.count - 1) * a / climb) / (level * float(np.ptp(x.place)))
    else:
        added = np.column_stack((none, none, a * (x.layer + y.layer)))  # one of the two is 0
        drawn = 1.0
    i, j = ends.T
    way, gap = flat[j] - flat[i], added[j] - added[i]
    # s way + gap is as long as the element
    left, mixed = length**2 - dot(gap, gap), dot(way, gap)
    if np.any(left <= 0.0) or drawn <= 0.0:
        return None
    largest = left / (mixed + np.sqrt(mixed**2 + dot(way, way) * left))
    folded = _SLACK * min(1.0, drawn, float(largest.min())) * flat + added
    chord = folded[j] - folded[i]
    if np.any(np.sqrt(dot(chord, chord)) < SHORTEST * length):
        return None
    return np.asarray(folded - 0.5 * (folded.min(axis=0) + folded.max(axis=0)))
