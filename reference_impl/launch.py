"""Directions in which bullets leave: outwards in the plane of the net, and along the throw, +z."""

from __future__ import annotations

import math

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.net import Net


def outwards(net: Net) -> Floats:
    """Unit vectors (k, 3) from the origin to the bullets' reference positions, in the net's plane."""
    return unit_outwards(net.reference_position[net.bullet_nodes])


def unit_outwards(place: Floats) -> Floats:
    """Unit vectors (k, 3) from the origin to places (k, 3), in the net's plane.

    As in Givens' rotations (Golub & Van Loan, Matrix Computations, 5.1.8): the larger coordinate gives the
    cosine 1/sqrt(1 + slope^2), the smaller one the sine, slope times that.  Mirrored places, x <-> y among
    the mirrors, get mirrored vectors to the last bit.
    """
    x, y, _ = place.T
    steep = np.abs(y) > np.abs(x)
    longer, shorter = np.where(steep, y, x), np.where(steep, x, y)
    slope = shorter / longer
    along = np.copysign(np.sqrt(1.0 / (1.0 + slope * slope)), longer)
    across = slope * along
    return np.column_stack((np.where(steep, across, along), np.where(steep, along, across), np.zeros_like(x)))


def spread(net: Net, angle: float) -> Floats:
    """Unit vectors (k, 3) at an angle [rad] from +z, leaning outwards: sin outwards, cos along +z."""
    return np.asarray(math.sin(angle) * outwards(net) + math.cos(angle) * np.array([0.0, 0.0, 1.0]))
