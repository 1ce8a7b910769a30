"""Contact of pairs of threads: penalty force, nearby pairs and limits, as compiled loops.

Each point of one element pushes each point of another that is nearer than the reach R, the sum of both radii,
along the line between them. With the distance d of two points, L and L' the reference lengths, and s, t from
0 to 1 along the elements, the pair stores

    U = L L' C/3 int int (R^2 - d^2)^(3/2) ds dt    over where d < R,    C = K / (pi R^2).

Forces are thus integrated over where threads touch: they do not jump where the closest points do, and do not
depend on how threads are divided. Threads side by side push with K p (1 - p/R) (1 - p/2R) per length, where
p = R - d; two that cross at an angle a with (2 K / 3 R^2) d (R^2 - d^2)^(3/2) / sin a.

Along one element, the inner integral, all is in closed form. Along the other, the outer one, Gauss's rule is
taken in the angle phi of s = m + h sin phi on each piece between places where the inner one has a kink, so
that it meets no square roots. The forces on both elements are made of the same sums: momentum and angular
momentum are kept to round-off, however exact the rule is.

A list has all pairs nearer than their reach and a skin. It is right for any state in which no node has moved
by more than half of the skin since it was made, against a shift that all have in common, whatever shift that
is: whether it is right is seen from the state alone. What is listed beside the pairs that touch adds nothing,
and pairs stand in a fixed order, so that forces are the same to the last bit whenever the list was made.
"""

from __future__ import annotations

import math
from typing import Any


def dot(a: Any, b: Any) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def point_of(x: Any, i: int) -> Any:
    """The place or velocity (3) whose entries begin at i."""
    return x[i], x[i + 1], x[i + 2]


def way(a: Any, b: Any) -> Any:
    """b - a."""
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


def moved(a: Any, b: Any, s: float) -> Any:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


def apart(a: Any, b: Any, p: Any, q: Any) -> float:
    """Least distance [m] of the line from a to b from that from p to q.

    Ericson, "Real-Time Collision Detection" (2005), section 5.1.9.
    """
    d, e, r = way(a, b), way(p, q), way(p, a)
    dd, ee, de = dot(d, d), dot(e, e), dot(d, e)
    dr, er = dot(d, r), dot(e, r)
    s, t = 0.0, 0.0
    if dd > 0.0 and ee > 0.0:
        both = dd * ee - de * de
        if both > 0.0:
            s = min(max((de * er - dr * ee) / both, 0.0), 1.0)
        t = (de * s + er) / ee
        if t < 0.0 or t > 1.0:
            t = min(max(t, 0.0), 1.0)
            s = min(max((de * t - dr) / dd, 0.0), 1.0)
    elif ee > 0.0:
        t = min(max(er / ee, 0.0), 1.0)
    elif dd > 0.0:
        s = min(max(-dr / dd, 0.0), 1.0)
    e = moved(moved(r, d, s), e, -t)
    return math.sqrt(dot(e, e))


def near_range(p: Any, d: Any, square: float) -> Any:
    """From where to where |p + s d|^2 < square; (2.0, -1.0): nowhere."""
    a, b, c = dot(d, d), dot(p, d), dot(p, p) - square
    f = p[1] * d[2] - p[2] * d[1], p[2] * d[0] - p[0] * d[2], p[0] * d[1] - p[1] * d[0]
    root = square * a - dot(f, f)  # b^2 - a c, in which less cancels
    if root <= 0.0:
        return (-1.0, 2.0) if c < 0.0 else (2.0, -1.0)
    root = math.sqrt(root)
    far = -b - root if b > 0.0 else -b + root
    one, other = far / a, c / far
    return min(one, other), max(one, other)


