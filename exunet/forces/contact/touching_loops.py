"""The force on a straight thread that touches a surface, as compiled loops.

It is integrated over the pieces of the thread in which the same solids are touched at the same kind of face,
edge or corner, see `span_loops`: there the distance is analytic, and Gauss and Legendre's rule converges like
(h / l)^(2n), with h the distance from the core and l half the length of the piece.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.blend_loops import deeper
from exunet.forces.contact.core_loops import core_vector, from_core, is_flat
from exunet.forces.contact.law import sum_place
from exunet.forces.contact.span_loops import SPANS, distance_of


def touch(c: Any, thick: float, v: Any, w: Any, m: int, sums: Any) -> bool:
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
            touch_between(c, thick, v, w, splits[k], splits[k + 1], sums)
    return sums[10] > 0.0


def touch_between(c: Any, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece in which the depth is analytic, parted where 1 + a p' is zero."""
    spans = c.spans
    middle = 0.5 * (low + high)
    touched = 0
    one = 0
    for n in range(c.kind.size):
        if spans[n, 0] < middle < spans[n, 1]:
            touched += 1
            one = n
    if touched == 1:
        touch_one(c, one, thick, v, w, low, high, sums)
    elif touched > 1:
        touch_several(c, thick, v, w, low, high, sums)


def rule_for(half: float, near: float) -> Any:
    """Equal parts of a piece, and the first and last of the rule's places for each, by h / l."""
    ratio = half / max(near, 1e-3 * half)
    if ratio < 0.06:
        return 1, 2, 6
    return min(16, 1 + int(2.7 * ratio)), 6, 14


def length_of(line: Any) -> float:
    """Of the thread [m]."""
    return math.sqrt(line[3] * line[3] + line[4] * line[4] + line[5] * line[5])


def distance_at(c: Any, n: int, s: float) -> Any:
    """Distance of a place s of the thread from core n, and its gradient in the core's axes."""
    line = c.lines[n]
    return distance_of(c, n, line[0] + s * line[3], line[1] + s * line[4], line[2] + s * line[5])


def touch_one(c: Any, n: int, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece that touches core n alone, worked out in the core's axes."""
    line = c.lines[n]
    middle = 0.5 * (low + high)
    size = c.numbers[n]
    x, y, z = line[0] + middle * line[3], line[1] + middle * line[4], line[2] + middle * line[5]
    parts, first, last = 1, 0, 2
    if not is_flat(c.kind[n], size[0], size[1], size[2], x, y, z):
        near, _, _, _ = distance_at(c, n, middle)
        begin, _, _, _ = distance_at(c, n, low)
        end, _, _, _ = distance_at(c, n, high)
        parts, first, last = rule_for(0.5 * (high - low) * length_of(line), min(near, min(begin, end)))
    reach = c.rounding[n] + thick
    o = core_vector(c, n, v[0], v[1], v[2])
    u = core_vector(c, n, w[0] - v[0], w[1] - v[1], w[2] - v[2])
    cut = high
    if c.damping > 0.0:
        cut = cut_between(c, n, o, u, low, high)
    a, b, d, e, f, g = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for side in range(2):
        begin = low if side == 0 else cut
        width = ((cut if side == 0 else high) - begin) / parts
        if width > 0.0:
            for part in range(parts):
                for k in range(first, last):
                    s = begin + width * (part + c.rule[0, k])
                    distance, p, q, r = distance_at(c, n, s)
                    depth = reach - distance
                    if depth > 0.0:
                        rate = -(p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))
                        own = sum_place(c, depth, rate, s, width * c.rule[1, k], sums)
                        a += own * p
                        b += own * q
                        d += own * r
                        own *= s
                        e += own * p
                        f += own * q
                        g += own * r
    a, b, d = from_core(c, n, a, b, d)
    e, f, g = from_core(c, n, e, f, g)
    sums[0] += a
    sums[1] += b
    sums[2] += d
    sums[3] += e
    sums[4] += f
    sums[5] += g


def cut_between(c: Any, n: int, o: Any, u: Any, low: float, high: float) -> float:
    """Where 1 + a p' is zero on core n, by false position (Illinois); `high` where it is not.

    o, u : (3) velocity where the thread begins, and what it changes by until its end, in the core's axes
    """
    begin = opening(c, n, o, u, low)
    end = opening(c, n, o, u, high)
    if (begin < 0.0) == (end < 0.0):
        return high
    side = 0
    s = high
    for _ in range(60):
        s = (low * end - high * begin) / (end - begin)
        now = opening(c, n, o, u, s)
        if abs(now) < 1e-13 or high - low < 1e-14:
            break
        if (now < 0.0) == (begin < 0.0):
            low, begin = s, now
            end = 0.5 * end if side == 1 else end
            side = 1
        else:
            high, end = s, now
            begin = 0.5 * begin if side == 2 else begin
            side = 2
    return s


