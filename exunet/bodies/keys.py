"""The keys of [bodies.NAME]: a rigid body's mass and inertia, and its state at time 0."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, StringConstraints, field_validator

from exunet.base.table import FromArray, Positive, Table, Vector

Quaternion = Annotated[tuple[float, float, float, float], FromArray]
Moments = Annotated[tuple[Positive, Positive, Positive], FromArray]
ROUND_OFF = 1e-12  # by which a principal moment may exceed the sum of the others, relative to it


class BodyKeys(Table):
    """A rigid body: free but for the forces that act on it."""

    # The body's axes are its principal axes; their origin is its centre of mass.

    mass: Positive = Field(description="mass of the body [kg]", examples=[500.0])
    inertia: Moments = Field(
        description="principal moments of inertia about the centre of mass [kg m2]",
        examples=[[80.0, 100.0, 120.0]],
    )
    position: Vector = Field((0.0, 0.0, 0.0), description="of the centre of mass at time 0 [m]")
    velocity: Vector = Field((0.0, 0.0, 0.0), description="of the centre of mass at time 0 [m/s]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="at time 0, quaternion [w, x, y, z] that turns the body's axes into the scene's; "
        "brought to length 1",
    )
    angular_velocity: Vector = Field(
        (0.0, 0.0, 0.0), description="at time 0, in the body's axes [rad/s]", examples=[[0.0, 0.0, 0.1]]
    )

    @field_validator("inertia")
    @classmethod
    def _of_some_mass_distribution(cls, moments: tuple[float, float, float]) -> tuple[float, float, float]:
        largest = max(moments)
        others = sum(moments) - largest
        if largest > others * (1 + ROUND_OFF):
            raise ValueError(
                f"no body has these moments: the largest, {largest:g}, must not exceed the sum of the "
                f"other two, {others:g} kg m2"
            )
        return moments

    @field_validator("attitude")
    @classmethod
    def _of_length_one(cls, attitude: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        largest = max(map(abs, attitude))
        if largest == 0.0:
            raise ValueError("must not be zero: [1, 0, 0, 0] leaves the body's axes along the scene's")
        w, x, y, z = (part / largest for part in attitude)  # so that no square overflows or vanishes
        length = math.hypot(w, x, y, z)
        return (w / length, x / length, y / length, z / length)


BodyName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
Bodies = Mapping[BodyName, BodyKeys]
