"""What closes the mouth of a net: a line that slides through rings, or an edge that becomes shorter.

At each node the thread is taken that comes first when one turns anticlockwise from where one came from: the
right-hand rule for the outer face of a plane graph.  Which nodes lie outside is asked nowhere.

The line has one strain.  With the way L = sum w(d) over its pieces and the length L0 outside, free of stress,
its elastic energy U = E A (E11 - e)^2 L0/2, E11 = (L^2 - L0^2)/(2 L0^2), free strain e, where it is taut, is
a function of L and L0 alone, and all forces follow from it (Lanczos, The Variational Principles of Mechanics,
III):

    N = dU/dL = E A (E11 - e) L/L0,    -dU/dL0 = N L/L0 - E A (E11 - e)^2/2,

the tension of all pieces and what winding up takes for each metre.  The free strain stands in E11 - e, as in
an element; lengths need no scaling then.  What is wound up, or the part of the edge that is left, is an
unknown of the state (`state`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from reference_impl.arrays import Floats, Ints, dot
from reference_impl.case import Case, ClosingLine, ClosingPerimeter, NetNode
from reference_impl.elements import Elements
from reference_impl.net import Net
from reference_impl.reels import LOCKED, Drive, Outlets, shorten


def around(place: Floats, sides: Ints, first: int) -> tuple[Ints, Ints]:
    """Nodes (q,) of the edge, anticlockwise from the corner `first`, and the sides (q,) that follow each.

    place (n, 2 or 3) [m] in the plane of the net; sides (s, 2).
    """
    beside: dict[int, list[tuple[int, int]]] = {}
    for side, (i, j) in enumerate(sides.tolist()):
        beside.setdefault(i, []).append((j, side))
        beside.setdefault(j, []).append((i, side))
    here, back = first, place[first, :2] - place[np.unique(sides), :2].mean(axis=0)  # as from outside
    nodes, passed = [first], []
    while True:
        angles = [_turn(back, place[there, :2] - place[here, :2]) for there, _ in beside[here]]
        there, side = beside[here][int(np.argmin(angles))]
        passed.append(side)
        if there == first:
            return np.array(nodes, dtype=np.intp), np.array(passed, dtype=np.intp)
        nodes.append(there)
        back, here = place[here, :2] - place[there, :2], there


def _turn(back: Floats, ahead: Floats) -> float:
    """Angle in (0, 2 pi] by which one turns anticlockwise from `back` to `ahead`, plane vectors (2,)."""
    angle = np.arctan2(back[0] * ahead[1] - back[1] * ahead[0], back @ ahead)
    return float(angle if angle > 1e-9 else angle + 2.0 * np.pi)


LONGEST = 2.0  # times its length free of stress: a run is stopped there


@dataclass(frozen=True, eq=False)
class Drawn:
    """States of c = 0 or 1 lines or edges, at one time or many (leading axes ...)."""

    amount: Floats  # (..., c) wound up [m] of a line, part left of an edge
    work: Floats  # (..., c) [J] that winding or shrinking has done


@dataclass(frozen=True, eq=False)
class Line:
    """A line of n pieces through its nodes (n + 1,); of a loop the last is the first."""

    nodes: Ints
    length: float  # free of stress [m]
    stiffness: float  # EA [N]
    diameter: float  # D [m] of the rings
    drive: Drive | None
    begin: float = 0.0  # wound up at time 0 [m]

    def way(self, x: Floats) -> Floats:
        """L (...) [m] at places x (..., n, 3)."""
        vector = np.diff(x[..., self.nodes, :], axis=-2)
        u = np.minimum(np.sqrt(dot(vector, vector)) / self.diameter, 1.0)
        beyond = np.maximum(np.sqrt(dot(vector, vector)) - self.diameter, 0.0)
        return np.asarray(np.sum(beyond + self.diameter * (0.375 + 0.75 * u**2 - 0.125 * u**4), axis=-1))

    def energy(self, x: Floats, amount: Floats, free_strain: float) -> Floats:
        """U (...) [J] at places x (..., n, 3) with `amount` (..., 1) wound up."""
        outside = self.length - amount[..., 0]
        taut = np.maximum(0.5 * ((self.way(x) / outside) ** 2 - 1.0) - free_strain, 0.0)
        return np.asarray(0.5 * self.stiffness * taut**2 * outside)

    def tension(self, x: Floats, amount: Floats, free_strain: float) -> Floats:
        """Elastic N (...) [N], likewise."""
        stretch = self.way(x) / (self.length - amount[..., 0])
        return np.asarray(self.stiffness * np.maximum(0.5 * (stretch**2 - 1.0) - free_strain, 0.0) * stretch)


@dataclass(frozen=True, eq=False)
class Edge:
    """Elements (q,) of a net's edge, whose lengths shrink by `rate` [1/s] from `at` [s] on to a `part`."""

    element: Ints
    at: float
    rate: float
    part: float
    begin: float = 1.0  # part at time 0

    @property
    def done(self) -> float:
        """When they have shrunk [s]."""
        return self.at + (1.0 - self.part) / self.rate


