"""Contact of straight threads with the surface of a body, as compiled loops.

The thread goes from a to b, (3,) each in the body's principal axes, as a + s (b - a), 0 <= s <= 1. The
distance from a convex core is convex along it, so that it touches each solid in one piece at most; the pieces
are parted where the nearest face, edge or corner changes.

It is integrated over the pieces of the thread in which the same solids are touched at the same kind of face,
edge or corner, see `find_spans`: there the distance is analytic, and Gauss and Legendre's rule converges like
(h / l)^(2n), with h the distance from the core and l half the length of the piece.

As the core is not convex, a thread may touch it in many pieces. It is cut into equal ones of about a cell of
its length at rest, with Gauss and Legendre's rule of two places in each. Where these are on the thread does
not depend on the state, so the force is as continuous as the gradient of the distance, and it is just the
gradient of the sum that the potential is. Pieces that are too far away to touch are left out, which changes
no bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.broad_phase import (
    begin_resultant,
    choose_near,
    end_resultant,
    is_near,
    keep_row,
    remember_status,
)
from exunet.forces.contact.law import friction, regularised_friction, shift_for, sum_place
from exunet.forces.contact.signed_distance import (
    apply_at_point,
    core_distance,
    core_point,
    core_vector,
    deeper,
    from_core,
    gap_to_box,
    is_flat,
    place_in_body,
    sampled_distance,
    turn_into,
    velocity_against_body,
)


def lay(c: Any, n: int, a: Any, b: Any) -> None:
    """Put the thread into the axes of core n: its beginning and b - a there, c.work.lines[n]."""
    line = c.work.lines[n]
    line[0], line[1], line[2] = core_point(c.cores, n, a[0], a[1], a[2])
    line[3], line[4], line[5] = core_vector(c.cores, n, b[0] - a[0], b[1] - a[1], b[2] - a[2])


def span(c: Any, n: int, reach: float) -> Any:
    """The piece (low, high) of the thread that is less than `reach` [m] from core n; (1, 0): none is.

    And how far beyond `reach` all of it is at least [m], by the tangents of the distance, which is convex.
    """
    line = c.work.lines[n]
    if c.cores.kind[n] == 0:
        return span_of_box(c.cores.numbers[n], line, reach)
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


def span_of_box(size: Any, line: Any, reach: float) -> Any:
    """As `span`, of a box with the half edges `size`, exactly.

    Between the places where the thread passes the planes of the faces, the squared distance is a quadratic:
    (square u + 2 half) u + rest of the way u from the middle of such a piece, less reach^2.
    """
    low, high = 1.0, 0.0
    least = np.inf
    begin = 0.0
    while begin < 1.0:
        end = 1.0
        for axis in range(3):
            if line[3 + axis] != 0.0:
                for face in (-size[axis], size[axis]):
                    s = (face - line[axis]) / line[3 + axis]
                    if begin < s < end:
                        end = s
        middle = 0.5 * (begin + end)
        width = 0.5 * (end - begin)
        square, half, rest = 0.0, 0.0, -reach * reach
        for axis in range(3):
            d = line[3 + axis]
            place = line[axis] + middle * d
            out = abs(place) - size[axis]
            if out > 0.0:
                square += d * d
                half += out * d if place > 0.0 else -out * d
                rest += out * out
        u = width if half < 0.0 else -width
        if abs(half) < square * width:
            u = -half / square
        lowest = (square * u + 2.0 * half) * u + rest
        least = min(least, lowest)
        if lowest < 0.0:
            first, last = begin, end
            root = math.sqrt(max(half * half - square * rest, 0.0))
            if (square * width - 2.0 * half) * width + rest >= 0.0:
                first = middle + ((-half - root) / square if half > 0.0 else rest / (root - half))
            if (square * width + 2.0 * half) * width + rest >= 0.0:
                last = middle + ((root - half) / square if half < 0.0 else -rest / (half + root))
            if first < last:
                low = min(low, first)
                high = max(high, last)
        begin = end
    if low < high:
        return low, high, 0.0
    return 1.0, 0.0, math.sqrt(max(least, 0.0) + reach * reach) - reach


def distance_of(c: Any, n: int, x: float, y: float, z: float) -> Any:
    """`core_distance` of core n."""
    cores = c.cores
    return core_distance(
        cores.kind[n], cores.numbers[n, 0], cores.numbers[n, 1], cores.numbers[n, 2], x, y, z
    )


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
    line = c.work.lines[n]
    p = (line[0], line[1], line[2])
    d = (line[3], line[4], line[5])
    kind = c.cores.kind[n]
    size = c.cores.numbers[n]
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
    """Where a thread touches each core, into `spans`, and where pieces of it begin and end, into `splits`.

    c : a `ThreadContact`; thick : the thread's radius [m]. How many splits there are, 0: it does not touch;
    and how far from all cores it is at least, beyond what would touch [m].
    """
    splits = c.work.splits
    spans = c.work.spans
    clear = np.inf
    m = 0
    for n in range(c.cores.kind.size):
        low, high = 1.0, 0.0
        apart = gap_to_box(c.cores, n, thick, a, b)
        if apart <= 0.0:
            lay(c, n, a, b)
            low, high, apart = span(c, n, c.cores.rounding[n] + thick)
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
    for n in range(c.cores.kind.size):
        touches = touches or c.work.spans[n, 0] < s < c.work.spans[n, 1]
    return touches


SPANS = (lay, span, span_of_box, distance_of, split, split_at_cone, split_at_edges, order, find_spans)


def touch(c: Any, thick: float, v: Any, w: Any, m: int, sums: Any) -> bool:
    """Integrals over where a thread touches into `sums`, once `find_spans` has found m splits; if it does.

    v, w : (3) velocities of its ends against the body's points there, in its axes [m/s]
    sums : (12,) of f n (3), of s f n (3), of f, of s f, of (f - F) p', of F p / 2, then the largest depth,
           and where: [N/m] and so on, of a thread of length 1. All f are 0 of one that leaves fast
    """
    splits = c.work.splits
    for k in range(12):
        sums[k] = 0.0
    for k in range(m - 1):
        if splits[k + 1] - splits[k] > 1e-14:
            touch_between(c, thick, v, w, splits[k], splits[k + 1], sums)
    return sums[10] > 0.0


def touch_between(c: Any, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece in which the depth is analytic, parted where 1 + a p' is zero."""
    spans = c.work.spans
    middle = 0.5 * (low + high)
    touched = 0
    one = 0
    for n in range(c.cores.kind.size):
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
    """Return the length of the thread [m]."""
    return math.sqrt(line[3] * line[3] + line[4] * line[4] + line[5] * line[5])


