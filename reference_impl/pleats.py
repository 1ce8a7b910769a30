"""Where a net may be creased across one axis, and where its nodes come to lie when it goes to and fro.

A crease is a line across the axis that no element crosses, so that nets bend at nodes only.  No topology is
asked: the lines follow from the elements alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from reference_impl.arrays import Floats, Ints

_SAME = 1e-6  # of the shortest element: places across the axis that are one line
_NARROWER = 20  # steps in which pleats between irregular lines are made narrower


@dataclass(frozen=True, eq=False)
class Pleats:
    """p pleats, of the n nodes."""

    count: int
    layer: Floats  # (n,) pleat from 0, half-way between two at a crease
    place: Floats  # (n,) [m] along the axis, to and fro


def ways(along: Floats, ends: Ints, shortest: float, widest: float) -> Iterator[Pleats]:
    """Pleats of a net with nodes at `along` (n,) [m] and elements (m, 2), from wide to narrow.

    None is wider than `widest` [m].  Odd numbers of pleats come first: opposite ends of the net then lie at
    opposite ends of the stack.
    """
    level, place = _levels(along, _SAME * shortest)
    lines = place[_free(level[ends], len(place))]
    if len(lines) < 2:
        yield Pleats(1, np.zeros(len(along)), along.copy())
        return
    for creases in _choices(lines, widest):
        yield _laid(place[level], lines, creases, _SAME * shortest)


def _levels(along: Floats, same: float) -> tuple[Ints, Floats]:
    """Number of the level of each node (n,), and the places (q,) [m] of the levels, increasing."""
    order = np.argsort(along, kind="stable")
    number = np.concatenate(([0], np.cumsum(np.diff(along[order]) > same)))
    level = np.empty(len(along), dtype=np.intp)
    level[order] = number
    return level, np.bincount(level, along) / np.bincount(level)


def _free(ends: Ints, count: int) -> Ints:
    """The levels that no element crosses, of elements between the levels `ends` (m, 2)."""
    over = np.zeros(count + 1)
    low, high = ends.min(axis=1), ends.max(axis=1)
    np.add.at(over, low[low < high] + 1, 1.0)
    np.add.at(over, high[low < high], -1.0)
    return np.flatnonzero(np.cumsum(over)[:count] == 0.0)


def _choices(lines: Floats, widest: float) -> Iterator[list[int]]:
    """Creases, as numbers of lines, of pleats from wide to narrow."""
    gaps, total = np.diff(lines), len(lines) - 1
    if lines[-1] - lines[0] <= widest:
        yield []
    if gaps.max() > widest:
        return
    if np.ptp(gaps) > _SAME * gaps.max():
        for step in range(_NARROWER):
            yield _greedy(lines, widest * (1.0 - step / _NARROWER))
        return
    for width in range(min(int(widest / gaps.mean() * (1.0 + 1e-9)), total - 1), 0, -1):
        fewest = -(-total // width)
        for count in sorted({fewest, fewest + 1}, key=lambda c: (c % 2 == 0, c)):
            outer = total - (count - 2) * width  # left for the outer two, which are narrower
            if 2 <= outer <= 2 * width:
                first = outer // 2
                yield [first + k * width for k in range(count - 1)]


def _greedy(lines: Floats, widest: float) -> list[int]:
    """Each pleat as wide as it may be, from the lower end on."""
    creases, begin = [], 0
    for k in range(1, len(lines)):
        if lines[k] - lines[begin] > widest and k - 1 > begin:
            begin = k - 1
            creases.append(begin)
    return creases


def _laid(along: Floats, lines: Floats, creases: list[int], same: float) -> Pleats:
    at = lines[np.array(creases, dtype=np.intp)]
    stops = np.concatenate(([lines[0]], at, [lines[-1]]))
    pleat = np.searchsorted(at, along - same)  # those on a crease are counted to the pleat before it
    sense = np.where(pleat % 2, -1.0, 1.0)
    begins = np.array(list(accumulate(w * (-1) ** k for k, w in enumerate(np.diff(stops))))[:-1])
    begin = np.concatenate(([0.0], begins))
    layer = pleat.astype(float)
    for line in at:
        layer[np.abs(along - line) <= same] += 0.5
    return Pleats(len(creases) + 1, layer, begin[pleat] + sense * (along - stops[pleat]))
