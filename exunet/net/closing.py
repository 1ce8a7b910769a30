"""Closing of a net's mouth: a line that slides through rings, or an edge whose threads become shorter.

A closing line is one length of cord between two nodes, its ends, that runs through rings at other nodes; a
closed loop has both ends at its first ring. Where the ends are nearer to each other, or the rings to their
neighbours, than the diameter of a ring, the line still has its way round the ring to go (see
`exunet.forces.closing`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import CaseError, Fault
from exunet.base.record import FromArray, NonNegative, Positive, Record
from exunet.net.arrays import Net, edge_of
from exunet.net.base import NodeConfig, NodeName
from exunet.net.drive import Drive, DriveConfig, softest

NAME = "closing"  # of the line in states, discrete states, events and commands
SLOWS = 0.01  # of the length: the way before a limit in which the winch slows down


class EndOfLine(NodeConfig):
    """Attachment of an end of the closing line."""

    EXACTLY_ONE: ClassVar = ("node", "bullet", "tether")

    tether: str | None = Field(
        None, description="name of a tether, at whose end the line is tied, instead of node", examples=["tow"]
    )


class Winch(DriveConfig):
    """A drive that winds up the line at one of its ends."""

    TABLE: ClassVar = "closing.winch"
    at: Literal["start", "end"] = Field("start", description="end of the line that it winds up")
    shortest: Positive = Field(
        description="length outside at which winding stops [m], below length", examples=[1.0]
    )


class ClosingLine(Record):
    """A line through rings, perhaps with a winch."""

    TABLE: ClassVar = "closing"
    EXACTLY_ONE: ClassVar = ("rings", "nodes")

    kind: Literal["line"] = Field(description="a line through rings, with the cable law of the paper")
    rings: Literal["edge", "corners"] | None = Field(
        None,
        description="rings at all nodes of the net's edge, or at the corners of its mouth, anticlockwise",
    )
    nodes: Annotated[tuple[NodeName, ...], FromArray] | None = Field(
        None,
        min_length=1,
        description="nodes with a ring, by number or name, in the order of the line, instead of rings; none "
        "twice in a row",
        examples=[[0, 1, 2, 3]],
    )
    start: EndOfLine | None = Field(
        None,
        description="what the start of an open line is tied to, with end; absent: the line is a loop of at "
        "least two rings, tied to its first ring",
    )
    end: EndOfLine | None = Field(None, description="what the end of an open line is tied to, with start")
    length: Positive = Field(
        description="length of the line, free of stress [m]; the path through the rings is at most "
        "twice as long "
        "at time 0",
        examples=[20.0],
    )
    stiffness: Positive = Field(description="EA of the line [N]", examples=[1e4])
    linear_density: NonNegative = Field(
        description="mass per length of the line [kg/m], divided evenly over its pieces and lumped "
        "at their ends",
        examples=[1e-3],
    )
    ring_diameter: Positive = Field(description="diameter D of the rings [m]", examples=[0.005])
    friction: float = Field(
        ge=0.0,
        le=2.0,
        description="coefficient mu of the line in the rings; above 0 exunet only",
        examples=[0.1],
    )
    strength: Positive | None = Field(
        None,
        description="specified axial strength of the line [N], for its margin; nothing breaks at it",
        examples=[400.0],
    )
    winch: Winch | None = Field(
        None, description="drive that winds up the line; absent: its length is constant"
    )

    def faults(self) -> Iterator[Fault]:
        """Require two ends or none, and a length that the winch can wind up."""
        for one, other in (("start", "end"), ("end", "start")):
            if self.is_given(one) and not self.is_given(other):
                yield Fault(one, f"requires {other}: a line that is not a loop has two ends")
        if self.winch is not None and self.winch.shortest >= self.length:
            words = f"must be below length = {self.length:g} m, got {self.winch.shortest:g} m"
            yield Fault("winch.shortest", f"{words}: there is nothing to wind up")


class Perimeter(Record):
    """Threads of the net's edge that become shorter."""

    TABLE: ClassVar = "closing"
    kind: Literal["perimeter"] = Field(description="threads of the edge that become shorter")
    at: NonNegative = Field(description="start of the shortening [s]", examples=[1.0])
    rate: Positive = Field(
        description="rate of shortening, as a fraction of the length [1/s]", examples=[0.5]
    )
    part: float = Field(
        gt=0.0, lt=1.0, description="fraction of the length that is left at the end", examples=[0.2]
    )


Closing = Annotated[ClosingLine | Perimeter, Field(discriminator="kind")]


@dataclass(frozen=True)
class LineThroughRings:
    """A line through rings.

    path      : nodes along it, ends included; the first and the last are the same for a loop
    length    : free of stress, with nothing wound up [m]
    stiffness : EA [N]
    linear_density : [kg/m]
    ring_diameter : [m]
    friction  : mu
    strength  : [N]; None: not known
    winch_at_end : False for one at the start
    shortest, largest_rate, times, drives, damping : of the winch, as of a `ReeledTether`
    has_winch : False for a line of constant length
    wound     : length wound up at time 0 [m]
    """

    path: tuple[int, ...]
    length: float
    stiffness: float
    linear_density: float
    ring_diameter: float
    friction: float
    strength: float | None = None
    winch_at_end: bool = False
    shortest: float = 0.0
    largest_rate: float = 0.0
    times: tuple[float, ...] = ()
    drives: tuple[Drive, ...] = field(default=(Drive(),))
    damping: float | None = None
    has_winch: bool = False
    wound: float = 0.0

    @property
    def length_at_start(self) -> float:
        """Outside at time 0, free of stress [m]."""
        return self.length - self.wound

    @property
    def is_commanded(self) -> bool:
        """True if it has a winch without commands in the case, so that a script may command it."""
        return self.has_winch and not self.times

    @property
    def softest(self) -> Drive:
        """Return the softest drive that a script may request."""
        return softest(self.damping if self.is_commanded else None)