def distance_at(c: Any, n: int, s: float) -> Any:
    """Distance of a place s of the thread from core n, and its gradient in the core's axes."""
    line = c.work.lines[n]
    return distance_of(c, n, line[0] + s * line[3], line[1] + s * line[4], line[2] + s * line[5])


def touch_one(c: Any, n: int, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece that touches core n alone, worked out in the core's axes."""
    line = c.work.lines[n]
    middle = 0.5 * (low + high)
    size = c.cores.numbers[n]
    x, y, z = line[0] + middle * line[3], line[1] + middle * line[4], line[2] + middle * line[5]
    parts, first, last = 1, 0, 2
    if not is_flat(c.cores.kind[n], size[0], size[1], size[2], x, y, z):
        near, _, _, _ = distance_at(c, n, middle)
        begin, _, _, _ = distance_at(c, n, low)
        end, _, _, _ = distance_at(c, n, high)
        parts, first, last = rule_for(0.5 * (high - low) * length_of(line), min(near, min(begin, end)))
    reach = c.cores.rounding[n] + thick
    o = core_vector(c.cores, n, v[0], v[1], v[2])
    u = core_vector(c.cores, n, w[0] - v[0], w[1] - v[1], w[2] - v[2])
    cut = high
    if c.law.damping > 0.0:
        cut = cut_between(c, n, o, u, low, high)
    a, b, d, e, f, g = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for side in range(2):
        begin = low if side == 0 else cut
        width = ((cut if side == 0 else high) - begin) / parts
        if width > 0.0:
            for part in range(parts):
                for k in range(first, last):
                    s = begin + width * (part + c.work.rule[0, k])
                    distance, p, q, r = distance_at(c, n, s)
                    depth = reach - distance
                    if depth > 0.0:
                        rate = -(p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))
                        own = sum_place(c.law, depth, rate, s, width * c.work.rule[1, k], sums)
                        a += own * p
                        b += own * q
                        d += own * r
                        own *= s
                        e += own * p
                        f += own * q
                        g += own * r
    a, b, d = from_core(c.cores, n, a, b, d)
    e, f, g = from_core(c.cores, n, e, f, g)
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
    return 1.0 - c.law.damping * (p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))


