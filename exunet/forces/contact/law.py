"""Forces across a touched surface: penalty with the damping of Hunt and Crossley.

    f = F(p) max(1 + a p', 0),   F = k p^n,

with the depth p and its rate (Hunt, Crossley, J. Appl. Mech. 42 (1975) 440, doi 10.1115/1.3423596). A body
that hits at the speed v0 leaves at e v0: from m v dv/dp = -F (1 + a v) the integral of v/(1 + a v) over v is
the same on the way in and on the way out, whatever m, k and n are, so with d = a v0

    d (1 + e) = ln((1 + d) / (1 - e d)).

The usual a = 3 (1 - e) / (2 v0) is its limit for e near 1.
"""

from __future__ import annotations

import math
from typing import Any

from scipy.optimize import brentq

LEAST_RESTITUTION = 1e-3  # below it d is 1/e but for less than e^-1000


def damping_of(restitution: float, impact_speed: float) -> float:
    """a [s/m] with which an impact at a speed [m/s] has a restitution in [LEAST_RESTITUTION, 1]."""
    e = restitution
    if e > 1.0 - 1e-5:
        return 1.5 * (1.0 - e) / impact_speed

    # With y = -ln(1 - e d), which tells d apart where it is all but 1/e; the root d = 0 is left out.
    def excess(y: float) -> float:
        d = -math.expm1(-y) / e
        return math.log1p(d) + y - d * (1.0 + e)

    y = brentq(excess, 0.5 * e * (1.0 - e), 2.0 * (1.0 + 1.0 / e), xtol=1e-300, rtol=1e-15)
    return -math.expm1(-y) / e / impact_speed


def hertz_of_sphere(modulus: float, radius: float) -> float:
    """4/3 E* sqrt(R) [N/m^1.5]: Johnson, "Contact Mechanics" (1985), eq. (4.23)."""
    return 4.0 / 3.0 * modulus * math.sqrt(radius)


def hertz_of_line(modulus: float) -> float:
    """pi/4 E* [N/m2]: force per length and depth of parallel cylinders, but for a logarithm of the depth.

    Popov, "Contact Mechanics and Friction" (2010), section 5.3.
    """
    return 0.25 * math.pi * modulus


# A scalar loop, in the subset of Python that Numba compiles.


def sum_place(c: Any, depth: float, rate: float, s: float, weight: float, sums: Any) -> float:
    """Add what a place s of the thread gives but for the directions; its part of the force [N/m]."""
    elastic = c.stiffness * depth
    f = elastic * max(1.0 + c.damping * rate, 0.0)
    sums[6] += weight * f
    sums[7] += weight * f * s
    sums[8] += weight * (f - elastic) * rate
    sums[9] += 0.5 * weight * elastic * depth
    if depth > sums[10]:
        sums[10] = depth
        sums[11] = s
    return weight * f
