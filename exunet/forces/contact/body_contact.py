"""Contact of two rigid bodies: corners, balls and edges of one body pressed into the surface of the other.

Both pairs of axes are brought together once: places, velocities and forces are worked out in the principal
axes of the body that is touched. A force acts on both bodies at one point, on the surface of the one and half
of the depth inside it, which is where friction rubs; across the surface it is the same for every point of the
line that it acts along. What is added up of all corners and edges is a force and its torque about the touched
body's centre, handed on to both bodies at the end.

Sticking friction is that of `law.friction`, but for what is remembered. Since bodies roll on each
other, it is a point of each, at the end of every accepted step the place of the contact anew, shifted by what
the spring along the surface is stretched by then; with that discrete state the force is the same. A row of
it: what is remembered (0.0: nothing, 1.0: an anchor), the pressing body's point (3), the touched one's (3),
each in its own axes.

A body presses with what its core is made of: a ball with its middle, a capsule with its axis and both ends
of that, a box with its eight corners and twelve edges. Where two rounded boxes overlap, a corner or an edge
of one of them at least is nearer to the other's core than both roundings together, because the nearest points
of two polyhedra that do not meet are a corner and a face, or two edges. So nothing is missed, and forces are
continuous where the nearest points of two bodies are not: of face on face all corners and edges press that
lie on it. Each way is a separate term; a body that has nothing to press with gets no term. A ball and a
solid are counted once, by the ball, so that this is exact.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.forces.blocks import Blocks
from exunet.forces.contact.broad_phase import (
    RESULTANT,
    begin_resultant,
    end_resultant,
    remember_touch,
    remember_wrong,
    size_of,
)
from exunet.forces.contact.estimate import damping_rate, friction_rate, speed_of_bodies
from exunet.forces.contact.law import (
    FRICTION,
    ContactLaw,
    along_surface,
    friction,
    regularised_friction,
    shift_for,
)
from exunet.forces.contact.segment_surface import TOUCHING, find_spans, touch
from exunet.forces.contact.signed_distance import (
    DISTANCES,
    core_gradient,
    deeper,
    is_flat,
    place_in_body,
    turn_into,
)
from exunet.forces.contact.status import discrete_state_of, trouble_of_bodies, untouched
from exunet.forces.contact.thread_contact import Friction, gauss_rules
from exunet.forces.cores import BOX, CAPSULE, SPHERE, Cores, Surface
from exunet.forces.terms import KernelTerm


def add_body_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces and torques on both bodies."""
    now = c.now
    for m in range(now.size):
        now[m] = 0.0
    now[1] = -1.0
    for k in range(c.springs.along.size):
        c.after[k, 0] = 0.0
    now[3] = closing_speed(v, c)
    now[6] = gap_of_balls(x, c)
    if now[6] >= 0.0:
        return
    bring_together(x, c)
    move_against(v, c)
    total = c.work.total
    for m in range(6):
        total[m] = 0.0
    for k in range(c.presses.thick.size):
        press_corner(c, k, force)
    for k in range(c.presses.thickness.size):
        press_edge(c, k, force)
    if now[2] > 0.0:
        begin_resultant(c, force)
        hand_on(c, force)
        end_resultant(c, force)


def closing_speed(v: Any, c: Any) -> float:
    """Bound [m/s] of the speed of any two points of the bodies against each other."""
    d = v[c.pressing.centre] - v[c.body.centre]
    e = v[c.pressing.centre + 1] - v[c.body.centre + 1]
    f = v[c.pressing.centre + 2] - v[c.body.centre + 2]
    turns = c.pressing.reach * size_of((v[c.pressing.spin], v[c.pressing.spin + 1], v[c.pressing.spin + 2]))
    turns += c.body.reach * size_of((v[c.body.spin], v[c.body.spin + 1], v[c.body.spin + 2]))
    return size_of((d, e, f)) + turns