def touch_several(c: Any, thick: float, v: Any, w: Any, low: float, high: float, sums: Any) -> None:
    """Add the integrals over a piece that touches more cores than one."""
    spans = c.work.spans
    middle = 0.5 * (low + high)
    near = np.inf
    half = 0.0
    for n in range(c.cores.kind.size):
        if spans[n, 0] < middle < spans[n, 1]:
            half = 0.5 * (high - low) * length_of(c.work.lines[n])
            for s in (low, middle, high):
                d, _, _, _ = distance_at(c, n, s)
                near = min(near, d)
    parts, first, last = rule_for(half, near)
    parts = max(parts, parts_of_seam(c, thick, v, w, low, high))
    cut = high
    if c.law.damping > 0.0:
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
                    s = begin + width * (part + c.work.rule[0, k])
                    depth, rate, p, q, r = depth_at(c, thick, v, w, s)
                    if depth > 0.0:
                        own = sum_place(c.law, depth, rate, s, width * c.work.rule[1, k], sums)
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
    for n in range(c.cores.kind.size):
        if c.work.spans[n, 0] < middle < c.work.spans[n, 1]:
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
    for n in range(c.cores.kind.size):
        if c.work.spans[n, 0] <= s <= c.work.spans[n, 1]:
            distance, g, h, m = distance_at(c, n, s)
            own = c.cores.rounding[n] + thick - distance
            if own > 0.0:
                found = deeper(found, own, from_core(c.cores, n, g, h, m))
    depth, i, j, k = found
    rate = -(i * o + j * p + k * q)
    return depth, rate, i, j, k


def opening_of_several(c: Any, thick: float, v: Any, w: Any, s: float) -> float:
    """1 + a p' at a place of the thread."""
    _, rate, _, _, _ = depth_at(c, thick, v, w, s)
    return 1.0 + c.law.damping * rate


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


def sampled_at(c: Any, s: float) -> Any:
    """`sampled_distance` at a place of the thread in c.work.lines."""
    line = c.work.lines[0]
    x, y, z = line[0] + s * line[3], line[1] + s * line[4], line[2] + s * line[5]
    return sampled_distance(c.cores.samples, x, y, z)


def list_pieces(c: Any, k: int, a: Any, b: Any) -> None:
    """List the pieces of the thread of pair k that are near the sampled core, and for how long this is right.

    a, b : (3) where its ends are in the body's axes [m]
    """
    pieces = c.threads.pieces[k]
    m, one = 0, 0
    right = gap_to_box(c.cores, 0, c.threads.thick[k], a, b)
    if right <= 0.0:
        width = lay_sampled(c, a, b) / pieces
        reach = c.cores.rounding[0] + c.threads.thick[k]
        room = reach + 0.5 * c.cores.samples.cell + c.work.rule[0, 1] * width
        skin = c.near.skin
        right = np.inf
        while one < pieces:
            d, _, _, _ = sampled_at(c, (one + c.work.rule[0, 0]) / pieces)
            free = d - room
            if free > skin:
                further = pieces
                if 0.5 * (free - skin) < pieces * width:
                    further = int(0.5 * (free - skin) / width)
                right = min(right, free - min(further, pieces) * width)
                one += 1 + further
                continue
            p, _, _, _ = sampled_at(c, (one + c.work.rule[0, 1]) / pieces)
            right = min(right, skin)
            apart = min(d, p) - reach
            if not apart > largest_drop(c, skin):
                c.near.pieces[k, m] = one
                c.near.apart[k, m] = apart
                m += 1
            one += 1
    c.near.listed_pieces[k] = m
    keep_clear(c, k, a, b, right)


def largest_drop(c: Any, moved: float) -> float:
    """Bound [m] of how much the sampled distance falls along a way [m].

    Its slope is below 3^(1/2) 1.5 1.25^2, as the weights' sizes have sums up to 1.25, and those of their
    slopes, of the differences of points, up to 1.5. Beside the way itself it falls by up to 0.69 of a cell,
    where the distance has kinks: the largest value of a linear program over samples that differ by no more
    than their distance.
    """
    return min(4.06 * moved, moved + 0.7 * c.cores.samples.cell)