Closing = Line | Edge


@dataclass(frozen=True, eq=False)
class Pulled:
    """What a line does in a state."""

    force: Floats  # (n, 3) [N] on the nodes
    tension: float  # N [N]
    rate: float  # ds/dt [m/s]
    power: float  # [W] of the winch on the line
    taken: float  # [W] by viscous stress


def pull(system: Elements, line: Line, order: int, x: Floats, v: Floats, wound_up: float) -> Pulled:
    """The line at places x and velocities v (n, 3) [m, m/s], its winch under an order."""
    vector, moving = np.diff(x[line.nodes], axis=0), np.diff(v[line.nodes], axis=0)
    squared = dot(vector, vector)
    near = 0.5 * (3.0 - squared / line.diameter**2) / line.diameter  # dw/dd over d
    slope = np.where(squared < line.diameter**2, near, 1.0 / np.sqrt(np.maximum(squared, line.diameter**2)))
    lengthening = math.fsum((slope * dot(vector, moving)).tolist())
    outside, e = line.length - wound_up, system.free_strain
    stretch = float(line.way(x)) / outside
    taut = max(0.5 * (stretch * stretch - 1.0) - e, 0.0)
    elastic = line.stiffness * taut * stretch
    rate = 0.0 if line.drive is None else line.drive.rate(order, elastic, wound_up)
    stretching = lengthening + stretch * rate  # L0 times that of the stretch
    tension = elastic
    if taut > 0.0:
        viscous = system.effects.relaxation_time * stretch * stretching / outside
        tension = max(elastic + line.stiffness * viscous * stretch, 0.0)
    force, each = np.zeros_like(x), (tension * slope)[:, None] * vector
    np.add.at(force, line.nodes[:-1], each)
    np.add.at(force, line.nodes[1:], -each)
    power = (tension * stretch - 0.5 * line.stiffness * taut * taut) * rate
    return Pulled(force, tension, rate, power, (tension - elastic) * stretching)


def order_at(closing: Closing, t: float) -> int:
    """Number of the command that holds from t [s] on; of an edge 0 where it shrinks, else LOCKED."""
    if isinstance(closing, Edge):
        return 0 if closing.at <= t < closing.done else LOCKED
    return LOCKED if closing.drive is None else closing.drive.order(t)


def kinks(closing: Closing) -> tuple[float, ...]:
    """Times [s] at which its command changes."""
    if isinstance(closing, Edge):
        return closing.at, closing.done
    return () if closing.drive is None else tuple(command.at for command in closing.drive.commands)


def shrink(system: Elements, edge: Edge, order: int, x: Floats, v: Floats, part: float) -> Outlets:
    """The elements of an edge of which a part is left."""
    whole = system.net.reference_length[edge.element]
    rate = whole * (0.0 if order == LOCKED else edge.rate)
    return shorten(system, edge.element, whole * part, lambda _: rate, x, v)


