"""`launch_force`: springs or gas push the bullets along their barrels; the chaser takes the reaction.

With the way s of a bullet along its barrel, relative to the chaser and since the start, the force is
F0 (1 - s/stroke) or F0 (V/(V + s))^gamma while s < stroke (gas behind the start: F0).  Gas expands
adiabatically: p V^gamma is constant (any textbook of thermodynamics).  The force depends on s alone, so it
has a potential, the energy that springs or gas still hold: zero for a bullet that has left its barrel.

The barrels are fixed to a rigid body, the chaser (`launch`).  A bullet leaves for good: it is not pushed
again where its barrel turns back to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Bools, Floats
from reference_impl.table import Table, number, text


@dataclass(frozen=True)
class LaunchForce:
    """F0 `force` on each bullet [N], `stroke` [m], `spread_angle` of the barrels from +z [rad], the chaser.

    `dead_length` V [m] and `exponent` gamma are those of gas; both None for springs.
    """

    force: float
    stroke: float
    spread_angle: float
    body: str
    dead_length: float | None = None
    exponent: float | None = None

    def push(self, s: Floats, pushed: Bools | None = None) -> Floats:
        """Force (k,) [N] along the barrels at ways s (k,) [m]; of bullets `pushed`, else where s < stroke."""
        inside = s < self.stroke if pushed is None else pushed
        if self.dead_length is None or self.exponent is None:
            force = self.force * (1.0 - s / self.stroke)
        else:
            expanded = self.dead_length / (self.dead_length + np.maximum(s, 0.0))
            force = self.force * expanded**self.exponent
        return np.asarray(np.where(inside, force, 0.0))

    def held(self, s: Floats) -> Floats:
        """Energy (...) [J] that each spring or gas volume would still give: the work from s to the stroke."""
        left = np.maximum(self.stroke - s, 0.0)
        if self.dead_length is None or self.exponent is None:
            return np.asarray(0.5 * self.force / self.stroke * left * left)
        inside = np.clip(s, 0.0, self.stroke)
        volume, power = self.dead_length + inside, self.exponent - 1.0
        # F0 V^gamma/(gamma - 1) [(V + s)^(1 - gamma) - (V + stroke)^(1 - gamma)], without their difference
        ratio = np.log((self.dead_length + self.stroke) / volume)
        at_start = self.force * self.dead_length * (self.dead_length / volume) ** power / power
        return np.asarray(at_start * -np.expm1(-power * ratio) + self.force * np.maximum(-s, 0.0))


def read_launch_force(table: Table) -> LaunchForce:
    """The launch of the bullets."""
    kind = table.choice("kind", "spring", "gas")
    keys = ("force", "stroke", "spread_angle", *(("dead_length", "exponent") if kind == "gas" else ()))
    values = {key: table.need(key, number) for key in keys}
    return LaunchForce(**values, body=table.need("body", text))
