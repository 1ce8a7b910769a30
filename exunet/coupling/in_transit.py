"""Momentum that a host has been given and does not show yet: methods that weigh the forces of two steps.

Exudyn's velocity Verlet and its trapezoidal rule take the mean of the forces at both ends of a step, of which
the one at the beginning is that of the step before: half of the last impulse is still to come. The
generalised-alpha method (Arnold and Bruels, "Convergence of the generalized-alpha scheme for constrained
mechanical systems", Multibody Syst. Dyn. 18 (2007), doi 10.1007/s11044-007-9084-0) spreads it over more steps
by its algorithmic acceleration. The Runge-Kutta methods take the impulse whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class InTransit(Protocol):
    """What of the impulses is on its way to the host's velocities."""

    def take(self, force: Floats, step: float) -> None:
        """A mean force (n,) [N] over a step [s]."""

    @property
    def impulse(self) -> Floats:
        """(n,) [N s] that the host is still to show."""


@dataclass
class Nothing:
    """Of methods that take each impulse whole."""

    impulse: Floats

    def take(self, force: Floats, step: float) -> None: ...


@dataclass
class Weighed:
    """Of the generalised-alpha method, with a of the step before as b, F as E:

        (1 - m) a + m b = (1 - f) F + f E,    v += h ((1 - g) b + g a)

    mass, force, gamma : m, f and g; 0, 0 and 1/2 for the trapezoidal rule and for velocity Verlet
    """

    impulse: Floats
    mass: float = 0.0
    force: float = 0.0
    gamma: float = 0.5
    _before: Floats = field(init=False)
    _rate: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._before = self._rate = np.zeros_like(self.impulse)

    def take(self, force: Floats, step: float) -> None:
        """See `InTransit`."""
        weighed = (1.0 - self.force) * force + self.force * self._before - self.mass * self._rate
        rate = weighed / (1.0 - self.mass)
        shown = step * ((1.0 - self.gamma) * self._rate + self.gamma * rate)
        self.impulse = self.impulse + step * force - shown
        self._before, self._rate = force, rate


def of_method(name: str, size: int, *, spectral_radius: float, newmark: bool) -> InTransit:
    """Of a solver type of Exudyn; size: how many components a force has."""
    nothing = np.zeros(size)
    if name in ("VelocityVerlet", "TrapezoidalIndex2") or (name == "GeneralizedAlpha" and newmark):
        return Weighed(nothing)
    if name == "GeneralizedAlpha":
        mass = (2.0 * spectral_radius - 1.0) / (spectral_radius + 1.0)
        force = spectral_radius / (spectral_radius + 1.0)
        return Weighed(nothing, mass, force, 0.5 + force - mass)
    return Nothing(nothing)