def lay_sampled(c: Any, a: Any, b: Any) -> float:
    """Put the thread into the axes of the sampled core, as `lay`; its length [m]."""
    line = c.work.lines[0]
    line[0], line[1], line[2] = core_point(c.cores, 0, a[0], a[1], a[2])
    line[3], line[4], line[5] = core_vector(c.cores, 0, b[0] - a[0], b[1] - a[1], b[2] - a[2])
    return length_of(line)


def find_pieces(c: Any, k: int, a: Any, b: Any) -> int:
    """How many pieces of the thread of pair k touch; which into `splits`, how near into `found`.

    a, b : (3) where its ends are in the body's axes [m]. Only what `list_pieces` has found is looked at, and
    of that only what may have come near since then.
    """
    moved = moved_since(c, k, a, b)
    if not moved < c.near.clear[k]:
        list_pieces(c, k, a, b)
        moved = 0.0
    if c.near.listed_pieces[k] == 0 or gap_to_box(c.cores, 0, c.threads.thick[k], a, b) > 0.0:
        return 0
    lay_sampled(c, a, b)
    m = 0
    pieces = c.threads.pieces[k]
    reach = c.cores.rounding[0] + c.threads.thick[k]
    drop = largest_drop(c, moved)
    for item in range(c.near.listed_pieces[k]):
        if c.near.apart[k, item] > drop:
            continue
        one = c.near.pieces[k, item]
        d, e, f, g = sampled_at(c, (one + c.work.rule[0, 0]) / pieces)
        p, q, r, s = sampled_at(c, (one + c.work.rule[0, 1]) / pieces)
        if min(d, p) < reach:
            found = c.work.found[m]
            found[0], found[1], found[2], found[3] = d, e, f, g
            found[4], found[5], found[6], found[7] = p, q, r, s
            c.work.splits[m] = one
            m += 1
    return m


def touch_pieces(c: Any, k: int, v: Any, w: Any, m: int, sums: Any) -> bool:
    """As `touch`: integrals over the m pieces of the thread of pair k that `find_pieces` has found."""
    for item in range(12):
        sums[item] = 0.0
    reach = c.cores.rounding[0] + c.threads.thick[k]
    o = core_vector(c.cores, 0, v[0], v[1], v[2])
    u = core_vector(c.cores, 0, w[0] - v[0], w[1] - v[1], w[2] - v[2])
    width = 1.0 / c.threads.pieces[k]
    first, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for entry in range(m):
        for g in range(2):
            s = width * (c.work.splits[entry] + c.work.rule[0, g])
            found = c.work.found[entry]
            p, q, r = found[4 * g + 1], found[4 * g + 2], found[4 * g + 3]
            depth = reach - found[4 * g]
            if depth > 0.0:
                rate = -(p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))
                own = sum_place(c.law, depth, rate, s, width * c.work.rule[1, g], sums)
                first = (first[0] + own * p, first[1] + own * q, first[2] + own * r)
                own *= s
                moment = (moment[0] + own * p, moment[1] + own * q, moment[2] + own * r)
    sums[0], sums[1], sums[2] = from_core(c.cores, 0, first[0], first[1], first[2])
    sums[3], sums[4], sums[5] = from_core(c.cores, 0, moment[0], moment[1], moment[2])
    return sums[10] > 0.0


def touches_sampled(c: Any, k: int, s: float) -> bool:
    """True if the thread of pair k, at which `find_pieces` looked last, touches at s."""
    distance, _, _, _ = sampled_at(c, s)
    return bool(distance < c.cores.rounding[0] + c.threads.thick[k])


PIECES = (
    length_of,
    sampled_at,
    lay_sampled,
    largest_drop,
    list_pieces,
    find_pieces,
    touch_pieces,
    touches_sampled,
)


def add_mesh_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """As `add_thread_contact`."""
    begin_resultant(c, force)
    for item in range(places_now(t, x, v, c)):
        k = c.near.pairs[item]
        a, b = ends_now(c, k)
        if c.near.listed_pieces[k] == 0 and is_clear(c, k, a, b):
            continue
        c.after[k, 0] = 0.0
        m = find_pieces(c, k, a, b)
        if m > 0:
            w_a, w_b = speeds_now(v, c, k, a, b)
            if touch_pieces(c, k, w_a, w_b, m, c.work.sums):
                holds = c.kept[5 * k] == 1.0 and touches_sampled(c, k, c.kept[5 * k + 1])
                apply_to_element(c, k, force, a, b, w_a, w_b, holds)
    end_resultant(c, force)