def course(case: Case, net: Net) -> Ints:
    """The nodes of a closing line in their order, both ends among them."""
    line = case.closing
    assert isinstance(line, ClosingLine)
    if not isinstance(line.rings, str):
        rings = np.array([node_of(net, ring) for ring in line.rings], dtype=np.intp)
    else:
        rings, _ = edge_of(net)
        if line.rings == "corners":
            rings = rings[np.isin(rings, net.corners)]
    if line.ends is None:
        return np.append(rings, rings[0])
    start, end = (_end(case, net, item) for item in line.ends)
    again = rings[:1] if isinstance(line.rings, str) else rings[:0]
    return np.concatenate(([start], rings, again, [end])).astype(np.intp)


def edge_of(net: Net) -> tuple[Ints, Ints]:
    """Nodes and elements of a woven net's edge, anticlockwise from the first corner of its mouth."""
    mesh = np.flatnonzero(~net.of_string & (net.tether < 0))
    nodes, passed = around(net.reference_position, net.element_nodes[mesh], int(net.corners[0]))
    return nodes, mesh[passed]


NEAR = 1e-9  # m per m of the net's diagonal, or parts of its perimeter: places that are one


def node_of(net: Net, place: NetNode) -> int:
    """A node by its number or its name; names are of ends of mesh sides, whatever their divisions."""
    if place.kind == "name":
        return _named(net, str(place.number))
    numbered = net.numbered_bullets if place.kind == "bullet" else net.numbered_nodes
    return int(numbered[int(place.number)])


def _named(net: Net, name: str) -> int:
    """The middle: of the nearest the lowest one, then the leftmost; a corner; or by the part of the rim."""
    whole = net.parents[:, 0] == net.parents[:, 1]
    kind, _, number = name.partition(" ")
    if kind == "centre":
        mesh = net.element_nodes[~net.of_string & (net.tether < 0)]
        knots = [k for k in np.unique(mesh).tolist() if whole[k]]
        grain = NEAR * float(np.hypot(*np.ptp(net.reference_position[knots, :2], axis=0)))

        def rank(knot: int) -> tuple[int, int, int]:
            x, y = net.reference_position[knot, :2].tolist()
            return round(math.hypot(x, y) / grain), round(y / grain), round(x / grain)

        return min(knots, key=rank)
    rim, passed = edge_of(net)
    if kind == "corner":
        return int(rim[np.isin(rim, net.corners)][int(number)])
    ends = np.cumsum(net.reference_length[passed])
    part = np.concatenate(([0.0], ends[:-1])) / ends[-1]
    apart = np.abs((part - float(number) + 0.5) % 1.0 - 0.5)[whole[rim]]
    return int(rim[whole[rim]][np.argmax(apart < apart.min() + NEAR)])


def _end(case: Case, net: Net, place: NetNode | str) -> int:
    """The node of an end; of a tether's name the last of it."""
    if isinstance(place, NetNode):
        return node_of(net, place)
    number = [tether.name for tether in case.tethers].index(place)
    return int(net.element_nodes[net.tether == number][-1, 1])


def with_line(case: Case, net: Net) -> Net:
    """The net with the mass of a closing line."""
    if not isinstance(line := case.closing, ClosingLine):
        return net
    nodes, mass = course(case, net), net.mass.copy()
    piece = line.linear_density * line.length / (len(nodes) - 1)
    np.add.at(mass, nodes[:-1], 0.5 * piece)
    np.add.at(mass, nodes[1:], 0.5 * piece)
    return replace(net, mass=mass)


def closed_by(case: Case, net: Net) -> Closing | None:
    """What closes the mouth of a case's net; None: nothing."""
    closing = case.closing
    if isinstance(closing, ClosingPerimeter):
        return Edge(edge_of(net)[1], closing.at, closing.rate, closing.part)
    if closing is None:
        return None
    winch, drive = closing.winch, None
    if winch is not None:
        most, ramp = closing.length - winch.shortest, 0.01 * closing.length
        drive = Drive(winch.commands, most, ramp, winch.largest_rate, winch.damping)
    return Line(course(case, net), closing.length, closing.stiffness, closing.ring_diameter, drive)
