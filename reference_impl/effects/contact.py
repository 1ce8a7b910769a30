"""`contact` and `self_contact`: records and readers of what touches, and the damping of a bounce.

Across the surface the law of Hunt and Crossley, F (1 + a p'), with the depth p (J. Appl. Mech. 42 (1975),
doi:10.1115/1.3423596).  A mass m that meets it at v0 obeys m p' dp'/dp = -F(p) (1 + a p'): the integral of
p'/(1 + a p') dp' is the same inwards and outwards, whatever F and m, which leaves one equation for d = a v0,

    d (1 + e) = ln((1 + d)/(1 - e d)),

e the restitution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

from reference_impl.table import Table, number, texts, unknown

_SMALL = 0.02  # below it series, whose twelfth term is round-off


@dataclass(frozen=True)
class Contact:
    """What touches what, and the laws across and along the surface (SI units).

    None stands for moduli that a law does not have, and for what friction does not need.
    """

    threads: tuple[str, ...]  # names of bodies
    nodes: tuple[str, ...]
    bullets: tuple[str, ...]
    node_radius: float | None  # [m]
    bullet_radius: float | None  # [m]
    law: str  # linear, hertz
    stiffness: float | None  # K [N/m2]
    node_stiffness: float | None  # k [N/m]
    bullet_stiffness: float | None  # k [N/m]
    modulus: float | None  # E* [Pa]
    damping: float  # a [s/m]
    friction: float  # mu, 0 without friction
    friction_law: str  # sticking, regularised
    tangential_ratio: float  # kappa
    tangential_damping: float  # zeta
    slip_speed: float | None  # v_s [m/s]

    @property
    def sticks(self) -> bool:
        """Whether friction has a memory."""
        return self.friction > 0.0 and self.friction_law == "sticking"


def read_contact(table: Table) -> Contact:
    """What touches what."""
    if "bodies" in table:
        raise unknown(table.name("bodies"), "of contact it has that of a net with bodies")
    values: dict[str, Any] = {key: table.get(key, texts, ()) for key in ("threads", "nodes", "bullets")}
    sizes = ("node_radius", "bullet_radius", "stiffness", "node_stiffness", "bullet_stiffness", "modulus")
    values |= {key: table.get(key, number, None) for key in sizes}
    values |= {"law": table.choice("law", "linear", "hertz"), "damping": damping_of_bounce(table)}
    friction = table.optional("friction") or Table({"coefficient": 0.0, "law": "sticking"})
    values["friction"] = friction.need("coefficient", number)
    values["friction_law"] = friction.choice("law", "sticking", "regularised")
    values["tangential_ratio"] = friction.get("tangential_ratio", number, 0.5)
    values["tangential_damping"] = friction.get("tangential_damping", number, 0.1)
    values["slip_speed"] = friction.get("slip_speed", number, None)
    friction.close()
    return Contact(**values)


@dataclass(frozen=True)
class SelfContact:
    """How threads of a net push each other (SI units)."""

    stiffness: float  # K [N/m2]
    radius: float | None  # r [m]; None: each thread's own
    damping: float  # a [s/m]


def read_self_contact(table: Table) -> SelfContact:
    """The effect."""
    stiffness, radius = table.need("stiffness", number), table.get("radius", number, None)
    return SelfContact(stiffness, radius, damping_of_bounce(table))


def damping_of_bounce(table: Table) -> float:
    """a [s/m], given itself or by restitution and impact speed."""
    if "damping" in table:
        return float(table.need("damping", number))
    return braking(table.need("restitution", number)) / float(table.need("impact_speed", number))


def braking(e: float) -> float:
    """d of d (1 + e) = ln((1 + d)/(1 - e d)), the positive root, for e in (0, 1); 0 for e = 1.

    Sought as y = -ln(1 - e d), because d is 1/e but for exp(-1/e) where e is small.
    """
    if e == 1.0:
        return 0.0

    def of(y: float) -> float:
        return -math.expm1(-y) / e

    def wrong(y: float) -> float:
        d = of(y)
        if d < _SMALL:  # both sides over d^2, in which nothing cancels
            return _bent(d) - e * e * _bent(-e * d)
        return (math.log1p(d) + y - d * (1.0 + e)) / (d * d)

    return of(brentq(wrong, 0.0, 1.0 / e + e + 40.0, xtol=1e-300, rtol=1e-15))


def _bent(x: float) -> float:
    """(ln(1 + x) - x)/x^2 for small x."""
    return math.fsum(-((-x) ** k) / (k + 2) for k in range(12))
