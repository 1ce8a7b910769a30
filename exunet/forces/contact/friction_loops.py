"""Friction of one touching pair, as compiled loops; vectors are in the body's principal axes.

Coulomb's law with memory: a spring of stiffness k and damping k theta along the surface, whose force never
exceeds mu N; where it would, its anchor is dragged along (return mapping: Simo, Hughes, "Computational
Inelasticity" (1998), section 1.2.2). What is remembered is a point of the thread s and a point b of the body,
which stay as they are while the pair sticks: forces then are functions of the state, and a method keeps its
order. Forces are worked out from the memory as the last accepted step left it, and what would be remembered
if the step were accepted is written beside it: with that memory the force is the same, so that it does not
matter whether it was worked out before or after.

A row of the memory: what is remembered (0.0: nothing, 1.0: an anchor, -1.0: the pair has not come out of the
body yet, and does not touch), s, b (3).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple


class Friction(NamedTuple):
    """friction : mu; slip_speed : v_s [m/s], 0.0 for friction with memory; ratio : kappa; damping : zeta."""

    friction: float
    slip_speed: float = 0.0
    ratio: float = 1.0
    damping: float = 0.0


def friction(push: float, n: Any, u: Any, w: Any, stiffness: float, time: float, c: Any) -> Any:
    """Force (3) [N] against sliding; True if the pair slides.

    push : normal force N [N]; n : (3) its direction
    u, w : (3) shift from the anchor [m], and velocity [m/s] of thread or bullet against the body
    time : theta [s]
    c    : has friction, the coefficient mu
    """
    p, q, r = along_surface(n, (u[0] + time * w[0], u[1] + time * w[1], u[2] + time * w[2]))
    wanted = stiffness * math.sqrt(p * p + q * q + r * r)
    most = c.friction * push
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


def regularised_friction(push: float, n: Any, w: Any, c: Any) -> Any:
    """-mu N w / sqrt(w^2 + v_s^2) (3) [N], of the part of w along the surface."""
    p, q, r = along_surface(n, w)
    part = -c.friction * push / math.sqrt(p * p + q * q + r * r + c.slip_speed * c.slip_speed)
    return part * p, part * q, part * r


FRICTION = (friction, shift_for, along_surface, regularised_friction)
