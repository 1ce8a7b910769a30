"""Keys that the topologies share, and what a cable is made of."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from exunet.record import Count, Positive, Record


class Cable(Record):
    """Material and cross section of a cable (reference configuration)."""

    diameter: Positive | None = Field(None, description="diameter of the circular cross section [m]")
    area: Positive | None = Field(None, description="area of the cross section [m2], instead of diameter")
    density: Positive = Field(description="mass density [kg/m3]")
    youngs_modulus: Positive = Field(description="Young's modulus E [Pa]")

    @model_validator(mode="after")
    def _one_cross_section(self) -> Self:
        if (self.diameter is None) == (self.area is None):
            raise ValueError("give either diameter or area, exactly one of them")
        return self

    @property
    def cross_section(self) -> float:
        """Area A of the cross section [m2]."""
        return self.area if self.area is not None else math.pi * (self.diameter or 0.0) ** 2 / 4


class Strings(Cable):
    """The strings that join bullets to the net's corners."""

    length: Positive = Field(description="reference length of each string [m]")
    divisions: Count = Field(1, description="elements on each string")


class Bullets(Record):
    """The masses that are thrown to open the net."""

    mass: Positive = Field(description="mass of each bullet [kg]")


class NetKeys(Record):
    """Keys of [net] that every topology has."""

    cable: Cable = Field(description="the cables of the net")
    divisions: Count = Field(1, description="elements on each mesh side")


class ThrownNetKeys(NetKeys):
    """Keys of the topologies that have corners."""

    strings: Strings | None = Field(None, description="corner strings; absent: none")
    bullets: Bullets | None = Field(None, description="bullets; absent: none")
