"""Friction of one touching pair, as compiled loops; vectors are in the body's principal axes.

Coulomb's law with memory: a spring of stiffness k and damping k theta along the surface, whose force never
exceeds mu N; where it would, its anchor is dragged along (return mapping: Simo, Hughes, "Computational
Inelasticity" (1998), section 1.2.2). What is remembered is a point of the thread s and a point b of the body,
which stay as they are while the pair sticks: forces then are functions of the state, and a method keeps its
order. Forces are worked out from the memory as the last accepted step left it, and what would be remembered
if the step were accepted is written beside it.

A row of the memory: what is remembered (0.0: nothing, 1.0: an anchor, -1.0: the pair has not come out of the
body yet, and does not touch), s, b (3).
"""

from __future__ import annotations

import math
from typing import Any


def friction(
    push: float, i: float, j: float, k: float, u: Any, w: Any, stiffness: float, time: float, c: Any
) -> Any:
    """Force (3) [N] against sliding, and the shift u (3) [m] that would give it; True if the pair slides.

    push    : normal force N [N]; i, j, k : its direction
    u, w    : (3) shift from the anchor [m], and velocity [m/s] of thread or bullet against the body
    time    : theta [s]
    c       : has friction, the coefficient mu
    """
    across = u[0] * i + u[1] * j + u[2] * k
    p, q, r = u[0] - across * i, u[1] - across * j, u[2] - across * k
    across = w[0] * i + w[1] * j + w[2] * k
    d, e, f = time * (w[0] - across * i), time * (w[1] - across * j), time * (w[2] - across * k)
    x, y, z = -stiffness * (p + d), -stiffness * (q + e), -stiffness * (r + f)
    wanted = math.sqrt(x * x + y * y + z * z)
    most = c.friction * push
    if wanted <= most:
        return x, y, z, p, q, r, False
    part = most / wanted
    x *= part
    y *= part
    z *= part
    return x, y, z, -x / stiffness - d, -y / stiffness - e, -z / stiffness - f, True


def regularised_friction(push: float, i: float, j: float, k: float, w: Any, c: Any) -> Any:
    """-mu N w / sqrt(w^2 + v_s^2) (3) [N], of the part of w along the surface."""
    across = w[0] * i + w[1] * j + w[2] * k
    p, q, r = w[0] - across * i, w[1] - across * j, w[2] - across * k
    part = -c.friction * push / math.sqrt(p * p + q * q + r * r + c.slip_speed * c.slip_speed)
    return part * p, part * q, part * r
