"""Accelerations and potential in Hill's frame, written so that nothing large cancels.

rho = R r + x is the position from Earth's centre.  The textbook's -mu rho/|rho|^3 + n^2 P rho is a difference
of numbers 1e7 times larger than itself.  With q = (|rho|/R)^2 - 1 = (2 R r.x + x.x)/R^2, u = sqrt(1 + q) and
mu = n^2 R^3 it becomes n^2 [P x - x/u^3 + (1 - 1/u^3) R r], where 1 - 1/u^3 = q (u^2 + u + 1)/((1 + u) u^3)
(Battin, An Introduction to the Mathematics and Methods of Astrodynamics, section 8.4, does likewise).
"""

from __future__ import annotations

import numpy as np

from reference_impl.effects import Orbit
from reference_impl.weave import Floats


def gradient(orbit: Orbit) -> Floats:
    """G (3, 3) [1/s2]: the linear model's acceleration is G x + C v; G = n^2 (3 r r^T - h h^T)."""
    r, h = np.array(orbit.radial), np.array(orbit.normal)
    return np.asarray(orbit.mean_motion**2 * (3.0 * np.outer(r, r) - np.outer(h, h)))


def coriolis(orbit: Orbit) -> Floats:
    """C (3, 3) [1/s], skew: the Coriolis acceleration is C v = -2 n h x v."""
    x, y, z = orbit.normal
    return -2.0 * orbit.mean_motion * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def orbital_acceleration(orbit: Orbit, x: Floats, v: Floats) -> Floats:
    """Acceleration (n, 3) [m/s2] of nodes at x (n, 3) [m] that move with v (n, 3) [m/s] in Hill's frame."""
    turning = v @ coriolis(orbit).T
    if not orbit.two_body:
        return np.asarray(x @ gradient(orbit).T + turning)
    q, u = _eccentric(orbit, x)
    cube = u * u * u
    outward = q * (u * u + u + 1.0) / ((1.0 + u) * cube) * orbit.radius
    h = np.array(orbit.normal)
    inplane = x - (x @ h)[:, None] * h
    tidal = inplane - x / cube[:, None] + outward[:, None] * np.array(orbit.radial)
    return np.asarray(orbit.mean_motion**2 * tidal + turning)


def orbital_potential(orbit: Orbit, x: Floats) -> Floats:
    """Potential per mass (...) [m2/s2] at x (..., 3) [m], zero at the origin of the scene.

    Two bodies: -mu/|rho| - n^2 |P rho|^2/2 less its value at x = 0, which is
    n^2 [(x.h)^2/2 - R^2 q^2 (u + 2)/(2 u (1 + u)^2)].
    """
    across = x @ np.array(orbit.normal)
    if orbit.two_body:
        q, u = _eccentric(orbit, x)
        inward = orbit.radius**2 * q * q * (u + 2.0) / (2.0 * u * (1.0 + u) ** 2)
    else:
        inward = 1.5 * (x @ np.array(orbit.radial)) ** 2
    return np.asarray(orbit.mean_motion**2 * (0.5 * across * across - inward))


def _eccentric(orbit: Orbit, x: Floats) -> tuple[Floats, Floats]:
    """q = (|rho|/R)^2 - 1 and u = |rho|/R (...) [-]."""
    radius = orbit.radius
    q = (2.0 * (x @ np.array(orbit.radial)) + np.sum(x * x, axis=-1) / radius) / radius
    return np.asarray(q), np.sqrt(1.0 + q)
