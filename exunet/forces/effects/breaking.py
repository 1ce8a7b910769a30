"""Breaking: an element whose strain or force exceeds a limit at the end of a step carries no load afterwards.

Its elastic energy counts as dissipated; its mass remains lumped at its nodes. Adaptive methods shorten their
steps near a limit, so that this energy is accurate to about 1e-6; with equal steps the summary says by how
much it was too large.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.forces.blocks import Blocks
from exunet.forces.cable import AxialLaw
from exunet.forces.cable_term import ElementLaw
from exunet.forces.effect import Effect, RestOfCase
from exunet.forces.effects.rayleigh_damping import RayleighDamping
from exunet.forces.estimate import Estimate, EstimateBasis, hardest_strain, snap_of
from exunet.net.arrays import Floats, Net


class Breaking(Effect):
    """Elements break for good at a strain or a force."""

    NEEDS_FRESH_STEPS: ClassVar = True
    INTERNAL: ClassVar = True
    NOT_WITH: ClassVar = {
        "reels": "elements of a tether on a reel do not break",
        "perimeter": "threads that become shorter do not break",
    }
    EXACTLY_ONE: ClassVar = ("strain", "force")

    strain: Positive | None = Field(
        None,
        description="Green-Lagrange strain, free strain excluded, above which an element breaks",
        examples=[0.03],
    )
    force: Positive | None = Field(
        None,
        description="elastic axial force [N] above which an element breaks, instead of strain",
        examples=[500.0],
    )

    def terms(self, blocks: Blocks) -> tuple[ElementLaw, ...]:
        """Return the limit of every element."""
        everywhere = np.ones(blocks.net.n_elements)
        if self.strain is not None:
            return (ElementLaw(breaking_strain=self.strain * everywhere),)
        assert self.force is not None
        return (ElementLaw(breaking_force=self.force * everywhere),)

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require no Rayleigh damping by the stiffness."""
        rayleigh = rest.scene.effects.get(RayleighDamping)
        if rayleigh is not None and rayleigh.beta != 0.0:
            words = "which damps along broken elements too; use material_damping"
            yield Fault("", f"contradicts effects.rayleigh_damping.beta, {words}")

    def breaking_limits(self, net: Net, free_strain: float) -> Floats:
        if self.force is not None:
            return np.full(net.n_elements, self.force)
        assert self.strain is not None
        if net.law_number is not None:
            return AxialLaw.of(net).tension(net.reference_length * math.sqrt(1.0 + 2.0 * self.strain))
        return np.asarray(
            self.strain * math.sqrt(1.0 + 2.0 * (self.strain + free_strain)) * net.axial_stiffness
        )

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[Breaking, str]:
        """Assume the strain at break of aramid fibre."""
        return Breaking.model_validate({"strain": 0.03}), "breaks at a strain of 0.03, as aramid fibres do"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the way of what flies off; nothing if the hardest snap stays below the limit."""
        snap, strain = snap_of(basis), hardest_strain(basis)
        limit = self.strain
        if limit is None:
            assert self.force is not None
            limit = self.force / float(basis.net.axial_stiffness.min(initial=np.inf))
        breaks = strain > limit
        words = "breaks" if breaks else "holds"
        return Estimate(
            snap.frequency * snap.speed if breaks else 0.0,
            basis.held(basis.speed * basis.duration) if breaks else 0.0,
            f"strain v sqrt(m / EA L) = {strain:.2g} of the hardest snap, limit {limit:.2g}: {words}",
        )
