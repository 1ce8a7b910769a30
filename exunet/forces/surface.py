"""What a flow or the light meets: widths of cables, and areas lumped to the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

# Mean projected area of a long cylinder over all orientations, as a part of diameter x length: Cauchy's
# theorem, a quarter of the surface, for a convex body.
TUMBLING = np.pi / 4.0


def widths(net: Net) -> Floats:
    """(n_elements,) diameter of a circle of each element's area [m]."""
    return 2.0 * np.sqrt(net.area / np.pi)


def tumbling_areas(blocks: Blocks, bullet_area: float | None) -> Floats:
    """(n_points,) [m2]: half of pi/4 d L0 of each element that ends in a node, and the bullets' areas."""
    net = blocks.net
    half = 0.5 * TUMBLING * widths(net) * net.reference_length
    areas = np.zeros(blocks.n_points)
    for end in net.element_nodes.T:
        areas += np.bincount(end, weights=half, minlength=blocks.n_points)
    areas[net.bullet_nodes] += bullet_area or 0.0
    return areas


def bullet_disc(mass: float) -> float:
    """Area [m2] of a ball of aluminium (2700 kg/m3) of that mass, where an estimate must assume one."""
    return float(np.pi * (3.0 * mass / (4.0 * np.pi * 2700.0)) ** (2.0 / 3.0))
