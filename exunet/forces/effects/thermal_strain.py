"""Thermal strain: cables warmer or colder than in the reference configuration are free at another length.

The free stretch is 1 + alpha dT, so the free Green-Lagrange strain is alpha dT + (alpha dT)^2 / 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.forces import cable
from exunet.forces.blocks import Blocks
from exunet.forces.cable import AxialLaw
from exunet.forces.cable_term import CableTerm, ElementLaw
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.law import excess_over


class ThermalStrain(Effect):
    """All cables at another temperature than in the reference configuration."""

    INTERNAL: ClassVar = True

    temperature_change: float = Field(
        description="difference from the reference configuration [K]", examples=[-80.0]
    )
    expansion_coefficient: float = Field(
        description="alpha, along the cable [1/K], negative for aramids; times the temperature change "
        "at most 0.1",
        examples=[-2.4e-6],
    )

    @property
    def stretch(self) -> float:
        """Free length over reference length."""
        return 1.0 + self.expansion_coefficient * self.temperature_change

    @property
    def free_strain(self) -> float:
        """Green-Lagrange strain of the free length."""
        return 0.5 * excess_over(self.stretch**2, 1.0)

    def faults(self) -> Iterator[Fault]:
        """Require a small strain."""
        strain = self.stretch - 1.0
        if not abs(strain) <= 0.1:
            yield Fault("", f"the thermal strain alpha dT must be between -0.1 and 0.1, got {strain:.3g}")

    def terms(self, blocks: Blocks) -> tuple[ElementLaw, ...]:
        """Return the same free strain for every element; nothing if it is zero."""
        if self.stretch == 1.0:
            return ()
        return (ElementLaw(free_strain=np.full(blocks.net.n_elements, self.free_strain)),)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[ThermalStrain, str]:
        """Assume a net that comes from a workshop into the shade of an orbit."""
        keys = ThermalStrain(temperature_change=-100.0, expansion_coefficient=5e-6)
        return keys, "100 K colder, alpha = 5e-6 1/K"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the change of the open net's distances; of a taut net, the flight on its elastic energy.

        Cold cables stretch a net that was just taut; it pulls itself together, goes slack, and flies on.
        """
        net = basis.net
        law = CableTerm(net, sum(self.terms(basis.blocks), ElementLaw())).law
        length = cable.lengths(net, basis.position)
        pull = law.tension(length)
        change = pull - AxialLaw.of(net).tension(length)
        along = cable.spans(net, basis.position) * (change / np.where(length > 0.0, length, 1.0))[:, None]
        force = np.zeros((net.n_nodes, 3))
        np.add.at(force, net.element_nodes[:, 0], along)
        np.subtract.at(force, net.element_nodes[:, 1], along)
        acceleration = basis.of_force(force)
        stored = cable.elastic_energy(law, length) - cable.elastic_energy(AxialLaw.of(net), length)
        speed = float(np.sqrt(2.0 * max(float(stored), 0.0) / net.mass[basis.free].sum()))
        flight = min(basis.ballistic(acceleration), basis.held(speed * basis.duration))
        static = abs(self.stretch - 1.0) * basis.rms(net.reference_position)
        return Estimate(
            acceleration,
            max(static, flight),
            f"strain alpha dT = {self.stretch - 1.0:.2g} of the open net"
            + (f"; sets free {stored:.2g} J of a taut net" if flight > static else ""),
        )
