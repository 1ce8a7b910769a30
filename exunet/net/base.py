"""Keys that the topologies share, and what a cable is made of."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sized
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from pydantic import Field, model_validator

from exunet.base.faults import Wrong, refuse, refuse_with, unless_one
from exunet.base.incomplete import Unknown
from exunet.base.table import Count, Positive, Table, check, exactly_one

MAX_ELEMENTS = 1_000_000
WHOLE = 1e-9  # how near size / mesh must be to a whole number


class Cable(Table):
    """Material and cross section of a cable (reference configuration)."""

    model_config = exactly_one("diameter", "area")

    diameter: Positive | None = Field(
        None, description="diameter of the circular cross section [m]", examples=[0.002]
    )
    area: Positive | None = Field(
        None, description="area of the cross section [m2], instead of diameter", examples=[3.14e-6]
    )
    density: Positive = Field(description="mass density [kg/m3]", examples=[1390.0])
    youngs_modulus: Positive = Field(description="Young's modulus E [Pa]", examples=[70e9])

    @model_validator(mode="wrap")
    @classmethod
    def _one_cross_section(cls, keys: Any, handler: Any) -> Any:
        return refuse_with(unless_one(("diameter", "area"), keys), keys, handler)

    @check
    def _within_floating_point(self) -> Iterator[Wrong]:
        if (self.diameter is None) == (self.area is None):
            return  # told above
        for name, key in (("mass per length", "density"), ("axial stiffness", "youngs_modulus")):
            with suppress(Unknown):
                product = getattr(self, key) * self.cross_section
                if not 0 < product < math.inf:
                    words = f"its {name}, {product:g}, is beyond what floating-point numbers can hold"
                    yield Wrong((), words)
                    return  # both have the same cause

    @property
    def cross_section(self) -> float:
        """Area A of the cross section [m2]."""
        return (
            self.area
            if self.area is not None
            else math.pi / 4 * (self.diameter or 0.0) * (self.diameter or 0.0)
        )


class Strings(Cable):
    """The strings that join the bullets to the net's corners."""

    length: Positive = Field(description="reference length of each string [m]", examples=[1.5])
    divisions: Count = Field(1, description="elements on each string")


class Bullets(Table):
    """The masses that are thrown to open the net."""

    mass: Positive = Field(description="mass of each bullet [kg]", examples=[0.5])


class NetTable(Table, ABC):
    """Keys of [net] that every topology has.

    A topology derives its `Keys` from this (or from `ThrownNetTable`), adds `topology: Literal["its name"]`,
    and counts its sides, so that an absurd net is refused before anything of its size is made.
    """

    if TYPE_CHECKING:
        topology: str
    cable: Cable = Field(description="the cables of the net")
    divisions: Count = Field(1, description="elements on each mesh side")

    @property
    @abstractmethod
    def n_sides(self) -> int:
        """Cable sides of the mesh, before division."""

    @property
    def n_elements(self) -> int:
        """Elements of the woven net."""
        return self.n_sides * self.divisions

    @check
    def _not_absurd(self) -> Iterator[Wrong]:
        if self.n_elements > MAX_ELEMENTS:
            count = f"{self.n_elements:,}" if self.n_elements < 10**15 else "more than 10^15"
            yield Wrong((), f"the net would have {count} elements; at most {MAX_ELEMENTS:,} are allowed")


class ThrownNetTable(NetTable, ABC):
    """Keys of [net] of the topologies that have corners, where strings and bullets are tied."""

    strings: Strings | None = Field(None, description="the strings between bullets and corners; absent: none")
    bullets: Bullets | None = Field(None, description="the bullets, one a corner; absent: none")

    @property
    @abstractmethod
    def n_strings(self) -> int:
        """Strings of the net if it has any."""

    @property
    def n_elements(self) -> int:
        of_strings = self.n_strings * self.strings.divisions if self.strings else 0
        return self.n_sides * self.divisions + of_strings


class AnyNet(ThrownNetTable):
    """The keys of a net whose topology is not known."""

    @property
    def n_sides(self) -> int:
        raise Unknown

    @property
    def n_strings(self) -> int:
        raise Unknown


def meshes(size: float, mesh: float) -> int:
    """How many meshes of side `mesh` [m] make up `size` [m]; ValueError if not a whole number within 1e-9."""
    ratio = size / mesh
    if ratio > 10 * MAX_ELEMENTS:
        raise ValueError(f"a mesh of {mesh:g} m is too fine for a net of {size:g} m: {ratio:g} meshes a side")
    count = round(ratio)
    if count >= 1 and abs(ratio - count) <= WHOLE:
        return count
    fits = [f"{_fitting(size, n)} ({n} a side)" for n in (math.floor(ratio), math.ceil(ratio)) if n > 0]
    raise ValueError(
        f"a net of {size:g} m is not a whole number of meshes of {mesh:g} m ({ratio:.6g}); "
        f"mesh = {' or '.join(fits)} would fit"
    )


def _fitting(size: float, count: int) -> str:
    """The shortest of some ways to write a mesh that divides `size` into `count`."""
    texts = (f"{size / count:.{digits}g}" for digits in (4, 8, 12, 17))
    return next((text for text in texts if abs(size / float(text) - count) <= WHOLE), repr(size / count))


def refuse_unfit(sizes: tuple[float, ...], mesh: tuple[float, ...]) -> None:
    """Raise for every axis whose mesh does not divide its size; the fault is at that item of `mesh`."""
    wrongs = []
    for axis, (size, spacing) in enumerate(zip(sizes, mesh, strict=True)):
        try:
            meshes(size, spacing)
        except ValueError as error:
            wrongs.append(Wrong((axis,), str(error), spacing))
    refuse(wrongs)


def no_node(node: int, count: int) -> str:
    """What is wrong with a node number outside 0 ... count - 1."""
    return f"there is no node {node}: the {count} nodes are numbered from 0 to {count - 1}"


def other_length(values: Sized, nodes: Sized) -> str:
    """What is wrong if there is not one of `values` for each of `nodes`, else ""."""
    if len(values) == len(nodes):
        return ""
    return f"needs one entry for each of the {len(nodes)} nodes of net.nodes, got {len(values)}"
