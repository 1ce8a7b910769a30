"""Environment of an orbit: density of the atmosphere, directions in the scene's axes, exposed areas.

Vallado, "Fundamentals of Astrodynamics and Applications", 4th ed., table 8-4 (U.S. Standard Atmosphere 1976
and CIRA-72, mean solar activity). A simple model: the true density varies by a factor of ten with the Sun.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from exunet.base.arrays import Floats
from exunet.base.errors import Fault
from exunet.base.record import Positive, Record, Vector
from exunet.forces.blocks import Blocks
from exunet.net.arrays import Net

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


EARTH_MU = 3.986004418e14  # [m3/s2], docs/explanation/theory_effects.md
EARTH_RADIUS = 6378137.0  # [m], equatorial
NEAR = 1e-9  # how near the directions must be to unit length and a right angle


def _of_length_one(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not abs(math.hypot(*vector) - 1.0) <= NEAR:
        raise ValueError(f"must have length 1 (within {NEAR:g}), got length {math.hypot(*vector):.12g}")
    return vector


UnitVector = Annotated[Vector, AfterValidator(_of_length_one)]


class CircularOrbitConfig(Record):
    """A circular orbit round the Earth, and where it lies in the scene's axes."""

    EXACTLY_ONE: ClassVar = ("altitude", "mean_motion")

    altitude: Positive | None = Field(
        None, description="height of the orbit above Earth's equatorial radius [m]", examples=[500e3]
    )
    mean_motion: Positive | None = Field(
        None, description="angular rate n of the orbit [rad/s], instead of altitude", examples=[1.1e-3]
    )
    radial: UnitVector = Field(
        description="unit vector away from Earth's centre, in the scene's axes", examples=[[0.0, 0.0, 1.0]]
    )
    along_track: UnitVector = Field(
        description="unit vector along the orbital velocity, in the scene's axes", examples=[[1.0, 0.0, 0.0]]
    )

    def faults(self) -> Iterator[Fault]:
        """Require directions at right angles."""
        if abs(cosine := float(np.dot(self.radial, self.along_track))) > NEAR:
            reason = f"must be at right angles to radial (within {NEAR:g}), got a cosine of {cosine:.3g}"
            yield Fault("along_track", reason)

    @property
    def rate(self) -> float:
        """Mean motion n [rad/s]."""
        if self.mean_motion is not None:
            return self.mean_motion
        return math.sqrt(EARTH_MU / (EARTH_RADIUS + (self.altitude or 0.0)) ** 3)

    @property
    def radius(self) -> float:
        """Return the radius of the orbit, (mu / n^2)^(1/3) [m]."""
        return math.cbrt(EARTH_MU / self.rate**2)

    @property
    def height(self) -> float:
        """Above Earth's equatorial radius [m]."""
        return self.radius - EARTH_RADIUS if self.altitude is None else self.altitude

    @property
    def words(self) -> str:
        """For an estimate that assumes it."""
        return f"an orbit at {self.height / 1e3:.0f} km"


# Of a case that names no orbit.
NOMINAL = CircularOrbitConfig.model_validate(
    {"altitude": 700e3, "radial": (0.0, 0.0, 1.0), "along_track": (1.0, 0.0, 0.0)}
)


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
