"""Directions of an orbit in the scene's axes, which several effects take."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from pydantic import Field, field_validator

from exunet.base.errors import Fault
from exunet.base.table import Positive, Table, Vector

EARTH_MU = 3.986004418e14  # [m3/s2], cases/README.md
EARTH_RADIUS = 6378137.0  # [m], equatorial
NEAR = 1e-9  # how near the directions must be to unit length and a right angle


def refuse_other_than_unit(vector: tuple[float, float, float]) -> None:
    """ValueError unless a direction has length 1."""
    if not abs(math.hypot(*vector) - 1.0) <= NEAR:
        raise ValueError(f"must have length 1 (within {NEAR:g}), got length {math.hypot(*vector):.12g}")


class OrbitKeys(Table):
    """A circular orbit round the Earth, and where it lies in the scene's axes."""

    EXACTLY_ONE: ClassVar = ("altitude", "mean_motion")

    altitude: Positive | None = Field(
        None, description="height of the orbit above Earth's equatorial radius [m]", examples=[500e3]
    )
    mean_motion: Positive | None = Field(
        None, description="angular rate n of the orbit [rad/s], instead of altitude", examples=[1.1e-3]
    )
    radial: Vector = Field(
        description="unit vector away from Earth's centre, in the scene's axes", examples=[[0.0, 0.0, 1.0]]
    )
    along_track: Vector = Field(
        description="unit vector along the orbital velocity, in the scene's axes", examples=[[1.0, 0.0, 0.0]]
    )

    @field_validator("radial", "along_track")
    @classmethod
    def _of_length_one(cls, vector: tuple[float, float, float]) -> tuple[float, float, float]:
        refuse_other_than_unit(vector)
        return vector

    @property
    def rate(self) -> float:
        """Mean motion n [rad/s]."""
        if self.mean_motion is not None:
            return self.mean_motion
        return math.sqrt(EARTH_MU / (EARTH_RADIUS + (self.altitude or 0.0)) ** 3)

    @property
    def radius(self) -> float:
        """Of the orbit, (mu / n^2)^(1/3) [m]."""
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
NOMINAL = OrbitKeys.model_validate(
    {"altitude": 700e3, "radial": (0.0, 0.0, 1.0), "along_track": (1.0, 0.0, 0.0)}
)


def at_right_angles(keys: OrbitKeys) -> Iterator[Fault]:
    """A fault unless the two directions of an orbit are at right angles."""
    if abs(cosine := float(np.dot(keys.radial, keys.along_track))) > NEAR:
        reason = f"must be at right angles to radial (within {NEAR:g}), got a cosine of {cosine:.3g}"
        yield Fault("along_track", reason)
