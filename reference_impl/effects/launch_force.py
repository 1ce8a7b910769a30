"""`launch_force`: springs or gas push the bullets along their barrels; the chaser takes the reaction.

With the way s of a bullet along its barrel, relative to the chaser and since the start, the force is
F0 (1 - s/stroke) or F0 (V/(V + s))^gamma while s < stroke (gas behind the start: F0).  Gas expands
adiabatically: p V^gamma is constant (any textbook of thermodynamics).  The force depends on s alone, so it
has a potential, the energy that springs or gas still hold: zero for a bullet that has left its barrel.

The chaser is a point mass or one of the rigid bodies (`barrels`).  From a body a bullet leaves for good: it
is not pushed again where its barrel turns back to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Bools, Floats
from reference_impl.table import Table, number, text

CHASER = "chaser"  # name of the point mass among the bodies


@dataclass(frozen=True)
class LaunchForce:
    """F0 `force` on each bullet [N], `stroke` [m], `spread_angle` of the barrels from +z [rad], chaser [kg].

    `dead_length` V [m] and `exponent` gamma are those of gas; both None for springs.  With `body`, the name
    of one of [bodies], the barrels are fixed to it, without a `chaser_mass`.
    """

    force: float
    stroke: float
    spread_angle: float
    chaser_mass: float | None
    dead_length: float | None = None
    exponent: float | None = None
    body: str | None = None

    def push(self, s: Floats, pushed: Bools | None = None) -> Floats:
        """Force (k,) [N] along the barrels at ways s (k,) [m]; of bullets `pushed`, else where s < stroke."""
        inside = s < self.stroke if pushed is None else pushed
        if self.dead_length is None or self.exponent is None:
            force = self.force * (1.0 - s / self.stroke)
        else:
            expanded = self.dead_length / (self.dead_length + np.maximum(s, 0.0))
            force = self.force * expanded**self.exponent
        return np.asarray(np.where(inside, force, 0.0))

    def mean(self, s0: Floats, s1: Floats) -> tuple[Floats, Floats]:
        """Mean force (k,) [N] over the ways from s0 to s1, and its derivative with respect to s1 [N/m].

        The work over s1 - s0 is the fall of `held` over it: the discrete gradient of the energy-momentum
        method.  Written without differences of energies, so that it is exact also where s1 is close to s0.
        """
        low, high = np.minimum(s0, s1), np.maximum(s0, s1)
        whole = high - low
        within = np.maximum(np.minimum(high, self.stroke) - low, 0.0)  # the part inside the barrel
        share = np.where(whole > 0.0, within / np.where(whole > 0.0, whole, 1.0), low < self.stroke)
        begin = np.minimum(low, self.stroke)
        if self.dead_length is None or self.exponent is None:
            mean = self.force * (1.0 - (begin + 0.5 * within) / self.stroke)
        else:
            behind = np.clip(-begin, 0.0, within)
            ahead = within - behind
            volume, power = self.dead_length + np.maximum(begin, 0.0), self.exponent - 1.0
            fall = -np.expm1(-power * np.log1p(ahead / volume)) * volume / power
            work = self.force * (behind + (self.dead_length / volume) ** self.exponent * fall)
            at_begin = self.push(begin, begin <= self.stroke)
            mean = np.where(within > 0.0, work / np.where(within > 0.0, within, 1.0), at_begin)
        mean = mean * share
        close = whole < 1e-6 * self.stroke
        step = np.where(close, 1e-6 * self.stroke, s1 - s0)
        near = (self.push(s1 + 0.5 * step) - self.push(s1 - 0.5 * step)) / (2.0 * step)
        return mean, np.where(close, near, (self.push(s1) - mean) / step)

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
    mass, body = table.get("chaser_mass", number, None), table.get("body", text, None)
    return LaunchForce(**values, chaser_mass=mass, body=body)
