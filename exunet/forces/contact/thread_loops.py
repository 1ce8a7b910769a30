"""What contact of threads does wherever their forces come from, as compiled loops."""

from __future__ import annotations

import math
from typing import Any

from exunet.forces.contact.frame_loops import place_in_body, push_point, turn_into, velocity_against_body
from exunet.forces.contact.friction_loops import friction, regularised_friction, shift_for
from exunet.forces.contact.near_loops import choose_near, is_near, keep_row, remember_status


def places_now(t: float, x: Any, v: Any, c: Any) -> int:
    """How many pairs are to be looked at; the places of their nodes in the body's axes are in c.own then."""
    if not is_near(t, c):
        choose_near(t, x, v, c)
    now = c.now
    now[0] = 0.0
    now[1] = -1.0
    now[2] = 0.0
    now[5] = 0.0
    now[7] = 0.0
    now[4] = max(now[4], 0.0)  # an attempt that was rejected may have been too deep
    number = int(c.look[0])
    now[3] = c.look[3] if number > 0 else 0.0
    now[6] = c.look[5]
    if number == 0:
        return 0
    turn_into(x, c.attitude, c.frame)
    own = c.own
    for one in range(int(c.look[4])):
        i = c.near_nodes[one]
        own[i], own[i + 1], own[i + 2] = place_in_body(x, i, c.centre, c.frame)
    return number


def ends_now(c: Any, k: int) -> Any:
    """Where the ends of the pair k are, (3) each in the body's axes [m], once `places_now` has found them."""
    i = c.first[k]
    j = c.second[k]
    own = c.own
    return (own[i], own[i + 1], own[i + 2]), (own[j], own[j + 1], own[j + 2])


def ends_at(x: Any, c: Any, k: int) -> Any:
    """As `ends_now`, of any state; c.frame is the body's there."""
    a = place_in_body(x, c.first[k], c.centre, c.frame)
    return a, place_in_body(x, c.second[k], c.centre, c.frame)


def speeds_now(v: Any, c: Any, k: int, a: Any, b: Any) -> Any:
    """Velocities of the ends of the pair k, which are at a and b, against the body, (3) each [m/s]."""
    w_a = velocity_against_body(v, c.first[k], c.centre, c.spin, c.frame, a)
    return w_a, velocity_against_body(v, c.second[k], c.centre, c.spin, c.frame, b)


def is_clear(c: Any, k: int, a: Any, b: Any) -> bool:
    """True if no end of the pair k has moved as far as this was from the surface: it cannot touch.

    This follows from the places alone, so that neither the past nor a restart changes a bit of the forces;
    its row in `after` is that of one that does not touch.
    """
    clear = c.clear[k]
    if clear <= 0.0:
        return False
    seen = c.seen[k]
    p = a[0] - seen[0]
    q = a[1] - seen[1]
    r = a[2] - seen[2]
    f = b[0] - seen[3]
    g = b[1] - seen[4]
    h = b[2] - seen[5]
    return max(p * p + q * q + r * r, f * f + g * g + h * h) < clear * clear


def keep_clear(c: Any, k: int, a: Any, b: Any, clear: float) -> None:
    """Remember how far from the surface the pair k is at least [m], less what round-off may change.

    What it would leave in the memory is that of one that does not touch, until it is pushed.
    """
    c.after[k, 0] = 0.0
    c.clear[k] = clear - 1e-9 * c.radius
    seen = c.seen[k]
    seen[0], seen[1], seen[2] = a
    seen[3], seen[4], seen[5] = b


