"""States within a step, from those at its ends."""

from __future__ import annotations

from exunet.forces.terms import Seen


def seen_within(begin: Seen, end: Seen, part: float, moved: int) -> Seen:
    """The state at a part of a step: what v moves by Hermite's cubic, all else by a straight line.

    begin, end : the step's ends, one state each
    part       : of the step, 0 to 1
    moved      : number of entries of x that v moves, those of points and centres, which come first in both;
                 their velocities are the cubic's
    """
    h, s = float(end.time[0] - begin.time[0]), part
    x = (1.0 - s) * begin.x + s * end.x
    v = (1.0 - s) * begin.v + s * end.v
    x0, x1, v0, v1 = (one[:, :moved] for one in (begin.x, end.x, begin.v, end.v))
    apart = x1 - x0
    x[:, :moved] = x0 + s * (h * v0 + s * (3.0 * apart - h * (2.0 * v0 + v1)))
    x[:, :moved] += s**3 * (h * (v0 + v1) - 2.0 * apart)
    v[:, :moved] = v0 + s * (6.0 * apart / h - 4.0 * v0 - 2.0 * v1)
    v[:, :moved] += s**2 * (3.0 * (v0 + v1) - 6.0 * apart / h)
    return Seen(begin.time + s * h, x, v, end.memory, end.told)
