"""Where a flat net can be creased along straight lines, and how it then lies to and fro along an axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exunet.net.arrays import Floats, Ints, Net

_MOST = 500  # lines, in the middle of the net, whose distances are tried as widths
BESIDE = 0.045  # of an element's length: twice as much leaves each 90 % of it, if nothing else takes some


@dataclass(frozen=True)
class Pleats:
    """Values along an axis of the flat net, folded to and fro.

    creases : (n,) increasing [m], where it turns
    along   : (k,) of each node along the axis, flat, round 0; what is drawn to a crease lies there [m]
    place   : (k,) of each node along the axis, folded, round 0 [m]
    pleat   : (k,) number of the pleat that a node is in; k + 1/2 on the crease between k and k + 1
    forward : (k,) 1 where the pleat runs along the axis, -1 where it runs back
    """

    creases: Floats
    along: Floats
    place: Floats
    pleat: Floats
    forward: Floats

    @property
    def number(self) -> int:
        return len(self.creases) + 1


def usable(lines: Floats, net: Net, axis: int, beside: float) -> Floats:
    """Those of `lines` (values along an axis, increasing) that no element crosses, but for close to an end.

    beside : how close, as a part of its length. The end is then drawn to the crease, which makes elements on
             one side longer, and on the other shorter
    """
    held = ~net.is_string
    ends = np.sort(net.reference_position[net.element_nodes[held], axis], axis=1)
    length = net.reference_length[held]
    tolerance = 1e-6 * length.min()
    first = np.searchsorted(lines, ends[:, 0] + tolerance)
    last = np.searchsorted(lines, ends[:, 1] - tolerance)
    count = np.maximum(last - first, 0)
    element = np.repeat(np.arange(len(length)), count)
    line = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    off = np.abs(lines[line, None] - ends[element]).min(axis=1)
    return np.delete(lines, np.unique(line[off > beside * length[element]]))


def widths(lines: Floats, low: float, high: float) -> Floats:
    """Widths of pleats to try on a net from `low` to `high` [m], decreasing; the net's own first."""
    inside = _inside(lines, low, high)
    few = max(0, (len(inside) - _MOST) // 2)
    middle = inside[few : few + _MOST]
    apart = np.sort(np.abs(middle[:, None] - middle).ravel())
    found = apart[np.diff(apart, prepend=0.0) > _tolerance(low, high)]
    return np.concatenate([[high - low], found[::-1]])


def narrowest(lines: Floats, low: float, high: float) -> float:
    """The least width of pleats that all lie in a stack [m]."""
    return next(
        float(width)
        for width in widths(lines, low, high)[::-1]
        if creases(lines, low, high, float(width)) is not None
    )


def creases(lines: Floats, low: float, high: float, room: float) -> Floats | None:
    """Where to crease a net from `low` to `high` [m] for a stack of at most `room` [m]; None: it cannot be.

    The pleats are equally wide, but for the outer two, which may be narrower. Pleats of different widths are
    chosen where they save a quarter of the creases, which they can where lines are not regular.
    """
    if high - low <= room + _tolerance(low, high):
        return np.empty(0)
    equal, other = _equal(lines, low, high, room), _to_the_walls(lines, low, high, room)
    if equal is None or (other is not None and 4 * len(other) < 3 * len(equal)):
        return other
    return equal


def _equal(lines: Floats, low: float, high: float, room: float) -> Floats | None:
    """Creases between pleats of one width, as wide as possible with an even number of them, else an odd one.

    An even number leaves opposite ends of the net at opposite ends of the stack. Of the rest, the fewest
    creases count, then the nearest to symmetric.
    """
    tolerance = _tolerance(low, high)
    inside = _inside(lines, low, high)
    fitting = [width for width in widths(lines, low, high) if width <= room + tolerance]
    for even in (True, False):
        for width in fitting:
            starts = inside[inside - low <= width + tolerance]
            tried = [_marks(inside, start, width, high, tolerance) for start in starts]
            found = [one for one in tried if one is not None and not (even and len(one) % 2)]
            if found:
                return min(found, key=lambda one: (len(one), round(abs(one[0] - low - high + one[-1]), 9)))
    return None


def _to_the_walls(lines: Floats, low: float, high: float, room: float) -> Floats | None:
    """Creases between pleats that each go as far as there is room, to and fro."""
    tolerance = _tolerance(low, high)
    inside = _inside(lines, low, high)
    at, place, forward = low, 0.0, True
    found: list[float] = []
    while (reach := at + (room - place if forward else place) + tolerance) < high:
        after = int(np.searchsorted(inside, reach, side="right"))
        if not after or inside[after - 1] <= at + tolerance:
            return None
        following = float(inside[after - 1])
        place += following - at if forward else at - following
        at, forward = following, not forward
        found.append(at)
    return np.array(found)


def _marks(lines: Floats, start: float, width: float, high: float, tolerance: float) -> Floats | None:
    """Creases from `start` on, `width` apart; None if there is not a line for each."""
    wanted = start + width * np.arange(int(np.floor((high - start - tolerance) / width)) + 1)
    after = np.clip(np.searchsorted(lines, wanted), 1, len(lines) - 1)
    nearest = np.where(wanted - lines[after - 1] < lines[after] - wanted, lines[after - 1], lines[after])
    return nearest if np.abs(nearest - wanted).max() <= tolerance else None


def pleated(values: Floats, at: Floats, elements: Ints, on_crease: float) -> Pleats:
    """Values (k,) folded to and fro at the creases `at`.

    Nodes within `on_crease` [m] lie on a crease; of an element (m, 2) that crosses one, the nearer end is
    drawn to it.
    """
    pleat = np.searchsorted(at, values).astype(float)
    sign = np.where(np.arange(len(at) + 1) % 2 == 0, 1.0, -1.0)
    # A pleat's place is sign * value + base; the two at a crease agree there.
    base = np.concatenate([[0.0], np.cumsum((sign[:-1] - sign[1:]) * at)])
    inside = pleat.astype(int)
    place = sign[inside] * values + base[inside]
    forward = sign[inside]
    along = values.copy()
    for k, crease in enumerate(at):
        beyond = values - crease
        on = np.abs(beyond) <= on_crease
        crossed = elements[(beyond[elements].prod(axis=1) < 0.0) & ~on[elements].any(axis=1)]
        on[crossed[np.arange(len(crossed)), np.abs(beyond[crossed]).argmin(axis=1)]] = True
        pleat[on], along[on] = k + 0.5, crease
        place[on] = sign[k] * crease + base[k]
    return Pleats(at, _centred(along), _centred(place), pleat, forward)


def _centred(values: Floats) -> Floats:
    return np.asarray(values - 0.5 * (values.min() + values.max()))


def _inside(lines: Floats, low: float, high: float) -> Floats:
    tolerance = _tolerance(low, high)
    return lines[(lines > low + tolerance) & (lines < high - tolerance)]


def _tolerance(low: float, high: float) -> float:
    return 1e-7 * (high - low)
