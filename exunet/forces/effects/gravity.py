"""Uniform gravity: force m g on every node and body, potential energy -m g . x."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.record import Vector
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.linear_term import LinearTerm
from exunet.forces.on_bodies import weight_on_bodies
from exunet.forces.terms import KernelTerm


class Gravity(Effect):
    """Uniform gravity, as on the ground or in a parabolic flight."""

    ON_THE_GROUND: ClassVar = True
    ACCELERATES_ALL: ClassVar = True
    EXCLUDES: ClassVar = {"orbit": "in the frame of an orbit the Earth's gravity is already in it; keep one"}

    acceleration: Vector = Field(description="g [m/s2]", examples=[[0.0, 0.0, -9.81]])

    def terms(self, blocks: Blocks) -> tuple[LinearTerm | KernelTerm, ...]:
        """Load m g on each node, and at the centre of mass of each body."""
        load = LinearTerm(load=np.outer(blocks.own_mass, self.acceleration).ravel())
        return load, *weight_on_bodies(blocks, self.acceleration)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[Gravity, str]:
        """Assume a test on the ground."""
        return Gravity(acceleration=(0.0, 0.0, -9.81)), "9.81 m/s2, a test on the ground"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate free fall, or the net's size where it hangs."""
        g = math.hypot(*self.acceleration)
        return Estimate(g, basis.ballistic(g), f"free fall, g = {g:.3g} m/s2")
