"""Curves of more points than a figure can show, thinned without losing an extreme."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BINS = 2000  # equal spans of time; axes of 5.3 inch at 150 dots per inch are 800 pixels wide


def thinned(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Of each of 2000 equal spans of time the first, least, largest and last point, in order of time.

    time, values : (n,); a NaN is a gap. Up to 8000 points are returned as they are.
    """
    if len(time) <= 4 * BINS:
        return time, values
    kept = []
    for start, stop in _bins(time):
        part = values[start:stop]
        least = int(np.argmin(np.where(np.isnan(part), np.inf, part)))
        largest = int(np.argmax(np.where(np.isnan(part), -np.inf, part)))
        kept += [start, start + least, start + largest, stop - 1]
    chosen = np.unique(kept)
    return time[chosen], values[chosen]


def thinned_band(time: Floats, values: Floats, extremes: Floats) -> tuple[Floats, Floats, Floats]:
    """A band between two curves (n,), each interval ending with one of the times: time and its two bounds.

    Of more than 8000 points, each of 2000 equal spans of time becomes one interval, which covers the bands
    within it.
    """
    if len(time) <= 4 * BINS:
        return time, values, extremes
    bins = _bins(time)
    lower, upper = np.minimum(values, extremes), np.maximum(values, extremes)
    starts = np.array([start for start, _ in bins])
    ends = np.array([stop - 1 for _, stop in bins])
    return time[ends], np.minimum.reduceat(lower, starts), np.maximum.reduceat(upper, starts)


def _bins(time: Floats) -> list[tuple[int, int]]:
    """First row, and that after the last, of each span that holds a time."""
    bounds = np.searchsorted(time, np.linspace(time[0], time[-1], BINS + 1)[1:-1])
    edges = np.unique([0, *bounds.tolist(), len(time)]).tolist()
    return list(itertools.pairwise(edges))
