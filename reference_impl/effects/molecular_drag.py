"""`molecular_drag`: on each node rho C A |u| u/2 with u = flow - v, as in free-molecular flow.

The areas A are those of tumbling cylinders (`areas`); for the law see Vallado, section 8.6.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Vector, dot
from reference_impl.effects.atmosphere import HIGHEST, LOWEST, density
from reference_impl.effects.values import of_bullets, one_of
from reference_impl.table import Table, number, numbers


@dataclass(frozen=True)
class MolecularDrag:
    """Gas of `density` [kg/m3] that flows with `flow` [m/s]; `altitude` [m] if the density comes from it."""

    density: float
    altitude: float | None
    flow: Vector
    drag_coefficient: float
    bullet_area: float  # [m2]


def read_molecular_drag(table: Table, bullets: bool) -> MolecularDrag | None:
    """The drag; None with faults noted where it cannot be read."""
    gas = one_of(table, {"density": number(above=0.0), "altitude": number(LOWEST, maximum=HIGHEST)})
    flow, coefficient = table.need("flow", numbers(3)), table.need("drag_coefficient", number(0.0))
    area = of_bullets(table, "bullet_area", bullets)
    rho, altitude = gas["density"], gas["altitude"]
    if altitude is not None:
        rho = density(altitude)
    if None in (rho, flow, coefficient, area):
        return None
    return MolecularDrag(rho, altitude, flow, coefficient, area)


def molecular_force(drag: MolecularDrag, area: Floats, v: Floats) -> Floats:
    """Forces (n, 3) [N] on nodes of `area` (n,) [m2] that move with v (n, 3) [m/s]."""
    u = np.array(drag.flow) - v
    pressure = 0.5 * drag.density * drag.drag_coefficient * area * np.sqrt(dot(u, u))
    return np.asarray(pressure[:, None] * u)