@dataclass(frozen=True)
class ShortenedEdge:
    """Elements that become shorter: from `at` [s] by `rate` [1/s] of their length, until `part` is left."""

    elements: tuple[int, ...]
    at: float
    rate: float
    part: float


def closing_of(net: Net, keys: ClosingLine | Perimeter) -> LineThroughRings | ShortenedEdge:
    """Return the closing of a net; raises CaseError for nodes, bullets and tethers that it does not have."""
    if isinstance(keys, Perimeter):
        loop = _edge(net, "kind")
        pairs = {frozenset(pair) for pair in pairwise((*loop, loop[0]))}
        own = range(net.n_net_elements)
        elements = tuple(e for e in own if frozenset(net.element_nodes[e].tolist()) in pairs)
        return ShortenedEdge(elements, keys.at, keys.rate, keys.part)
    winch = keys.winch
    line = LineThroughRings(
        _path(net, keys),
        keys.length,
        keys.stiffness,
        keys.linear_density,
        keys.ring_diameter,
        keys.friction,
        keys.strength,
    )
    if winch is None:
        return line
    return replace(
        line,
        winch_at_end=winch.at == "end",
        shortest=winch.shortest,
        largest_rate=winch.rate_limit,
        times=winch.times,
        drives=winch.drives,
        damping=winch.damping,
        has_winch=True,
    )


def with_mass_of(net: Net, line: LineThroughRings) -> Net:
    """The net with the mass of a line at its nodes: an equal share of each piece, half at either end."""
    if line.linear_density == 0.0:
        return net
    mass, path = net.mass.copy(), np.array(line.path)
    share = line.linear_density * line.length / (len(path) - 1)
    for ends in (path[:-1], path[1:]):
        np.add.at(mass, ends, 0.5 * share)
    mass.flags.writeable = False
    return replace(net, mass=mass)


def _path(net: Net, keys: ClosingLine) -> tuple[int, ...]:
    faults = list[Fault]()
    if keys.nodes is not None:
        rings = _rings(net, keys.nodes, faults)
        if len(rings) > 2 and keys.start is None and rings[0] == rings[-1]:
            words = f"node {rings[0]} is the first node too: a loop returns to it anyway"
            faults.append(Fault(f"closing.nodes[{len(rings) - 1}]", words))
    else:
        rings = _edge(net, "rings") if keys.rings == "edge" else _corners(net)
    if keys.start is None or keys.end is None:
        if len(rings) < 2:
            faults.append(Fault("closing.nodes", "a loop needs two rings at least: give start and end"))
        path = (*rings, rings[0])
    else:
        round_it = (*rings, rings[0]) if keys.nodes is None else rings
        ends = (_end(net, getattr(keys, name), name, faults) for name in ("start", "end"))
        first, last = ends
        path = (first, *round_it, last)
        for name, end, ring in (("start", first, path[1]), ("end", last, path[-2])):
            if end == ring >= 0:
                words = f"node {end} is the ring next to it: tie the line to another, or leave out the ring"
                faults.append(Fault(f"closing.{name}", words))
    if faults:
        raise CaseError(faults)
    return tuple(int(node) for node in path)


def _rings(net: Net, nodes: tuple[int | str, ...], faults: list[Fault]) -> tuple[int, ...]:
    """The nodes of the rings; -1 for those that the net does not have."""
    found: list[int] = []
    for k, given in enumerate(nodes):
        try:
            node = net.node(given)
        except ValueError as error:
            node = -1
            faults.append(Fault(f"closing.nodes[{k}]", str(error)))
        if found[-1:] == [node] and node >= 0:
            faults.append(Fault(f"closing.nodes[{k}]", f"node {node} follows itself: one ring is enough"))
        found.append(node)
    return tuple(found)


def _end(net: Net, keys: EndOfLine, name: str, faults: list[Fault]) -> int:
    if keys.tether is not None:
        nodes = {tether.name: tether.nodes for tether in net.tethers}
        if keys.tether not in nodes:
            known = ", ".join(nodes) or "none"
            words = f'there is no tether "{keys.tether}" (tethers: {known})'
            faults.append(Fault(f"closing.{name}.tether", words))
            return -1
        return nodes[keys.tether][-1]
    try:
        return keys.node_of(net)
    except ValueError as error:
        faults.append(Fault(f"closing.{name}.{keys.key}", str(error)))
        return -1


def _corners(net: Net) -> tuple[int, ...]:
    if len(net.mouth) < 2:
        words = "the net has no mouth: give closing.nodes, the numbers of its nodes"
        raise CaseError([Fault("closing.rings", words)])
    return net.mouth


def _edge(net: Net, key: str) -> tuple[int, ...]:
    """The nodes of the net's edge, anticlockwise from the first corner of its mouth."""
    found = edge_of(net.faces, net.mouth[0] if net.mouth else None)
    if not found:
        words = "the net has no edge that is one loop round its meshes"
        words += ": give closing.nodes, the numbers of its nodes" if key == "rings" else ""
        raise CaseError([Fault(f"closing.{key}", words)])
    return found
