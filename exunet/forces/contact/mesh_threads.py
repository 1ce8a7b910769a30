"""Contact of threads with a body whose shape is a mesh, as compiled loops; see `piece_loops`."""

from __future__ import annotations

from typing import Any

from exunet.forces.contact.frame_loops import place_in_body, turn_into, velocity_against_body
from exunet.forces.contact.piece_loops import find_pieces, sampled_at, touch_pieces
from exunet.forces.contact.thread_loops import is_clear, keep_clear, places_now, push_thread


def add_mesh_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """Forces of all threads that touch the body, and what they would leave in the memory."""
    for one in range(places_now(t, x, v, c)):
        add_to_mesh(x, v, c, c.near[one], force)


def add_to_mesh(x: Any, v: Any, c: Any, k: int, force: Any) -> None:
    """Forces of the pair k."""
    i = c.first[k]
    j = c.second[k]
    own = c.own
    a = (own[i], own[i + 1], own[i + 2])
    b = (own[j], own[j + 1], own[j + 2])
    if is_clear(c, k, a, b):
        return
    row = c.after[k]
    kept = c.kept
    row[0] = min(kept[5 * k], 0.0)
    m, clear = find_pieces(c, k, a, b)
    keep_clear(c, k, a, b, clear)
    if m == 0:
        row[0] = 0.0
        return
    w_a = velocity_against_body(v, i, c.centre, c.spin, c.frame, a)
    w_b = velocity_against_body(v, j, c.centre, c.spin, c.frame, b)
    if not touch_pieces(c, k, w_a, w_b, m, c.sums):
        row[0] = 0.0
        return
    holds = False
    if kept[5 * k] == 1.0:
        distance, _, _, _ = sampled_at(c, kept[5 * k + 1])
        holds = distance < c.rounding[0] + c.thick[k]
    push_thread(c, k, force, a, b, w_a, w_b, holds)


def mesh_contact_potential(x: Any, c: Any) -> float:
    """Energy [J] stored across the surface."""
    turn_into(x, c.attitude, c.frame)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.length.size):
        if c.kept[5 * k] >= 0.0:
            a = place_in_body(x, c.first[k], c.centre, c.frame)
            b = place_in_body(x, c.second[k], c.centre, c.frame)
            m, _ = find_pieces(c, k, a, b)
            if m > 0 and touch_pieces(c, k, rest, rest, m, c.sums):
                total += c.length[k] * c.sums[9]
    return total


MESH = (add_to_mesh,)