def chord(z: float, square: float) -> Any:
    """Integrals from 0 to z of q, z q, z^2 q and q^3 with q = (square - z^2)^(1/2)."""
    q = math.sqrt(max(square - z * z, 0.0))
    arc = math.atan2(z, q)
    return (
        0.5 * (z * q + square * arc),
        -q * q * q / 3.0,
        0.125 * (z * (2.0 * z * z - square) * q + square * square * arc),
        0.125 * (z * (5.0 * square - 2.0 * z * z) * q + 3.0 * square * square * arc),
    )


def press(c: Any, a: Any, b: Any, p: Any, q: Any, reach: float) -> bool:
    """Integrals over where the thread from a to b is near that from p to q, into c.sums; if it is anywhere.

    c.sums : (10,) of k e (3), s k e (3), t k e (3) and k^3 over s and t, k = (R^2 - e^2)^(1/2), where e goes
             from the place t of the second to the place s of the first
    """
    sums, splits, rule = c.sums, c.splits, c.rule
    square = reach * reach
    r, d, e = way(p, a), way(a, b), way(p, q)
    length = math.sqrt(dot(e, e))
    if not length > 1e-6 * reach:  # a point, as what is outside is not longer
        length = 0.0
        r = moved(r, e, -0.5)
        e = (0.0, 0.0, 0.0)
    else:
        e = (e[0] / length, e[1] / length, e[2] / length)
    begin, rise = dot(r, e), dot(d, e)
    r_across, d_across = moved(r, e, -begin), moved(d, e, -rise)
    low, high = near_range(r_across, d_across, square)
    low, high = max(low, 0.0), min(high, 1.0)
    if not low < high:
        return False
    splits[0], splits[1] = low, high
    m = 2
    if length > 0.0:
        for end in range(2):
            from_end = moved(r, e, -length * end)
            one, other = near_range(from_end, d, square)
            if one > other and dot(d, d) > 0.0:  # where it passes by, so that the rule is finer there
                one = -dot(from_end, d) / dot(d, d)
            if low < one < high:
                splits[m] = one
                m += 1
            if low < other < high:
                splits[m] = other
                m += 1
    for n in range(1, m):
        value, i = splits[n], n - 1
        while i >= 0 and splits[i] > value:
            splits[i + 1] = splits[i]
            i -= 1
        splits[i + 1] = value
    for n in range(10):
        sums[n] = 0.0
    for n in range(m - 1):
        half = 0.5 * (splits[n + 1] - splits[n])
        middle = splits[n] + half
        for g in range(rule.shape[1]):
            s = middle + half * rule[0, g]
            across = moved(r_across, d_across, s)
            rest = square - dot(across, across)
            if rest > 0.0:
                z = begin + s * rise
                press_at(sums, half * rule[1, g], s, z, length, across, e, rest)
    return sums[9] > 0.0


def press_at(
    sums: Any, weight: float, s: float, z: float, length: float, across: Any, e: Any, rest: float
) -> None:
    """Add to the sums of `press` what the place s of one thread gives.

    z, across : along the other thread from where it begins [m], and (3) from it to the place [m]
    length, e : of the other thread [m], and its direction (3)
    rest      : R^2 less the square of the distance from its line [m2]
    """
    if length == 0.0:
        k = math.sqrt(rest)
        m_0, m_1, m_2, energy = k, 0.0, 0.0, k * k * k
        at, each = 0.5, 0.0
    else:
        half = math.sqrt(rest)
        low, high = max(-half, -z), min(half, length - z)
        if not low < high:
            return
        f_0, f_1, f_2, f_3 = chord(low, rest)
        g_0, g_1, g_2, g_3 = chord(high, rest)
        m_0, m_1, m_2 = (g_0 - f_0) / length, (g_1 - f_1) / length, (g_2 - f_2) / length
        energy = (g_3 - f_3) / length
        at, each = z / length, 1.0 / length
    for axis in range(3):
        normal_force = weight * (across[axis] * m_0 - e[axis] * m_1)
        sums[axis] += normal_force
        sums[3 + axis] += s * normal_force
        sums[6 + axis] += at * normal_force + each * weight * (across[axis] * m_1 - e[axis] * m_2)
    sums[9] += weight * energy


