"""`air_drag` and `molecular_drag`: forces of gas on cables, nodes and bullets.

`air_drag` is that of cables in cross-flow and of bullets in still air.  Cross-flow principle (Hoerner,
Fluid-Dynamic Drag, section 3.11): only the velocity normal to a cable counts.  On each element
-rho C d L |u_n| u_n/2, half on either end, u_n the mean velocity of its ends normal to the line between them;
on each bullet -rho C A |v| v/2.

`molecular_drag` is rho C A |u| u/2 on each node with u = flow - v, as in free-molecular flow, with the areas
A of tumbling cylinders (`net.exposed`).  The density at an altitude is that of the exponential atmosphere,
layer by layer: rho = rho0 exp(-(h - h0)/H) (Vallado, Fundamentals of Astrodynamics and Applications, section
8.6.2 and table 8-4, from 150 km on).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Vector, dot
from reference_impl.table import Table, number, triple

LAYERS = (  # base h0 [km], density there rho0 [kg/m3], scale height H [km]
    (150.0, 2.070e-9, 22.523),
    (180.0, 5.464e-10, 29.740),
    (200.0, 2.789e-10, 37.105),
    (250.0, 7.248e-11, 45.546),
    (300.0, 2.418e-11, 53.628),
    (350.0, 9.518e-12, 53.298),
    (400.0, 3.725e-12, 58.515),
    (450.0, 1.585e-12, 60.828),
    (500.0, 6.967e-13, 63.822),
    (600.0, 1.454e-13, 71.835),
    (700.0, 3.614e-14, 88.667),
    (800.0, 1.170e-14, 124.64),
    (900.0, 5.245e-15, 181.05),
    (1000.0, 3.019e-15, 268.00),
)


@dataclass(frozen=True)
class AirDrag:
    """Still air of `density` [kg/m3]; coefficients of cables and bullets, frontal area of a bullet [m2]."""

    density: float
    drag_coefficient: float
    bullet_drag_coefficient: float
    bullet_area: float


def cable_drag(drag: AirDrag, frontal: Floats, d: Floats, u: Floats) -> Floats:
    """Forces (m, 3) [N] on elements of frontal area d L (m,) [m2] along d (m, 3) [m].

    u (m, 3) [m/s] is the mean velocity of the two ends; all of it counts as normal where the ends coincide.
    """
    squared = dot(d, d)
    along = dot(u, d) / np.where(squared > 0.0, squared, 1.0)
    normal = u - along[:, None] * d
    return np.asarray(_dynamic(drag.density * drag.drag_coefficient * frontal, normal))


def bullet_drag(drag: AirDrag, v: Floats) -> Floats:
    """Forces (k, 3) [N] on bullets that move with v (k, 3) [m/s]."""
    reach = np.full(len(v), drag.density * drag.bullet_drag_coefficient * drag.bullet_area)
    return _dynamic(reach, v)


def _dynamic(factor: Floats, u: Floats) -> Floats:
    """-factor |u| u/2, row by row."""
    return np.asarray(-(0.5 * factor * np.sqrt(dot(u, u)))[:, None] * u)


@dataclass(frozen=True)
class MolecularDrag:
    """Gas of `density` [kg/m3] that flows with `flow` [m/s]."""

    density: float
    flow: Vector
    drag_coefficient: float
    bullet_area: float  # [m2]


def molecular_force(drag: MolecularDrag, area: Floats, v: Floats) -> Floats:
    """Forces (n, 3) [N] on nodes of `area` (n,) [m2] that move with v (n, 3) [m/s]."""
    u = np.array(drag.flow) - v
    pressure = 0.5 * drag.density * drag.drag_coefficient * area * np.sqrt(dot(u, u))
    return np.asarray(pressure[:, None] * u)


def read_air_drag(table: Table) -> AirDrag:
    """The drag; bullets have keys of their own where there are any."""
    density, coefficient = table.need("density", number), table.need("drag_coefficient", number)
    of_bullets = (table.get(key, number, 0.0) for key in ("bullet_drag_coefficient", "bullet_area"))
    return AirDrag(density, coefficient, *of_bullets)


def read_molecular_drag(table: Table) -> MolecularDrag:
    """The drag, at a density or at the altitude that has it."""
    if "altitude" in table:
        density = atmospheric_density(table.need("altitude", number))
    else:
        density = table.need("density", number)
    flow, coefficient = table.need("flow", triple), table.need("drag_coefficient", number)
    return MolecularDrag(density, flow, coefficient, table.get("bullet_area", number, 0.0))


def atmospheric_density(altitude: float) -> float:
    """Density [kg/m3] at an altitude [m] from 150 km to 2000 km."""
    height = altitude / 1e3
    base, at_base, scale = LAYERS[bisect_right(LAYERS, height, key=lambda layer: layer[0]) - 1]
    return at_base * math.exp(-(height - base) / scale)