def push_thread(c: Any, k: int, force: Any, a: Any, b: Any, w_a: Any, w_b: Any, holds: bool) -> None:
    """Forces of the pair k, whose integrals over where it touches are in c.sums.

    a, b     : (3) where its ends are in the body's axes [m]
    w_a, w_b : (3) their velocities against the body's points there [m/s]
    holds    : False if its anchor is at a place of the thread that does not touch any more
    """
    i = c.first[k]
    j = c.second[k]
    sums = c.sums
    held = min(c.kept[5 * k], 0.0)
    c.after[k, 0] = held
    if held < 0.0:
        return
    c.now[2] += 1.0
    c.now[5] += c.length[k] * sums[6]
    c.now[7] += c.length[k] * sums[9]
    if sums[10] > c.now[0]:
        c.now[0] = sums[10]
        c.now[1] = k
    if sums[10] > c.allowed + c.thick[k]:
        c.now[4] = -1.0 - k
    length = c.length[k]
    on_b = (length * sums[3], length * sums[4], length * sums[5])
    on_a = (length * sums[0] - on_b[0], length * sums[1] - on_b[1], length * sums[2] - on_b[2])
    force[c.taken] += length * sums[8]
    if c.friction > 0.0:
        size = math.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
        rub = (0.0, 0.0, 0.0)
        at = 0.0
        if size > 0.0:
            at = sums[7] / sums[6]
            n = (sums[0] / size, sums[1] / size, sums[2] / size)
            push = length * sums[6]
            if c.slip_speed > 0.0:
                w = between(w_a, w_b, at)
                rub = regularised_friction(push, n, w, c)
            else:
                rub, at = rub_with_memory(c, k, (push, n), (a, b), (w_a, w_b), at, holds)
            w = between(w_a, w_b, at)
            force[c.taken + 1] -= rub[0] * w[0] + rub[1] * w[1] + rub[2] * w[2]
            on_a = along(on_a, rub, 1.0 - at)
            on_b = along(on_b, rub, at)
    push_point(force, i, c.centre, c.spin, c.frame, a, on_a)
    push_point(force, j, c.centre, c.spin, c.frame, b, on_b)


def rub_with_memory(c: Any, k: int, normal: Any, ends: Any, speeds: Any, middle: float, holds: bool) -> Any:
    """Friction (3) [N] of a pair, and where on the thread it acts; its next memory into c.after.

    normal : size of the force across the surface [N], and its direction (3); middle : where it acts
    ends, speeds : as `ends_now` and `speeds_now` give them; holds : as of `push_thread`
    """
    push, n = normal
    a, b = ends
    w_a, w_b = speeds
    kept = c.kept
    row = c.after[k]
    first = 5 * k
    here = between(a, b, middle)
    spring, time = c.spring[k], c.relaxation[k]
    at = middle
    u = (0.0, 0.0, 0.0)
    remembers = kept[first] == 1.0
    if remembers:
        at = kept[first + 1]
        p = between(a, b, at)
        u = (p[0] - kept[first + 2], p[1] - kept[first + 3], p[2] - kept[first + 4])
    rub, slides = friction(push, n, u, between(w_a, w_b, at), spring, time, c)
    if slides or not remembers or not holds:
        at = middle
        u = shift_for(rub, n, between(w_a, w_b, middle), spring, time)
        remember_anchor(row, middle, along(here, u, -1.0))
    else:
        remember_anchor(row, at, (kept[first + 2], kept[first + 3], kept[first + 4]))
    return rub, at


def remember_anchor(row: Any, s: float, place: Any) -> None:
    """Put an anchor into a row of the memory."""
    row[0] = 1.0
    row[1] = s
    row[2] = place[0]
    row[3] = place[1]
    row[4] = place[2]


def between(a: Any, b: Any, s: float) -> Any:
    """(1 - s) a + s b."""
    return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])


def along(a: Any, b: Any, s: float) -> Any:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


def remember_thread_contact(t: float, x: Any, v: Any, c: Any) -> None:
    """What the pairs that were looked at leave in the memory, and the largest depth.

    `add_thread_contact` has looked at this state last.
    """
    kept = c.kept
    for one in range(int(c.look[0])):
        keep_row(kept, c.near[one], c.after[c.near[one]])
    last = 5 * c.length.size
    remember_status(t, c, kept[last:])


THREADS = (
    places_now,
    ends_now,
    ends_at,
    speeds_now,
    is_clear,
    keep_clear,
    push_thread,
    rub_with_memory,
    remember_anchor,
    between,
    along,
)
