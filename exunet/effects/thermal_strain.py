"""Thermal strain: cables warmer or colder than in the reference configuration are free at another length.

The free stretch is 1 + alpha dT, so the free Green-Lagrange strain is alpha dT + (alpha dT)^2 / 2.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from exunet.effects.estimate import Estimate, Setting
from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.record import Record


class Keys(Record):
    """All cables at another temperature than in the reference configuration."""

    temperature_change: float = Field(description="against the reference configuration [K]", examples=[-80.0])
    expansion_coefficient: float = Field(
        description="alpha, along the cable [1/K]; negative for aramids", examples=[-2.4e-6]
    )

    @model_validator(mode="after")
    def _some_length_left(self) -> Self:
        if not abs(self.stretch - 1.0) <= 0.1:
            raise ValueError(
                f"the thermal strain alpha dT must be between -0.1 and 0.1, got {self.stretch - 1.0:.3g}"
            )
        return self

    @property
    def stretch(self) -> float:
        """Free length over reference length."""
        return 1.0 + self.expansion_coefficient * self.temperature_change


def terms(keys: Keys, net: Net) -> Terms:
    """The same free strain for every element; nothing if it is zero."""
    if keys.stretch == 1.0:
        return Terms()
    return Terms(free_strain=np.full(net.n_elements, 0.5 * (keys.stretch**2 - 1.0)))


def nominal(setting: Setting) -> tuple[Keys, str]:
    """From a workshop into the shade of an orbit."""
    keys = Keys(temperature_change=-100.0, expansion_coefficient=5e-6)
    return keys, "100 K colder, alpha = 5e-6 1/K"


def magnitude(keys: Keys, setting: Setting) -> Estimate:
    """The change of the distances from the origin in the open net; the force of the strain in one element."""
    net = setting.net
    strain = abs(keys.stretch - 1.0)
    i, j = net.element_nodes.T
    force = np.zeros(net.n_nodes)
    np.add.at(force, np.concatenate([i, j]), np.tile(net.axial_stiffness * strain, 2) / np.sqrt(2.0))
    way = strain * setting.rms(net.reference_position - net.reference_position.mean(axis=0))
    return Estimate(
        setting.of_force(np.outer(force, [1.0, 0.0, 0.0])),
        way,
        f"strain alpha dT = {keys.stretch - 1.0:.2g} of the open net; EA alpha dT on its nodes while taut",
    )
