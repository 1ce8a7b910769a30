"""A spider's web folded into a star: every second spoke along the axis z, those between pointing outwards.

All threads keep their lengths.  Spokes 1, 3, 5 ... lie beside the axis, at a distance that leaves their nodes
one thickness d apart, and go to and fro by some rings.  From them the threads of rings lead outwards at an
angle of 2 pi/spokes; each further layer lies d over the sine of that farther out, so that they are d apart.

A knot of the spokes 0, 2, 4 ... is where it keeps its distances: c, the ring's side, to the two knots beside
the axis, and the way a along its own spoke to the knot before.  In the half-plane of its spoke these are two
circles; of their two points it has the outer one.
"""

from __future__ import annotations

import math

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.direction import direction
from reference_impl.shape import Radial

_SLACK = 1.0 - 1e-9  # so that round-off stretches nothing


def star(shape: Radial, per_pleat: int, d: float) -> Floats | None:
    """Places (rings + 1, spokes, 3) [m] of the knots, the first all the hub; None where there are none."""
    step, half_turn = shape.radius / shape.rings * _SLACK, math.pi / shape.spokes
    c, s = math.cos(2.0 * half_turn), math.sin(2.0 * half_turn)
    inner, layer = 0.5 * d / s, d / s
    beside, outer = [(0.0, 0.0)], [(0.0, 0.0)]  # distance from the axis, height
    for ring in range(1, shape.rings + 1):
        pleat, into = divmod(ring - 1, per_pleat)
        crease = into + 1 == per_pleat and ring < shape.rings
        away = inner + (pleat + (0.5 if crease else 0.0)) * layer
        rise = step**2 - (away - beside[-1][0]) ** 2
        side = 2.0 * math.sin(half_turn) * shape.radius * ring / shape.rings * _SLACK
        reach = side**2 - (away * s) ** 2
        if rise < 0.0 or reach < 0.0:
            return None
        beside.append((away, beside[-1][1] + math.sqrt(rise) * (-1) ** pleat))
        knot = _outer_point((away * c, beside[-1][1]), math.sqrt(reach), outer[-1], step)
        if knot is None:
            return None
        outer.append(knot)
    rays = np.array([direction(k, shape.spokes) for k in range(shape.spokes)])
    of_spoke = np.where(
        np.arange(shape.spokes)[:, None] % 2, np.array(beside)[:, None], np.array(outer)[:, None]
    )
    return np.concatenate((of_spoke[..., :1] * rays, of_spoke[..., 1:]), axis=-1)


def _outer_point(
    one: tuple[float, float], its: float, other: tuple[float, float], others: float
) -> tuple[float, float] | None:
    """Of the points at the distances `its` from `one` and `others` from `other` that farther out; or None."""
    x, z = other[0] - one[0], other[1] - one[1]
    apart = math.hypot(x, z)
    if not abs(its - others) <= apart <= its + others:
        return None
    along = (apart**2 + its**2 - others**2) / (2.0 * apart)
    aside = math.sqrt(max(its**2 - along**2, 0.0))
    points = [
        (one[0] + (along * x - sign * aside * z) / apart, one[1] + (along * z + sign * aside * x) / apart)
        for sign in (1.0, -1.0)
    ]
    return max(points)