def gap_of_balls(x: Any, c: Any) -> float:
    """How far apart [m] balls about both centres of mass are, which have all of the bodies in them."""
    d = x[c.pressing.centre] - x[c.body.centre]
    e = x[c.pressing.centre + 1] - x[c.body.centre + 1]
    f = x[c.pressing.centre + 2] - x[c.body.centre + 2]
    return size_of((d, e, f)) - c.body.reach - c.pressing.reach


def bring_together(x: Any, c: Any) -> None:
    """The rotation from the pressing body's axes to the touched one's, and where its centre is there."""
    turn_into(x, c.body.attitude, c.work.frame)
    turn_into(x, c.pressing.attitude, c.work.from_frame)
    frame, other, turned = c.work.frame, c.work.from_frame, c.work.turned
    for i in range(3):
        for j in range(3):
            turned[i, j] = frame[0, i] * other[0, j] + frame[1, i] * other[1, j] + frame[2, i] * other[2, j]
    shift = c.work.shift
    shift[0], shift[1], shift[2] = place_in_body(x, c.pressing.centre, c.body.centre, frame)


def move_against(v: Any, c: Any) -> None:
    """The motion against the touched body, in its axes, as u + o x p of what is at p: u, o into `motion`."""
    shift, motion = c.work.shift, c.work.motion
    d, e, f = place_in_body(v, c.pressing.centre, c.body.centre, c.work.frame)
    spin = turned_vector(c.work.turned, (v[c.pressing.spin], v[c.pressing.spin + 1], v[c.pressing.spin + 2]))
    p, q, r = cross(spin, (shift[0], shift[1], shift[2]))
    motion[0], motion[1], motion[2] = d - p, e - q, f - r
    for axis in range(3):
        motion[3 + axis] = spin[axis] - v[c.body.spin + axis]


def turned_vector(turn: Any, a: Any) -> Any:
    """turn a, of a vector (3)."""
    return (
        turn[0, 0] * a[0] + turn[0, 1] * a[1] + turn[0, 2] * a[2],
        turn[1, 0] * a[0] + turn[1, 1] * a[1] + turn[1, 2] * a[2],
        turn[2, 0] * a[0] + turn[2, 1] * a[1] + turn[2, 2] * a[2],
    )


def cross(a: Any, b: Any) -> Any:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def place_of_body(c: Any, own: Any) -> Any:
    """A place (3) in the pressing body's axes in those of the touched one."""
    shift = c.work.shift
    p, q, r = turned_vector(c.work.turned, own)
    return shift[0] + p, shift[1] + q, shift[2] + r


def motion_at(c: Any, p: Any) -> Any:
    """Velocity (3) [m/s] of the pressing body's point at p (3) against that of the touched one there."""
    u = c.work.motion
    d, e, f = cross((u[3], u[4], u[5]), p)
    return u[0] + d, u[1] + e, u[2] + f


def depth_of_corner(c: Any, k: int, p: Any) -> Any:
    """Depth [m] of corner or ball k at p (3), and the direction (3) of the force.

    Of more solids as `segment_surface.depth_at`. Balls alone press on balls.
    """
    found = (0.0, 0.0, 0.0, 0.0)
    thick = c.presses.thick[k]
    for n in range(c.cores.kind.size):
        distance, d, e, f = core_gradient(c.cores, n, p[0], p[1], p[2])
        found = deeper(found, c.cores.rounding[n] + thick - distance, (d, e, f))
    if c.presses.is_ball[k] == 1.0:
        for n in range(c.balls.radius.size):
            d = p[0] - c.balls.place[n, 0]
            e = p[1] - c.balls.place[n, 1]
            f = p[2] - c.balls.place[n, 2]
            size = max(size_of((d, e, f)), 1e-300)
            found = deeper(found, c.balls.radius[n] + thick - size, (d / size, e / size, f / size))
    return found


