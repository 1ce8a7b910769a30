"""Contact of threads with a body whose shape is a mesh, as compiled loops; see `piece_loops`."""

from __future__ import annotations

from typing import Any

from exunet.forces.contact.frame_loops import turn_into
from exunet.forces.contact.piece_loops import find_pieces, touch_pieces, touches_sampled
from exunet.forces.contact.thread_loops import (
    ends_at,
    ends_now,
    is_clear,
    keep_clear,
    places_now,
    push_thread,
    speeds_now,
)


def add_mesh_contact(t: float, x: Any, v: Any, c: Any, force: Any) -> None:
    """As `add_thread_contact`."""
    for one in range(places_now(t, x, v, c)):
        k = c.near[one]
        a, b = ends_now(c, k)
        if is_clear(c, k, a, b):
            continue
        m, clear = find_pieces(c, k, a, b)
        keep_clear(c, k, a, b, clear)
        if m > 0:
            w_a, w_b = speeds_now(v, c, k, a, b)
            if touch_pieces(c, k, w_a, w_b, m, c.sums):
                holds = c.kept[5 * k] == 1.0 and touches_sampled(c, k, c.kept[5 * k + 1])
                push_thread(c, k, force, a, b, w_a, w_b, holds)


def mesh_contact_potential(x: Any, c: Any) -> float:
    """As `thread_contact_potential`."""
    turn_into(x, c.attitude, c.frame)
    rest = (0.0, 0.0, 0.0)
    total = 0.0
    for k in range(c.length.size):
        if c.kept[5 * k] >= 0.0:
            a, b = ends_at(x, c, k)
            m, _ = find_pieces(c, k, a, b)
            if m > 0 and touch_pieces(c, k, rest, rest, m, c.sums):
                total += c.length[k] * c.sums[9]
    return total
