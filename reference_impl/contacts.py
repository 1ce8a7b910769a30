"""Threads, nodes and bullets that touch bodies: who may touch whom, and the forces across the surface.

Everything is seen from a body: places, relative velocities and forces in its axes, about its centre of mass,
so that its surface rests.  A thread is the straight line between two nodes; a node or a bullet is a point,
one line of no length.  What a line feels is shared by its ends as s and 1 - s, so that the forces at the
nodes are all that is needed: the body gets the opposite, at their places, with the same sum and moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from reference_impl.arrays import Bools, Floats, Ints, dot
from reference_impl.bodies import Bodies
from reference_impl.case import Case
from reference_impl.effects.contact import Contact
from reference_impl.net import Net, diameter
from reference_impl.quadrature import integrals, split
from reference_impl.rounded import Depth, Part, deepest, depth, part, touching

# Of the integrals along a thread (force on it and on its end j, N, its moment, stored, damped) the measures
# of their size: the elastic force with all that damping could add, and its power.
_MEASURE = np.array([10] * 8 + [8, 11, 10, 11], dtype=np.intp)
_ROUND_OFF = 4.0 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class Group:
    """q threads, nodes or bullets that may touch one body."""

    name: str  # of the body
    body: int  # which of the bodies
    parts: tuple[Part, ...]
    what: str  # "element", "node" or "bullet"
    i: Ints  # (q,) nodes; of points both are the same
    j: Ints
    number: Ints  # (q,) of the element, node or bullet
    radius: Floats  # (q,) [m]
    length: Floats  # (q,) reference length [m]; 1 of points
    factor: float  # F = factor p^power, per length of threads
    power: float
    stiffness: Floats  # k_t (q,) [N/m] along the surface
    lag: Floats  # theta (q,) [s]
    allowed: Floats  # (q,) greatest depth [m]
    first: int  # number of its first pair among all pairs

    def some(self, rows: Ints) -> Group:
        """Those of these rows."""
        keys = ("i", "j", "number", "radius", "length", "stiffness", "lag", "allowed")
        return replace(self, **{key: getattr(self, key)[rows] for key in keys})

    def at(self, s: Floats, values: Floats) -> Floats:
        """Values (q, 3) at places s (q,) of the lines, of those (n, 3) at the nodes."""
        return np.asarray((1.0 - s)[:, None] * values[self.i] + s[:, None] * values[self.j])

    def push(self, p: Floats) -> Floats:
        """F (...) [N/m], of points [N]."""
        return np.asarray(self.factor * p**self.power)

    def stored(self, p: Floats) -> Floats:
        """The integral of F over p (...) [N, N m]."""
        return np.asarray(self.factor / (self.power + 1.0) * p ** (self.power + 1.0))

    @property
    def threads(self) -> bool:
        """Whether they have a length."""
        return self.what == "element"


@dataclass(frozen=True, eq=False)
class Pressed:
    """The t lines of a group that touch, and what acts across the surface; in the axes of the body."""

    row: Ints  # (t,) in the group
    on_i: Floats  # (t, 3) [N]
    on_j: Floats  # (t, 3) [N]
    normal: Floats  # N (t,) [N]
    direction: Floats  # m (t, 3)
    s: Floats  # s_c (t,)
    stored: Floats  # (t,) [J]
    damped: Floats  # (t,) [W]


@dataclass(frozen=True, eq=False)
class Contacts:
    """All pairs of a system that may touch."""

    law: Contact
    groups: tuple[Group, ...]

    @property
    def pairs(self) -> int:
        """P."""
        return sum(len(group.i) for group in self.groups)

    @property
    def bristles(self) -> int:
        """For how many pairs friction may remember a direction: all, or none where it has no memory."""
        return self.pairs if self.law.sticks else 0

    def press(self, group: Group, x: Floats, w: Floats, rows: Ints) -> Pressed:
        """What acts across the surface on the lines `rows` of a group, nodes at x (n, 3) passing with w."""
        rows = rows[near(group.some(rows), x)]
        if not len(rows):
            none = np.zeros((0, 3))
            return Pressed(rows, none, none, none[:, 0], none, none[:, 0], none[:, 0], none[:, 0])
        lines = group.some(rows)
        return (self._threads if group.threads else self._points)(lines, x, w, rows)

    def _factor(self, rate: Floats) -> Floats:
        """max(1 + a p', 0)."""
        return np.asarray(np.maximum(1.0 + self.law.damping * rate, 0.0))

    def _points(self, group: Group, x: Floats, w: Floats, rows: Ints) -> Pressed:
        here = depth(group.parts, group.radius, x[group.i], w[group.i])
        elastic = group.push(here.p)
        force = elastic * self._factor(here.rate)
        # what moves away faster than it springs back has no force, but still loses what was stored
        lost, stored = (force - elastic) * here.rate, group.stored(here.p)
        on = force[:, None] * here.outwards
        found = Pressed(
            rows, on, np.zeros_like(on), force, _unit(here.outwards), np.zeros(len(rows)), stored, lost
        )
        return _some(found, here.p > 0.0)

    def _threads(self, group: Group, x: Floats, w: Floats, rows: Ints) -> Pressed:
        a = self.law.damping
        x0, w0 = x[group.i], w[group.i]
        along, change = x[group.j] - x0, w[group.j] - w0
        pieces = touching(group.parts, group.radius, x0, along)

        def look(line: Ints, s: Floats) -> tuple[Depth, Floats]:
            place = x0[line, None] + s[..., None] * along[line, None]
            moving = w0[line, None] + s[..., None] * change[line, None]
            return depth(group.parts, group.radius[line, None], place, moving), moving

        if a:
            fast = np.maximum(dot(w0, w0), dot(w[group.j], w[group.j]))
            steep = len(group.parts) ** 0.25  # above the norm of the shares of the parts
            may = (a * steep) ** 2 * fast[pieces.line] > 1.0
            if np.any(may):
                divided = split(lambda line, s: 1.0 + a * look(line, s)[0].rate, pieces.some(may))
                pieces = pieces.some(~may).joined(divided)

        def density(line: Ints, s: Floats) -> Floats:
            here, moving = look(line, s)
            p, rate = here.p, here.rate
            elastic = group.push(p)
            force = elastic * self._factor(rate)
            on = force[..., None] * here.outwards
            speed = np.sqrt(dot(moving, moving))
            most = elastic * (1.0 + a * speed)
            each = (force, s * force, group.stored(p), (force - elastic) * rate, most, most * speed)
            return np.concatenate((on, s[..., None] * on, np.stack(each, axis=-1)), axis=-1)

        # p is a difference of lengths, whose round-off is not small where p is
        lengths = np.sqrt(dot(x0, x0)) + np.sqrt(dot(along, along)) + group.radius
        middle = look(pieces.line, 0.5 * (pieces.begin + pieces.end)[:, None])[0].p[:, 0]
        deep = np.full(len(rows), np.finfo(float).tiny)
        np.maximum.at(deep, pieces.line, middle)
        blur = _ROUND_OFF * lengths / deep
        total = group.length[:, None] * integrals(density, pieces, len(rows), _MEASURE, blur)
        on_j, normal = total[:, 3:6], total[:, 6]
        on = total[:, :3]
        place = total[:, 7] / np.where(normal > 0.0, normal, np.inf)
        found = Pressed(rows, on - on_j, on_j, normal, _unit(on), place, total[:, 8], total[:, 9])
        return _some(found, total[:, 8] > 0.0)


def _unit(vector: Floats) -> Floats:
    size = np.sqrt(dot(vector, vector))
    return np.asarray(vector / np.where(size > 0.0, size, np.inf)[:, None])


def _some(found: Pressed, rows: Bools) -> Pressed:
    if np.all(rows):
        return found
    return Pressed(*(getattr(found, key)[rows] for key in found.__dataclass_fields__))


def gaps(group: Group, x: Floats) -> Floats:
    """Distances (q,) [m] of the lines from balls round the rounded parts, which touch not before these do."""
    x0, along = x[group.i], x[group.j] - x[group.i]
    squared = dot(along, along)
    gap = np.full(len(x0), np.inf)
    for core in group.parts:
        away = core.centre - x0
        s = np.clip(dot(away, along) / np.where(squared > 0.0, squared, np.inf), 0.0, 1.0)
        from_centre = away - s[:, None] * along
        distance = np.sqrt(dot(from_centre, from_centre))
        gap = np.minimum(gap, distance - core.girth - core.rounding - group.radius)
    return gap


def near(group: Group, x: Floats) -> Bools:
    """Which lines (q,) may touch the body at all; those of infinite or unknown place do not."""
    return np.asarray(gaps(group, x) < 0.0)


def depths(group: Group, x: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """The greatest depth (q,) [m] of each line, below zero where it is apart, and s (q,) there.

    -inf where the line is not of `rows`.  Far from the body the distance from balls round its parts.
    """
    deep, s = np.full(len(group.i), -np.inf), np.zeros(len(group.i))
    chosen = group.some(rows)
    deep[rows] = -gaps(chosen, x)
    close = rows[deep[rows] > 0.0]
    if len(close):
        lines = group.some(close)
        begin = x[lines.i]
        deep[close], s[close] = deepest(lines.parts, lines.radius, begin, x[lines.j] - begin)
    return deep, s


def pairs(case: Case, net: Net, bodies: Bodies) -> Contacts | None:
    """What may touch what in a case; None where nothing may.

    Nodes that are points of a body, and what ends in them, do not touch that body.
    """
    law = case.effects.contact
    if law is None:
        return None
    groups: list[Group] = []
    for what, names in (("element", law.threads), ("node", law.nodes), ("bullet", law.bullets)):
        groups += [_group(case, net, bodies, name, what) for name in names]
    first = 0
    for k, group in enumerate(groups):
        groups[k] = replace(group, first=first)
        first += len(group.i)
    return Contacts(law, tuple(groups))


def _group(case: Case, net: Net, bodies: Bodies, name: str, what: str) -> Group:
    law, number = case.effects.contact, bodies.names.index(name)
    assert law is not None
    body = case.bodies[number]
    parts = tuple(part(block, body.edge_radius, bodies.centre_of_mass[number]) for block in body.blocks)
    least = min(float(np.min(block.half)) for block in body.blocks)
    rounding = min(core.rounding for core in parts)
    attached = net.anchors.node[net.anchors.body == number]
    if what == "element":
        i, j = net.element_nodes.T
        radius, length = 0.5 * diameter(net), net.reference_length
        mass = net.density * net.area * length
        number_of = np.arange(len(i))
    else:
        own = np.arange(net.woven)
        i = j = net.numbered_bullets if what == "bullet" else own[~np.isin(own, net.bullet_nodes)]
        size = law.bullet_radius if what == "bullet" else law.node_radius
        radius, length = np.full(len(i), size), np.ones(len(i))
        mass = net.mass[i]
        number_of = np.arange(len(i)) if what == "bullet" else i
    factor, power, stiffness = _moduli(law, what)
    along = law.tangential_ratio * stiffness * length
    lag = 2.0 * law.tangential_damping * np.sqrt(mass / along)
    allowed = radius + min(0.5 * least, rounding)
    if what != "element":  # a large sphere may not come out on the other side
        allowed = np.minimum(allowed, 2.0 * least)
    whole = Group(
        name, number, parts, what, i, j, number_of, radius, length, factor, power, along, lag, allowed, 0
    )
    return whole.some(np.flatnonzero(~(np.isin(i, attached) | np.isin(j, attached))))


def _moduli(law: Contact, what: str) -> tuple[float, float, float]:
    """Factor and power of F, and what k_t is kappa times of: per length of threads."""
    if law.law == "linear":
        factor = {"element": law.stiffness, "node": law.node_stiffness, "bullet": law.bullet_stiffness}[what]
        assert factor is not None
        return factor, 1.0, factor
    assert law.modulus is not None
    if what == "element":
        factor = 0.25 * math.pi * law.modulus
        return factor, 1.0, factor
    radius = law.bullet_radius if what == "bullet" else law.node_radius
    assert radius is not None
    stiffness = 4.0 / 3.0 * law.modulus * radius
    return 4.0 / 3.0 * law.modulus * math.sqrt(radius), 1.5, stiffness