def opening(c: Any, n: int, o: Any, u: Any, s: float) -> float:
    """1 + a p' at a place of the thread, on core n; o, u : as of `cut_between`."""
    _, p, q, r = distance_at(c, n, s)
    return 1.0 - c.damping * (p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))


def touch_several(c: Any, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece that touches more cores than one."""
    spans = c.spans
    middle = 0.5 * (low + high)
    near = np.inf
    half = 0.0
    for n in range(c.kind.size):
        if spans[n, 0] < middle < spans[n, 1]:
            half = 0.5 * (high - low) * length_of(c.lines[n])
            for s in (low, middle, high):
                d, _, _, _ = distance_at(c, n, s)
                near = min(near, d)
    parts, first, last = rule_for(half, near)
    parts = max(parts, parts_of_seam(c, thick, v, w, low, high))
    cut = high
    if c.damping > 0.0:
        begins = opening_of_several(c, thick, v, w, low)
        ends = opening_of_several(c, thick, v, w, high)
        if (begins < 0.0) != (ends < 0.0):
            below, above = low, high
            for _ in range(60):
                cut = 0.5 * (below + above)
                if (opening_of_several(c, thick, v, w, cut) < 0.0) == (begins < 0.0):
                    below = cut
                else:
                    above = cut
    for side in range(2):
        begin = low if side == 0 else cut
        width = ((cut if side == 0 else high) - begin) / parts
        if width > 0.0:
            for part in range(parts):
                for k in range(first, last):
                    s = begin + width * (part + c.rule[0, k])
                    depth, rate, p, q, r = depth_at(c, thick, v, w, s)
                    if depth > 0.0:
                        own = sum_place(c, depth, rate, s, width * c.rule[1, k], sums)
                        sums[0] += own * p
                        sums[1] += own * q
                        sums[2] += own * r
                        own *= s
                        sums[3] += own * p
                        sums[4] += own * q
                        sums[5] += own * r


def parts_of_seam(c: Any, thick: float, v: Any, w: Any, low: float, high: float) -> int:
    """Equal parts of a piece that touches several cores: enough for where one becomes deeper than another.

    The eighth powers of the depths p change over there while their difference changes by p / 8.
    """
    middle = 0.5 * (low + high)
    least, most = np.inf, -np.inf
    for n in range(c.kind.size):
        if c.spans[n, 0] < middle < c.spans[n, 1]:
            begin, _, _, _ = distance_at(c, n, low)
            end, _, _, _ = distance_at(c, n, high)
            least = min(least, end - begin)
            most = max(most, end - begin)
    deep = np.inf
    for s in (low, middle, high):
        depth, _, _, _, _ = depth_at(c, thick, v, w, s)
        deep = min(deep, depth)
    ratio = 8.0 * (most - least) / max(deep, 1e-3 * (most - least) + 1e-300)
    return int(min(max(ratio, 4.0), 64.0))


def depth_at(c: Any, thick: float, v: Any, w: Any, s: float) -> Any:
    """Depth [m], its rate [m/s], and the direction (3) of the force at a place s of the thread.

    Of several solids as `deeper`.
    """
    o = v[0] + s * (w[0] - v[0])
    p = v[1] + s * (w[1] - v[1])
    q = v[2] + s * (w[2] - v[2])
    found = (0.0, 0.0, 0.0, 0.0)
    for n in range(c.kind.size):
        if c.spans[n, 0] <= s <= c.spans[n, 1]:
            distance, g, h, m = distance_at(c, n, s)
            own = c.rounding[n] + thick - distance
            if own > 0.0:
                found = deeper(found, own, from_core(c, n, g, h, m))
    depth, i, j, k = found
    rate = -(i * o + j * p + k * q)
    return depth, rate, i, j, k


def opening_of_several(c: Any, thick: float, v: Any, w: Any, s: float) -> float:
    """1 + a p' at a place of the thread."""
    _, rate, _, _, _ = depth_at(c, thick, v, w, s)
    return 1.0 + c.damping * rate


TOUCHING = (
    *SPANS,
    distance_at,
    length_of,
    rule_for,
    deeper,
    depth_at,
    parts_of_seam,
    opening,
    opening_of_several,
    cut_between,
    sum_place,
    touch_one,
    touch_several,
    touch_between,
    touch,
)
