"""`j2`: the gravity gradient of the Earth's oblateness at one place of the orbit.

The force function of the second zonal harmonic is U = mu J2 Re^2 (1 - 3 (k.rho)^2/|rho|^2)/(2 |rho|^3), k the
Earth's axis (Vallado, Fundamentals of Astrodynamics and Applications, section 8.6).  Its second derivatives
at rho = R r are, with s = k.r,

    G = mu J2 Re^2/(2 R^5) [(15 s^2 - 3) I + (15 - 105 s^2) r r^T - 6 k k^T + 30 s (k r^T + r k^T)],

of trace zero, as Laplace's equation wants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.effects.earth import EARTH_J2, EARTH_MU, EARTH_RADIUS
from reference_impl.effects.frame import Frame, read_frame
from reference_impl.table import Table, number

PART_OF_ORBIT = 1.0 / 20.0  # the longest scene: the place is taken as constant


@dataclass(frozen=True)
class J2(Frame):
    """A place on an orbit: its inclination and the argument of latitude [rad]."""

    inclination: float
    argument_of_latitude: float


def read_j2(table: Table, end: float | None) -> J2 | None:
    """The place; None with faults noted where it cannot be read.  `end` [s] of the scene, if it is known."""
    frame = read_frame(table)
    inclination = table.need("inclination", number(0.0, maximum=math.pi))
    latitude = table.need("argument_of_latitude", number())
    if frame is None or inclination is None or latitude is None:
        return None
    longest = PART_OF_ORBIT * 2.0 * math.pi / frame.mean_motion
    if end is not None and end > longest:
        table.faults.append(
            f"{table.path}: time.end must be at most 1/20 orbit, {longest:.6g} s, because the place is held"
        )
    return J2(frame.mean_motion, frame.radial, frame.along_track, inclination, latitude)


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
