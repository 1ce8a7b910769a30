"""Keys that the topologies share, and what a cable is made of."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sized
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, GetJsonSchemaHandler

from exunet.base.arguments import shown
from exunet.base.arrays import Floats
from exunet.base.errors import Fault
from exunet.base.record import Count, FromArray, Number, Positive, Record
from exunet.net.arrays import NO_TABLE, NODE_NAME, Net
from exunet.net.cords import CONSTRUCTIONS, FIBRES, ConstructionName, FibreName, circle, cord

MAX_ELEMENTS = 1_000_000
WHOLE = 1e-9  # how near size / mesh must be to a whole number


def _known_form(given: Any) -> Any:
    if isinstance(given, str):
        fits = NODE_NAME.fullmatch(given) is not None
    else:
        fits = isinstance(given, int) and not isinstance(given, bool) and given >= 0
    if not fits:
        words = 'must be a number from 0 on, "centre", "corner 2" or "rim 0.25" (a part from 0 to below 1)'
        raise ValueError(f"{words}, got {shown(given)}")
    return given


NodeName = Annotated[
    Number | Annotated[str, Field(pattern=f"^{NODE_NAME.pattern}$")], BeforeValidator(_known_form)
]


class NodeConfig(Record):
    """A node of the net, by its number or name, or as a bullet."""

    EXACTLY_ONE: ClassVar[tuple[str, ...]] = ("node", "bullet")

    node: NodeName | None = Field(
        None,
        description='node of the net: its number, or "centre", "corner 2" or "rim 0.25" of a woven net',
        examples=[0],
    )
    bullet: Number | None = Field(
        None, description="number of a bullet, from 0, instead of node", examples=[0]
    )

    @property
    def key(self) -> str:
        """The one of the two keys that is given."""
        return "node" if self.node is not None else "bullet"

    def node_of(self, net: Net) -> int:
        """Return the number of the node; raise ValueError if the net does not have it."""
        if self.node is not None:
            return net.node(self.node)
        assert self.bullet is not None
        return net.bullet(self.bullet)


class Cable(Record):
    """Material and cross section of a cable (reference configuration)."""

    EXACTLY_ONE: ClassVar = ("diameter", "area")

    diameter: Positive | None = Field(
        None, description="diameter of the circular cross section [m]", examples=[0.002]
    )
    area: Positive | None = Field(
        None, description="area of the cross section [m2], instead of diameter", examples=[3.14e-6]
    )
    law: Literal["green_lagrange", "hooke", "table"] = Field(
        "green_lagrange",
        description="tension in terms of the stretch s: E A (s^3 - s) / 2, as in the paper; E A (s - 1); "
        "or straight lines between the points of table",
    )
    table: Annotated[tuple[Annotated[tuple[float, float], FromArray], ...], FromArray] | None = Field(
        None,
        min_length=2,
        description='points of law = "table" from [0, 0] on, both increasing: strain s - 1, tension [N]; its '
        "first slope stands for E A, and the run stops where a strain exceeds its last",
        examples=[[[0.0, 0.0], [0.01, 100.0], [0.05, 900.0]]],
    )
    material: FibreName | None = Field(
        None,
        description="fibre or wire, from which density, youngs_modulus and strength follow where absent",
        examples=["dyneema_sk75"],
    )
    construction: ConstructionName = Field(
        "monofilament", description="with material: how much fibre fills the circle, and its factors"
    )
    density: Positive = Field(
        default_factory=lambda given: _density_of_cord(given),
        description="mass density [kg/m3]; required without material",
        examples=[1390.0],
    )
    youngs_modulus: Positive | None = Field(
        default_factory=lambda given: _modulus_of_cord(given),
        description="Young's modulus E [Pa]; required without material or a table",
        examples=[70e9],
    )
    strength: Positive | None = Field(
        default_factory=lambda given: _strength_of_cord(given),
        description="specified axial strength [N], against which margins are reported; nothing breaks at it",
        examples=[400.0],
    )
    knot_efficiency: float = Field(
        1.0, gt=0.0, le=1.0, description="part of the strength that knots leave, for margins"
    )
    safety_factor: float = Field(1.0, ge=1.0, description="by which loads are multiplied, for margins")

    @property
    def cross_section(self) -> float:
        """Area A of the cross section [m2]."""
        return self.area if self.area is not None else circle(self.diameter or 0.0)

    @property
    def allowable(self) -> float | None:
        """Largest load [N] with a margin of at least zero: strength x knot efficiency / safety factor."""
        return None if self.strength is None else self.strength * self.knot_efficiency / self.safety_factor

    @property
    def assumed(self) -> str:
        """Values that follow from the material, with their sources; "" without."""
        names = [name for name in _UNITS if not self.is_given(name)] if self.material else []
        found = {name: value for name in names if (value := getattr(self, name)) is not None}
        if not found or self.material is None:
            return ""
        values = ", ".join(f"{name} = {value:.4g} {_UNITS[name]}" for name, value in found.items())
        kept = CONSTRUCTIONS[self.construction]
        how = f"{self.construction} (factors of area, modulus, strength {kept.fill:g}, {kept.modulus:g}, "
        how += f"{kept.strength:g}: {kept.source})"
        return f"{values} assumed from {self.material} ({FIBRES[self.material].source}), {how}"

    @property
    def modulus(self) -> float:
        """Young's modulus [Pa], of a table that of its first line."""
        if self.table is not None:
            (strain, force), *_ = self.table[1:]
            return force / strain / self.cross_section
        assert self.youngs_modulus is not None
        return self.youngs_modulus

    def faults(self) -> Iterator[Fault]:
        """Require a mass per length and an axial stiffness that are positive floating-point numbers."""
        missing = {"density": math.isnan(self.density)}
        missing["youngs_modulus"] = self.youngs_modulus is None and self.law != "table"
        about = {name: type(self).model_fields[name].description for name in missing if missing[name]}
        faults = [*(Fault(name, f"missing: {words}") for name, words in about.items()), *self._law_faults()]
        if self.material is None and "construction" in self.model_fields_set:
            faults.append(Fault("construction", "requires material, whose values it scales"))
        for name in ("knot_efficiency", "safety_factor"):
            if name in self.model_fields_set and self.strength is None:
                words = "requires strength or material: it changes the margin to a strength"
                faults.append(Fault(name, words))
        yield from faults
        if faults or self.is_given("diameter") == self.is_given("area"):
            return
        for words, value in (("mass per length", self.density), ("axial stiffness", self.modulus)):
            if not 0 < (product := value * self.cross_section) < math.inf:
                yield Fault("", f"its {words}, {product:g}, is outside the range of floating-point numbers")
                return

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = super().__get_pydantic_json_schema__(core_schema, handler)
        needed = [["material"], ["density", "youngs_modulus"], ["density", "table"]]
        handler.resolve_ref_schema(schema)["anyOf"] = [{"required": names} for names in needed]
        return schema

    def _law_faults(self) -> Iterator[Fault]:
        by_table = self.law == "table"
        if by_table and self.is_given("youngs_modulus"):
            yield Fault("youngs_modulus", "excluded by a table, whose first line has it")
        if (self.table is not None) != by_table:
            yield Fault("table", 'requires law = "table"' if self.table else 'required by law = "table"')
        if self.table is None:
            return
        if self.table[0] != (0.0, 0.0):
            yield Fault("table[0]", f"must be [0, 0], where a thread becomes taut, got {[*self.table[0]]}")
        for k, (before, after) in enumerate(pairwise(self.table), start=1):
            if not (after[0] > before[0] and after[1] > before[1]):
                words = f"strain and tension must increase from row to row, got {[*after]} after {[*before]}"
                yield Fault(f"table[{k}]", words)
                return