PAIRS = (dot, point_of, way, moved, apart, near_range, chord, press, press_at)


def list_is_right(x: Any, c: Any) -> bool:
    """True if every pair that may touch is listed; how far nodes have moved since then goes into `look`."""
    number = c.nodes.size
    step = max(1, number // 8)
    p, q, r = 0.0, 0.0, 0.0
    for item in range(0, number, step):
        i = c.nodes[item]
        p += x[i] - c.listed_at[i]
        q += x[i + 1] - c.listed_at[i + 1]
        r += x[i + 2] - c.listed_at[i + 2]
    share = 1.0 / ((number + step - 1) // step)
    p, q, r = share * p, share * q, share * r
    most = 0.0
    for entry in range(number):
        i = c.nodes[entry]
        d = x[i] - c.listed_at[i] - p
        e = x[i + 1] - c.listed_at[i + 1] - q
        f = x[i + 2] - c.listed_at[i + 2] - r
        most = max(most, d * d + e * e + f * f)
    c.look[3] = math.sqrt(most)
    return c.look[3] <= 0.5 * c.look[1]


def list_pairs(x: Any, c: Any) -> None:
    """List the pairs anew, with a skin that leaves few; `look` is True if there are too many without it."""
    skin = c.skin if c.look[1] == 0.0 else min(c.skin, 2.0 * c.look[1])
    number = list_within(x, c, skin, min(c.few, c.pairs.size))
    while number < 0 and skin > 1e-3 * c.skin:
        skin *= 0.5
        number = list_within(x, c, skin, min(c.few, c.pairs.size))
    if number < 0:
        number = list_within(x, c, skin, c.pairs.size)
    c.look[2] = 1.0 if number < 0 else 0.0
    c.look[0] = max(number, 0)
    c.look[1] = skin
    c.look[3] = 0.0
    for item in range(int(c.look[0])):
        k, m = c.pairs[item] // c.length.size, c.pairs[item] % c.length.size
        c.gaps[item] = distance_of(x, c, k, m) - c.thick[k] - c.thick[m]
    for entry in range(c.nodes.size):
        for i in range(c.nodes[entry], c.nodes[entry] + 3):
            c.listed_at[i] = x[i]


def list_within(x: Any, c: Any, skin: float, room: int) -> int:
    """Put the pairs nearer than reach and skin into c.pairs, in order; how many, -1: more than there is room.

    The boxes around the elements are swept along the axis along which they are spread most.
    """
    many = c.length.size
    boxes = c.boxes
    for k in range(many):
        for axis in range(3):
            a, b = x[c.first[k] + axis], x[c.second[k] + axis]
            boxes[k, axis] = min(a, b) - c.thick[k] - 0.5 * skin
            boxes[k, 3 + axis] = max(a, b) + c.thick[k] + 0.5 * skin
    sweep = 0
    for axis in range(1, 3):
        if spread(boxes[:, axis]) > spread(boxes[:, sweep]):
            sweep = axis
    order = c.order
    for k in range(many):
        c.begins[k] = boxes[k, sweep]
    sort(order, many, c.begins)
    number = 0
    for item in range(many):
        k = order[item]
        for other in range(item + 1, many):
            m = order[other]
            if boxes[m, sweep] > boxes[k, 3 + sweep]:
                break
            if meet(boxes, k, m) and not are_neighbours(c, k, m):
                reach = c.thick[k] + c.thick[m]
                if distance_of(x, c, k, m) < reach + skin:
                    if number == room:
                        return -1
                    c.pairs[number] = min(k, m) * many + max(k, m)
                    number += 1
    sort(c.pairs, number, c.none)
    return number


def sort(items: Any, number: int, of: Any) -> None:
    """Sort the first items by the number that `of` has of each, or by themselves where `of` is empty.

    Shell's method, with Knuth's gaps: quick for what is nearly sorted.
    """
    by_number = of.size > 0
    gap = 1
    while gap < number // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for entry in range(gap, number):
            item = items[entry]
            place = entry
            while place >= gap:
                before = items[place - gap]
                if by_number:
                    if not of[before] > of[item]:
                        break
                elif not before > item:
                    break
                items[place] = before
                place -= gap
            items[place] = item
        gap //= 3


def spread(places: Any) -> float:
    """Difference of the largest and the least."""
    return places.max() - places.min()


def meet(boxes: Any, k: int, m: int) -> bool:
    """True if two boxes share points."""
    for axis in range(3):
        if boxes[k, axis] > boxes[m, 3 + axis] or boxes[m, axis] > boxes[k, 3 + axis]:
            return False
    return True


def are_neighbours(c: Any, k: int, m: int) -> bool:
    """True for elements that share a node, or are listed as too near along the threads."""
    i, j, p, q = c.first[k], c.second[k], c.first[m], c.second[m]
    if i in (p, q) or j in (p, q):
        return True
    return place_of(c.neighbours, min(k, m) * c.length.size + max(k, m)) >= 0


def place_of(pairs: Any, pair: int) -> int:
    """Where a pair stands in an ordered list; -1: it does not."""
    low, high = 0, pairs.size
    while low < high:
        middle = (low + high) // 2
        if pairs[middle] < pair:
            low = middle + 1
        else:
            high = middle
    return low if low < pairs.size and pairs[low] == pair else -1


def distance_of(x: Any, c: Any, k: int, m: int) -> float:
    """Least distance [m] of the axes of two elements."""
    return apart(
        point_of(x, c.first[k]),
        point_of(x, c.second[k]),
        point_of(x, c.first[m]),
        point_of(x, c.second[m]),
    )


def volume_of(x: Any, c: Any, k: int, m: int) -> float:
    """Volume [m3] spanned by two elements and their distance vector; its sign is the side of the first."""
    a, p = point_of(x, c.first[k]), point_of(x, c.first[m])
    d, e = way(a, point_of(x, c.second[k])), way(p, point_of(x, c.second[m]))
    across = d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0]
    return dot(across, way(p, a))


def longest_way(x: Any, before: Any) -> float:
    """The longest way [m] along an axis since `before`; no node has gone further than 3^(1/2) of it."""
    most = 0.0
    for n in range(before.size):
        most = max(most, abs(x[n] - before[n]))
    return most


def passed(x: Any, before: Any, c: Any, k: int, m: int, least: float) -> bool:
    """True if two elements came nearer than `least` [m] as they changed sides since the last step.

    before : where the nodes were then. In between they are taken to have gone straight; where the elements
             lie in one plane is found by false position (Illinois)
    """
    begin, end = volume_of(before, c, k, m), volume_of(x, c, k, m)
    if not begin * end < 0.0:
        return False
    low, high, part, side = 0.0, 1.0, 0.5, 0
    ends = c.ends
    for _ in range(40):
        part = (low * end - high * begin) / (end - begin)
        for place in range(4):
            i = (c.first[k], c.second[k], c.first[m], c.second[m])[place]
            for axis in range(3):
                ends[place, axis] = before[i + axis] + part * (x[i + axis] - before[i + axis])
        d, e = way(ends[0], ends[1]), way(ends[2], ends[3])
        across = d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0]
        now = dot(across, way(ends[2], ends[0]))
        if high - low < 1e-9 or now == 0.0:
            break
        if (now < 0.0) == (begin < 0.0):
            low, begin = part, now
            end = 0.5 * end if side == 1 else end
            side = 1
        else:
            high, end = part, now
            begin = 0.5 * begin if side == 2 else begin
            side = 2
    return apart(ends[0], ends[1], ends[2], ends[3]) < least


TOGETHER = (
    list_is_right,
    list_pairs,
    list_within,
    sort,
    spread,
    meet,
    are_neighbours,
    place_of,
    distance_of,
    volume_of,
    longest_way,
    passed,
)
