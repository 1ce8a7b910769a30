"""The exponential model of the atmosphere, piecewise over height.

Vallado, "Fundamentals of Astrodynamics and Applications", 4th ed., table 8-4 (U.S. Standard Atmosphere 1976
and CIRA-72, mean solar activity). A simple model: the true density varies by a factor of ten with the Sun.
"""

from __future__ import annotations

import math

# Base height [km], density there [kg/m3], scale height [km]; from 150 km up, below which no net flies.
LAYERS = (
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
LOWEST, HIGHEST = 150e3, 2000e3  # [m]


def exponential_density(altitude: float) -> float:
    """Density [kg/m3] at a height [m] between `LOWEST` and `HIGHEST`."""
    height = altitude / 1e3
    base, density, scale = next(layer for layer in reversed(LAYERS) if height >= layer[0])
    return density * math.exp(-(height - base) / scale)
