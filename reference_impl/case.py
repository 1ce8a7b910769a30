"""The record of a case, and how a case is turned away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reference_impl.arrays import Vector
from reference_impl.bodies import Body
from reference_impl.effects import Effects
from reference_impl.shape import Shape


class Refused(ValueError):
    """A case that this program does not run; `faults` holds one line for each reason."""

    def __init__(self, faults: Sequence[str]) -> None:
        super().__init__("\n".join(faults))
        self.faults = tuple(faults)


@dataclass(frozen=True)
class Cable:
    """What an element is made of: undeformed area [m2], density [kg/m3], Young's modulus [Pa]."""

    area: float
    density: float
    youngs_modulus: float


@dataclass(frozen=True)
class Strings:
    """The strings between bullets and net: cable, reference length of each [m], elements on each."""

    cable: Cable
    length: float
    divisions: int


@dataclass(frozen=True)
class Start:
    """Packing factor [-], velocity [m/s] and spin [rad/s] of all nodes, lists for explicit nets."""

    packing: float
    velocity: Vector
    spin: Vector
    node_positions: tuple[Vector, ...] | None
    node_velocities: tuple[Vector, ...] | None


@dataclass(frozen=True)
class Case:
    """One scene.  Absent bullets, strings, launch are None."""

    title: str
    times: tuple[float, ...]  # stored times [s], from 0 to the end
    shape: Shape
    divisions: int
    cable: Cable
    strings: Strings | None
    bullet_mass: float | None
    start: Start
    launch: tuple[float, float] | None  # radial and axial speed [m/s]
    bodies: tuple[Body, ...]
    effects: Effects
    source: str = ""  # the file's text, for the record
