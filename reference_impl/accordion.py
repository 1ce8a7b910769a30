"""A net folded into an accordion: pleats along y, then pleats of the whole stack along x.

Layers lie one thickness d apart, nodes on a crease half-way between the layers that it joins.  Round a crease
along x the stack turns by half a turn: there its layers are spread along x instead of z, each as far from the
hinge between the two pleats as it is before and after.  Lengths along y and x are drawn together by one
factor each, the largest at which no element is longer than its reference length.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reference_impl.arrays import Floats, Ints
from reference_impl.pleats import Pleats, ways

SHORTEST = 0.9  # least chord of an element over its reference length
_SLACK = 1.0 - 1e-9  # so that round-off stretches nothing


def accordion(
    place: Floats, ends: Ints, length: Floats, d: float, room: Floats, holds: Callable[[Floats], bool]
) -> tuple[Floats | None, Floats]:
    """Places (n, 3) [m], or None if nothing that `holds` allows was found; the extent (3,) of the first try.

    Nodes lie flat at `place` (n, 3) [m], elements (m, 2) have a reference length (m,) [m]; `room` (3,) [m] is
    about what there is along x, y, z.
    """
    shortest, first = float(length.min()), np.full(3, np.nan)
    for along_y in ways(place[:, 1], ends, shortest, float(room[1])):
        for along_x in ways(place[:, 0], ends, shortest, float(room[0])):
            folded = _folded(along_x, along_y, ends, length, d)
            if folded is None:
                continue
            extent = np.ptp(folded, axis=0) + d
            if np.isnan(first).any():
                first = extent
            if holds(folded):
                return folded, first
    return None, first


def _folded(x: Pleats, y: Pleats, ends: Ints, length: Floats, d: float) -> Floats | None:
    """Places (n, 3) round the origin; None where elements would become too short."""
    beyond, height = _stacked(x, y, d)
    i, j = ends.T
    flat = x.place[j] - x.place[i]
    inner = y.layer * d
    across = _factor(
        y.place[j] - y.place[i], np.zeros(len(i)), length**2 - flat**2 - (inner[j] - inner[i]) ** 2
    )
    folded = np.column_stack((np.zeros(len(inner)), across * y.place, height))
    used = np.sum((folded[j] - folded[i]) ** 2, axis=1)
    folded[:, 0] = _factor(flat, beyond[j] - beyond[i], length**2 - used) * x.place + beyond
    chord = np.linalg.norm(folded[j] - folded[i], axis=1) / length
    if not (np.all(chord >= SHORTEST) and np.all(chord <= 1.0)):
        return None
    return np.asarray(folded - 0.5 * (folded.min(axis=0) + folded.max(axis=0)))


def _stacked(x: Pleats, y: Pleats, d: float) -> tuple[Floats, Floats]:
    """What the turning stack adds along x, and the heights, (n,) [m] each."""
    pleat = np.floor(x.layer)
    from_below = np.where(pleat % 2, y.count - 1 - y.layer, y.layer)
    height = (pleat * y.count + from_below) * d
    hinge = ((pleat + 1) * y.count - 0.5) * d
    turning = x.crease >= 0
    away = np.where(turning, hinge - height, 0.0) * np.where(pleat % 2, -1.0, 1.0)
    return away, np.where(turning, hinge, height)


def _factor(reach: Floats, offset: Floats, square: Floats) -> float:
    """The largest f <= 1 with |f reach + offset| <= sqrt(square) for all elements; 0 if there is none."""
    moving = np.abs(reach) > 0.0
    sign = np.sign(reach[moving])
    if np.any(square[moving] < 0.0):
        return 0.0
    bound = (np.sqrt(square[moving]) - sign * offset[moving]) / np.abs(reach[moving])
    return max(0.0, min(1.0, _SLACK * float(bound.min(initial=1.0))))
