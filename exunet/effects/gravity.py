"""Uniform gravity: force m g on every node, potential energy -m g . x."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.record import Record, Vector


class Keys(Record):
    """Uniform gravity, as on the ground or in a parabolic flight."""

    acceleration: Vector = Field(description="g [m/s2]")


def terms(keys: Keys, net: Net) -> Terms:
    """Load m g on each node."""
    return Terms(load=np.outer(net.mass, keys.acceleration).ravel())
