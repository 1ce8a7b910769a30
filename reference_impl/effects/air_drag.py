"""`air_drag`: cables in cross-flow and bullets in still air.

Cross-flow principle (Hoerner, Fluid-Dynamic Drag, section 3.11): only the velocity normal to a cable counts.
On each element -rho C d L |u_n| u_n/2, half on either end, u_n the mean velocity of its ends normal to the
line between them; on each bullet -rho C A |v| v/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, dot
from reference_impl.effects.values import of_bullets
from reference_impl.table import Table, number


@dataclass(frozen=True)
class AirDrag:
    """Still air of `density` [kg/m3]; coefficients of cables and bullets, frontal area of a bullet [m2]."""

    density: float
    drag_coefficient: float
    bullet_drag_coefficient: float
    bullet_area: float


def read_air_drag(table: Table, bullets: bool) -> AirDrag | None:
    """The drag; None with faults noted where it cannot be read."""
    values = (
        table.need("density", number(above=0.0)),
        table.need("drag_coefficient", number(0.0)),
        of_bullets(table, "bullet_drag_coefficient", bullets),
        of_bullets(table, "bullet_area", bullets),
    )
    return None if None in values else AirDrag(*values)


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