def press_corner(c: Any, k: int, force: Any) -> None:
    """Add the force of corner or ball k to c.work.total."""
    p = place_of_body(c, c.presses.corner[k])
    depth, d, e, f = depth_of_corner(c, k, p)
    if depth <= 0.0:
        return
    w = motion_at(c, p)
    rate = -(d * w[0] + e * w[1] + f * w[2])
    elastic = c.springs.corner[k] * depth**c.law.exponent
    normal_force = elastic * max(1.0 + c.law.damping * rate, 0.0)
    note(c, depth, normal_force, elastic * depth / (c.law.exponent + 1.0))
    force[c.taken] += (normal_force - elastic) * rate
    act(c, p, (normal_force * d, normal_force * e, normal_force * f))
    size = size_of((d, e, f))
    rub(c, k, p, (d / size, e / size, f / size), normal_force, c.presses.thick[k] - 0.5 * depth, force)


def press_edge(c: Any, k: int, force: Any) -> None:
    """Add the force of edge k to c.work.total."""
    a = place_of_body(c, c.presses.edge[k, 0])
    b = place_of_body(c, c.presses.edge[k, 1])
    thick = c.presses.thickness[k]
    m, _ = find_spans(c, thick, a, b)
    sums, stiffness = c.work.sums, c.springs.edge[k]
    if m == 0 or not touch(c, thick, motion_at(c, a), motion_at(c, b), m, sums):
        return
    normal_force = stiffness * sums[6]
    note(c, sums[10], normal_force, stiffness * sums[9])
    force[c.taken] += stiffness * sums[8]
    on_b = (stiffness * sums[3], stiffness * sums[4], stiffness * sums[5])
    act(c, b, on_b)
    act(c, a, (stiffness * sums[0] - on_b[0], stiffness * sums[1] - on_b[1], stiffness * sums[2] - on_b[2]))
    size = size_of((sums[0], sums[1], sums[2]))
    if size > 0.0:
        at = sums[7] / sums[6]
        p = (a[0] + at * (b[0] - a[0]), a[1] + at * (b[1] - a[1]), a[2] + at * (b[2] - a[2]))
        n = (sums[0] / size, sums[1] / size, sums[2] / size)
        rub(c, c.presses.thick.size + k, p, n, normal_force, thick - 0.5 * sums[10], force)


def note(c: Any, depth: float, normal_force: float, stored: float) -> None:
    """How deep [m] and how hard [N] one of them presses, and the energy that it stores [J]."""
    now = c.now
    now[2] += 1.0
    now[5] += normal_force
    now[7] += stored
    if depth > now[0]:
        now[0] = depth
        now[1] = 0.0
    if depth > c.allowed:
        now[4] = -1.0


def act(c: Any, p: Any, f: Any) -> None:
    """Add a force (3) on the pressing body at p (3), and its torque about the touched body's centre."""
    total = c.work.total
    d, e, g = cross(p, f)
    total[0] += f[0]
    total[1] += f[1]
    total[2] += f[2]
    total[3] += d
    total[4] += e
    total[5] += g


def rub(c: Any, k: int, p: Any, n: Any, normal_force: float, inwards: float, force: Any) -> None:
    """Friction of row k where `normal_force` [N] acts along n (3): `inwards` [m] from p (3) against n."""
    if c.law.friction > 0.0:
        q = (p[0] - inwards * n[0], p[1] - inwards * n[1], p[2] - inwards * n[2])
        w = motion_at(c, q)
        f = (
            regularised_friction(normal_force, n, w, c.law)
            if c.law.slip_speed > 0.0
            else hold(c, k, q, n, w, normal_force)
        )
        force[c.taken + 1] -= f[0] * w[0] + f[1] * w[1] + f[2] * w[2]
        act(c, q, f)


