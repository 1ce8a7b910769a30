"""Breaking: an element whose strain or force exceeds a limit at the end of a step carries nothing any more.

The elastic energy that it held is booked as dissipated. Its mass stays lumped at its nodes. Methods that
choose their step shorten it near a limit, so that this energy is right to about 1e-3; with equal steps the
summary says by how much it was too large.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from exunet.base.faults import Wrong, refuse_with, unless_one
from exunet.base.incomplete import Unknown
from exunet.base.table import Positive, Table, exactly_one
from exunet.forces.cable_term import ElementLaw
from exunet.forces.estimate import Estimate, EstimateBasis, hardest_strain, snap_of
from exunet.forces.points import Points
from exunet.forces.requirements import Surroundings

# They use, in the step after a break, the acceleration of the step before it.
REMEMBERING = ("VelocityVerlet", "GeneralizedAlpha", "TrapezoidalIndex2")


class Keys(Table):
    """Elements break for good at a strain or a force."""

    model_config = exactly_one("strain", "force")

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

    @model_validator(mode="wrap")
    @classmethod
    def _one_limit(cls, keys: Any, handler: Any) -> Any:
        return refuse_with(unless_one(("strain", "force"), keys), keys, handler)


def terms(keys: Keys, points: Points) -> tuple[ElementLaw, ...]:
    """The limit of every element."""
    everywhere = np.ones(points.net.n_elements)
    if keys.strain is not None:
        return (ElementLaw(breaking_strain=keys.strain * everywhere),)
    assert keys.force is not None
    return (ElementLaw(breaking_force=keys.force * everywhere),)


def needs(keys: Keys, around: Surroundings) -> Iterator[Wrong]:
    """A method that starts each step afresh, and no damping along elements that may be gone."""
    with suppress(Unknown):
        if around.method in REMEMBERING:
            words = f"needs an explicit Runge-Kutta method such as DOPRI5 or RK44, not {around.method}"
            yield Wrong((), words)
    with suppress(Unknown):
        if getattr(around.on.get("rayleigh_damping"), "beta", 0.0) > 0.0:
            words = "contradicts effects.rayleigh_damping.beta, which damps along broken elements too"
            yield Wrong((), f"{words}; use material_damping")


def nominal(basis: EstimateBasis) -> tuple[Keys, str]:
    """Strain at break of aramid fibre."""
    return Keys.model_validate({"strain": 0.03}), "breaks at a strain of 0.03, as aramid fibres do"


def magnitude(keys: Keys, basis: EstimateBasis) -> Estimate:
    """Nothing if the hardest snap stays below the limit, else the way of what flies off at its speed."""
    snap, strain = snap_of(basis), hardest_strain(basis)
    limit = keys.strain
    if limit is None:
        assert keys.force is not None
        limit = keys.force / float(basis.net.axial_stiffness.max(initial=np.inf))
    breaks = strain > limit
    words = "breaks" if breaks else "holds"
    return Estimate(
        snap.frequency * snap.speed if breaks else 0.0,
        basis.held(basis.speed * basis.duration) if breaks else 0.0,
        f"strain v sqrt(m / EA L) = {strain:.2g} of the hardest snap, limit {limit:.2g}: {words}",
    )