def laws_of(cables: Iterable[Cable], before: Floats = NO_TABLE) -> tuple[list[int], Floats]:
    """Return numbers of the laws of cables, see `exunet.forces.law`, and the rows of all tables.

    before : rows of tables that come first
    """
    numbers, rows = [], [*before.tolist()]
    for cable in cables:
        numbers.append(2 + len(rows) if cable.table is not None else int(cable.law == "hooke"))
        held, points = 0.0, cable.table or ()
        for begin, end in pairwise(points):
            stiffness = points[1][1] / points[1][0]
            width, force = end[0] - begin[0], begin[1] / stiffness
            slope = (end[1] - begin[1]) / stiffness / width
            rows.append([begin[0], force, slope, held])
            held += (force + 0.5 * slope * width) * width
        if points:
            rows.append([points[-1][0], points[-1][1] / stiffness, slope, held])
    return numbers, np.array(rows).reshape(-1, 4)


_UNITS = {"density": "kg/m3", "youngs_modulus": "Pa", "strength": "N"}  # of what follows from a material


def _density_of_cord(given: dict[str, Any]) -> float:
    """Return the density of the cord of a cable [kg/m3]; NaN without a material."""
    made = cord(given["material"], given["construction"])
    return math.nan if made is None else made.density


def _modulus_of_cord(given: dict[str, Any]) -> float | None:
    """Return the modulus of the cord of a cable [Pa]; None without a material and with a table."""
    made = cord(given["material"], given["construction"])
    return None if made is None or given["law"] == "table" else made.youngs_modulus


