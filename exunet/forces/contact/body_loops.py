"""Contact of two bodies, as compiled loops: corners, balls and edges of one press into the other.

Both pairs of axes are brought together once: places, velocities and forces are worked out in the principal
axes of the body that is touched. A force acts on both bodies at one point, on the surface of the one and half
of the depth inside it, which is where friction rubs; across the surface it is the same for every point of the
line that it acts along. What is added up of all corners and edges is a force and its torque about the touched
body's centre, handed on to both bodies at the end.

Friction with memory is that of `friction_loops`, but for what is remembered. Since bodies roll on each other,
it is a point of each, at the end of every accepted step the place of the contact anew, shifted by what the
spring along the surface is stretched by then; with that memory the force is the same. A row of it: what is
remembered (0.0: nothing, 1.0: an anchor), the pressing body's point (3), the touched one's (3), each in its
own axes.
"""

from __future__ import annotations

from typing import Any

from exunet.forces.contact.blend_loops import deeper
from exunet.forces.contact.core_loops import core_gradient
from exunet.forces.contact.frame_loops import place_in_body, turn_into
from exunet.forces.contact.friction_loops import along_surface, friction, regularised_friction, shift_for
from exunet.forces.contact.near_loops import remember_touch, remember_wrong, size_of
from exunet.forces.contact.span_loops import find_spans
from exunet.forces.contact.touching_loops import touch


def add_body_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces and torques on both bodies."""
    now = c.now
    for m in range(now.size):
        now[m] = 0.0
    now[1] = -1.0
    for k in range(c.along.size):
        c.after[k, 0] = 0.0
    now[3] = closing_speed(v, c)
    now[6] = gap_of_balls(x, c)
    if now[6] >= 0.0:
        return
    bring_together(x, c)
    move_against(v, c)
    total = c.total
    for m in range(6):
        total[m] = 0.0
    for k in range(c.thick.size):
        press_corner(c, k, force)
    for k in range(c.thickness.size):
        press_edge(c, k, force)
    if now[2] > 0.0:
        hand_on(c, force)


def closing_speed(v: Any, c: Any) -> float:
    """Bound [m/s] of the speed of any two points of the bodies against each other."""
    d = v[c.from_centre] - v[c.centre]
    e = v[c.from_centre + 1] - v[c.centre + 1]
    f = v[c.from_centre + 2] - v[c.centre + 2]
    turns = c.from_reach * size_of((v[c.from_spin], v[c.from_spin + 1], v[c.from_spin + 2]))
    turns += c.reach * size_of((v[c.spin], v[c.spin + 1], v[c.spin + 2]))
    return size_of((d, e, f)) + turns


def gap_of_balls(x: Any, c: Any) -> float:
    """How far apart [m] balls about both centres of mass are, which have all of the bodies in them."""
    d = x[c.from_centre] - x[c.centre]
    e = x[c.from_centre + 1] - x[c.centre + 1]
    f = x[c.from_centre + 2] - x[c.centre + 2]
    return size_of((d, e, f)) - c.reach - c.from_reach


def bring_together(x: Any, c: Any) -> None:
    """The rotation from the pressing body's axes to the touched one's, and where its centre is there."""
    turn_into(x, c.attitude, c.frame)
    turn_into(x, c.from_attitude, c.from_frame)
    frame, other, turned = c.frame, c.from_frame, c.turned
    for i in range(3):
        for j in range(3):
            turned[i, j] = frame[0, i] * other[0, j] + frame[1, i] * other[1, j] + frame[2, i] * other[2, j]
    c.shift[0], c.shift[1], c.shift[2] = place_in_body(x, c.from_centre, c.centre, frame)


def move_against(v: Any, c: Any) -> None:
    """The motion against the touched body, in its axes, as u + o x p of what is at p: u, o into c.motion."""
    shift, motion = c.shift, c.motion
    d, e, f = place_in_body(v, c.from_centre, c.centre, c.frame)
    spin = turned_vector(c.turned, (v[c.from_spin], v[c.from_spin + 1], v[c.from_spin + 2]))
    p, q, r = cross(spin, (shift[0], shift[1], shift[2]))
    motion[0], motion[1], motion[2] = d - p, e - q, f - r
    for axis in range(3):
        motion[3 + axis] = spin[axis] - v[c.spin + axis]


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
    shift = c.shift
    p, q, r = turned_vector(c.turned, own)
    return shift[0] + p, shift[1] + q, shift[2] + r


def motion_at(c: Any, p: Any) -> Any:
    """Velocity (3) [m/s] of the pressing body's point at p (3) against that of the touched one there."""
    u = c.motion
    d, e, f = cross((u[3], u[4], u[5]), p)
    return u[0] + d, u[1] + e, u[2] + f


