"""Areas that gas in free-molecular flow and sunlight see of a node.

A cylinder that tumbles at random shows the mean area pi/4 d L of its side (a quarter of its surface pi d L,
by Cauchy's theorem on mean projections), half of which belongs to either end.
"""

from __future__ import annotations

import math

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.net import Net


def diameter(net: Net) -> Floats:
    """Diameter (m,) [m] of a circle of each element's area."""
    return np.asarray(np.sqrt(4.0 / math.pi * net.area))


def exposed(net: Net, bullet_area: float) -> Floats:
    """Area (n,) [m2] of each node: half of pi/4 d L of each element that ends there, and the bullet's.

    Correctly rounded sums, so that mirrored nodes agree to the last bit.
    """
    shares: list[list[float]] = [[] for _ in net.mass]
    halves = (0.5 * math.pi / 4.0 * diameter(net) * net.reference_length).tolist()
    for (i, j), half in zip(net.element_nodes.tolist(), halves, strict=True):
        shares[i].append(half)
        shares[j].append(half)
    for node in net.bullet_nodes.tolist():
        shares[node].append(bullet_area)
    return np.array([math.fsum(share) for share in shares])
