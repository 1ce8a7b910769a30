"""Contact of two rigid bodies: corners, balls and edges of the one, pressed into the other's surface.

A body presses with what its core is made of: a ball with its middle, a capsule with its axis and both ends
of that, a box with its eight corners and twelve edges. Where two rounded boxes overlap, a corner or an edge
of one of them at least is nearer to the other's core than both roundings together, because the nearest points
of two polyhedra that do not meet are a corner and a face, or two edges. So nothing is missed, and forces are
continuous where the nearest points of two bodies are not: of face on face all corners and edges press that
lie on it. Each way is a term of its own, and a body that has nothing to press with has none. A ball and a
solid are counted once, by the ball, so that this is exact.
"""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.blocks import Blocks
from exunet.forces.contact.body_loops import (
    BODIES,
    add_body_contact,
    body_contact_potential,
    remember_body_contact,
)
from exunet.forces.contact.core_loops import DISTANCES, is_flat
from exunet.forces.contact.frame_loops import place_in_body, turn_into
from exunet.forces.contact.friction_loops import FRICTION
from exunet.forces.contact.impact import damping_rate, friction_rate, speed_of_bodies
from exunet.forces.contact.near_loops import remember_touch, remember_wrong, size_of
from exunet.forces.contact.status import OF_BODY, memory_of, untouched
from exunet.forces.contact.threads import Friction, gauss_rules
from exunet.forces.contact.touching_loops import TOUCHING
from exunet.forces.contact.trouble import trouble_of_bodies
from exunet.forces.cores import BOX, CAPSULE, SPHERE, Cores, Surface
from exunet.forces.terms import KernelTerm

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROW = 7  # numbers of a corner, ball or edge in the memory, see `body_loops`


class BodyLaw(NamedTuple):
    """F = k p^n of a corner or ball: k [N/m^n] by its radius, n; K of edges; damping a [s/m].

    stiffness : k [N/m] for n = 1, of every corner and ball; else k over the root of its radius
    modulus   : K [N/m2] of edges; None: k over the sum of both roundings
    """

    stiffness: float
    exponent: float
    modulus: float | None
    damping: float


class Frame(NamedTuple):
    """What a body presses with, in its principal axes from its centre of mass.

    corner    : (m, 3) corners, ends of axes and middles of balls [m]; thick : (m,) radius around each [m]
    is_ball   : (m,) 1.0 for balls, else 0.0
    edge      : (e, 2, 3) ends of edges [m]; thickness : (e,) radius around each [m]
    """

    corner: Floats
    thick: Floats
    is_ball: Floats
    edge: Floats
    thickness: Floats


