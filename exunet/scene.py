"""The scene: what a case file says, as frozen records in SI units."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from exunet.effects import Effects
from exunet.net import NetKeys
from exunet.record import NonNegative, Positive, Record, Vector
from exunet.solvers import Solver


class Time(Record):
    """Duration and stored times."""

    end: Positive = Field(description="end of the simulation [s]; it starts at 0")
    output_step: Positive | None = Field(None, description="spacing of the stored states [s]")
    output_times: tuple[NonNegative, ...] | None = Field(
        None, description="stored times [s], instead of output_step"
    )


class Initial(Record):
    """State at time 0."""

    packing: NonNegative = Field(description="initial position = packing x reference position")
    velocity: Vector | None = Field(None, description="velocity of every node [m/s]")
    spin: Vector | None = Field(None, description="angular velocity about the origin [rad/s]")
    node_positions: tuple[Vector, ...] | None = Field(
        None, description="initial positions [m], explicit topology only"
    )
    node_velocities: tuple[Vector, ...] | None = Field(
        None, description="initial velocities [m/s], explicit topology only"
    )


class Launch(Record):
    """Velocities given to the bullets."""

    radial_speed: float = Field(description="away from the origin, in the net's plane [m/s]")
    axial_speed: float = Field(description="along +z, the direction of the throw [m/s]")


class Scene(Record):
    """A whole case."""

    format: Literal[1] = Field(description="version of the case format")
    title: str = Field(description="one line for tables and figures")
    time: Time
    solver: Solver = Field(default_factory=Solver)
    net: Annotated[NetKeys, Field(discriminator="topology")]
    initial: Initial
    launch: Launch | None = None
    effects: Effects = Field(default_factory=Effects)
