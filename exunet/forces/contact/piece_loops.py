"""Where a straight thread touches a sampled core, and the force on it, as compiled loops.

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

from exunet.forces.contact.core_loops import core_point, core_vector, from_core, gap_to_box
from exunet.forces.contact.grid_loops import sampled_distance
from exunet.forces.contact.law import sum_place


def sampled_at(c: Any, s: float) -> Any:
    """`sampled_distance` at a place of the thread in c.lines."""
    line = c.lines[0]
    return sampled_distance(c, line[0] + s * line[3], line[1] + s * line[4], line[2] + s * line[5])


def find_pieces(c: Any, k: int, a: Any, b: Any) -> Any:
    """Which pieces of the thread of pair k touch the sampled core, into c.splits, and how near into c.found.

    a, b : (3) where its ends are in the body's axes [m]. How many pieces they are, and how far from the core
    all of it is at least, beyond what would touch [m]. The distance between grid points is wrong by less than
    a quarter of a cell even where it has a kink.
    """
    apart = gap_to_box(c, 0, c.thick[k], a, b)
    if apart > 0.0:
        return 0, apart
    pieces = c.pieces[k]
    line = c.lines[0]
    line[0], line[1], line[2] = core_point(c, 0, a[0], a[1], a[2])
    line[3], line[4], line[5] = core_vector(c, 0, b[0] - a[0], b[1] - a[1], b[2] - a[2])
    width = math.sqrt(line[3] * line[3] + line[4] * line[4] + line[5] * line[5]) / pieces
    reach = c.rounding[0] + c.thick[k]
    room = reach + 0.5 * c.cell + c.rule[0, 1] * width
    clear = np.inf
    m, one = 0, 0
    while one < pieces:
        d, e, f, g = sampled_at(c, (one + c.rule[0, 0]) / pieces)
        free = d - room
        if free > 0.0:
            further = pieces
            if 0.5 * free < pieces * width:
                further = int(0.5 * free / width)
            clear = min(clear, free - min(further, pieces) * width)
            one += 1 + further
            continue
        clear = 0.0
        p, q, r, s = sampled_at(c, (one + c.rule[0, 1]) / pieces)
        if min(d, p) < reach:
            found = c.found[m]
            found[0], found[1], found[2], found[3] = d, e, f, g
            found[4], found[5], found[6], found[7] = p, q, r, s
            c.splits[m] = one
            m += 1
        one += 1
    return m, max(clear, 0.0)


def touch_pieces(c: Any, k: int, v: Any, w: Any, m: int, sums: Any) -> bool:
    """As `touch`: integrals over the m pieces of the thread of pair k that `find_pieces` has found."""
    for one in range(12):
        sums[one] = 0.0
    reach = c.rounding[0] + c.thick[k]
    o = core_vector(c, 0, v[0], v[1], v[2])
    u = core_vector(c, 0, w[0] - v[0], w[1] - v[1], w[2] - v[2])
    width = 1.0 / c.pieces[k]
    first, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for one in range(m):
        for g in range(2):
            s = width * (c.splits[one] + c.rule[0, g])
            p, q, r = c.found[one, 4 * g + 1], c.found[one, 4 * g + 2], c.found[one, 4 * g + 3]
            depth = reach - c.found[one, 4 * g]
            if depth > 0.0:
                rate = -(p * (o[0] + s * u[0]) + q * (o[1] + s * u[1]) + r * (o[2] + s * u[2]))
                own = sum_place(c, depth, rate, s, width * c.rule[1, g], sums)
                first = (first[0] + own * p, first[1] + own * q, first[2] + own * r)
                own *= s
                moment = (moment[0] + own * p, moment[1] + own * q, moment[2] + own * r)
    sums[0], sums[1], sums[2] = from_core(c, 0, first[0], first[1], first[2])
    sums[3], sums[4], sums[5] = from_core(c, 0, moment[0], moment[1], moment[2])
    return sums[10] > 0.0


def touches_sampled(c: Any, k: int, s: float) -> bool:
    """True if the thread of pair k, at which `find_pieces` looked last, touches at s."""
    distance, _, _, _ = sampled_at(c, s)
    return bool(distance < c.rounding[0] + c.thick[k])


PIECES = (sampled_at, find_pieces, touch_pieces, touches_sampled)
