"""Uniform gravity: force m g on every node, potential energy -m g . x."""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from exunet.base.table import Table, Vector
from exunet.forces.blocks import Blocks
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.terms import LinearTerm

ON_THE_GROUND = True  # what is off in a case is not advised for a scene in space
EXCLUDES = {"orbit": "in the frame of an orbit the Earth's gravity is already in it; keep one"}


class Keys(Table):
    """Uniform gravity, as on the ground or in a parabolic flight."""

    acceleration: Vector = Field(description="g [m/s2]")


def terms(keys: Keys, blocks: Blocks) -> tuple[LinearTerm, ...]:
    """Load m g on each node."""
    return (LinearTerm(load=np.outer(blocks.mass, keys.acceleration).ravel()),)


def nominal(basis: EstimateBasis) -> tuple[Keys, str]:
    """A test on the ground."""
    return Keys(acceleration=(0.0, 0.0, -9.81)), "9.81 m/s2, a test on the ground"


def magnitude(keys: Keys, basis: EstimateBasis) -> Estimate:
    """Free fall, or the net's size where it hangs."""
    g = math.hypot(*keys.acceleration)
    return Estimate(g, basis.ballistic(g), f"free fall, g = {g:.3g} m/s2")
