"""What springs and gas in barrels push with, as functions of the way s along the barrel since the start.

law : data with F0 `force` [N], `stroke` [m], and of gas its `dead_length` V [m], the volume behind the bullet
      over the bore's area, and `exponent` gamma of the adiabatic expansion
In the subset of Python that Numba compiles.
"""

from __future__ import annotations

from typing import Any


def spring_force(s: float, law: Any) -> float:
    """F0 (1 - s / stroke) [N]."""
    return law.force * (1.0 - s / law.stroke)


def spring_energy(s: float, law: Any) -> float:
    """F0 (stroke - s)^2 / (2 stroke) [J]: the work that a spring has still to do."""
    left = law.stroke - s
    return law.force * left * left / (2.0 * law.stroke)


def gas_force(s: float, law: Any) -> float:
    """F0 (V / (V + s))^gamma [N]; F0 behind the start."""
    ratio = law.dead_length / (law.dead_length + max(s, 0.0))
    return law.force * ratio**law.exponent


def gas_energy(s: float, law: Any) -> float:
    """The work that the gas in a barrel has still to do [J]."""
    dead, less = law.dead_length, law.exponent - 1.0
    inside = (dead / (dead + max(s, 0.0))) ** less - (dead / (dead + law.stroke)) ** less
    return law.force * (dead / less * inside - min(s, 0.0))