def mesh_contact_potential(x: Any, c: Any) -> float:
    """As `thread_contact_potential`."""
    turn_into(x, c.body.attitude, c.work.frame)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.threads.length.size):
        if c.kept[5 * k] >= 0.0:
            a, b = ends_at(x, c, k)
            m = find_pieces(c, k, a, b)
            if m > 0 and touch_pieces(c, k, rest, rest, m, c.work.sums):
                total += c.threads.length[k] * c.work.sums[9]
    return total


def places_now(t: float, x: Any, v: Any, c: Any) -> int:
    """How many pairs are to be looked at; the places of their nodes in the body's axes are in `own` then."""
    if not is_near(t, c):
        choose_near(t, x, v, c)
    now = c.now
    now[0] = 0.0
    now[1] = -1.0
    now[2] = 0.0
    now[5] = 0.0
    now[7] = 0.0
    now[4] = max(now[4], 0.0)  # an attempt that was rejected may have been too deep
    number = int(c.near.look[0])
    now[3] = c.near.look[3] if number > 0 else 0.0
    now[6] = c.near.look[5]
    if number == 0:
        return 0
    turn_into(x, c.body.attitude, c.work.frame)
    own = c.work.own
    for item in range(int(c.near.look[4])):
        i = c.near.near_nodes[item]
        own[i], own[i + 1], own[i + 2] = place_in_body(x, i, c.body.centre, c.work.frame)
    return number


def ends_now(c: Any, k: int) -> Any:
    """Where the ends of the pair k are, (3) each in the body's axes [m], once `places_now` has found them."""
    i = c.threads.first[k]
    j = c.threads.second[k]
    own = c.work.own
    return (own[i], own[i + 1], own[i + 2]), (own[j], own[j + 1], own[j + 2])


def ends_at(x: Any, c: Any, k: int) -> Any:
    """As `ends_now`, of any state; c.work.frame is the body's there."""
    a = place_in_body(x, c.threads.first[k], c.body.centre, c.work.frame)
    return a, place_in_body(x, c.threads.second[k], c.body.centre, c.work.frame)


def speeds_now(v: Any, c: Any, k: int, a: Any, b: Any) -> Any:
    """Velocities of the ends of the pair k, which are at a and b, against the body, (3) each [m/s]."""
    w_a = velocity_against_body(v, c.threads.first[k], c.body.centre, c.body.spin, c.work.frame, a)
    return w_a, velocity_against_body(v, c.threads.second[k], c.body.centre, c.body.spin, c.work.frame, b)


def is_clear(c: Any, k: int, a: Any, b: Any) -> bool:
    """True if no end of the pair k has moved as far as this was from the surface: it cannot touch.

    This follows from the places alone, so that neither the past nor a restart changes a bit of the forces;
    its row in `after` is that of one that does not touch.
    """
    clear = c.near.clear[k]
    return clear > 0.0 and moved_since(c, k, a, b) < clear


def moved_since(c: Any, k: int, a: Any, b: Any) -> float:
    """The longer way [m] of both ends of the pair k since `keep_clear`."""
    seen = c.near.seen[k]
    p = a[0] - seen[0]
    q = a[1] - seen[1]
    r = a[2] - seen[2]
    f = b[0] - seen[3]
    g = b[1] - seen[4]
    h = b[2] - seen[5]
    return math.sqrt(max(p * p + q * q + r * r, f * f + g * g + h * h))


def keep_clear(c: Any, k: int, a: Any, b: Any, clear: float) -> None:
    """Remember how far from the surface the pair k is at least [m], less what round-off may change.

    What it would leave in the discrete state is that of one that does not touch, until it is pushed.
    """
    c.after[k, 0] = 0.0
    c.near.clear[k] = clear - 1e-9 * c.body.radius
    seen = c.near.seen[k]
    seen[0], seen[1], seen[2] = a
    seen[3], seen[4], seen[5] = b


