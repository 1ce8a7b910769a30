"""Breaking: an element whose strain or force exceeds a limit at the end of a step carries no load afterwards.

Its elastic energy counts as dissipated; its mass remains lumped at its nodes. Adaptive methods shorten their
steps near a limit, so that this energy is accurate to about 1e-6; with equal steps the summary says by how
much it was too large.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.record import Positive, Record
from exunet.forces.blocks import Blocks
from exunet.forces.cable import Law
from exunet.forces.cable_term import ElementLaw
from exunet.forces.estimate import Estimate, EstimateBasis, hardest_strain, snap_of
from exunet.net.arrays import Floats, Net

NEEDS_FRESH_STEPS = True
NEEDS_ZERO = {
    "rayleigh_damping": {"beta": "which damps along broken elements too; use material_damping"},
}


class Breaking(Record):
    """Elements break for good at a strain or a force."""

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


def internal(keys: Breaking) -> bool:
    """Its forces are pulls along elements, or springs whose forces and moments cancel."""
    return True


def not_with_reels(keys: Breaking) -> str:
    """Why the threads of a reel cannot have it."""
    return "elements of a tether on a reel do not break"


def not_with_perimeter(keys: Breaking) -> str:
    """Why an edge that becomes shorter cannot have it."""
    return "threads that become shorter do not break"


def terms(keys: Breaking, blocks: Blocks) -> tuple[ElementLaw, ...]:
    """The limit of every element."""
    everywhere = np.ones(blocks.net.n_elements)
    if keys.strain is not None:
        return (ElementLaw(breaking_strain=keys.strain * everywhere),)
    assert keys.force is not None
    return (ElementLaw(breaking_force=keys.force * everywhere),)


def limits(keys: Breaking, net: Net, free_strain: float = 0.0) -> Floats:
    """(n_elements,) axial force [N] at which each element breaks; free_strain: of a thermal strain."""
    if keys.force is not None:
        return np.full(net.n_elements, keys.force)
    assert keys.strain is not None
    if net.law_number is not None:
        return Law.of(net).tension(net.reference_length * math.sqrt(1.0 + 2.0 * keys.strain))
    return np.asarray(keys.strain * math.sqrt(1.0 + 2.0 * (keys.strain + free_strain)) * net.axial_stiffness)


def nominal(basis: EstimateBasis) -> tuple[Breaking, str]:
    """Strain at break of aramid fibre."""
    return Breaking.model_validate({"strain": 0.03}), "breaks at a strain of 0.03, as aramid fibres do"


def magnitude(keys: Breaking, basis: EstimateBasis) -> Estimate:
    """Nothing if the hardest snap stays below the limit, else the way of what flies off at its speed."""
    snap, strain = snap_of(basis), hardest_strain(basis)
    limit = keys.strain
    if limit is None:
        assert keys.force is not None
        limit = keys.force / float(basis.net.axial_stiffness.min(initial=np.inf))
    breaks = strain > limit
    words = "breaks" if breaks else "holds"
    return Estimate(
        snap.frequency * snap.speed if breaks else 0.0,
        basis.held(basis.speed * basis.duration) if breaks else 0.0,
        f"strain v sqrt(m / EA L) = {strain:.2g} of the hardest snap, limit {limit:.2g}: {words}",
    )
