"""Where a straight thread is near each core of a body, as compiled loops.

The thread goes from a to b, (3,) each in the body's principal axes, as a + s (b - a), 0 <= s <= 1. The
distance from a convex core is convex along it, so that it touches each solid in one piece at most; the pieces
are parted where the nearest face, edge or corner changes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.core_loops import core_distance, core_point, core_vector, gap_to_box


def lay(c: Any, n: int, a: Any, b: Any) -> None:
    """Put the thread into the axes of core n: its beginning and b - a there, c.lines[n]."""
    line = c.lines[n]
    line[0], line[1], line[2] = core_point(c, n, a[0], a[1], a[2])
    line[3], line[4], line[5] = core_vector(c, n, b[0] - a[0], b[1] - a[1], b[2] - a[2])


def span(c: Any, n: int, reach: float) -> Any:
    """The piece (low, high) of the thread that is less than `reach` [m] from core n; (1, 0): none is.

    And how far beyond `reach` all of it is at least [m], by the tangents of the distance, which is convex.
    """
    line = c.lines[n]
    p, q, r = line[0], line[1], line[2]
    d, e, f = line[3], line[4], line[5]
    middle, _, _, _ = distance_of(c, n, p + 0.5 * d, q + 0.5 * e, r + 0.5 * f)
    apart = middle - reach - 0.5 * math.sqrt(d * d + e * e + f * f)
    if apart > 0.0:
        return 1.0, 0.0, apart
    begin, i, j, k = distance_of(c, n, p, q, r)
    begin -= reach
    falls = i * d + j * e + k * f
    end, i, j, k = distance_of(c, n, p + d, q + e, r + f)
    end -= reach
    rises = i * d + j * e + k * f
    if begin < 0.0 and end < 0.0:
        return 0.0, 1.0, 0.0
    low, high = 0.0, 1.0
    if begin >= 0.0 and end >= 0.0:
        # Two tangents from outside meet below the lowest point between them (Kelley's cutting planes).
        inside = False
        for _ in range(60):
            if falls >= 0.0 or rises <= 0.0:
                return 1.0, 0.0, begin if falls >= 0.0 else end
            s = (end - begin + falls * low - rises * high) / (falls - rises)
            least = begin + falls * (s - low)
            if least >= 0.0 or not low < s < high:
                return 1.0, 0.0, max(least, 0.0)
            f_s, i, j, k = distance_of(c, n, p + s * d, q + s * e, r + s * f)
            f_s -= reach
            if f_s < 0.0:
                inside = True
                break
            slope = i * d + j * e + k * f
            if slope < 0.0:
                low, begin, falls = s, f_s, slope
            else:
                high, end, rises = s, f_s, slope
        if not inside:
            return 1.0, 0.0, 0.0
    if begin >= 0.0:  # Newton's method on a convex function comes from outside, and does not pass the root
        for _ in range(60):
            if falls >= 0.0:
                return 1.0, 0.0, 0.0
            step = -begin / falls
            low += step
            if step < 1e-9:
                break
            begin, i, j, k = distance_of(c, n, p + low * d, q + low * e, r + low * f)
            begin -= reach
            falls = i * d + j * e + k * f
            if begin <= 0.0:
                break
    if end >= 0.0:
        for _ in range(60):
            if rises <= 0.0:
                return 1.0, 0.0, 0.0
            step = end / rises
            high -= step
            if step < 1e-9:
                break
            end, i, j, k = distance_of(c, n, p + high * d, q + high * e, r + high * f)
            end -= reach
            rises = i * d + j * e + k * f
            if end <= 0.0:
                break
    if not low < high:
        return 1.0, 0.0, 0.0
    return low, high, 0.0


def distance_of(c: Any, n: int, x: float, y: float, z: float) -> Any:
    """`core_distance` of core n."""
    return core_distance(c.kind[n], c.numbers[n, 0], c.numbers[n, 1], c.numbers[n, 2], x, y, z)


def split(s: float, low: float, high: float, splits: Any, m: int) -> int:
    """Put s among the splits, of which there are m, if it is between low and high; how many there are."""
    if low < s < high and m < splits.size:
        splits[m] = s
        return m + 1
    return m


def split_at_cone(
    p: Any, d: Any, width: float, slope: float, low: float, high: float, splits: Any, m: int
) -> int:
    """As `split`, where the line p + s d crosses x^2 + y^2 = (width + slope z)^2."""
    w = width + slope * p[2]
    g = slope * d[2]
    square = d[0] * d[0] + d[1] * d[1] - g * g
    half = p[0] * d[0] + p[1] * d[1] - w * g
    rest = p[0] * p[0] + p[1] * p[1] - w * w
    root = half * half - square * rest
    if root <= 0.0:
        return m
    root = math.sqrt(root)
    far = -half - root if half > 0.0 else -half + root
    if far != 0.0:
        m = split(rest / far, low, high, splits, m)
    if square != 0.0:
        m = split(far / square, low, high, splits, m)
    return m


def split_at_edges(c: Any, n: int, low: float, high: float, splits: Any, m: int) -> int:
    """Put the places where the nearest face, edge or corner of core n changes among the splits."""
    line = c.lines[n]
    p = (line[0], line[1], line[2])
    d = (line[3], line[4], line[5])
    kind = c.kind[n]
    size = c.numbers[n]
    if kind == 0:
        for axis in range(3):
            if d[axis] != 0.0:
                m = split((size[axis] - p[axis]) / d[axis], low, high, splits, m)
                m = split((-size[axis] - p[axis]) / d[axis], low, high, splits, m)
        return m
    if kind == 2:
        return m
    end = size[0] if kind == 3 else size[1] if kind == 1 else size[2]
    if d[2] != 0.0:
        m = split((end - p[2]) / d[2], low, high, splits, m)
        m = split((-end - p[2]) / d[2], low, high, splits, m)
    if kind == 1:
        m = split_at_cone(p, d, size[0], 0.0, low, high, splits, m)
    if kind == 4:
        m = split_at_cone(p, d, size[0], 0.0, low, high, splits, m)
        m = split_at_cone(p, d, size[1], 0.0, low, high, splits, m)
        rise = size[1] - size[0]
        if rise != 0.0:  # the cones around the rims, across the side
            slope = -2.0 * size[2] / rise
            m = split_at_cone(p, d, size[0] + slope * size[2], slope, low, high, splits, m)
            m = split_at_cone(p, d, size[1] - slope * size[2], slope, low, high, splits, m)
    return m


def order(splits: Any, m: int) -> None:
    """Sort the first m."""
    for k in range(1, m):
        value = splits[k]
        i = k - 1
        while i >= 0 and splits[i] > value:
            splits[i + 1] = splits[i]
            i -= 1
        splits[i + 1] = value


def find_spans(c: Any, thick: float, a: Any, b: Any) -> Any:
    """Where a thread touches each core, into c.spans, and where pieces of it begin and end, into c.splits.

    c : a `ThreadContact`; thick : the thread's radius [m]. How many splits there are, 0: it does not touch;
    and how far from all cores it is at least, beyond what would touch [m].
    """
    splits = c.splits
    spans = c.spans
    clear = np.inf
    m = 0
    for n in range(c.kind.size):
        low, high = 1.0, 0.0
        apart = gap_to_box(c, n, thick, a, b)
        if apart <= 0.0:
            lay(c, n, a, b)
            low, high, apart = span(c, n, c.rounding[n] + thick)
        clear = min(clear, apart)
        spans[n, 0] = low
        spans[n, 1] = high
        if low < high:
            if m + 2 > splits.size:
                break
            splits[m] = low
            splits[m + 1] = high
            m = split_at_edges(c, n, low, high, splits, m + 2)
    order(splits, m)
    return m, clear


def touches_at(c: Any, s: float) -> bool:
    """True if the thread that `find_spans` looked at last touches at s."""
    touches = False
    for n in range(c.kind.size):
        touches = touches or c.spans[n, 0] < s < c.spans[n, 1]
    return touches


SPANS = (lay, span, distance_of, split, split_at_cone, split_at_edges, order, find_spans)
