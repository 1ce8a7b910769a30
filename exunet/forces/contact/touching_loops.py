"""Where a straight thread touches a surface, and the force on it, as compiled loops.

The thread goes from a to b, (3,) each in the body's principal axes, as a + s (b - a), 0 <= s <= 1. The
distance from a convex core is convex along it, so that it touches each solid in one piece at most. The force
is integrated over the pieces in which the same solids are touched at the same kind of face, edge or corner:
there the distance is analytic, and Gauss and Legendre's rule converges like (h / l)^(2n), with h the distance
from the core and l half the length of the piece.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.core_loops import (
    core_distance,
    core_gradient,
    core_point,
    core_vector,
    is_flat,
)


def span(c: Any, n: int, reach: float, a: Any, b: Any) -> Any:
    """The piece (low, high) of the thread that is less than `reach` [m] from core n; (1, 0): none is."""
    p, q, r = core_point(c, n, a[0], a[1], a[2])
    d, e, f = core_vector(c, n, b[0] - a[0], b[1] - a[1], b[2] - a[2])
    none = (1.0, 0.0)
    middle, _, _, _ = distance_of(c, n, p + 0.5 * d, q + 0.5 * e, r + 0.5 * f)
    if middle - reach > 0.5 * math.sqrt(d * d + e * e + f * f):
        return none
    begin, i, j, k = distance_of(c, n, p, q, r)
    begin -= reach
    falls = i * d + j * e + k * f
    end, i, j, k = distance_of(c, n, p + d, q + e, r + f)
    end -= reach
    rises = i * d + j * e + k * f
    if begin < 0.0 and end < 0.0:
        return 0.0, 1.0
    low, high = 0.0, 1.0
    if begin >= 0.0 and end >= 0.0:
        # Two tangents from outside meet below the lowest point between them (Kelley's cutting planes).
        inside = False
        for _ in range(60):
            if falls >= 0.0 or rises <= 0.0:
                return none
            s = (end - begin + falls * low - rises * high) / (falls - rises)
            if begin + falls * (s - low) >= 0.0 or not low < s < high:
                return none
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
            return none
    if begin >= 0.0:  # Newton's method on a convex function comes from outside, and does not pass the root
        for _ in range(60):
            if falls >= 0.0:
                return none
            step = -begin / falls
            low += step
            begin, i, j, k = distance_of(c, n, p + low * d, q + low * e, r + low * f)
            begin -= reach
            falls = i * d + j * e + k * f
            if begin <= 0.0 or step < 1e-16:
                break
    if end >= 0.0:
        for _ in range(60):
            if rises <= 0.0:
                return none
            step = end / rises
            high -= step
            end, i, j, k = distance_of(c, n, p + high * d, q + high * e, r + high * f)
            end -= reach
            rises = i * d + j * e + k * f
            if end <= 0.0 or step < 1e-16:
                break
    if not low < high:
        return none
    return low, high


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


def split_at_edges(c: Any, n: int, a: Any, b: Any, low: float, high: float, splits: Any, m: int) -> int:
    """Put the places where the nearest face, edge or corner of core n changes among the splits."""
    p = core_point(c, n, a[0], a[1], a[2])
    d = core_vector(c, n, b[0] - a[0], b[1] - a[1], b[2] - a[2])
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


def may_touch(c: Any, n: int, thick: float, a: Any, b: Any) -> bool:
    """True if a thread reaches into the box along the principal axes around core n and its rounding."""
    box = c.boxes[n]
    for axis in range(3):
        if max(a[axis], b[axis]) < box[axis] - thick or min(a[axis], b[axis]) > box[3 + axis] + thick:
            return False
    return True


def find_spans(c: Any, thick: float, a: Any, b: Any) -> int:
    """Where a thread touches each core, into c.spans, and where pieces of it begin and end, into c.splits.

    c : a `ThreadContact`; thick : the thread's radius [m]. How many splits there are; 0: it does not touch.
    """
    splits = c.splits
    spans = c.spans
    m = 0
    for n in range(c.kind.size):
        low, high = 1.0, 0.0
        if may_touch(c, n, thick, a, b):
            low, high = span(c, n, c.rounding[n] + thick, a, b)
        spans[n, 0] = low
        spans[n, 1] = high
        if low < high:
            if m + 2 > splits.size:
                break
            splits[m] = low
            splits[m + 1] = high
            m = split_at_edges(c, n, a, b, low, high, splits, m + 2)
    order(splits, m)
    return m


def touch(c: Any, thick: float, a: Any, b: Any, v: Any, w: Any, m: int, sums: Any) -> bool:
    """Integrals over where a thread touches into `sums`, once `find_spans` has found m splits; if it does.

    v, w : (3) velocities of its ends against the body's points there, in its axes [m/s]
    sums : (12,) of f n (3), of s f n (3), of f, of s f, of (f - F) p', of F p / 2, then the largest depth,
           and where: [N/m] and so on, of a thread of length 1. All f are 0 of one that leaves fast
    """
    splits = c.splits
    for k in range(12):
        sums[k] = 0.0
    for k in range(m - 1):
        if splits[k + 1] - splits[k] > 1e-14:
            touch_between(c, thick, a, b, v, w, splits[k], splits[k + 1], sums)
    return sums[10] > 0.0


def touch_between(
    c: Any, thick: float, a: Any, b: Any, v: Any, w: Any, low: float, high: float, sums: Any
) -> None:
    """Add the integrals over a piece in which the depth is analytic, parted where 1 + a p' is zero."""
    spans = c.spans
    middle = 0.5 * (low + high)
    touched = 0
    one = 0
    near = np.inf
    for n in range(c.kind.size):
        if spans[n, 0] < middle < spans[n, 1]:
            touched += 1
            one = n
            for s in (low, middle, high):
                p, q, r = core_point(
                    c, n, a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])
                )
                d, _, _, _ = distance_of(c, n, p, q, r)
                near = min(near, d)
    if touched == 0:
        return
    size = c.numbers[one]
    p, q, r = core_point(
        c,
        one,
        a[0] + middle * (b[0] - a[0]),
        a[1] + middle * (b[1] - a[1]),
        a[2] + middle * (b[2] - a[2]),
    )
    flat = touched == 1 and is_flat(c.kind[one], size[0], size[1], size[2], p, q, r)
    half = 0.5 * (high - low) * math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    parts = 1
    first = 0
    last = 2
    if not flat:
        ratio = half / max(near, 1e-3 * half)
        first = 2 if ratio < 0.06 else 6
        last = 6 if ratio < 0.06 else 14
        parts = 1 if ratio < 0.06 else min(16, 1 + int(2.7 * ratio))
        parts = max(parts, 4) if touched > 1 else parts
    cut = high
    if c.damping > 0.0:
        begins = opening(c, thick, a, b, v, w, low)
        ends = opening(c, thick, a, b, v, w, high)
        if (begins < 0.0) != (ends < 0.0):
            below, above = low, high
            for _ in range(60):
                cut = 0.5 * (below + above)
                if (opening(c, thick, a, b, v, w, cut) < 0.0) == (begins < 0.0):
                    below = cut
                else:
                    above = cut
    for side in range(2):
        begin = low if side == 0 else cut
        width = ((cut if side == 0 else high) - begin) / parts
        if width > 0.0:
            for part in range(parts):
                for g in range(first, last):
                    s = begin + width * (part + c.rule[0, g])
                    touch_at(c, thick, a, b, v, w, s, width * c.rule[1, g], sums)