class BodyContact(NamedTuple):
    """What of one body may press into another, this one's surface, the law and work space.

    corner, thick, is_ball, edge, thickness : as `Frame`
    spring   : (m,) k [N/m^n]; edge_stiffness : (e,) K L of edges of length L [N/m]
    along, relaxation : (m + e,) k_t [N/m] and theta [s] of friction, of corners and balls, then of edges
    ball_place, ball_radius : (b, 3), (b,) balls of the touched body, on which balls alone press
    kind, numbers, place, turn, rounding, boxes : as `Cores`, of its other solids
    reach, from_reach : radius of a ball about the centre of mass that has all of it: of the touched body, of
               the one that presses [m]
    allowed  : depth beyond which nothing may be [m]
    least    : half of the least thickness of both [m]
    centre, attitude, spin, from_centre, from_attitude, from_spin : where the entries of both begin
    taken    : where in force the rates of the energies that damping and friction take stand
    stiffness : 1.0, of what `touching_loops` integrates
    damping, exponent : a [s/m], n
    friction, slip_speed : as `exunet.forces.contact.threads.Friction`
    kept     : (ROW (m + e) + STATUS,) the memory
    after    : (m + e, ROW) what the memory would be after the state that was looked at last
    now      : (8,) of the state that was looked at last: largest depth [m], 0.0 where something touches, how
               many corners, balls and edges touch, bound of the speed of the bodies against each other [m/s],
               less than 0 where it is too deep, sum of the forces across the surface [N], how far the balls
               about the bodies are apart [m], energy stored [J]
    frame, from_frame, turned, shift, motion, total : work space, see `body_loops`
    lines, spans, splits, sums, rule : work space and Gauss's rules, see `span_loops`, `touching_loops`
    """

    corner: Floats
    thick: Floats
    is_ball: Floats
    edge: Floats
    thickness: Floats
    spring: Floats
    edge_stiffness: Floats
    along: Floats
    relaxation: Floats
    ball_place: Floats
    ball_radius: Floats
    kind: Ints
    numbers: Floats
    place: Floats
    turn: Floats
    rounding: Floats
    boxes: Floats
    reach: float
    from_reach: float
    allowed: float
    least: float
    centre: int
    attitude: int
    spin: int
    from_centre: int
    from_attitude: int
    from_spin: int
    taken: int
    stiffness: float
    damping: float
    exponent: float
    friction: float
    slip_speed: float
    kept: Floats
    after: Floats
    now: Floats
    frame: Floats
    from_frame: Floats
    turned: Floats
    shift: Floats
    motion: Floats
    total: Floats
    lines: Floats
    spans: Floats
    splits: Floats
    sums: Floats
    rule: Floats


def body_contact(
    blocks: Blocks, pair: tuple[str, str], law: BodyLaw, rubbing: Friction
) -> tuple[KernelTerm, ...]:
    """The terms of the contact of two bodies by name: what of each may press into the other."""
    first, second = pair
    found = []
    for presses, touched in (first, second), (second, first):
        of_balls = presses == first
        data = _contact_of(blocks, presses, touched, law, rubbing, of_balls)
        if len(data.thick) + len(data.thickness):
            found.append(_term(blocks, presses, touched, data, rubbing))
    return tuple(found)


def frame_of(cores: Cores) -> Frame:
    """What a body of these solids presses with; nothing of cylinders and frustums."""
    corners: list[tuple[Floats, float, float]] = []
    edges: list[tuple[Floats, Floats, float]] = []
    for kind, numbers, place, turn, radius in zip(*cores[:5], strict=True):
        if kind == SPHERE:
            corners.append((place, radius, 1.0))
        elif kind == CAPSULE:
            ends = [place + sign * numbers[0] * turn[:, 2] for sign in (-1.0, 1.0)]
            corners += [(end, radius, 0.0) for end in ends]
            edges.append((ends[0], ends[1], radius))
        elif kind == BOX:
            own, sides = _of_box(numbers)
            corners += [(place + turn @ corner, radius, 0.0) for corner in own]
            edges += [(place + turn @ a, place + turn @ b, radius) for a, b in sides]
    return Frame(
        np.array([one for one, _, _ in corners]).reshape(-1, 3),
        np.array([radius for _, radius, _ in corners], dtype=float),
        np.array([ball for _, _, ball in corners], dtype=float),
        np.array([(a, b) for a, b, _ in edges]).reshape(-1, 2, 3),
        np.array([radius for _, _, radius in edges], dtype=float),
    )


def _of_box(half: Floats) -> tuple[list[Floats], list[tuple[Floats, Floats]]]:
    """Corners and edges of a box, each once: one that is flat has fewer."""
    signs = [(-1.0, 1.0) if size > 0.0 else (0.0,) for size in half]
    corners = [half * np.array(one) for one in product(*signs)]
    edges = []
    for axis in range(3):
        if half[axis] > 0.0:
            way = np.where(np.arange(3) == axis, half, 0.0)
            others = [(0.0,) if k == axis else signs[k] for k in range(3)]
            edges += [(half * np.array(one) - way, half * np.array(one) + way) for one in product(*others)]
    return corners, edges


