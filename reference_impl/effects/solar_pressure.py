"""`solar_pressure`: a constant force C flux/c A along the light on each node.

The momentum of light is its energy over c (Vallado, section 8.6.4); C is 1 where all is absorbed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Vector
from reference_impl.table import Table, number, triple

LIGHT_SPEED = 299792458.0  # [m/s]


@dataclass(frozen=True)
class SolarPressure:
    """Light of `flux` [W/m2] along the unit vector `direction`; bullets show it `bullet_area` [m2]."""

    flux: float
    direction: Vector
    pressure_coefficient: float
    bullet_area: float


def solar_force(light: SolarPressure, area: Floats) -> Floats:
    """Forces (n, 3) [N] on nodes of `area` (n,) [m2]."""
    pressure = light.pressure_coefficient * light.flux / LIGHT_SPEED
    return np.asarray((pressure * area)[:, None] * np.array(light.direction))


def read_solar_pressure(table: Table) -> SolarPressure:
    """The light."""
    flux, direction = table.need("flux", number), table.need("direction", triple)
    coefficient = table.need("pressure_coefficient", number)
    return SolarPressure(flux, direction, coefficient, table.get("bullet_area", number, 0.0))
