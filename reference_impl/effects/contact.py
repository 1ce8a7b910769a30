"""`contact`: threads, nodes and bullets touch bodies; the record, its reader, and the damping of a bounce.

Across the surface the law of Hunt and Crossley, F (1 + a p'), with the depth p (J. Appl. Mech. 42 (1975),
doi:10.1115/1.3423596).  A mass m that meets it at v0 obeys m p' dp'/dp = -F(p) (1 + a p'): the integral of
p'/(1 + a p') dp' is the same inwards and outwards, whatever F and m, which leaves one equation for d = a v0,

    d (1 + e) = ln((1 + d)/(1 - e d)),

e the restitution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

from reference_impl.table import Table, number, one_of_names, refusal, texts

_SMALL = 0.02  # below it series, whose twelfth term is round-off


@dataclass(frozen=True)
class Contact:
    """What touches what, and the laws across and along the surface (SI units).

    Moduli that a law does not have are None, as are what friction does not need.
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
    friction_law: str | None  # sticking, regularised
    tangential_ratio: float  # kappa
    tangential_damping: float  # zeta
    slip_speed: float | None  # v_s [m/s]

    @property
    def sticks(self) -> bool:
        """Whether friction has a memory."""
        return self.friction > 0.0 and self.friction_law == "sticking"


def read_contact(table: Table, bullets: bool) -> Contact | None:
    """The contact; None with faults noted where it cannot be read.  `bullets`: whether the case has any."""
    before = len(table.faults)
    if "bodies" in table.values:
        table.faults.append(refusal(table.name("bodies"), "of contact it has that of a net with bodies"))
        table.ignore_rest()
        return None
    threads, nodes, bodies = (table.get(key, texts, ()) for key in ("threads", "nodes", "bullets"))
    if threads == nodes == bodies == ():
        some = f"{table.name('threads')}, {table.name('nodes')} or {table.name('bullets')}"
        table.faults.append(f"{table.path}: name bodies in {some}")
    if both := sorted({*(threads or ())} & {*(nodes or ())}):
        table.faults.append(f"{table.name('nodes')}: threads touch {', '.join(both)} already")
    if bodies and not bullets:
        table.faults.append(f"{table.name('bullets')}: needs net.bullets")
    law = table.need("law", one_of_names("linear", "hertz"))
    positive = number(above=0.0)
    linear, hertz = law == "linear", law == "hertz"
    unread = law is None or threads is None or nodes is None or bodies is None
    given = {
        key: _where(table, key, positive, wanted, unread, why)
        for key, wanted, why in (
            ("node_radius", bool(nodes), "nodes touch bodies"),
            ("bullet_radius", bool(bodies), "bullets touch bodies"),
            ("stiffness", linear and bool(threads), 'threads touch bodies with law = "linear"'),
            ("node_stiffness", linear and bool(nodes), 'nodes touch bodies with law = "linear"'),
            ("bullet_stiffness", linear and bool(bodies), 'bullets touch bodies with law = "linear"'),
            ("modulus", hertz, 'law = "hertz"'),
        )
    }
    damping = damping_of_bounce(table)
    friction = table.table("friction", required=False)
    coefficient = friction.need("coefficient", number(0.0))
    law_of_friction = friction.need("law", one_of_names("sticking", "regularised"))
    sticking, regularised = law_of_friction == "sticking", law_of_friction == "regularised"
    faulty = law_of_friction is None
    along = {
        "tangential_ratio": number(above=0.0, maximum=1.0),
        "tangential_damping": number(0.0),
    }
    memory = {
        key: _where(friction, key, bound, sticking and key in friction.values, faulty, 'law = "sticking"')
        for key, bound in along.items()
    }
    slip = _where(friction, "slip_speed", positive, regularised, faulty, 'law = "regularised"')
    friction.close()
    if len(table.faults) > before or damping is None:
        return None
    ratio, part = memory["tangential_ratio"], memory["tangential_damping"]
    return Contact(
        threads,
        nodes,
        bodies,
        given["node_radius"],
        given["bullet_radius"],
        law,
        given["stiffness"],
        given["node_stiffness"],
        given["bullet_stiffness"],
        given["modulus"],
        damping,
        coefficient or 0.0,
        law_of_friction,
        0.5 if ratio is None else ratio,
        0.1 if part is None else part,
        slip,
    )


def _where(
    table: Table, key: str, bound: Callable[[Any], float], wanted: bool, unread: bool, why: str
) -> float | None:
    """A number that must be given if it is `wanted` and must not be otherwise, as far as that can be read."""
    if wanted:
        return float(value) if (value := table.need(key, bound)) is not None else None
    if key in table.values:
        table.get(key, bound, None)
        if not unread:
            table.faults.append(f"{table.name(key)}: leave it out, it is only where {why}")
    return None


def damping_of_bounce(table: Table) -> float | None:
    """a [s/m], given itself or by restitution and impact speed; None with faults noted."""
    bounce = [key for key in ("restitution", "impact_speed") if key in table.values]
    restitution = table.need("restitution", number(above=0.0, maximum=1.0)) if bounce else None
    speed = table.need("impact_speed", number(above=0.0)) if bounce else None
    damping = table.get("damping", number(0.0), None)
    if bool(bounce) == ("damping" in table.values):
        pair = f"{table.name('restitution')} and {table.name('impact_speed')}"
        table.faults.append(f"{table.path}: give either {pair}, or {table.name('damping')}")
        return None
    if not bounce:
        return damping
    return None if restitution is None or speed is None else braking(restitution) / speed


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