def hold(c: Any, k: int, q: Any, n: Any, w: Any, normal_force: float) -> Any:
    """Sticking friction (3) [N] at q (3), where bodies slide at w (3) [m/s]; the next discrete state: row."""
    kept, row, first = c.kept, c.after[k], 7 * k
    u = (0.0, 0.0, 0.0)
    if kept[first] == 1.0:
        a, b, d = place_of_body(c, kept[first + 1 : first + 4])
        u = (a - kept[first + 4], b - kept[first + 5], d - kept[first + 6])
    f, slides = friction(normal_force, n, u, w, c.springs.along[k], c.springs.relaxation[k], c.law)
    u = shift_for(f, n, w, c.springs.along[k], c.springs.relaxation[k]) if slides else along_surface(n, u)
    row[0] = 1.0
    turned, shift = c.work.turned, c.work.shift
    for axis in range(3):
        row[1 + axis] = 0.0
        for m in range(3):
            row[1 + axis] += turned[m, axis] * (q[m] - shift[m])
        row[4 + axis] = q[axis] - u[axis]
    return f


def hand_on(c: Any, force: Any) -> None:
    """The sums of c.work.total to both bodies: opposite forces, and torques about each body's own centre."""
    total, shift, frame, turned = c.work.total, c.work.shift, c.work.frame, c.work.turned
    f = (total[0], total[1], total[2])
    d, e, g = cross((shift[0], shift[1], shift[2]), f)
    torque = (total[3] - d, total[4] - e, total[5] - g)
    for axis in range(3):
        own = frame[axis, 0] * f[0] + frame[axis, 1] * f[1] + frame[axis, 2] * f[2]
        force[c.pressing.centre + axis] += own
        force[c.body.centre + axis] -= own
        turns = turned[0, axis] * torque[0] + turned[1, axis] * torque[1] + turned[2, axis] * torque[2]
        force[c.pressing.spin + axis] += turns
        force[c.body.spin + axis] -= total[3 + axis]


