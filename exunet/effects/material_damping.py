"""Viscous stress along the current direction while taut, S11 = max(E (E11 + tau dE11/dt), 0): objective.

A Kelvin-Voigt material in Green-Lagrange strain and second Piola-Kirchhoff stress that cannot push; a rigid
motion of the net is not braked, unlike by eq. (13).
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.record import NonNegative, Record


class Keys(Record):
    """Viscous stress along the current direction, only while taut."""

    relaxation_time: NonNegative = Field(description="tau, viscosity over Young's modulus [s]")


def terms(keys: Keys, net: Net) -> Terms:
    """The same relaxation time for every element; nothing if it is zero."""
    if keys.relaxation_time == 0.0:
        return Terms()
    return Terms(relaxation_time=np.full(net.n_elements, keys.relaxation_time))