def depth_at(c: Any, thick: float, a: Any, b: Any, v: Any, w: Any, s: float) -> Any:
    """Depth [m], its rate [m/s], and the direction (3) of the force at a place s of the thread.

    Of more solids the depths count as (sum p^8)^(1/8).
    """
    d = b[0] - a[0]
    e = b[1] - a[1]
    f = b[2] - a[2]
    x = a[0] + s * d
    y = a[1] + s * e
    z = a[2] + s * f
    o = v[0] + s * (w[0] - v[0])
    p = v[1] + s * (w[1] - v[1])
    q = v[2] + s * (w[2] - v[2])
    depth = 0.0
    rate = 0.0
    i = 0.0
    j = 0.0
    k = 0.0
    touched = 0
    for n in range(c.kind.size):
        if c.spans[n, 0] <= s <= c.spans[n, 1]:
            distance, g, h, m = core_gradient(c, n, x, y, z)
            own = c.rounding[n] + thick - distance
            if own > 0.0:
                touched += 1
                if touched == 1:
                    depth = own
                    i, j, k = g, h, m
                else:
                    most = max(own, depth)
                    both = most * (1.0 + (min(own, depth) / most) ** 8) ** 0.125
                    before = (depth / both) ** 7
                    after = (own / both) ** 7
                    i = before * i + after * g
                    j = before * j + after * h
                    k = before * k + after * m
                    depth = both
    rate = -(i * o + j * p + k * q)
    return depth, rate, i, j, k


def opening(c: Any, thick: float, a: Any, b: Any, v: Any, w: Any, s: float) -> float:
    """1 + a p' at a place of the thread."""
    _, rate, _, _, _ = depth_at(c, thick, a, b, v, w, s)
    return 1.0 + c.damping * rate


def touch_at(
    c: Any, thick: float, a: Any, b: Any, v: Any, w: Any, s: float, weight: float, sums: Any
) -> None:
    """Add what a place s of the thread gives."""
    depth, rate, i, j, k = depth_at(c, thick, a, b, v, w, s)
    if depth <= 0.0:
        return
    elastic = c.stiffness * depth
    f = elastic * max(1.0 + c.damping * rate, 0.0)
    own = weight * f
    sums[0] += own * i
    sums[1] += own * j
    sums[2] += own * k
    own *= s
    sums[3] += own * i
    sums[4] += own * j
    sums[5] += own * k
    sums[6] += weight * f
    sums[7] += own
    sums[8] += weight * (f - elastic) * rate
    sums[9] += 0.5 * weight * elastic * depth
    if depth > sums[10]:
        sums[10] = depth
        sums[11] = s


TOUCHING = (
    span,
    distance_of,
    split,
    split_at_cone,
    split_at_edges,
    order,
    depth_at,
    opening,
    touch_at,
    touch_between,
    may_touch,
    find_spans,
    touch,
)
