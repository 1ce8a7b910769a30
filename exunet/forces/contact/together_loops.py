"""Which pairs of elements are near each other, and what of them must stop a run, as compiled loops.

A list has all pairs nearer than their reach and a skin. It is right for any state in which no node has moved
by more than half of the skin since it was made, against a shift that all have in common, whatever shift that
is: whether it is right is seen from the state alone. What is listed beside the pairs that touch adds nothing,
and pairs stand in a fixed order, so that forces are the same to the last bit whenever the list was made.
"""

from __future__ import annotations

import math
from typing import Any

from exunet.forces.contact.pair_loops import apart, dot, point_of, way


def list_is_right(x: Any, c: Any) -> bool:
    """True if every pair that may touch is listed; how far nodes have moved since then goes into `look`."""
    number = c.nodes.size
    step = max(1, number // 8)
    p, q, r = 0.0, 0.0, 0.0
    for one in range(0, number, step):
        i = c.nodes[one]
        p += x[i] - c.listed_at[i]
        q += x[i + 1] - c.listed_at[i + 1]
        r += x[i + 2] - c.listed_at[i + 2]
    share = 1.0 / ((number + step - 1) // step)
    p, q, r = share * p, share * q, share * r
    most = 0.0
    for one in range(number):
        i = c.nodes[one]
        d = x[i] - c.listed_at[i] - p
        e = x[i + 1] - c.listed_at[i + 1] - q
        f = x[i + 2] - c.listed_at[i + 2] - r
        most = max(most, d * d + e * e + f * f)
    c.look[3] = math.sqrt(most)
    return c.look[3] <= 0.5 * c.look[1]


def list_pairs(x: Any, c: Any) -> None:
    """List the pairs anew, with a skin that leaves few; `look` tells if there are too many without."""
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
    for one in range(int(c.look[0])):
        k, m = c.pairs[one] // c.length.size, c.pairs[one] % c.length.size
        c.gaps[one] = distance_of(x, c, k, m) - c.thick[k] - c.thick[m]
    for one in range(c.nodes.size):
        for i in range(c.nodes[one], c.nodes[one] + 3):
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
    for one in range(many):
        k = order[one]
        for other in range(one + 1, many):
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
        for one in range(gap, number):
            item = items[one]
            place = one
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
    """Volume [m3] spanned by two elements and the way between them; its sign tells on which side one is."""
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
