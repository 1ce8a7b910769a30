"""The edge of a net: a walk along its threads that keeps the outside on its right hand.

At each node the thread is taken that comes first when one turns anticlockwise from where one came from: the
right-hand rule for the outer face of a plane graph.  Which nodes lie outside is asked nowhere.
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats, Ints


def around(place: Floats, sides: Ints, first: int) -> tuple[Ints, Ints]:
    """Nodes (q,) of the edge, anticlockwise from the corner `first`, and the sides (q,) that follow each.

    place (n, 2 or 3) [m] in the plane of the net, about its centre; sides (s, 2).
    """
    beside: dict[int, list[tuple[int, int]]] = {}
    for side, (i, j) in enumerate(sides.tolist()):
        beside.setdefault(i, []).append((j, side))
        beside.setdefault(j, []).append((i, side))
    here, back = first, place[first, :2]  # as if one came from outside
    nodes, passed = [first], []
    while True:
        angles = [_turn(back, place[there, :2] - place[here, :2]) for there, _ in beside[here]]
        there, side = beside[here][int(np.argmin(angles))]
        passed.append(side)
        if there == first:
            return np.array(nodes, dtype=np.intp), np.array(passed, dtype=np.intp)
        nodes.append(there)
        back, here = place[here, :2] - place[there, :2], there


def _turn(back: Floats, ahead: Floats) -> float:
    """Angle in (0, 2 pi] by which one turns anticlockwise from `back` to `ahead`, plane vectors (2,)."""
    angle = np.arctan2(back[0] * ahead[1] - back[1] * ahead[0], back @ ahead)
    return float(angle if angle > 1e-9 else angle + 2.0 * np.pi)