def _contact_of(
    blocks: Blocks, presses: str, touched: str, law: BodyLaw, rubbing: Friction, of_balls: bool
) -> BodyContact:
    """of_balls : balls press on balls this way"""
    mine, surface = blocks.surfaces[presses], blocks.surfaces[touched]
    balls = surface.cores.kind == SPHERE
    others = surface.cores.of(~balls)
    ball_place, ball_radius = (
        part[balls] if of_balls else part[:0] for part in (surface.cores.place, surface.cores.rounding)
    )
    frame = frame_of(mine.cores)
    rounding = float(others.rounding.min(initial=np.inf))
    if not len(others.kind):  # corners and edges have nothing to press on
        ball = frame.is_ball == 1.0
        few = ball if len(ball_radius) else np.zeros(len(ball), dtype=bool)
        none = np.zeros(0)
        frame = Frame(frame.corner[few], frame.thick[few], frame.is_ball[few], np.zeros((0, 2, 3)), none)
    springs, along = _springs(frame, law, _only_ball(mine), _only_ball(surface))
    edges = law.stiffness / (frame.thickness + rounding) if law.modulus is None else law.modulus
    number = len(others.kind)
    length = np.linalg.norm(frame.edge[:, 1] - frame.edge[:, 0], axis=1)
    along = rubbing.ratio * np.concatenate([along, edges * length])
    relaxation = 2.0 * rubbing.damping * np.sqrt(_reduced_mass(blocks, presses, touched) / along)
    parts = (*frame, springs, edges * length, along, relaxation, ball_place, ball_radius, *others.own)
    bounds = (_reach(surface), _reach(mine), surface.allowed + mine.allowed, min(surface.least, mine.least))
    entries = (*_entries(blocks, touched), *_entries(blocks, presses), blocks.rate("contact/damping"))
    laws = (1.0, law.damping, law.exponent, rubbing.friction, rubbing.slip_speed)
    rooms = (8, (3, 3), (3, 3), (3, 3), 3, 6, 6, (number, 6), (number, 2), 16 * number, 12)
    values: tuple[Any, ...] = (
        *(*parts, *bounds, *entries, *laws),
        untouched(np.zeros((len(along), ROW))),
        np.zeros((len(along), ROW)),
        *(np.zeros(room) for room in rooms),
        gauss_rules(2, 4, 8),
    )
    return BodyContact(*values)


def _entries(blocks: Blocks, body: str) -> tuple[int, int, int]:
    """Where the entries of a body begin: centre, attitude, spin."""
    return blocks.centre(body), blocks.attitude(body), blocks.spin(body)


def _only_ball(surface: Surface) -> float:
    """The radius [m] of a body that is one ball; 0.0 of others."""
    alone = len(surface.cores.kind) == 1 and surface.cores.kind[0] == SPHERE
    return float(surface.cores.rounding[0]) if alone else 0.0


def _springs(frame: Frame, law: BodyLaw, own: float, other: float) -> tuple[Floats, Floats]:
    """(m,) k [N/m^n], and (m,) [N/m] of what k_t is a part of.

    By Hertz's law of the radius, against a flat face but for two balls alone.
    """
    if law.exponent == 1.0:
        return np.full(len(frame.thick), law.stiffness), np.full(len(frame.thick), law.stiffness)
    curvature = 1.0 / frame.thick + (1.0 / other if own > 0.0 and other > 0.0 else 0.0)
    return np.asarray(law.stiffness / np.sqrt(curvature)), np.asarray(law.stiffness / curvature)


def _reduced_mass(blocks: Blocks, *names: str) -> float:
    """[kg] of those that move freely; 0.0: none does."""
    mass = [
        blocks.inertia.mass[blocks.free_bodies.index(name)] for name in names if name in blocks.free_bodies
    ]
    return float(1.0 / sum(1.0 / one for one in mass)) if mass else 0.0


def _reach(surface: Surface) -> float:
    """Radius of a ball about the centre of mass that has all of a body [m]."""
    return float(np.linalg.norm(surface.middle)) + surface.radius


