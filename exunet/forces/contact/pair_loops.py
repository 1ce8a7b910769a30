"""How two threads push each other apart, as compiled loops.

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
        push = weight * (across[axis] * m_0 - e[axis] * m_1)
        sums[axis] += push
        sums[3 + axis] += s * push
        sums[6 + axis] += at * push + each * weight * (across[axis] * m_1 - e[axis] * m_2)
    sums[9] += weight * energy


PAIRS = (dot, point_of, way, moved, apart, near_range, chord, press, press_at)
