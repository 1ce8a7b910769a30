"""The star: spokes folded towards the axis and away from it in turn, and the arms pleated along the axis.

Every second spoke lies along the axis, as the ribs of a closed umbrella; those between them point outward and
are the tips of the star. The rings between two spokes go from the axis to a tip and back. Along the spokes
the net goes up and down by some rings each way. A ring that lies further out in the flat net lies further out
in the star too, so the pleats enclose each other and do not cross.
"""

from __future__ import annotations

import math

import numpy as np

from exunet.base.errors import CaseError
from exunet.net.arrays import Floats, Net
from exunet.net.canister import LEAST_CHORD, Fold, Folded, check_chords, mesh_nodes, spread, threads
from exunet.net.radial import Keys, mesh
from exunet.net.string_folds import with_strings
from exunet.net.weave import between

_KEPT = 0.99  # of lengths, where there is a choice


def star(net: Net, keys: Keys, fold: Fold) -> Folded:
    """A radial net with an even number of spokes, folded into the canister.

    Raises CaseError if it does not fit, with a size that would do.
    """
    radius, height = fold.radius_and_height
    room = np.array([2.0 * radius, 2.0 * radius, height]) * (1.0 + 1e-9)
    tried, fault = [], fold.fault("")
    thread = float(threads(net).max())
    for per_pleat in range(keys.rings, 0, -1):
        try:
            _, size = _laid(net, keys, per_pleat, thread, fold)
        except CaseError as error:
            fault = error
            continue
        beyond = float((size / room).max())
        tried.append((beyond > 1.0, beyond if beyond > 1.0 else 0.0, -per_pleat))
    # With layers further apart than a thread a star may be wider or lower: one beyond the room may fit too.
    refused: list[Folded] = []
    for _, _, pleat in sorted(tried):
        try:
            found = _folded(net, keys, -pleat, fold)
        except CaseError as error:
            fault = error
            continue
        if (found.size <= room).all():
            return found
        refused.append(found)
    if not refused:
        raise fault
    found = min(refused, key=lambda one: float((one.size / room).max()))
    needed = found.size.copy()
    if fold.box is None:  # the radius of a cylinder, not of a prism in it
        needed[:2] *= math.sqrt(0.5)
    words = f"the folded net takes {found.size[0]:.4g} m across and {found.size[2]:.4g} m along the axis"
    raise fold.too_small(words, fold.holding(needed))


def _folded(net: Net, keys: Keys, per_pleat: int, fold: Fold) -> Folded:
    """The whole net; raises CaseError if its threads are too thick, or it would not keep its lengths."""
    layer = spread(lambda layer: _laid(net, keys, per_pleat, layer, fold)[0], net, fold)
    position, size = _laid(net, keys, per_pleat, layer, fold)
    position = with_strings(net, position, np.ones_like(position), float(threads(net).max()))
    check_chords(net, position, fold)
    pleats = math.ceil(keys.rings / per_pleat)
    return Folded(position, f"{keys.spokes // 2} arms, {pleats} pleats along the axis", pleats, size)


def _laid(net: Net, keys: Keys, per_pleat: int, layer: float, fold: Fold) -> tuple[Floats, Floats]:
    """Positions (n_nodes, 3), of strings anywhere, and edges (3,) of the box round the net [m]."""
    knots = _knots(keys, per_pleat, layer)
    if knots is None:
        words = "the threads are too thick for a star of this net: its rings cannot lie beside each other"
        raise fold.fault(words)
    thread = float(threads(net).max())
    across = 2.0 * float(np.hypot(knots[:, 0], knots[:, 1]).max()) + thread
    size = np.array([across, across, float(np.ptp(knots[:, 2])) + thread])
    position = np.zeros((net.n_nodes, 3))
    first = keys.spokes if keys.strings else 0  # bullets come first
    # Threads are straight between the folded knots.
    inner = between(knots, mesh(keys).sides, keys.divisions)
    position[first : first + len(knots) + len(inner)] = np.concatenate([knots, inner])
    nodes = mesh_nodes(net)
    position[:, 2] -= 0.5 * (position[nodes, 2].min() + position[nodes, 2].max())
    return position, size


