"""The record of a case, and how a case is turned away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reference_impl.arrays import Floats, Vector
from reference_impl.bodies import Body
from reference_impl.canister import Fold
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
class NetNode:
    """A node of the net by its number in the case format: `kind` is "node" or "bullet"."""

    kind: str
    number: int


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
    attachments: tuple[Attachment, ...] = ()
    tethers: tuple[Tether, ...] = ()
    border: Cable | None = None  # of cut nets
    closing: ClosingLine | ClosingPerimeter | None = None
    source: str = ""  # the file's text, for the record
