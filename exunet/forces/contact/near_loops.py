"""Which pairs are looked at: broad phase, as compiled loops; and what is told of a contact.

Those near the body's ball are chosen now and then, with a margin; the others need not be looked at for as
long as they would take to cross the margin at eight times the largest speed of now and 5 m/s more. So a body
out of reach costs next to nothing. What has come into reach unseen all the same is told, and stops a run.
"""

from __future__ import annotations

import math
from typing import Any

from exunet.forces.contact.frame_loops import place_in_body, turn_into, velocity_against_body


def is_near(t: float, c: Any) -> bool:
    """True if the pairs that were chosen are still the right ones.

    A step that is tried again, shorter, begins before the instant at which the rejected one chose.
    """
    return 0.0 <= t - c.look[1] <= c.look[2]


def clearance(c: Any, k: int, x: Any) -> float:
    """Distance [m] that the pair k keeps at least from the body's ball; c.frame is set."""
    a = place_in_body(x, c.first[k], c.centre, c.frame)
    b = place_in_body(x, c.second[k], c.centre, c.frame)
    d = 0.5 * (a[0] + b[0]) - c.middle[0]
    e = 0.5 * (a[1] + b[1]) - c.middle[1]
    f = 0.5 * (a[2] + b[2]) - c.middle[2]
    half = 0.5 * math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    return math.sqrt(d * d + e * e + f * f) - half - c.thick[k] - c.radius


def choose_near(t: float, x: Any, v: Any, c: Any) -> None:
    """Choose the pairs that are looked at from now on."""
    turn_into(x, c.attitude, c.frame)
    margin = 0.25 * c.radius
    fastest = 0.0
    n = 0
    for k in range(c.length.size):
        a = place_in_body(x, c.first[k], c.centre, c.frame)
        w = velocity_against_body(v, c.first[k], c.centre, c.spin, c.frame, a)
        fastest = max(fastest, w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        a = place_in_body(x, c.second[k], c.centre, c.frame)
        w = velocity_against_body(v, c.second[k], c.centre, c.spin, c.frame, a)
        fastest = max(fastest, w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        apart = clearance(c, k, x)
        if apart < margin:
            if apart < 0.0 and c.now[4] == 0.0 and c.listed[k] == 0.0 and c.look[2] >= 0.0:
                c.now[4] = 1.0 + k
            c.near[n] = k
            n += 1
        c.listed[k] = 1.0 if apart < margin else 0.0
    c.look[0] = n
    c.look[1] = t
    c.look[3] = math.sqrt(fastest)
    c.look[2] = margin / (8.0 * (c.look[3] + 5.0))


def remember_status(t: float, c: Any, status: Any) -> None:
    """The `Status` at the end of an accepted step."""
    now = c.now
    if now[0] > status[0]:
        status[0] = now[0]
        status[1] = t
        status[2] = now[1]
    if now[2] > 0.0 and status[3] < 0.0:
        status[3] = t
    status[7] = max(status[7], now[2])
    status[9] = now[2]
    status[10] = now[5]
    way = now[3] * (t - status[8])
    status[8] = t
    wrong = 1.0 if now[4] < 0.0 else 2.0 if way > c.least else 3.0 if now[4] > 0.0 else 0.0
    if status[4] == 0.0 and wrong > 0.0:
        status[4] = wrong
        status[5] = t
        status[6] = now[1] if wrong == 2.0 else abs(now[4]) - 1.0
    now[4] = 0.0


def keep_row(kept: Any, k: int, row: Any) -> None:
    """Put the next memory of pair k into place; of one that remembers nothing all is zero but that."""
    kept[5 * k] = row[0]
    for m in range(1, 5):
        kept[5 * k + m] = row[m] if row[0] == 1.0 else 0.0


NEAR = (is_near, clearance, choose_near, remember_status, keep_row)