def apply_to_element(c: Any, k: int, force: Any, a: Any, b: Any, w_a: Any, w_b: Any, holds: bool) -> None:
    """Forces of the pair k, whose integrals over where it touches are in c.work.sums.

    a, b     : (3) where its ends are in the body's axes [m]
    w_a, w_b : (3) their velocities against the body's points there [m/s]
    holds    : False if its anchor is at a place of the thread that does not touch any more
    """
    i = c.threads.first[k]
    j = c.threads.second[k]
    sums = c.work.sums
    held = min(c.kept[5 * k], 0.0)
    c.after[k, 0] = held
    if held < 0.0:
        return
    c.now[2] += 1.0
    c.now[5] += c.threads.length[k] * sums[6]
    c.now[7] += c.threads.length[k] * sums[9]
    if sums[10] > c.now[0]:
        c.now[0] = sums[10]
        c.now[1] = k
    if sums[10] > c.body.allowed + c.threads.thick[k]:
        c.now[4] = -1.0 - k
    length = c.threads.length[k]
    on_b = (length * sums[3], length * sums[4], length * sums[5])
    on_a = (length * sums[0] - on_b[0], length * sums[1] - on_b[1], length * sums[2] - on_b[2])
    force[c.taken] += length * sums[8]
    if c.law.friction > 0.0:
        size = math.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
        rub = (0.0, 0.0, 0.0)
        at = 0.0
        if size > 0.0:
            at = sums[7] / sums[6]
            n = (sums[0] / size, sums[1] / size, sums[2] / size)
            normal_force = length * sums[6]
            if c.law.slip_speed > 0.0:
                w = between(w_a, w_b, at)
                rub = regularised_friction(normal_force, n, w, c.law)
            else:
                rub, at = sticking_friction(c, k, (normal_force, n), (a, b), (w_a, w_b), at, holds)
            w = between(w_a, w_b, at)
            force[c.taken + 1] -= rub[0] * w[0] + rub[1] * w[1] + rub[2] * w[2]
            on_a = along(on_a, rub, 1.0 - at)
            on_b = along(on_b, rub, at)
    apply_at_point(force, i, c.body.centre, c.body.spin, c.work.frame, a, on_a)
    apply_at_point(force, j, c.body.centre, c.body.spin, c.work.frame, b, on_b)


def sticking_friction(c: Any, k: int, normal: Any, ends: Any, speeds: Any, middle: float, holds: bool) -> Any:
    """Friction (3) [N] of a pair, and where on the thread it acts; its next discrete state into c.after.

    normal : size of the force across the surface [N], and its direction (3); middle : where it acts
    ends, speeds : as `ends_now` and `speeds_now` give them; holds : as of `apply_to_element`
    """
    normal_force, n = normal
    a, b = ends
    w_a, w_b = speeds
    kept = c.kept
    row = c.after[k]
    first = 5 * k
    here = between(a, b, middle)
    spring, time = c.threads.spring[k], c.threads.relaxation[k]
    at = middle
    u = (0.0, 0.0, 0.0)
    remembers = kept[first] == 1.0
    if remembers:
        at = kept[first + 1]
        p = between(a, b, at)
        u = (p[0] - kept[first + 2], p[1] - kept[first + 3], p[2] - kept[first + 4])
    rub, slides = friction(normal_force, n, u, between(w_a, w_b, at), spring, time, c.law)
    if slides or not remembers or not holds:
        at = middle
        u = shift_for(rub, n, between(w_a, w_b, middle), spring, time)
        remember_anchor(row, middle, along(here, u, -1.0))
    else:
        remember_anchor(row, at, (kept[first + 2], kept[first + 3], kept[first + 4]))
    return rub, at


def remember_anchor(row: Any, s: float, place: Any) -> None:
    """Put an anchor into a row of the discrete state."""
    row[0] = 1.0
    row[1] = s
    row[2] = place[0]
    row[3] = place[1]
    row[4] = place[2]


def between(a: Any, b: Any, s: float) -> Any:
    """(1 - s) a + s b."""
    return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])


def along(a: Any, b: Any, s: float) -> Any:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


def remember_thread_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """Store the discrete state of the evaluated pairs, and the largest depth.

    `add_thread_contact` has evaluated this state last.
    """
    kept = c.kept
    for item in range(int(c.near.look[0])):
        keep_row(kept, c.near.pairs[item], c.after[c.near.pairs[item]])
    last = 5 * c.threads.length.size
    remember_status(t, c, kept[last:])


THREADS = (
    places_now,
    ends_now,
    ends_at,
    speeds_now,
    is_clear,
    moved_since,
    keep_clear,
    apply_to_element,
    sticking_friction,
    remember_anchor,
    between,
    along,
)
