"""Solar radiation pressure: a constant force away from the Sun on tumbling cables and on bullets.

F = C (flux / c) A along the light (Montenbruck and Gill, "Satellite Orbits", sec. 3.4). The cables tumble: A
is the mean over all orientations, pi d L0 / 4; nodes do not shade each other, and the Earth casts no shadow.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.record import NonNegative, Positive
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.environment import UnitVector, bullet_disc, tumbling_areas
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm

LIGHT = 299792458.0  # [m/s]


class SolarPressure(Effect):
    """Pressure of sunlight on tumbling cables and on bullets."""

    EXCLUDES: ClassVar = {"gravity": "uniform gravity is for the ground, sunlight in vacuum for orbits"}
    BULLET_KEYS: ClassVar = ("bullet_area",)
    ON_THE_NET_ALONE: ClassVar = True

    flux: Positive = Field(description="energy flux of sunlight [W/m2], 1361 at the Earth", examples=[1361.0])
    direction: UnitVector = Field(
        description="unit vector of the light, away from the Sun, in the scene's axes",
        examples=[[1.0, 0.0, 0.0]],
    )
    pressure_coefficient: NonNegative = Field(
        le=2.0, description="C [-]: 1 absorbs all light, 2 sends all back", examples=[1.3]
    )
    bullet_area: NonNegative | None = Field(
        None,
        description="area of a bullet across the light [m2]; if and only if the net has bullets",
        examples=[4e-3],
    )

    def terms(self, blocks: Blocks) -> tuple[LinearTerm, ...]:
        """Return a constant load on each node."""
        pressure = self.pressure_coefficient * self.flux / LIGHT
        area = tumbling_areas(blocks, self.bullet_area)
        return (LinearTerm(load=np.outer(pressure * area, self.direction).ravel()),)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[SolarPressure, str]:
        """Assume sunlight near the Earth, bullets as balls of aluminium."""
        bullets = basis.net.bullet_nodes
        area = bullet_disc(float(basis.net.mass[bullets[0]])) if len(bullets) else None
        keys = SolarPressure.model_validate(
            {"flux": 1361.0, "direction": (1.0, 0.0, 0.0), "pressure_coefficient": 1.3, "bullet_area": area}
        )
        return keys, "1361 W/m2, C = 1.3" + (", balls of aluminium" if area else "")

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the load on each node."""
        load = self.terms(basis.blocks)[0].load
        assert load is not None
        acceleration = basis.of_force(load.reshape(-1, 3))
        pressure = self.pressure_coefficient * self.flux / LIGHT
        return Estimate(
            acceleration,
            basis.ballistic(acceleration),
            f"C flux / c = {pressure:.3g} Pa on {math.pi / 4:.3f} d L of each cable",
        )
