"""Hill's frame, which turns with a circular orbit: gravity gradient, centrifugal and Coriolis forces.

Linear: Clohessy and Wiltshire, "Terminal guidance system for satellite rendezvous", J. Aerospace Sci. 27
(1960) 653-658, doi 10.2514/8.8704. Two-body: the exact relative motion in the same frame, written after Encke
so that no difference of large numbers is taken (Battin, "An Introduction to the Mathematics and Methods of
Astrodynamics", sec. 8.3).
"""

from __future__ import annotations

import math
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator
from scipy.sparse import csr_array, diags_array, kron

from exunet.checks import Wrong, refuse
from exunet.effects.terms import KernelTerm, Terms
from exunet.net.arrays import Net
from exunet.record import Positive, Record, Vector

EARTH_MU = 3.986004418e14  # [m3/s2], cases/README.md
EARTH_RADIUS = 6378137.0  # [m], equatorial
NEAR = 1e-9  # how near the directions must be to unit length and a right angle


class Keys(Record):
    """The scene's axes turn with a circular orbit round the Earth (Hill's frame)."""

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
    model: Literal["linear", "two_body"] = Field(
        description="equations of Clohessy and Wiltshire, or the full relative two-body motion"
    )

    @field_validator("radial", "along_track")
    @classmethod
    def _of_length_one(cls, vector: tuple[float, float, float]) -> tuple[float, float, float]:
        if not abs(math.hypot(*vector) - 1.0) <= NEAR:
            raise ValueError(f"must have length 1 (within {NEAR:g}), got length {math.hypot(*vector):.12g}")
        return vector

    @field_validator("along_track")
    @classmethod
    def _at_right_angles(
        cls, vector: tuple[float, float, float], others: ValidationInfo
    ) -> tuple[float, float, float]:
        radial = others.data.get("radial")
        if radial is not None and abs(cosine := float(np.dot(radial, vector))) > NEAR:
            raise ValueError(
                f"must be at right angles to radial (within {NEAR:g}), got a cosine of {cosine:.3g}"
            )
        return vector

    @model_validator(mode="after")
    def _one_orbit(self) -> Self:
        if (self.altitude is None) == (self.mean_motion is None):
            where = ("mean_motion",) if self.mean_motion is not None else ()
            refuse([Wrong(where, "give either altitude or mean_motion, exactly one of them")])
        return self

    @property
    def rate(self) -> float:
        """Mean motion n [rad/s]."""
        if self.mean_motion is not None:
            return self.mean_motion
        return math.sqrt(EARTH_MU / (EARTH_RADIUS + (self.altitude or 0.0)) ** 3)


def terms(keys: Keys, net: Net) -> Terms:
    """Coriolis force as a constant matrix; the rest as one too (linear), or as a kernel term (two_body)."""
    radial, normal = np.array(keys.radial), np.cross(keys.radial, keys.along_track)
    rate = keys.rate
    turning = 2.0 * rate * np.cross(normal, np.eye(3)).T  # turning @ v = 2 n h x v
    gyroscopic = _each_node(net.mass, turning)
    if keys.model == "linear":
        gradient = rate**2 * (np.outer(normal, normal) - 3.0 * np.outer(radial, radial))
        return Terms(gyroscopic=gyroscopic, stiffness=_each_node(net.mass, gradient))
    radius = math.cbrt(EARTH_MU / rate**2)
    term = KernelTerm(add_two_body, (net.mass, rate, radius, radial, normal), two_body_potential)
    return Terms(gyroscopic=gyroscopic, kernels=(term,))


def _each_node(mass: NDArray[np.float64], block: NDArray[np.float64]) -> csr_array:
    matrix = csr_array(kron(diags_array(mass), block))
    matrix.eliminate_zeros()
    return matrix


def add_two_body(
    t: float, x: Any, v: Any, mass: Any, rate: float, radius: float, radial: Any, normal: Any, force: Any
) -> None:
    """m n^2 [P x - x / c + (1 - 1 / c) R r], c = (|R r + x| / R)^3 = (1 + q)^(3/2), without cancellation."""
    for node in range(mass.size):
        k = 3 * node
        height = x[k] * radial[0] + x[k + 1] * radial[1] + x[k + 2] * radial[2]
        across = x[k] * normal[0] + x[k + 1] * normal[1] + x[k + 2] * normal[2]
        square = x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2]
        q = (2.0 * height + square / radius) / radius
        c = (1.0 + q) * math.sqrt(1.0 + q)
        missing = q * (3.0 + q * (3.0 + q)) / ((1.0 + c) * c)  # 1 - 1 / c
        scale = mass[node] * rate * rate
        for axis in range(3):
            force[k + axis] += scale * (
                missing * (x[k + axis] + radius * radial[axis]) - across * normal[axis]
            )


def two_body_potential(x: Any, mass: Any, rate: float, radius: float, radial: Any, normal: Any) -> float:
    """m n^2 [(x . h)^2 - R^2 q^2 (u + 2) / (u (1 + u)^2)] / 2, u^2 = 1 + q; zero at the origin."""
    total = 0.0
    for node in range(mass.size):
        k = 3 * node
        height = x[k] * radial[0] + x[k + 1] * radial[1] + x[k + 2] * radial[2]
        across = x[k] * normal[0] + x[k + 1] * normal[1] + x[k + 2] * normal[2]
        square = x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2]
        q = (2.0 * height + square / radius) / radius
        u = math.sqrt(1.0 + q)
        inward = radius * radius * q * q * (u + 2.0) / (u * (1.0 + u) * (1.0 + u))
        total += 0.5 * mass[node] * rate * rate * (across * across - inward)
    return total
