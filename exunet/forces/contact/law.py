"""Normal and friction forces across a touched surface: penalty, Hunt-Crossley damping, friction.

    f = F(p) max(1 + a p', 0),   F = k p^n,

with the depth p and its rate (Hunt, Crossley, J. Appl. Mech. 42 (1975) 440, doi 10.1115/1.3423596). A body
that hits at the speed v0 leaves at e v0: from m v dv/dp = -F (1 + a v) the integral of v/(1 + a v) over v is
the same on the way in and on the way out, whatever m, k and n are, so with d = a v0

    d (1 + e) = ln((1 + d) / (1 - e d)).

The usual a = 3 (1 - e) / (2 v0) is its limit for e near 1.

Coulomb's law with stick: a spring of stiffness k and damping k theta along the surface, whose force
never exceeds mu N; where it would, its anchor is dragged along (return mapping: Simo, Hughes, "Computational
Inelasticity" (1998), section 1.2.2). What is remembered is a point of the thread s and a point b of the body,
which stay as they are while the pair sticks: forces then are functions of the state, and a method keeps its
order. Forces are worked out from the discrete state as the last accepted step left it, and what would be
remembered
if the step were accepted is written beside it: with that state the force is the same, so that it does not
matter whether it was worked out before or after.

A row of the discrete state: what is remembered (0.0: nothing, 1.0: an anchor, -1.0: the pair has not come out
of the body yet, and does not touch), s, b (3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import scipy
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import NonNegative, Positive, Record
from exunet.forces.blocks import Blocks
from exunet.forces.cores import Surface, TouchedBody

LEAST_RESTITUTION = 1e-3  # below it d is 1/e but for less than e^-1000


def damping_of(restitution: float, impact_speed: float) -> float:
    """a [s/m] with which an impact at a speed [m/s] has a restitution in [LEAST_RESTITUTION, 1]."""
    e = restitution
    if e > 1.0 - 1e-5:
        return 1.5 * (1.0 - e) / impact_speed

    # With y = -ln(1 - e d), which resolves d where it is all but 1/e; the root d = 0 is left out.
    def excess(y: float) -> float:
        d = -math.expm1(-y) / e
        return math.log1p(d) + y - d * (1.0 + e)

    y = scipy.optimize.brentq(excess, 0.5 * e * (1.0 - e), 2.0 * (1.0 + 1.0 / e), xtol=1e-300, rtol=1e-15)
    return -math.expm1(-y) / e / impact_speed


class ImpactDampingConfig(Record):
    """Hunt and Crossley's damping."""

    restitution: float | None = Field(
        None,
        ge=LEAST_RESTITUTION,
        le=1.0,
        description="e, speed after over speed before an impact at impact_speed [-]",
        examples=[0.5],
    )
    impact_speed: Positive | None = Field(None, description="v0 [m/s]; for restitution", examples=[1.0])
    damping: NonNegative | None = Field(
        None, description="a in F(p)(1 + a p') [s/m]; instead of restitution", examples=[0.5]
    )

    @property
    def a(self) -> float:
        """Return the damping coefficient a of Hunt and Crossley's law [s/m]."""
        if self.damping is not None:
            return self.damping
        assert self.restitution is not None
        assert self.impact_speed is not None
        return damping_of(self.restitution, self.impact_speed)

    def faults(self) -> Iterator[Fault]:
        """Require damping, or restitution at an impact speed."""
        bounces = self.restitution is not None, self.impact_speed is not None
        if (self.damping is not None) == any(bounces):
            yield Fault("", "requires either restitution with impact_speed, or damping")
        elif any(bounces) and not all(bounces):
            yield Fault("", "requires restitution and impact_speed together")


def hertz_of_sphere(modulus: float, radius: float) -> float:
    """4/3 E* sqrt(R) [N/m^1.5]: Johnson, "Contact Mechanics" (1985), eq. (4.23)."""
    return 4.0 / 3.0 * modulus * math.sqrt(radius)


def hertz_of_line(modulus: float) -> float:
    """pi/4 E* [N/m2]: force per length and depth of parallel cylinders, but for a logarithm of the depth.

    Popov, "Contact Mechanics and Friction" (2010), section 5.3.
    """
    return 0.25 * math.pi * modulus


def touched_body(blocks: Blocks, body: str, surface: Surface, allowed: float) -> TouchedBody:
    """Return a touched body; allowed : depth beyond which nothing may be [m]."""
    entries = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    return TouchedBody(surface.middle, surface.radius, allowed, surface.least, *entries)


# A scalar loop, in the subset of Python that Numba compiles.


def sum_place(law: Any, depth: float, rate: float, s: float, weight: float, sums: Any) -> float:
    """Add what a place s of the thread gives but for the directions; its part of the force [N/m]."""
    elastic = law.stiffness * depth
    f = elastic * max(1.0 + law.damping * rate, 0.0)
    sums[6] += weight * f
    sums[7] += weight * f * s
    sums[8] += weight * (f - elastic) * rate
    sums[9] += 0.5 * weight * elastic * depth
    if depth > sums[10]:
        sums[10] = depth
        sums[11] = s
    return weight * f


class ContactLaw(NamedTuple):
    """Law of a contact as compiled loops take it.

    stiffness : K [N/m2] of threads, k [N/m^n] of spheres; 1.0 where each row has its own
    damping   : a [s/m]
    exponent  : n of F = k p^n
    friction, slip_speed : as `Friction`
    """

    stiffness: float
    damping: float
    exponent: float
    friction: float
    slip_speed: float


class Friction(NamedTuple):
    """friction : mu; slip_speed : v_s [m/s], 0.0 for sticking friction; ratio : kappa; damping : zeta."""

    friction: float
    slip_speed: float = 0.0
    ratio: float = 1.0
    damping: float = 0.0


def friction(normal_force: float, n: Any, u: Any, w: Any, stiffness: float, time: float, law: Any) -> Any:
    """Force (3) [N] against sliding; True if the pair slides.

    normal_force : N [N]; n : (3) its direction
    u, w : (3) shift from the anchor [m], and velocity [m/s] of thread or bullet against the body
    time : theta [s]
    law  : has friction, the coefficient mu
    """
    p, q, r = along_surface(n, (u[0] + time * w[0], u[1] + time * w[1], u[2] + time * w[2]))
    wanted = stiffness * math.sqrt(p * p + q * q + r * r)
    most = law.friction * normal_force
    part = -stiffness if wanted <= most else -stiffness * most / wanted
    return (part * p, part * q, part * r), wanted > most


def shift_for(rub: Any, n: Any, w: Any, stiffness: float, time: float) -> Any:
    """The shift (3) [m] with which a pair at w (3) [m/s] has the force `rub` (3) [N]."""
    d, e, f = along_surface(n, w)
    return -rub[0] / stiffness - time * d, -rub[1] / stiffness - time * e, -rub[2] / stiffness - time * f


def along_surface(n: Any, a: Any) -> Any:
    """The part of a vector a (3) across the direction n (3)."""
    across = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
    return a[0] - across * n[0], a[1] - across * n[1], a[2] - across * n[2]


def regularised_friction(normal_force: float, n: Any, w: Any, law: Any) -> Any:
    """-mu N w / sqrt(w^2 + v_s^2) (3) [N], of the part of w along the surface."""
    p, q, r = along_surface(n, w)
    part = -law.friction * normal_force / math.sqrt(p * p + q * q + r * r + law.slip_speed * law.slip_speed)
    return part * p, part * q, part * r


FRICTION = (friction, shift_for, along_surface, regularised_friction)
