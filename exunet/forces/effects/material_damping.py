"""Viscous stress along the current direction while taut, S11 = max(E (E11 + tau dE11/dt), 0): objective.

A Kelvin-Voigt material in Green-Lagrange strain and second Piola-Kirchhoff stress that cannot push; a rigid
motion of the net is not braked, unlike by eq. (13).
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.record import NonNegative
from exunet.forces.blocks import Blocks
from exunet.forces.cable_term import ElementLaw
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis, snap_of


class MaterialDamping(Effect):
    """Viscous stress along the current direction, only while taut."""

    INTERNAL: ClassVar = True

    relaxation_time: NonNegative = Field(
        description="tau, viscosity over Young's modulus [s]", examples=[1e-5]
    )

    def terms(self, blocks: Blocks) -> tuple[ElementLaw, ...]:
        """Return the same relaxation time for every element; nothing if it is zero."""
        if self.relaxation_time == 0.0:
            return ()
        return (ElementLaw(relaxation_time=np.full(blocks.net.n_elements, self.relaxation_time)),)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[MaterialDamping, str]:
        """Assume as much damping of the same modes as by the paper's beta, while taut."""
        return MaterialDamping(relaxation_time=1e-8), "tau = 1e-8 s, as the paper's beta"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the speed lost in the hardest snap, v (1 - exp(-pi tau omega / 2)), over half the time."""
        snap = snap_of(basis)
        ratio = 0.5 * self.relaxation_time * snap.frequency
        lost = -math.expm1(-math.pi * ratio) if ratio < 1.0 else 1.0
        return Estimate(
            2.0 * ratio * snap.frequency * snap.speed * (basis.speed / snap.speed if snap.speed else 0.0),
            basis.held(0.5 * lost * basis.speed * basis.duration),
            f"damping ratio tau omega / 2 = {ratio:.2g} of the first snap, "
            f"omega = {snap.frequency:.3g} rad/s",
        )
