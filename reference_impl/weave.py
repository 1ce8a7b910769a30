"""Builds the net of a case in the reference configuration (z = 0, centre at 0), its tethers included.

A tether is one more side, divided as the sides of the net are (`division`): its inner nodes lie between its
ends by their shares, in place and velocity.  Where it ends on a body it has a node of its own there, which is
a point of the body.  Its reference configuration is the straight line on which it starts.

The connectivity comes out of the geometry.  A net is a set of mesh cells: the outline of every cell is laid
down as loose segments of endpoint coordinates, the strings likewise; endpoints that coincide become one node,
segments that coincide one side.  No formula for node numbers appears anywhere.  Coordinates that mirror each
other are mirrored to the last bit, which `mirror` relies on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from reference_impl.arrays import Floats, Ints, direction
from reference_impl.attachments import Anchors, none
from reference_impl.case import BodyPoint, Cable, Case
from reference_impl.closing import node_of, with_line
from reference_impl.cut import cut
from reference_impl.net import Net, between, divide, lump
from reference_impl.reels import chain, spread_outside
from reference_impl.start import initial_state, net_axes
from reference_impl.topology import Cut, Explicit, Hexagonal, Radial, Rectangular

COINCIDENT = 1e-9  # part of the length of a tether below which its ends are in one place


def tie(case: Case, net: Net) -> Net:
    """The net with the case's attachments and tethers, its reference directions in the scene's axes."""
    if case.start.carrier is not None:
        net = replace(net, direction=net.direction @ net_axes(case).T)
    if not (case.attachments or case.tethers):
        return net
    held = [(node_of(net, a.node), a.place) for a in case.attachments]
    ends: list[int] = []
    tied_to: list[int] = []
    for number, tether in enumerate(case.tethers):
        for end in (tether.start, tether.end):
            if isinstance(end, BodyPoint):
                ends.append(len(net.mass) + len(tied_to))
                held.append((ends[-1], end))
                tied_to.append(number)
            else:
                ends.append(node_of(net, end))
    tied = replace(net, anchors=_anchors(case, held))
    if not case.tethers:
        return tied
    return _placed(case, _lengthened(case, tied, np.array(ends, dtype=np.intp).reshape(-1, 2), tied_to))


def _anchors(case: Case, held: list[tuple[int, BodyPoint]]) -> Anchors:
    names = [body.name for body in case.bodies]
    return Anchors(
        np.array([node for node, _ in held], dtype=np.intp),
        np.array([names.index(place.body) for _, place in held], dtype=np.intp),
        np.array([place.point for _, place in held], dtype=float).reshape(-1, 3),
    )


def _lengthened(case: Case, net: Net, ends: Ints, tied_to: list[int]) -> Net:
    """The net with tethers between the nodes `ends` (q, 2); not yet placed.

    These are nodes of the net, or beyond them ends on bodies: `tied_to`, the numbers of their tethers.
    """
    pieces = np.array([tether.divisions for tether in case.tethers])
    element_nodes, parents, shares = divide(len(net.mass) + len(tied_to), ends, pieces)
    order = _tether_by_tether(len(net.mass), tied_to, pieces)
    number = np.argsort(order)
    element_nodes, parents, shares = number[element_nodes], number[parents[order]], shares[order]
    net = replace(net, anchors=replace(net.anchors, node=number[net.anchors.node]))
    tether = np.repeat(np.arange(len(pieces)), pieces)
    _let_out(case, element_nodes, tether, shares)
    made = np.array([(t.cable.area, t.cable.youngs_modulus, t.cable.density) for t in case.tethers])[tether]
    reference_length = np.array([t.length / t.divisions for t in case.tethers])[tether]
    before, more = len(net.mass), len(parents) - len(net.mass)
    law, curves = _laws([t.cable for t in case.tethers], len(net.curves))
    halves = lump(
        len(parents), element_nodes, made[:, 2] * made[:, 0] * reference_length, np.zeros(len(parents))
    )
    return replace(
        net,
        reference_position=np.concatenate((net.reference_position, np.zeros((more, 3)))),
        element_nodes=np.concatenate((net.element_nodes, element_nodes)),
        reference_length=np.concatenate((net.reference_length, reference_length)),
        area=np.concatenate((net.area, made[:, 0])),
        youngs_modulus=np.concatenate((net.youngs_modulus, made[:, 1])),
        density=np.concatenate((net.density, made[:, 2])),
        mass=np.concatenate((net.mass, np.zeros(more))) + halves,
        law=np.concatenate((net.law, law[tether])),
        curves=net.curves + curves,
        of_string=np.concatenate((net.of_string, np.zeros(len(tether), dtype=bool))),
        parents=np.concatenate((net.parents, parents[before:])),
        shares=np.concatenate((net.shares, shares[before:])),
        direction=np.concatenate((net.direction, np.zeros((len(tether), 3)))),
        tether=np.concatenate((net.tether, tether)),
    )


def _tether_by_tether(woven: int, tied_to: list[int], pieces: Ints) -> Ints:
    """The order of the nodes: the `woven` ones, then of each tether its ends on bodies and its inner nodes.

    They come with all ends on bodies, `tied_to` the tethers of these numbers, before all inner nodes.
    """
    inside = np.repeat(np.arange(len(pieces)), pieces - 1)
    owner = np.concatenate((np.full(woven, -1), np.array(tied_to, dtype=np.intp), inside))
    return np.argsort(owner, kind="stable")


def _let_out(case: Case, element_nodes: Ints, tether: Ints, shares: Floats) -> None:
    """Changes the shares (n, 2) of nodes of reeled tethers: on the drum, or between it and the other end."""
    for number, line in enumerate(case.tethers):
        if line.reel is None:
            continue
        nodes, _ = chain(element_nodes, tether, number, line.reel.at_start)
        way = spread_outside(line.length, line.divisions, line.reel.paid_out)
        drum, other = (0, 1) if line.reel.at_start else (1, 0)
        shares[nodes[1:-1], drum], shares[nodes[1:-1], other] = 1.0 - way, way


def _placed(case: Case, net: Net) -> Net:
    """Directions and reference positions of the tethers, from where the case starts."""
    place = initial_state(case, net)[0]
    direction = net.direction.copy()
    for number, tether in enumerate(case.tethers):
        elements = np.flatnonzero(net.tether == number)
        way = place[net.element_nodes[elements[-1], 1]] - place[net.element_nodes[elements[0], 0]]
        distance = float(np.linalg.norm(way))
        if distance > COINCIDENT * tether.length:
            direction[elements] = way / distance
    reference = np.concatenate((net.reference_position[: net.woven], place[net.woven :]))
    return replace(net, reference_position=reference, direction=direction)


@dataclass(frozen=True, eq=False)
class _Segments:
    """Loose segments: ends (s, 2, 3) [m], reference lengths (s,) [m]."""

    ends: Floats
    length: Floats


def weave(case: Case) -> Net:
    """The net of the case, its tethers and the mass of its closing line included."""
    return with_line(case, tie(case, _woven(case)))


@dataclass(frozen=True, eq=False)
class _Family:
    """Sides of one cable: pairs of knots (s, 2), reference lengths (s,) [m], elements on each."""

    sides: Ints
    length: Floats
    cable: Cable
    divisions: int
    strings: bool = False

    @property
    def elements(self) -> int:
        return len(self.sides) * self.divisions


def _woven(case: Case) -> Net:
    """The net without tethers."""
    if isinstance(case.shape, Explicit):
        return _finish(case, *_listed(case, case.shape))
    laid = _lay(case)
    parts = [(laid.mesh, case.cable, case.divisions)]
    if laid.border is not None and case.border is not None:
        parts.append((laid.border, case.border, case.divisions))
    if laid.strings is not None and case.strings is not None:
        parts.append((laid.strings, case.strings.cable, case.strings.divisions))
    knots, labels = merge_points(
        np.concatenate([part.ends.reshape(-1, 3) for part, _, _ in parts]),
        tolerance=1e-6 * float(laid.mesh.length.min()),
    )
    families, before = [], 0
    for part, cable, divisions in parts:
        joined = labels[before : before + 2 * len(part.length)].reshape(-1, 2)
        before += 2 * len(part.length)
        families.append(_Family(*_once(joined, part.length), cable, divisions, part is laid.strings))
    corners = np.asarray(cKDTree(knots).query(laid.corners)[1], dtype=np.intp)
    tips = families[-1].sides[:, 1] if families[-1].strings else corners
    return _finish(case, knots, families, _anticlockwise(knots, np.unique(tips)), corners)


def _laws(cables: list[Cable], first: int) -> tuple[Ints, tuple[Floats, ...]]:
    """Which curve each cable follows, the new ones counted from `first` on, and these."""
    own = [cable for cable in cables if cable.points]
    law = [first + own.index(cable) if cable.points else -1 for cable in cables]
    return np.array(law, dtype=np.intp), tuple(np.array(cable.points) for cable in own)


def _finish(case: Case, knots: Floats, families: list[_Family], tips: Ints, corners: Ints) -> Net:
    """Divides the sides of each family and lumps the masses.

    `tips`: where bullets are, if there are any; `corners` of the mouth.
    """
    bullets = tips if case.bullet_mass is not None else tips[:0]
    whole = np.concatenate([np.full(len(family.sides), family.divisions) for family in families])
    element_nodes, parents, shares = divide(
        len(knots), np.concatenate([family.sides for family in families]), whole
    )
    kind = np.repeat(np.arange(len(families)), [family.elements for family in families])
    made = [(f.cable.area, f.cable.youngs_modulus, f.cable.density) for f in families]
    cables = np.array(made)[kind].reshape(-1, 3)
    law, curves = _laws([family.cable for family in families], 0)
    reference_length = np.concatenate([np.repeat(f.length / f.divisions, f.divisions) for f in families])
    n = len(parents)
    extra = np.zeros(n)
    if case.bullet_mass is not None:
        extra[bullets] = case.bullet_mass
    fixed = np.empty(0, dtype=np.intp)
    if isinstance(case.shape, Explicit):
        extra[: len(case.shape.node_masses)] = case.shape.node_masses
        fixed = np.unique(np.array(case.shape.fixed, dtype=np.intp))
    mass = lump(n, element_nodes, cables[:, 2] * cables[:, 0] * reference_length, extra)
    place = between(knots, parents, shares)
    i, j = element_nodes.T
    return Net(
        place,
        element_nodes,
        reference_length,
        cables[:, 0],
        cables[:, 1],
        cables[:, 2],
        mass,
        bullets,
        fixed,
        np.array([family.strings for family in families])[kind],
        _numbered(case, knots, bullets),
        parents,
        shares,
        np.asarray((place[j] - place[i]) / reference_length[:, None]),
        np.full(len(kind), -1),
        n,
        _numbered_nodes(case, knots, tips),
        corners,
        none(),
        law[kind],
        curves,
    )


def merge_points(points: Floats, tolerance: float) -> tuple[Floats, Ints]:
    """Distinct points (n, 3), in order of first appearance, and which of them each of the p points became."""
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    link = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    group = connected_components(link, directed=False)[1]
    _, first, group = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return points[first[order]], rank[group].astype(np.intp)


def _once(sides: Ints, length: Floats) -> tuple[Ints, Floats]:
    """Sides shared by two cells, kept once, in order of first appearance."""
    first = np.sort(np.unique(np.sort(sides, axis=1), axis=0, return_index=True)[1])
    return sides[first], length[first]


def _anticlockwise(points: Floats, nodes: Ints) -> Ints:
    """`nodes` sorted by polar angle in [-pi, pi)."""
    angle = np.arctan2(points[nodes, 1], points[nodes, 0])
    angle[angle > math.pi - 1e-9] -= 2.0 * math.pi
    return nodes[np.argsort(angle)]


def _numbered(case: Case, points: Floats, bullets: Ints) -> Ints:
    """Nodes of the bullets in the order of their numbers.

    The case format numbers the spokes, the rays of a honeycomb and the corners of an outline, from the x axis
    on; the corners of a rectangle it does not, they are taken as `Net` has them, from the lower left one on.
    """
    if not isinstance(case.shape, Hexagonal | Radial | Cut):
        return bullets
    angle = np.arctan2(points[bullets, 1], points[bullets, 0])
    angle[angle < -1e-9] += 2.0 * math.pi
    return bullets[np.argsort(angle)]


def _numbered_nodes(case: Case, points: Floats, tips: Ints) -> Ints:
    """Nodes with a number in the case format: those listed, or free ends of strings without bullets."""
    if isinstance(case.shape, Explicit):
        return np.arange(len(points))
    if case.strings is None or case.bullet_mass is not None:
        return tips[:0]
    return _numbered(case, points, tips)


def _listed(case: Case, shape: Explicit) -> tuple[Floats, list[_Family], Ints, Ints]:
    """Knots as listed, bullets on strings after them; sides thread by thread; tips of strings; corners."""
    knots = np.array(shape.nodes, dtype=float).reshape(-1, 3)
    sides = np.array(shape.elements, dtype=np.intp).reshape(-1, 2)
    length = np.linalg.norm(knots[sides[:, 1]] - knots[sides[:, 0]], axis=1)
    named = np.array(shape.threads or [""] * len(sides))
    families = [
        _Family(sides[named == name], length[named == name], cable, case.divisions)
        for name, cable in {"": case.cable, **case.threads}.items()
    ]
    corners = tips = np.array(shape.corners, dtype=np.intp)
    if case.strings is not None:
        reach, tips = case.strings.length, len(knots) + np.arange(len(corners))
        away = knots[corners]
        knots = np.concatenate((knots, away + reach * away / np.linalg.norm(away, axis=1)[:, None]))
        ties = np.column_stack((corners, tips))
        lengths = np.full(len(ties), reach)
        families.append(_Family(ties, lengths, case.strings.cable, case.strings.divisions, strings=True))
    return knots, families, tips, corners


@dataclass(frozen=True, eq=False)
class _Laid:
    """A net in loose segments: mesh, border and strings, these from corner knot to bullet; corners (k, 3)."""

    mesh: _Segments
    corners: Floats
    strings: _Segments | None
    border: _Segments | None = None


def _lay(case: Case) -> _Laid:
    """Outlines of all cells, or what a cut has left of them, and strings."""
    shape, reach, border = case.shape, 0.0 if case.strings is None else case.strings.length, None
    if isinstance(shape, Rectangular):
        mesh, corners, held, bullets = _rectangular(shape, reach)
    elif isinstance(shape, Hexagonal):
        mesh, corners, held, bullets = _hexagonal(shape, reach)
    elif isinstance(shape, Radial):
        mesh, corners, held, bullets = _radial(shape, reach)
    else:
        assert isinstance(shape, Cut)
        net = cut(shape)
        mesh = _Segments(_raised(net.mesh), net.mesh_length)
        border = _Segments(_raised(net.border), net.border_length)
        corners = held = _raised(net.corners)
        bullets = _outward(corners, reach)
    strings = _Segments(np.stack((held, bullets), axis=1), np.full(len(held), reach))
    return _Laid(mesh, corners, None if case.strings is None else strings, border)


def _raised(points: Floats) -> Floats:
    """Points (..., 3) in the plane z = 0 of (..., 2)."""
    return np.concatenate((points, np.zeros_like(points[..., :1])), axis=-1)


def _loops(corners: Floats, length: Floats) -> _Segments:
    """Closed outlines: corners (c, s, 3) of c cells with s sides of the lengths (c, s)."""
    return _Segments(
        np.stack((corners, np.roll(corners, -1, axis=1)), axis=2).reshape(-1, 2, 3), length.reshape(-1)
    )


def _outward(corners: Floats, reach: float) -> Floats:
    """Corners (k, 3) moved away from the origin by `reach` [m]."""
    radius = np.sqrt(corners[:, :1] * corners[:, :1] + corners[:, 1:2] * corners[:, 1:2])
    return np.asarray(corners + reach * (corners / radius))


def _rectangular(shape: Rectangular, reach: float) -> tuple[_Segments, Floats, Floats, Floats]:
    """Outlines, corners, string feet, string tips of a grid; positions are multiples of half a mesh."""
    half = np.array([shape.size[0] / shape.cells[0] / 2.0, shape.size[1] / shape.cells[1] / 2.0, 0.0])
    middles = np.stack(np.meshgrid(*(np.arange(1 - c, c, 2) for c in shape.cells), [0]), axis=-1).reshape(
        -1, 1, 3
    )
    around = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    outlines = (middles + around) * half
    length = np.broadcast_to(2.0 * half[[0, 1, 0, 1]], outlines.shape[:2])
    corners = around * np.array([shape.size[0] / 2.0, shape.size[1] / 2.0, 0.0])
    return _loops(outlines, length), corners, corners, _outward(corners, reach)


def _hexagonal(shape: Hexagonal, reach: float) -> tuple[_Segments, Floats, Floats, Floats]:
    """Outlines, corners, string feet, string tips of a honeycomb, the dual of the lattice of its cells.

    Each corner of a cell is the centroid of three middles next to one another.  In units of (√3/2, 1/2) a
    middles and corners are whole numbers.
    """
    rings, a = shape.rings, shape.mesh
    unit = np.array([math.sqrt(3.0) / 2.0 * a, 0.5 * a, 0.0])
    middles = np.array([place for ring in range(rings + 1) for place in _ring(ring)])
    around = np.array(_ring(1))  # the six neighbours, anticlockwise
    neighbours = middles[:, None, :] + around
    corners = (middles[:, None, :] + neighbours + np.roll(neighbours, -1, axis=1)) // 3
    outlines = np.concatenate((corners, np.zeros_like(corners[..., :1])), axis=-1) * unit
    feet, tips = [], []
    apothem = (rings + 0.5) * math.sqrt(3.0) * a
    for k in range(6):
        c, s = direction(k, 6)
        outer = apothem + math.sqrt(max(reach**2 - a**2 / 4.0, 0.0))
        for side in (-0.5 * a, 0.5 * a):
            feet.append((apothem * c - side * s, apothem * s + side * c, 0.0))
            tips.append((outer * c, outer * s, 0.0))
    return _loops(outlines, np.full(outlines.shape[:2], a)), np.array(feet), np.array(feet), np.array(tips)


def _ring(ring: int) -> list[tuple[int, int]]:
    """A walk round the middles of a ring of cells, anticlockwise from the x axis, `ring` steps a side."""
    if not ring:
        return [(0, 0)]
    x, y, places = 2 * ring, 0, []
    for dx, dy in ((-1, 3), (-2, 0), (-1, -3), (1, -3), (2, 0), (1, 3)):
        for _ in range(ring):
            places.append((x, y))
            x, y = x + dx, y + dy
    return places


def _radial(shape: Radial, reach: float) -> tuple[_Segments, Floats, Floats, Floats]:
    """Outlines, corners, string feet, string tips of a web: triangles at the hub, trapezia outside them."""
    rays = np.array([(*direction(k, shape.spokes), 0.0) for k in range(shape.spokes)])
    radii = shape.radius * np.arange(shape.rings + 1) / shape.rings
    right, left = rays, np.roll(rays, -1, axis=0)
    step, chord = shape.radius / shape.rings, 2.0 * math.sin(math.pi / shape.spokes)
    hub = np.stack((0.0 * right, radii[1] * right, radii[1] * left), axis=1)
    laid = [_loops(hub, np.tile([step, radii[1] * chord, step], (shape.spokes, 1)))]
    for inner, outer in pairwise(radii[1:]):
        cell = np.stack((inner * right, outer * right, outer * left, inner * left), axis=1)
        laid.append(_loops(cell, np.tile([step, outer * chord, step, inner * chord], (shape.spokes, 1))))
    outlines = _Segments(np.concatenate([s.ends for s in laid]), np.concatenate([s.length for s in laid]))
    corners = shape.radius * rays
    return outlines, corners, corners, (shape.radius + reach) * rays