def _term(blocks: Blocks, presses: str, touched: str, data: BodyContact, rubbing: Friction) -> KernelTerm:
    def wrong(values: Floats) -> str:
        return trouble_of_bodies(values, presses, touched, data.allowed, data.least)

    rate = _stiffness_rate(blocks, presses, touched, data)
    arms = _reach(blocks.surfaces[presses]), _reach(blocks.surfaces[touched])
    speed = speed_of_bodies(blocks, presses, touched, arms)
    return KernelTerm(
        f"{presses} and {touched}",
        add_body_contact,
        data,
        body_contact_potential,
        (*_HELPERS, *DISTANCES, is_flat, *TOUCHING, *BODIES),
        bodies=tuple(name for name in (touched, presses) if name in blocks.free_bodies),
        stiffness_rate=rate,
        damping_rate=damping_rate(data.damping, rate, speed, data.exponent),
        friction_rate=friction_rate(rubbing, rate, speed),
        memory=memory_of(f"{OF_BODY}{presses}", touched, data.kept, wrong),
        remember=remember_body_contact,
        internal=True,
    )


_HELPERS = (
    turn_into,
    place_in_body,
    *FRICTION,
    remember_touch,
    remember_wrong,
    size_of,
)


def steepest(data: BodyContact) -> tuple[Floats, Floats]:
    """(m,) the largest stiffness [N/m] of each corner or ball, and (e,) of each edge, on all of the other."""
    slope = data.spring * data.exponent * data.allowed ** (data.exponent - 1.0)
    length = np.linalg.norm(data.edge[:, 1] - data.edge[:, 0], axis=1)
    return slope, data.edge_stiffness * np.minimum(1.0, 2.0 * data.reach / length)


def _stiffness_rate(blocks: Blocks, presses: str, touched: str, data: BodyContact) -> float:
    """Bound [1/s2] of what contact adds to the eigenvalues, while nothing is too deep; as of threads.

    All corners and edges press at once; on the touched body where that is moved most easily.
    """
    slope, along = steepest(data)
    thick = np.concatenate([data.thick, data.thickness, data.thickness])
    places = _at_the_surface(np.concatenate([data.corner, data.edge[:, 0], data.edge[:, 1]]), thick)
    stiffness = np.concatenate([slope, 0.5 * along, 0.5 * along])
    total, rate = float(stiffness.sum()), 0.0
    if presses in blocks.free_bodies:
        rate += _fastest(blocks, presses, places, stiffness)
    if touched in blocks.free_bodies:
        boxes = blocks.surfaces[touched].cores.boxes
        low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        corners = product(*zip(low, high, strict=True))
        rate += max(_fastest(blocks, touched, np.array([one]), np.full(1, total)) for one in corners)
    return rate


def _at_the_surface(places: Floats, thick: Floats) -> Floats:
    """Places (n, 3) [m] as far from the centre as what is around them (n,) [m] reaches."""
    far = np.linalg.norm(places, axis=1, keepdims=True)
    outwards = np.divide(places, far, out=np.tile([0.0, 0.0, 1.0], (len(far), 1)), where=far > 0.0)
    return np.asarray(places + thick[:, None] * outwards)


def _fastest(blocks: Blocks, body: str, places: Floats, stiffness: Floats) -> float:
    """Largest eigenvalue [1/s2] of a free body that springs (n,) [N/m] hold at places (n, 3), all ways."""
    number = blocks.free_bodies.index(body)
    inertia = np.concatenate([np.full(3, blocks.inertia.mass[number]), blocks.inertia.moments[number]])
    held = np.zeros((6, 6))
    for place, k in zip(places, stiffness, strict=True):
        moves = np.concatenate([np.eye(3), np.cross(np.eye(3), place).T], axis=1)
        held += k * moves.T @ moves
    root = np.sqrt(inertia)
    return float(np.linalg.eigvalsh(held / np.outer(root, root))[-1])