def depth_of_corner(c: Any, k: int, p: Any) -> Any:
    """Depth [m] of corner or ball k at p (3), and the direction (3) of the force.

    Of more solids as `touching_loops.depth_at`. Balls alone press on balls.
    """
    found = (0.0, 0.0, 0.0, 0.0)
    thick = c.thick[k]
    for n in range(c.kind.size):
        distance, d, e, f = core_gradient(c, n, p[0], p[1], p[2])
        found = deeper(found, c.rounding[n] + thick - distance, (d, e, f))
    if c.is_ball[k] == 1.0:
        for n in range(c.ball_radius.size):
            d = p[0] - c.ball_place[n, 0]
            e = p[1] - c.ball_place[n, 1]
            f = p[2] - c.ball_place[n, 2]
            size = max(size_of((d, e, f)), 1e-300)
            found = deeper(found, c.ball_radius[n] + thick - size, (d / size, e / size, f / size))
    return found


def press_corner(c: Any, k: int, force: Any) -> None:
    """What corner or ball k gives, into c.total."""
    p = place_of_body(c, c.corner[k])
    depth, d, e, f = depth_of_corner(c, k, p)
    if depth <= 0.0:
        return
    w = motion_at(c, p)
    rate = -(d * w[0] + e * w[1] + f * w[2])
    elastic = c.spring[k] * depth**c.exponent
    push = elastic * max(1.0 + c.damping * rate, 0.0)
    note(c, depth, push, elastic * depth / (c.exponent + 1.0))
    force[c.taken] += (push - elastic) * rate
    act(c, p, (push * d, push * e, push * f))
    size = size_of((d, e, f))
    rub(c, k, p, (d / size, e / size, f / size), push, c.thick[k] - 0.5 * depth, force)


def press_edge(c: Any, k: int, force: Any) -> None:
    """What edge k gives, into c.total."""
    a = place_of_body(c, c.edge[k, 0])
    b = place_of_body(c, c.edge[k, 1])
    thick = c.thickness[k]
    m, _ = find_spans(c, thick, a, b)
    sums, stiffness = c.sums, c.edge_stiffness[k]
    if m == 0 or not touch(c, thick, motion_at(c, a), motion_at(c, b), m, sums):
        return
    push = stiffness * sums[6]
    note(c, sums[10], push, stiffness * sums[9])
    force[c.taken] += stiffness * sums[8]
    on_b = (stiffness * sums[3], stiffness * sums[4], stiffness * sums[5])
    act(c, b, on_b)
    act(c, a, (stiffness * sums[0] - on_b[0], stiffness * sums[1] - on_b[1], stiffness * sums[2] - on_b[2]))
    size = size_of((sums[0], sums[1], sums[2]))
    if size > 0.0:
        at = sums[7] / sums[6]
        p = (a[0] + at * (b[0] - a[0]), a[1] + at * (b[1] - a[1]), a[2] + at * (b[2] - a[2]))
        n = (sums[0] / size, sums[1] / size, sums[2] / size)
        rub(c, c.thick.size + k, p, n, push, thick - 0.5 * sums[10], force)