def _knots(keys: Keys, per_pleat: int, layer: float) -> Floats | None:
    """(n_knots, 3) places of hub and knots, ring by ring as in `radial.mesh`; None if there are none.

    per_pleat : rings that the net goes along the axis before it turns
    layer     : how far spokes at the axis lie apart [m]
    """
    spokes, rings = keys.spokes, keys.rings
    turn, step = 2.0 * math.pi / spokes, keys.radius / rings
    # Spokes at the axis are a layer from the next, and a ring a layer from those further in: its threads
    # leave the axis nearly along the spoke beside.
    apart = layer / math.sin(turn)
    axis, tip = (0.0, 0.0), (0.0, 0.0)  # distance from the axis and height of the knots of the last ring
    found = [np.zeros((1, 3))]
    angle = turn * np.arange(spokes)
    for ring in range(1, rings + 1):
        pleat, within = divmod(ring, per_pleat)
        # On a crease, half way between the pleats that it joins.
        out = pleat - 0.5 * (within == 0 and ring < rings) - 1.0 * (within == 0 and ring == rings)
        down = -1.0 if (ring - 1) // per_pleat % 2 == 0 else 1.0
        next_axis = _next_on_axis(axis, (0.5 + out) * apart, down, _KEPT * step)
        if next_axis is None:
            return None
        chord = 2.0 * math.sin(0.5 * turn) * step * ring
        next_tip = _next_tip(tip, next_axis, turn, down, step, chord)
        if next_tip is None:
            return None
        axis, tip = next_axis, next_tip
        away = np.where(np.arange(spokes) % 2 == 0, axis[0], tip[0])
        height = np.where(np.arange(spokes) % 2 == 0, axis[1], tip[1])
        found.append(np.stack([away * np.cos(angle), away * np.sin(angle), height], axis=1))
    return np.concatenate(found)


def _next_on_axis(
    last: tuple[float, float], away: float, down: float, length: float
) -> tuple[float, float] | None:
    """The next knot of a spoke at the axis, `length` [m] from the last."""
    across = away - last[0]
    if not abs(across) < length:
        return None
    return away, last[1] + down * math.sqrt(length * length - across * across)


def _next_tip(
    last: tuple[float, float],
    axis: tuple[float, float],
    turn: float,
    down: float,
    step: float,
    chord: float,
) -> tuple[float, float] | None:
    """The next knot of a spoke at a tip: where both it and its ring keep their lengths, if they can.

    Of the parts of their lengths that the two may keep, the largest for which their circles meet.
    """
    for kept_chord, kept_step in _PARTS:
        # In the plane of the spoke: circles round the last knot, and round the knots at the axis beside it.
        beside = axis[0] * math.sin(turn)
        radius = (kept_chord * chord) ** 2 - beside**2
        if radius <= 0.0:
            return None
        centre = (axis[0] * math.cos(turn), axis[1])
        met = _meeting(last, kept_step * step, centre, math.sqrt(radius))
        if met is not None and met[0] > last[0] * (1.0 - 1e-9):
            return met
    return None


_LEVELS = np.linspace(_KEPT, LEAST_CHORD + 0.005, 18).tolist()
_PARTS = sorted(((a, b) for a in _LEVELS for b in _LEVELS), key=lambda pair: (-min(pair), -sum(pair)))


def _meeting(
    a: tuple[float, float], radius_a: float, b: tuple[float, float], radius_b: float
) -> tuple[float, float] | None:
    """Of the points where two circles in a plane meet, the one further out; None if they do not."""
    x, y = b[0] - a[0], b[1] - a[1]
    apart = math.hypot(x, y)
    if apart == 0.0:
        return None
    along = 0.5 * (apart + (radius_a - radius_b) * (radius_a + radius_b) / apart)
    squared = radius_a**2 - along**2
    if squared < 0.0:
        return None
    across = math.sqrt(squared) * (1.0 if y <= 0.0 else -1.0)
    return a[0] + (along * x - across * y) / apart, a[1] + (along * y + across * x) / apart
