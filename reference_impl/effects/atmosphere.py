"""The exponential atmosphere, layer by layer: rho = rho0 exp(-(h - h0)/H).

Vallado, Fundamentals of Astrodynamics and Applications, table 8-4, from 150 km on.
"""

from __future__ import annotations

import math
from bisect import bisect_right

LOWEST, HIGHEST = 150e3, 2000e3  # [m]

LAYERS = (  # base h0 [km], density there rho0 [kg/m3], scale height H [km]
    (150.0, 2.070e-9, 22.523),
    (180.0, 5.464e-10, 29.740),
    (200.0, 2.789e-10, 37.105),
    (250.0, 7.248e-11, 45.546),
    (300.0, 2.418e-11, 53.628),
    (350.0, 9.518e-12, 53.298),
    (400.0, 3.725e-12, 58.515),
    (450.0, 1.585e-12, 60.828),
    (500.0, 6.967e-13, 63.822),
    (600.0, 1.454e-13, 71.835),
    (700.0, 3.614e-14, 88.667),
    (800.0, 1.170e-14, 124.64),
    (900.0, 5.245e-15, 181.05),
    (1000.0, 3.019e-15, 268.00),
)


def density(altitude: float) -> float:
    """Density [kg/m3] at an altitude [m] from LOWEST to HIGHEST."""
    height = altitude / 1e3
    base, at_base, scale = LAYERS[bisect_right(LAYERS, height, key=lambda layer: layer[0]) - 1]
    return at_base * math.exp(-(height - base) / scale)
