"""The records of a case file; those of topologies, bodies and effects have their own modules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from reference_impl.arrays import Floats, Vector
from reference_impl.bodies import Body
from reference_impl.effects import Effects
from reference_impl.thrusters import Thruster
from reference_impl.topology import Shape


@dataclass(frozen=True)
class Cable:
    """What an element is made of: undeformed area [m2], density [kg/m3], Young's modulus [Pa].

    Without points its law is eq. (8); else its tension over E A is straight between points (strain, value).
    """

    area: float
    density: float
    youngs_modulus: float
    points: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Strings:
    """The strings between bullets and net: cable, reference length of each [m], elements on each."""

    cable: Cable
    length: float
    divisions: int


@dataclass(frozen=True)
class NetNode:
    """A node of the net in the case format: `kind` is "node" or "bullet" with a number, or "name"."""

    kind: str
    number: int | str


@dataclass(frozen=True)
class BodyPoint:
    """A point of a body, in its frame [m]."""

    body: str
    point: Vector


@dataclass(frozen=True)
class Attachment:
    """A node of the net that is a point of a body."""

    node: NetNode
    place: BodyPoint


@dataclass(frozen=True)
class Command:
    """What a drive does from a time `at` [s] on: `rate` [m/s] of winding up, `force` [N]."""

    at: float
    mode: str  # "lock", "brake", "rate", "tension"
    rate: float | None = None
    force: float | None = None


@dataclass(frozen=True)
class Reel:
    """A drum at one end of a tether, which winds it up and pays it out."""

    at_start: bool
    paid_out: float  # length outside at time 0 [m]
    shortest: float  # length outside at which winding stops [m]
    largest_rate: float  # [m/s], infinite where there is no limit
    damping: float  # c [N s/m] of the drive, infinite where no command has a force
    commands: tuple[Command, ...]


@dataclass(frozen=True)
class Tether:
    """A cable beside the net, of this reference length [m], between two nodes or points of bodies."""

    name: str
    cable: Cable
    length: float
    divisions: int
    start: NetNode | BodyPoint
    end: NetNode | BodyPoint
    reel: Reel | None = None

    @property
    def piece(self) -> float:
        """Reference length of each of its elements [m]."""
        return self.length / self.divisions


@dataclass(frozen=True)
class Winch:
    """A drive that winds up a closing line."""

    shortest: float  # length outside at which winding stops [m]
    largest_rate: float  # [m/s], infinite where there is no limit
    damping: float  # c [N s/m] of the drive, infinite where no command has a force
    commands: tuple[Command, ...]


@dataclass(frozen=True)
class ClosingLine:
    """A line that slides without friction through rings at the mouth of a net."""

    rings: str | tuple[NetNode, ...]  # "edge", "corners", or nodes in the order of the line
    ends: tuple[NetNode | str, NetNode | str] | None  # names of tethers: where these end; None: a loop
    length: float  # free of stress [m]
    stiffness: float  # EA [N]
    linear_density: float  # [kg/m]
    ring_diameter: float  # D [m]
    winch: Winch | None


@dataclass(frozen=True)
class ClosingPerimeter:
    """Threads of the net's edge that become shorter from `at` [s] on, until `part` of them is left."""

    at: float
    rate: float  # [1/s]
    part: float


@dataclass(frozen=True, eq=False)
class Carrier:
    """The net's axes at time 0, carried by a body: origin (3,) [m], rotation (3, 3) in the body's frame.

    The body holds the packed net until `eject_at` [s].
    """

    body: str
    position: Floats
    attitude: Floats
    eject_at: float = 0.0


@dataclass(frozen=True, eq=False)
class Places:
    """Where exunet's fold puts nodes: reference positions and places, (n, 3) [m], in the net's axes."""

    reference_position: Floats
    place: Floats


@dataclass(frozen=True)
class Fold:
    """The canister of a folded net, round the origin: edges along x, y, z [m], or radius and height along z.

    How the net is folded into it is not computed here: its `places` are given.
    """

    box: tuple[float, ...] | None
    cylinder: tuple[float, ...] | None
    places: Places | None = None

    def holds(self, place: Floats, d: float) -> bool:
        """Whether threads of a thickness d [m] through places (n, 3) [m] lie inside."""
        if self.box is not None:
            return bool(np.all(2.0 * np.abs(place).max(axis=0) + d <= self.box))
        assert self.cylinder is not None
        radius, height = self.cylinder
        across = np.hypot(place[:, 0], place[:, 1]).max() + 0.5 * d <= radius
        return bool(across and 2.0 * np.abs(place[:, 2]).max() + d <= height)


@dataclass(frozen=True)
class Start:
    """Packing factor [-] or fold, velocity [m/s] and spin [rad/s] of all nodes, lists for explicit nets."""

    packing: float  # 1 beside a fold
    velocity: Vector
    spin: Vector
    node_positions: tuple[Vector, ...] | None
    node_velocities: tuple[Vector, ...] | None
    carrier: Carrier | None = None
    fold: Fold | None = None


class Launch(NamedTuple):
    """Velocities of bullets, then what each of them has of its own: a factor, and two angles."""

    radial: float  # [m/s]
    axial: float  # [m/s]
    factors: tuple[float, ...] | None = None
    tilts: tuple[tuple[float, ...], ...] | None = None  # [rad] about z x o, and about the axis across both


@dataclass(frozen=True)
class Case:
    """One scene.  None stands for absent bullets, strings, launch."""

    title: str
    times: tuple[float, ...]  # stored times [s], from 0 to the end
    shape: Shape
    divisions: int
    cable: Cable
    strings: Strings | None
    bullet_mass: float | None
    start: Start
    launch: Launch | None
    bodies: tuple[Body, ...]
    effects: Effects
    attachments: tuple[Attachment, ...] = ()
    tethers: tuple[Tether, ...] = ()
    border: Cable | None = None  # of cut nets
    closing: ClosingLine | ClosingPerimeter | None = None
    thrusters: tuple[tuple[str, Thruster], ...] = ()  # with the names of their bodies
    threads: Mapping[str, Cable] = field(default_factory=dict)  # named ones of explicit nets