def body_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surfaces."""
    if gap_of_balls(x, c) >= 0.0:
        return 0.0
    bring_together(x, c)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.presses.thick.size):
        depth, _, _, _ = depth_of_corner(c, k, place_of_body(c, c.presses.corner[k]))
        if depth > 0.0:
            total += c.springs.corner[k] * depth ** (c.law.exponent + 1.0) / (c.law.exponent + 1.0)
    for k in range(c.presses.thickness.size):
        a = place_of_body(c, c.presses.edge[k, 0])
        b = place_of_body(c, c.presses.edge[k, 1])
        m, _ = find_spans(c, c.presses.thickness[k], a, b)
        if m > 0 and touch(c, c.presses.thickness[k], rest, rest, m, c.work.sums):
            total += c.springs.edge[k] * c.work.sums[9]
    return total


def remember_body_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """Store the discrete state of friction, and the status, at the end of an accepted step.

    `add_body_contact` has evaluated this state last.
    """
    kept, rows = c.kept, c.springs.along.size
    for k in range(rows):
        row = c.after[k]
        for m in range(7):
            kept[7 * k + m] = row[m] if row[0] == 1.0 else 0.0
    now, status = c.now, kept[7 * rows :]
    way = now[3] * (t - status[8])
    remember_touch(t, now, status)
    unseen = way > c.least and way > now[6]
    remember_wrong(t, 1.0 if now[4] < 0.0 else 2.0 if unseen else 0.0, 0.0, status)


BODIES = (
    closing_speed,
    gap_of_balls,
    bring_together,
    move_against,
    turned_vector,
    cross,
    place_of_body,
    motion_at,
    depth_of_corner,
    press_corner,
    press_edge,
    note,
    act,
    rub,
    hold,
    hand_on,
)


ROW = 7  # numbers of a corner, ball or edge in the discrete state, see `hold`


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
    """Corners, balls and edges by which a body presses, in its principal axes from its centre of mass.

    corner    : (m, 3) corners, ends of axes and middles of balls [m]; thick : (m,) radius around each [m]
    is_ball   : (m,) 1.0 for balls, else 0.0
    edge      : (e, 2, 3) ends of edges [m]; thickness : (e,) radius around each [m]
    """

    corner: Floats
    thick: Floats
    is_ball: Floats
    edge: Floats
    thickness: Floats


class Springs(NamedTuple):
    """Springs of what presses.

    corner : (m,) k [N/m^n] of corners and balls
    edge   : (e,) K L of edges of length L [N/m]
    along, relaxation : (m + e,) k_t [N/m] and theta [s] of friction, of corners and balls, then of edges
    """

    corner: Floats
    edge: Floats
    along: Floats
    relaxation: Floats


class TouchedBalls(NamedTuple):
    """Balls of the touched body, on which balls alone press: place (b, 3), radius (b,) [m]."""

    place: Floats
    radius: Floats


class Partner(NamedTuple):
    """A body of a pair.

    reach : radius of a ball about the centre of mass that has all of it [m]
    centre, attitude, spin : where its entries begin, see `exunet.forces.blocks`
    """

    reach: float
    centre: int
    attitude: int
    spin: int


class BodyWorkspace(NamedTuple):
    """Work space of the contact of two bodies, and Gauss's rules.

    frame, from_frame : (3, 3) rotations of the touched body and of the pressing one
    turned, shift : see `bring_together`; motion : see `move_against`
    total    : (6,) force and torque, see `act`
    lines, spans, splits, sums, rule : as of threads
    """

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


class BodyContact(NamedTuple):
    """Pressing corners and edges of one body, the touched surface of another, the law and work space.

    presses  : what presses
    cores    : of the touched body, without balls
    body, pressing : the touched body, and the one that presses
    allowed  : depth beyond which nothing may be [m]
    least    : half of the least thickness of both [m]
    taken    : where in force the rates of the energies that damping and friction take stand
    kept     : (ROW (m + e) + STATUS,) the discrete state
    after    : (m + e, ROW) what the discrete state would be after the state that was evaluated last
    now      : (14,) of the state that was evaluated last: largest depth [m], 0.0 where something touches, how
               many corners, balls and edges touch, bound of the speed of the bodies against each other [m/s],
               less than 0 where it is too deep, sum of the forces across the surface [N], how far the balls
               about the bodies are apart [m], energy stored [J]; force and torque as of `Status` [N], [N m]
    """

    presses: Frame
    springs: Springs
    balls: TouchedBalls
    cores: Cores
    body: Partner
    pressing: Partner
    allowed: float
    least: float
    law: ContactLaw
    taken: int
    kept: Floats
    after: Floats
    now: Floats
    work: BodyWorkspace


def body_contact(
    blocks: Blocks, pair: tuple[str, str], law: BodyLaw, rubbing: Friction
) -> tuple[KernelTerm, ...]:
    """The terms of the contact of two bodies by name: what of each may press into the other."""
    first, second = pair
    found = []
    for presses, touched in (first, second), (second, first):
        of_balls = presses == first
        data = _contact_of(blocks, presses, touched, law, rubbing, of_balls)
        if len(data.presses.thick) + len(data.presses.thickness):
            found.append(_term(blocks, presses, touched, data, rubbing))
    return tuple(found)


def frame_of(cores: Cores) -> Frame:
    """Collect the pressing corners, balls and edges of solids; cylinders and frustums add nothing."""
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
    corners = [half * np.array(item) for item in product(*signs)]
    edges = []
    for axis in range(3):
        if half[axis] > 0.0:
            way = np.where(np.arange(3) == axis, half, 0.0)
            others = [(0.0,) if k == axis else signs[k] for k in range(3)]
            edges += [
                (half * np.array(entry) - way, half * np.array(entry) + way) for entry in product(*others)
            ]
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
    work = BodyWorkspace(
        frame=np.zeros((3, 3)),
        from_frame=np.zeros((3, 3)),
        turned=np.zeros((3, 3)),
        shift=np.zeros(3),
        motion=np.zeros(6),
        total=np.zeros(6),
        lines=np.zeros((number, 6)),
        spans=np.zeros((number, 2)),
        splits=np.zeros(16 * number),
        sums=np.zeros(12),
        rule=gauss_rules(2, 4, 8),
    )
    return BodyContact(
        presses=frame,
        springs=Springs(springs, edges * length, along, relaxation),
        balls=TouchedBalls(ball_place, ball_radius),
        cores=others,
        body=_partner(blocks, touched),
        pressing=_partner(blocks, presses),
        allowed=surface.allowed + mine.allowed,
        least=min(surface.least, mine.least),
        law=ContactLaw(1.0, law.damping, law.exponent, rubbing.friction, rubbing.slip_speed),
        taken=blocks.rate("contact/damping"),
        kept=untouched(np.zeros((len(along), ROW))),
        after=np.zeros((len(along), ROW)),
        now=np.zeros(14),
        work=work,
    )


def _partner(blocks: Blocks, body: str) -> Partner:
    reach = _reach(blocks.surfaces[body])
    return Partner(reach, blocks.centre(body), blocks.attitude(body), blocks.spin(body))


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
    return float(1.0 / sum(1.0 / item for item in mass)) if mass else 0.0


def _reach(surface: Surface) -> float:
    """Radius of a ball about the centre of mass that has all of a body [m]."""
    return float(np.linalg.norm(surface.middle)) + surface.radius


def _term(blocks: Blocks, presses: str, touched: str, data: BodyContact, rubbing: Friction) -> KernelTerm:
    shown: Any = {"presses": presses, "touched": touched, "allowed": data.allowed, "least": data.least}
    wrong = partial(trouble_of_bodies, **shown)
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
        damping_rate=damping_rate(data.law.damping, rate, speed, data.law.exponent),
        friction_rate=friction_rate(rubbing, rate, speed),
        discrete=discrete_state_of(presses, touched, data.kept, wrong, of_bodies=True),
        remember=remember_body_contact,
        internal=True,
    )


_HELPERS = (
    turn_into,
    place_in_body,
    *FRICTION,
    *RESULTANT,
    remember_touch,
    remember_wrong,
    size_of,
)


def steepest(data: BodyContact) -> tuple[Floats, Floats]:
    """(m,) the largest stiffness [N/m] of each corner or ball, and (e,) of each edge, on all of the other."""
    slope = data.springs.corner * data.law.exponent * data.allowed ** (data.law.exponent - 1.0)
    length = np.linalg.norm(data.presses.edge[:, 1] - data.presses.edge[:, 0], axis=1)
    return slope, data.springs.edge * np.minimum(1.0, 2.0 * data.body.reach / length)


def _stiffness_rate(blocks: Blocks, presses: str, touched: str, data: BodyContact) -> float:
    """Bound [1/s2] of what contact adds to the eigenvalues, while nothing is too deep; as of threads.

    All corners and edges press at once; on the touched body where that is moved most easily.
    """
    slope, along = steepest(data)
    thick = np.concatenate([data.presses.thick, data.presses.thickness, data.presses.thickness])
    places = _at_the_surface(
        np.concatenate([data.presses.corner, data.presses.edge[:, 0], data.presses.edge[:, 1]]), thick
    )
    stiffness = np.concatenate([slope, 0.5 * along, 0.5 * along])
    total, rate = float(stiffness.sum()), 0.0
    if presses in blocks.free_bodies:
        rate += _fastest(blocks, presses, places, stiffness)
    if touched in blocks.free_bodies:
        boxes = blocks.surfaces[touched].cores.boxes
        low, high = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        corners = product(*zip(low, high, strict=True))
        rate += max(_fastest(blocks, touched, np.array([corner]), np.full(1, total)) for corner in corners)
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
