"""`orbit` and `j2`: accelerations and potentials in Hill's frame of a circular orbit.

`orbit` is written so that nothing large cancels.  rho = R r + x is the position from Earth's centre.  The
textbook's -mu rho/|rho|^3 + n^2 P rho is a difference of numbers 1e7 times larger than itself.  With q =
(|rho|/R)^2 - 1 = (2 R r.x + x.x)/R^2, u = sqrt(1 + q) and mu = n^2 R^3 it becomes n^2 [P x - x/u^3 +
(1 - 1/u^3) R r], where 1 - 1/u^3 = q (u^2 + u + 1)/((1 + u) u^3) (Battin, An Introduction to the Mathematics
and Methods of Astrodynamics, section 8.4, does likewise).

`j2` is the gravity gradient of the Earth's oblateness at one place of the orbit.  The force function of the
second zonal harmonic is U = mu J2 Re^2 (1 - 3 (k.rho)^2/|rho|^2)/(2 |rho|^3), k the Earth's axis (Vallado,
Fundamentals of Astrodynamics and Applications, section 8.6).  Its second derivatives at rho = R r are, with
s = k.r,

    G = mu J2 Re^2/(2 R^5) [(15 s^2 - 3) I + (15 - 105 s^2) r r^T - 6 k k^T + 30 s (k r^T + r k^T)],

of trace zero, as Laplace's equation requires.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reference_impl.arrays import Floats, Vector
from reference_impl.table import Table, number, triple

EARTH_MU = 3.986004418e14  # gravitational parameter [m3/s2]
EARTH_RADIUS = 6378137.0  # equatorial [m]
EARTH_J2 = 1.08262668e-3  # second zonal harmonic [-]
_MOST = 64  # points of Legendre's rule


@dataclass(frozen=True)
class Frame:
    """A circular orbit: mean motion n [rad/s] and two unit vectors of Hill's frame in the scene's axes."""

    mean_motion: float
    radial: Vector  # away from Earth's centre
    along_track: Vector

    @cached_property
    def normal(self) -> Vector:
        """Unit vector of the orbit's angular momentum, radial x along-track."""
        x, y, z = np.cross(self.radial, self.along_track).tolist()
        return (x, y, z)

    @cached_property
    def radius(self) -> float:
        """R = (mu / n^2)^(1/3) [m]."""
        return float(np.cbrt(EARTH_MU / self.mean_motion**2))


def _frame(table: Table) -> tuple[float, Vector, Vector]:
    """Mean motion [rad/s], radial and along-track unit vectors."""
    if "altitude" in table:
        mean_motion = math.sqrt(EARTH_MU / (EARTH_RADIUS + table.need("altitude", number)) ** 3)
    else:
        mean_motion = table.need("mean_motion", number)
    return mean_motion, table.need("radial", triple), table.need("along_track", triple)


def read_orbit(table: Table) -> Orbit:
    """The orbit of the scene."""
    return Orbit(*_frame(table), table.choice("model", "linear", "two_body") == "two_body")


def read_j2(table: Table) -> J2:
    """The place on the orbit."""
    return J2(*_frame(table), table.need("inclination", number), table.need("argument_of_latitude", number))


@dataclass(frozen=True)
class Orbit(Frame):
    """The axes of the scene turn with n about `normal`."""

    two_body: bool  # the full relative motion; else Clohessy and Wiltshire's linear one


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
    return np.asarray(orbit.mean_motion**2 * _tide(orbit, x) + turning)


def orbital_potential(orbit: Orbit, x: Floats) -> Floats:
    """Potential per mass (...) [m2/s2] at x (..., 3) [m], zero at the origin of the scene.

    Two bodies: -mu/|rho| - n^2 |P rho|^2/2 less its value at x = 0, as the work against the tidal force along
    the ray from the origin, -int_0^1 a(s x).x ds, by Gauss and Legendre's rule: no difference of large
    numbers, and exact to round-off up to |x| = 0.8 R.
    """
    if not orbit.two_body:
        across = x @ np.array(orbit.normal)
        inward = 1.5 * (x @ np.array(orbit.radial)) ** 2
        return np.asarray(orbit.mean_motion**2 * (0.5 * across * across - inward))
    work = np.zeros(x.shape[:-1])
    reach = math.sqrt(float(np.max(np.sum(x * x, axis=-1), initial=0.0))) / orbit.radius
    for place, weight in zip(*np.polynomial.legendre.leggauss(_points(reach)), strict=True):
        work = work + 0.5 * weight * np.sum(_tide(orbit, 0.5 * (1.0 + place) * x) * x, axis=-1)
    return np.asarray(-(orbit.mean_motion**2) * work)


def _points(reach: float) -> int:
    """Points of Legendre's rule that are exact to round-off where |x| <= reach R.

    The error falls as rho^(-2 n), rho the sum of half axes of the ellipse through the pole at Earth's centre,
    seen from [-1, 1] (Trefethen, Approximation Theory and Approximation Practice, theorem 19.3).
    """
    pole = 2.0 / max(reach, 1e-12) - 1.0
    if pole < 1.25:
        return _MOST
    return min(_MOST, 2 + math.ceil(18.5 / math.acosh(pole)))  # acosh(pole) = log(rho)


def _tide(orbit: Orbit, x: Floats) -> Floats:
    """Two-body acceleration (..., 3) [m] at rest in Hill's frame, over n^2: P x - x/u^3 + (1 - 1/u^3) R r."""
    radius = orbit.radius
    q = (2.0 * (x @ np.array(orbit.radial)) + np.sum(x * x, axis=-1) / radius) / radius
    u = np.sqrt(1.0 + q)
    cube = u * u * u
    outward = q * (u * u + u + 1.0) / ((1.0 + u) * cube) * orbit.radius
    h = np.array(orbit.normal)
    inplane = x - (x @ h)[..., None] * h
    return np.asarray(inplane - x / cube[..., None] + outward[..., None] * np.array(orbit.radial))


@dataclass(frozen=True)
class J2(Frame):
    """A place on an orbit: its inclination and the argument of latitude [rad]."""

    inclination: float
    argument_of_latitude: float


def axis(place: J2) -> Floats:
    """Unit vector (3,) of the Earth's axis in the scene's axes.

    Latitude grows from the ascending node: k.r = sin i sin u, its rate along the track sin i cos u.
    """
    i, u = place.inclination, place.argument_of_latitude
    r, t, h = (np.array(a) for a in (place.radial, place.along_track, place.normal))
    return np.asarray(math.sin(i) * (math.sin(u) * r + math.cos(u) * t) + math.cos(i) * h)


def oblate_gradient(place: J2) -> Floats:
    """G (3, 3) [1/s2]: the acceleration of a node at x is G x."""
    k, r = axis(place), np.array(place.radial)
    s = float(k @ r)
    size = EARTH_MU * EARTH_J2 * EARTH_RADIUS**2 / (2.0 * place.radius**5)
    mixed = np.outer(k, r) + np.outer(r, k)
    return np.asarray(
        size
        * (
            (15.0 * s * s - 3.0) * np.eye(3)
            + (15.0 - 105.0 * s * s) * np.outer(r, r)
            - 6.0 * np.outer(k, k)
            + 30.0 * s * mixed
        )
    )
