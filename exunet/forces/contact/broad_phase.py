"""Broad phase: nearby pairs of threads, nodes or bodies, as compiled loops; extremes of a contact.

Those near the boxes around the body's solids are chosen now and then, with a margin; the others need not be
looked at for as long as they would take to come there at eight times their largest speed against the body of
now, and 5 m/s more. So a body out of reach costs next to nothing. What has come into reach unseen all the
same is reported, and stops a run.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from exunet.forces.contact.signed_distance import place_in_body, turn_into, velocity_against_body


def is_near(t: float, c: Any) -> bool:
    """True if the pairs that were chosen are still the right ones.

    A step that is tried again, shorter, begins before the instant at which the rejected one chose.
    """
    return 0.0 <= t - c.near.look[1] <= c.near.look[2]


def clearance(c: Any, k: int) -> float:
    """Distance [m] that the pair k, whose nodes stand in `own`, keeps at least from the body; 0: may touch.

    That of the boxes, along the body's principal axes, around the thread and around each solid.
    """
    own = c.work.own
    i = c.threads.first[k]
    j = c.threads.second[k]
    least = np.inf
    for n in range(c.cores.kind.size):
        box = c.cores.boxes[n]
        square = 0.0
        for axis in range(3):
            a = own[i + axis]
            b = own[j + axis]
            gap = max(min(a, b) - box[3 + axis], box[axis] - max(a, b)) - c.threads.thick[k]
            if gap > 0.0:
                square += gap * gap
        least = min(least, square)
    return math.sqrt(least)


def choose_near(t: float, x: Any, v: Any, c: Any) -> None:
    """Choose the pairs that are looked at from now on, and their nodes.

    What touches and was not chosen before has come unseen. Where steps are taken again, from before the last
    choice, that is judged by the one before it; from before that too, not at all: they had been judged.
    """
    again = t < c.near.look[1]
    judged = c.near.look[2] >= 0.0 and t >= (c.near.look[6] if again else c.near.look[1])
    if again:
        c.now[4] = min(c.now[4], 0.0)
    else:
        c.near.look[6] = c.near.look[1] if c.near.look[2] >= 0.0 else t
    turn_into(x, c.body.attitude, c.work.frame)
    own, body, frame = c.work.own, c.body, c.work.frame
    rest = (0.0, 0.0, 0.0)
    fastest = 0.0
    for item in range(c.near.nodes.size):
        i = c.near.nodes[item]
        own[i], own[i + 1], own[i + 2] = place_in_body(x, i, c.body.centre, c.work.frame)
        fastest = max(fastest, size_of(velocity_against_body(v, i, body.centre, body.spin, frame, rest)))
        c.near.wanted[i // 3] = 0
    spin = size_of((v[c.body.spin], v[c.body.spin + 1], v[c.body.spin + 2]))
    margin = 0.1 * c.body.radius
    right_for = np.inf
    speed = 0.0
    fastest_pair = 0
    n = 0
    for k in range(c.threads.length.size):
        i = c.threads.first[k]
        j = c.threads.second[k]
        apart = clearance(c, k)
        before = c.near.listed[k] >= 2.0 if again else c.near.listed[k] % 2.0 == 1.0
        if apart < margin:
            if apart == 0.0 and c.now[4] == 0.0 and judged and not before:
                c.now[4] = 1.0 + k
            c.near.pairs[n] = k
            n += 1
            for node in (i, j):
                c.near.wanted[node // 3] = 1
                a = (own[node], own[node + 1], own[node + 2])
                own_speed = size_of(velocity_against_body(v, node, body.centre, body.spin, frame, a))
                if own_speed > speed:
                    speed = own_speed
                    fastest_pair = k
        else:
            away = max(size_of((own[i], own[i + 1], own[i + 2])), size_of((own[j], own[j + 1], own[j + 2])))
            right_for = min(right_for, apart / (8.0 * (fastest + spin * away + 5.0)))
        c.near.listed[k] = (1.0 if apart < margin else 0.0) + (2.0 if before else 0.0)
    m = 0
    for entry in range(c.near.nodes.size):
        if c.near.wanted[c.near.nodes[entry] // 3] == 1:
            c.near.near_nodes[m] = c.near.nodes[entry]
            m += 1
    if n > 0:  # so that what has left is not looked at for ever
        right_for = min(right_for, margin / (fastest + spin * c.body.radius + 5.0))
    c.near.look[0] = n
    c.near.look[1] = t
    c.near.look[2] = right_for
    c.near.look[3] = speed
    c.near.look[4] = m
    c.near.look[5] = fastest_pair


def size_of(a: Any) -> float:
    """Return the length of a vector (3)."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def remember_status(t: float, c: Any, status: Any) -> None:
    """The `Status` at the end of an accepted step."""
    now = c.now
    way = now[3] * (t - status[8])
    remember_touch(t, now, status)
    wrong = 1.0 if now[4] < 0.0 else 2.0 if way > c.body.least else 3.0 if now[4] > 0.0 else 0.0
    remember_wrong(t, wrong, now[6] if wrong == 2.0 else abs(now[4]) - 1.0, status)
    now[4] = 0.0


def begin_resultant(c: Any, force: Any) -> None:
    """Note in `now` what else acts on the body, before the forces of contact are added."""
    for axis in range(3):
        c.now[8 + axis] = force[c.body.centre + axis]
        c.now[11 + axis] = force[c.body.spin + axis]


def end_resultant(c: Any, force: Any) -> None:
    """Leave in `now` what contact has added to the force and the torque on the body."""
    for axis in range(3):
        c.now[8 + axis] = force[c.body.centre + axis] - c.now[8 + axis]
        c.now[11 + axis] = force[c.body.spin + axis] - c.now[11 + axis]


def remember_touch(t: float, now: Any, status: Any) -> None:
    """Depths, touches, forces and energy of the state that was looked at last, in the `Status`."""
    if now[0] > status[0]:
        status[0] = now[0]
        status[1] = t
        status[2] = now[1]
    if now[2] > 0.0 and status[3] < 0.0:
        status[3] = t
    status[7] = max(status[7], now[2])
    status[8] = t
    status[9] = now[2]
    status[10] = now[5]
    status[11] = now[7]
    for m in range(8, now.size):
        status[m + 4] = now[m]


def remember_wrong(t: float, wrong: float, pair: float, status: Any) -> None:
    """Store the first error in the `Status`; wrong = 0.0: no error."""
    if status[4] == 0.0 and wrong > 0.0:
        status[4] = wrong
        status[5] = t
        status[6] = pair


def keep_row(kept: Any, k: int, row: Any) -> None:
    """Put the next discrete state of pair k into place; all is zero of a pair that remembers nothing."""
    kept[5 * k] = row[0]
    for m in range(1, 5):
        kept[5 * k + m] = row[m] if row[0] == 1.0 else 0.0


KEPT = (remember_status, remember_touch, remember_wrong, keep_row)
RESULTANT = (begin_resultant, end_resultant)
NEAR = (is_near, clearance, choose_near, size_of, *KEPT)