def note(c: Any, depth: float, push: float, stored: float) -> None:
    """How deep [m] and how hard [N] one of them presses, and the energy that it stores [J]."""
    now = c.now
    now[2] += 1.0
    now[5] += push
    now[7] += stored
    if depth > now[0]:
        now[0] = depth
        now[1] = 0.0
    if depth > c.allowed:
        now[4] = -1.0


def act(c: Any, p: Any, f: Any) -> None:
    """Add a force (3) on the pressing body at p (3), and its torque about the touched body's centre."""
    total = c.total
    d, e, g = cross(p, f)
    total[0] += f[0]
    total[1] += f[1]
    total[2] += f[2]
    total[3] += d
    total[4] += e
    total[5] += g


def rub(c: Any, k: int, p: Any, n: Any, push: float, inwards: float, force: Any) -> None:
    """Friction of row k where `push` [N] acts along n (3): `inwards` [m] from p (3) against n."""
    if c.friction > 0.0:
        q = (p[0] - inwards * n[0], p[1] - inwards * n[1], p[2] - inwards * n[2])
        w = motion_at(c, q)
        f = regularised_friction(push, n, w, c) if c.slip_speed > 0.0 else hold(c, k, q, n, w, push)
        force[c.taken + 1] -= f[0] * w[0] + f[1] * w[1] + f[2] * w[2]
        act(c, q, f)


def hold(c: Any, k: int, q: Any, n: Any, w: Any, push: float) -> Any:
    """Friction (3) [N] with memory at q (3), where bodies slide at w (3) [m/s]; its next memory: the row."""
    kept, row, first = c.kept, c.after[k], 7 * k
    u = (0.0, 0.0, 0.0)
    if kept[first] == 1.0:
        a, b, d = place_of_body(c, kept[first + 1 : first + 4])
        u = (a - kept[first + 4], b - kept[first + 5], d - kept[first + 6])
    f, slides = friction(push, n, u, w, c.along[k], c.relaxation[k], c)
    u = shift_for(f, n, w, c.along[k], c.relaxation[k]) if slides else along_surface(n, u)
    row[0] = 1.0
    turned, shift = c.turned, c.shift
    for axis in range(3):
        row[1 + axis] = 0.0
        for m in range(3):
            row[1 + axis] += turned[m, axis] * (q[m] - shift[m])
        row[4 + axis] = q[axis] - u[axis]
    return f


def hand_on(c: Any, force: Any) -> None:
    """The sums of c.total to both bodies: opposite forces, and torques about each body's own centre."""
    total, shift, frame, turned = c.total, c.shift, c.frame, c.turned
    f = (total[0], total[1], total[2])
    d, e, g = cross((shift[0], shift[1], shift[2]), f)
    torque = (total[3] - d, total[4] - e, total[5] - g)
    for axis in range(3):
        own = frame[axis, 0] * f[0] + frame[axis, 1] * f[1] + frame[axis, 2] * f[2]
        force[c.from_centre + axis] += own
        force[c.centre + axis] -= own
        turns = turned[0, axis] * torque[0] + turned[1, axis] * torque[1] + turned[2, axis] * torque[2]
        force[c.from_spin + axis] += turns
        force[c.spin + axis] -= total[3 + axis]


def body_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surfaces."""
    if gap_of_balls(x, c) >= 0.0:
        return 0.0
    bring_together(x, c)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.thick.size):
        depth, _, _, _ = depth_of_corner(c, k, place_of_body(c, c.corner[k]))
        if depth > 0.0:
            total += c.spring[k] * depth ** (c.exponent + 1.0) / (c.exponent + 1.0)
    for k in range(c.thickness.size):
        a = place_of_body(c, c.edge[k, 0])
        b = place_of_body(c, c.edge[k, 1])
        m, _ = find_spans(c, c.thickness[k], a, b)
        if m > 0 and touch(c, c.thickness[k], rest, rest, m, c.sums):
            total += c.edge_stiffness[k] * c.sums[9]
    return total


def remember_body_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """What friction remembers, and the status, at the end of an accepted step.

    `add_body_contact` has looked at this state last.
    """
    kept, rows = c.kept, c.along.size
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
