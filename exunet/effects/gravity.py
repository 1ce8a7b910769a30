"""Uniform gravity: force m g on every node, potential energy -m g . x."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from pydantic import Field

from exunet.checks import Wrong
from exunet.effects.estimate import Estimate, Setting
from exunet.effects.needs import Surroundings, excludes
from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.record import Record, Vector

ON_THE_GROUND = True  # what is off in a case is not advised for a scene in space


class Keys(Record):
    """Uniform gravity, as on the ground or in a parabolic flight."""

    acceleration: Vector = Field(description="g [m/s2]")


def terms(keys: Keys, net: Net) -> Terms:
    """Load m g on each node."""
    return Terms(load=np.outer(net.mass, keys.acceleration).ravel())


def needs(keys: Keys, around: Surroundings) -> Iterator[Wrong]:
    """Not in orbit: there the gravity of the Earth is the orbit's own."""
    yield from excludes(
        around, "orbit", "in the frame of an orbit the Earth's gravity is already in it; keep one"
    )


def nominal(setting: Setting) -> tuple[Keys, str]:
    """A test on the ground."""
    return Keys(acceleration=(0.0, 0.0, -9.81)), "9.81 m/s2, a test on the ground"


def magnitude(keys: Keys, setting: Setting) -> Estimate:
    """Free fall, or the net's size where it hangs."""
    g = math.hypot(*keys.acceleration)
    return Estimate(g, setting.ballistic(g), f"free fall, g = {g:.3g} m/s2")