def _strength_of_cord(given: dict[str, Any]) -> float | None:
    """Return the strength of a cable [N] from its material; None without one."""
    made, area = cord(given["material"], given["construction"]), given["area"]
    return None if made is None else made.strength * (area or circle(given["diameter"] or 0.0))


class Strings(Cable):
    """The strings that join the bullets to the net's corners."""

    TABLE: ClassVar = "net.strings"
    length: Positive = Field(description="reference length of each string [m]", examples=[1.5])
    divisions: Count = Field(1, description="elements on each string")


class Bullets(Record):
    """The masses that are thrown to open the net."""

    TABLE: ClassVar = "net.bullets"
    mass: Positive = Field(description="mass of each bullet [kg]", examples=[0.5])


class NetConfig(Record, ABC):
    """Keys of [net] that every topology has.

    A topology derives its record from this (or from `ThrownNetConfig`), adds `topology: Literal["its name"]`,
    and counts its sides (and corners), so that a net that is too large is refused before it is woven.
    """

    if TYPE_CHECKING:
        topology: str
    TABLE: ClassVar = "net"
    cable: Cable = Field(description="the cables of the net")
    divisions: Count = Field(1, description="elements on each mesh side")

    @classmethod
    def owners_of(cls, name: str) -> str:
        """Return the topologies that have a key, for a message; "" if none has it."""
        records = [*ThrownNetConfig.__subclasses__(), *NetConfig.__subclasses__()]
        kinds = [kind for kind in records if {"topology", name} <= set(kind.model_fields)]
        topologies = [get_args(kind.model_fields["topology"].annotation)[0] for kind in kinds]
        return f"nets of topology {', '.join(topologies)}" if kinds else ""

    @property
    def has_mouth(self) -> bool:
        """True if the topology has corners, which span a mouth."""
        return False

    @property
    @abstractmethod
    def n_sides(self) -> int:
        """Cable sides of the mesh, before division."""

    @property
    def n_elements(self) -> int:
        """Elements of the woven net."""
        return self.n_sides * self.divisions

    def faults(self) -> Iterator[Fault]:
        """Refuse a net with too many elements."""
        try:
            number = self.n_elements
        except ValueError:  # the mesh does not divide the size, which the topology reports
            return
        if number > MAX_ELEMENTS:
            count = f"{number:,}" if number < 10**15 else "more than 10^15"
            yield Fault("", f"the net would have {count} elements; at most {MAX_ELEMENTS:,} are allowed")


class ThrownNetConfig(NetConfig, ABC):
    """Keys of [net] of the topologies that have corners, where strings and bullets are tied."""

    strings: Strings | None = Field(None, description="the strings between bullets and corners; absent: none")
    bullets: Bullets | None = Field(None, description="the bullets, one a corner; absent: none")

    @property
    def has_mouth(self) -> bool:
        return True

    @property
    @abstractmethod
    def n_corners(self) -> int:
        """Places where a bullet hangs or sits, if the net has bullets."""

    @property
    def n_strings(self) -> int:
        """Strings of the net if it has any."""
        return self.n_corners

    @property
    def n_elements(self) -> int:
        of_strings = self.n_strings * self.strings.divisions if self.strings else 0
        return self.n_sides * self.divisions + of_strings


def meshes(size: float, mesh: float | None, given: int | None = None) -> int:
    """How many meshes of side `mesh` [m] make up `size` [m], or how many are given.

    ValueError if not a whole number within 1e-9.
    """
    if mesh is None:
        if given is None:
            raise ValueError("requires mesh or meshes")
        return given
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


def mesh_divides(key: str, size: float, mesh: float) -> Iterator[Fault]:
    """A fault of `key` if the mesh does not divide the size."""
    try:
        meshes(size, mesh)
    except ValueError as error:
        yield Fault(key, str(error))


def no_node(node: int, count: int) -> str:
    """Return the reason why a node number outside 0 ... count - 1 is wrong."""
    return f"there is no node {node}: the {count} nodes are numbered from 0 to {count - 1}"


def other_length(values: Sized, nodes: Sized) -> str:
    """Return the reason why `values` do not have one entry for each of `nodes`, or ""."""
    if len(values) == len(nodes):
        return ""
    return f"needs one entry for each of the {len(nodes)} nodes of net.nodes, got {len(values)}"
