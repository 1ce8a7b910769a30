"""The accordion: a net pleated along y, and the stack of layers that this gives pleated along x.

Elements lie between the creases, which pass through nodes, so that a fold without thickness would keep all
lengths. Layers lie a distance d apart, nodes on a crease of the first fold between the two that it joins: one
thread, or as much more as keeps all threads so far from each other.

A net that is pleated along one axis only lies in layers normal to z. Where threads are straight between
nodes, the layers of a stack that is pleated again turn at one crease as wedges, one in the other: to be
d apart all along, each must turn d / sin a further out than the next inner one, a being their slope.
So the stack is a bellows: it rises by a all along x, as high as the canister allows, and its layers, at one
height, are shifted along x by d / sin a each. At a crease on the right the one furthest right is the outer
one, at a crease on the left the one furthest left: no layer has further to go than another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from exunet.base.errors import CaseError
from exunet.net.arrays import Floats, Net
from exunet.net.canister import Fold, Folded, check_chords, check_strings, mesh_nodes, spread, threads
from exunet.net.creases import BESIDE, Pleats, creases, narrowest, pleated, usable
from exunet.net.string_folds import with_strings

STEEPEST = 0.5  # rise of a bellows, as a part of the way along x
_FURTHEST = (0.5, 0.1)  # of the shortest element: what layers of a bellows are shifted by; tried in turn
_ENLARGED = 8  # canisters that are tried to tell of one that fits
_NARROWED = 0.95  # of its lengths: what a bellows keeps to be a pleat wider


def accordion(net: Net, lines: tuple[Floats, Floats], fold: Fold) -> Folded:
    """The net folded into the canister.

    lines : x, and y, of the lines along which the net can be creased, increasing [m]
    Raises CaseError if it does not fit, with a size that would do.
    """
    found, needed = _best(net, lines, fold)
    if _fits(needed, fold):
        return found
    fitting = fold
    for _ in range(_ENLARGED):  # another canister may give other pleats, and so need a little more
        fitting = fitting.holding(needed)
        _, needed = _best(net, lines, fitting)
        if _fits(needed, fitting):
            break
    edges = " x ".join(f"{edge:.4g}" for edge in found.size)
    words = f"the folded net ({found.pleats}) takes {edges} m, in {found.layers} layers"
    if crossed := sum(
        len(of_axis) - len(usable(of_axis, net, axis, BESIDE)) for axis, of_axis in enumerate(lines)
    ):
        words += f" ({crossed} lines cannot be creased: near the border, threads cross them)"
    raise fold.too_small(words, fitting)


def _fits(needed: Floats, fold: Fold) -> bool:
    return bool((needed <= np.array(fold.room) * (1.0 + 1e-9)).all())


def _best(net: Net, lines: tuple[Floats, Floats], fold: Fold) -> tuple[Folded, Floats]:
    """The first fold that fits, else the first that keeps its lengths, and the room (3,) that it needs [m].

    A node may be drawn to a crease; where that costs too much length, lines that are crossed are left out.
    """
    laid, too_thick = [], None
    for furthest, beside in product(_FURTHEST, (BESIDE, 0.0)):
        try:
            found, needed = _folded(net, lines, fold, beside, furthest)
        except CaseError as error:
            too_thick = error
            continue
        if _fits(needed, fold):
            return found, needed
        laid.append((found, needed))
    if not laid:
        assert too_thick is not None
        raise too_thick
    return laid[0]


@dataclass(frozen=True)
class _Laid:
    """The net without its strings.

    position : (n_nodes, 3) [m]; of strings, anywhere
    forward  : (n_nodes, 3) 1 or -1 by which an axis of the flat net runs in a node's pleat
    number   : of pleats along x, and y
    size     : (3,) edges of the box round the net, threads included [m]
    needed   : (3,) edges of a canister for it [m]
    """

    position: Floats
    forward: Floats
    number: tuple[int, int]
    size: Floats
    needed: Floats


def _folded(
    net: Net, lines: tuple[Floats, Floats], fold: Fold, beside: float, furthest: float
) -> tuple[Folded, Floats]:
    """The net in the widest pleats that the canister allows, and the room (3,) that it needs [m].

    Raises CaseError if an element would not keep its length.
    """
    layer = spread(lambda layer: _laid(net, lines, fold, beside, furthest, layer).position, net, fold)
    laid = _laid(net, lines, fold, beside, furthest, layer)
    position = with_strings(net, laid.position, laid.forward, float(threads(net).max()))
    check_chords(net, position, fold)
    check_strings(net, position, fold)
    x, y = laid.number
    return Folded(position, f"{y} pleats along y, {x} along x", x * y, laid.size), laid.needed


def _laid(
    net: Net, lines: tuple[Floats, Floats], fold: Fold, beside: float, furthest: float, layer: float
) -> _Laid:
    """The net in layers that are `layer` [m] apart."""
    thread = float(threads(net).max())
    room = np.array(fold.room) - thread
    along_y, wide_y = _along(net, 1, lines[1], room[1], beside)
    length = float(np.ptp(net.reference_position[mesh_nodes(net), 0]))
    rise = shift = 0.0
    narrowed = 1.0
    if along_y.number > 1 and length > room[0]:
        rise, shift = _bellows(net, room[2] / length, furthest, layer)
        narrowed = _NARROWED
    level, shifted = math.sqrt(1.0 - rise * rise), (along_y.number - 1) * shift
    along_x, wide_x = _along(net, 0, lines[0], (room[0] - shifted) / (level * narrowed), beside)
    flat = np.stack([level * along_x.place, along_y.place, rise * along_x.along], axis=1)
    offset = np.zeros_like(flat)
    if rise:
        offset[:, 0] = -shift * along_y.pleat
    else:
        offset[:, 2] = layer * (along_y.pleat if along_x.number == 1 else along_x.pleat)
    wide = float(np.ptp(along_x.place))
    most = (room[0] - shifted) / (level * wide)
    position = _scale(net, flat, offset, fold, most if most >= narrowed else 1.0) * flat + offset
    nodes = mesh_nodes(net)
    low, high = position[nodes].min(axis=0), position[nodes].max(axis=0)
    size = high - low + thread
    return _Laid(
        position - 0.5 * (low + high),
        np.stack([along_x.forward, along_y.forward, np.zeros(net.n_nodes)], axis=1),
        (along_x.number, along_y.number),
        size,
        np.maximum(
            size, thread + np.array([level * min(wide_x * narrowed, wide) + shifted, wide_y, rise * length])
        ),
    )


def _bellows(net: Net, rise: float, furthest: float, layer: float) -> tuple[float, float]:
    """Sine of the slope of a stack that may have this one, and what its layers are shifted by [m]."""
    shortest = float(net.reference_length[~net.is_string].min())
    rise = min(STEEPEST, max(layer / (furthest * shortest), rise))
    return rise, layer / rise


def _along(net: Net, axis: int, lines: Floats, room: float, beside: float) -> tuple[Pleats, float]:
    """The pleats along one axis, no wider than `room` [m] if they can, and how wide they may be [m]."""
    nodes = mesh_nodes(net)
    values = net.reference_position[:, axis]
    low, high = float(values[nodes].min()), float(values[nodes].max())
    lines = usable(lines, net, axis, beside)
    found = creases(lines, low, high, room)
    if found is None:
        room = narrowest(lines, low, high)
        found = creases(lines, low, high, room)
        assert found is not None
    elements = net.element_nodes[~net.is_string]
    on_crease = 1e-6 * float(net.reference_length.min())
    return pleated(np.clip(values, low, high), found, elements, on_crease), room


def _scale(net: Net, flat: Floats, offset: Floats, fold: Fold, most: float) -> float:
    """The largest factor of the flat fold, up to `most`, that makes no element longer than free of stress."""
    held = ~net.is_string
    i, j = net.element_nodes[held].T
    a, b = flat[j] - flat[i], offset[j] - offset[i]
    # |s a + b| = L
    aa, ab = np.einsum("ek,ek->e", a, a), np.einsum("ek,ek->e", a, b)
    left = net.reference_length[held] ** 2 - np.einsum("ek,ek->e", b, b)
    if (left <= 0.0).any():
        raise fold.fault("the stack of layers is thicker than an element is long: use thinner threads")
    factor = (np.sqrt(ab * ab + aa * left) - ab) / aa
    return min(1.0, most, float(factor.min())) * (1.0 - 1e-14)
