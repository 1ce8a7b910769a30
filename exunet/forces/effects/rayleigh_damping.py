"""Rayleigh damping with the tangent stiffness of the reference configuration: paper, eqs. (13), (14).

It is not objective: beta T brakes a rigid rotation of the net too, and damps slack elements along their
reference direction. That is the paper's model; it is kept exactly. `material_damping` is objective. The
reference configuration lies in the axes in which the net starts, so that the damping of a net in a canister
turns with the canister. Tethers, which have no reference configuration, are damped along the straight line
between their ends at the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import scipy
from pydantic import Field

from exunet.base.errors import CaseError, Fault
from exunet.base.record import NonNegative
from exunet.forces.blocks import Blocks
from exunet.forces.cable import reference_spans, reference_tangent_stiffness
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm
from exunet.forces.on_bodies import braking_on_bodies
from exunet.forces.terms import KernelTerm


class RayleighDamping(Effect):
    """D = alpha M + beta T(reference), eq. (13)."""

    NUMERICAL: ClassVar = True  # proportional damping: no material or medium has it
    NOT_WITH: ClassVar = {
        "reels": "its beta would damp along elements on the drum; use material_damping",
        "perimeter": "its beta damps threads as if they kept their length; use material_damping",
    }

    alpha: NonNegative = Field(description="factor of the mass matrix [1/s]", examples=[1e-3])
    beta: NonNegative = Field(description="factor of the tangent stiffness matrix [s]", examples=[1e-8])

    def terms(self, blocks: Blocks) -> tuple[LinearTerm | KernelTerm, ...]:
        """Return the constant damping matrix of eq. (13); its part by the mass on bodies too."""
        if self.beta and (faults := list(_without_direction(blocks))):
            raise CaseError(faults)
        damping = self.matrix(blocks)
        on_points = (LinearTerm(damping=damping),) if damping.nnz else ()
        return *on_points, *braking_on_bodies(blocks, self.alpha)

    def not_with(self) -> Mapping[str, str]:
        return self.NOT_WITH if self.beta else {}

    def matrix(self, blocks: Blocks) -> scipy.sparse.csr_array:
        """Return D of eq. (13), (3 n_points, 3 n_points) [N s/m]."""
        stiffness = reference_tangent_stiffness(blocks.net, blocks.position, blocks.poses.net)
        damping = scipy.sparse.diags_array(np.repeat(self.alpha * blocks.own_mass, 3)) + self.beta * stiffness
        damping = scipy.sparse.csr_array(damping)
        damping.eliminate_zeros()
        return damping

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[RayleighDamping, str]:
        """Assume the paper's coefficients."""
        return RayleighDamping(alpha=1e-3, beta=1e-8), "alpha = 1e-3 1/s, beta = 1e-8 s (paper, sec. 3.3)"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the way lost by a speed that changes at the rate |M^-1 D v| / |v| of the start."""
        speed = basis.rms(basis.velocity)
        rate = 0.0
        if speed > 0.0:
            force = self.matrix(basis.blocks) @ basis.velocity.ravel()
            rate = basis.of_force(force.reshape(-1, 3)) / speed
        return Estimate(
            rate * basis.speed,
            basis.held(basis.braked(rate)),
            f"|Dv| / |Mv| = {rate:.3g} 1/s at the start, a speed of {basis.speed:.3g} m/s",
        )


def _without_direction(blocks: Blocks) -> Iterator[Fault]:
    """A fault for each tether whose ends are at one place at the start."""
    span = reference_spans(blocks.net, blocks.position, blocks.poses.net)
    for name, elements in blocks.net.tether_elements.items():
        if not span[elements].any():
            words = (
                "its ends are at one place at the start, so beta of rayleigh_damping has no direction to damp"
            )
            yield Fault(f"tethers.{name}.end", f"{words} along: move one, or use material_damping")
