"""Damping by the mass: a force -alpha m v on every node, the first part of eq. (13) alone."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import scipy
from pydantic import Field

from exunet.base.record import NonNegative
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm
from exunet.forces.on_bodies import braking_on_bodies
from exunet.forces.terms import KernelTerm


class MassDamping(Effect):
    """A force -alpha m v on every node."""

    NUMERICAL: ClassVar = True  # proportional damping: no material or medium has it

    alpha: NonNegative = Field(description="decay rate of the velocity [1/s]", examples=[0.1])

    def terms(self, blocks: Blocks) -> tuple[LinearTerm | KernelTerm, ...]:
        """Return the diagonal damping matrix alpha M, and the same on bodies; nothing if alpha is zero."""
        if self.alpha == 0.0:
            return ()
        damping = scipy.sparse.csr_array(scipy.sparse.diags_array(np.repeat(self.alpha * blocks.own_mass, 3)))
        return LinearTerm(damping=damping), *braking_on_bodies(blocks, self.alpha)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[MassDamping, str]:
        """Assume the paper's coefficient."""
        return MassDamping(alpha=1e-3), "alpha = 1e-3 1/s (paper, sec. 3.3)"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the way lost by a speed that decays as exp(-alpha t)."""
        return Estimate(
            self.alpha * basis.speed,
            basis.held(basis.braked(self.alpha)),
            f"decay at alpha = {self.alpha:.3g} 1/s of a speed of {basis.speed:.3g} m/s",
        )
