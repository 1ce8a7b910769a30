"""The accordion: a net pleated along y, and the stack of layers that this gives pleated along x.

Elements lie between the creases, which pass through nodes, so that a fold without thickness would keep all
lengths. Layers lie one thread apart. Nodes on a crease of the first fold lie between the two layers. At a
crease of the second fold, the outer layers of the stack go round the inner ones: each turns a thread further
out, half way between its two heights, and the stack is sheared by as much, so that all layers have the same
way to go, along slopes that all begin at the same distance from the crease. A common factor then makes room
for the heights.
"""

from __future__ import annotations

import numpy as np

from exunet.base.errors import CaseError
from exunet.net.arrays import Floats, Net
from exunet.net.canister import Fold, Folded, check_chords, check_threads, mesh_nodes, threads
from exunet.net.creases import BESIDE, Pleats, creases, narrowest, pleated, usable
from exunet.net.string_folds import with_strings


def accordion(net: Net, lines: tuple[Floats, Floats], fold: Fold) -> Folded:
    """The net folded into the canister, in layers normal to z.

    lines : x, and y, of the lines along which the net can be creased, increasing [m]
    Raises CaseError if it does not fit, with a size that would do.
    """
    too_thick, too_large = None, []
    # A node may be drawn to a crease; where that costs too much length, lines that are crossed are left out.
    for beside in (BESIDE, 0.0):
        try:
            found, needed = _laid_out(net, lines, fold, beside)
        except CaseError as error:
            too_thick = error
            continue
        if (needed <= np.array(fold.room) * (1.0 + 1e-9)).all():
            return found
        too_large.append((found, needed))
    if not too_large:
        assert too_thick is not None
        raise too_thick
    found, needed = too_large[0]
    edges = " x ".join(f"{edge:.4g}" for edge in found.size)
    words = f"the folded net ({found.pleats}) takes {edges} m, in {found.layers} layers"
    if crossed := sum(
        len(of_axis) - len(usable(of_axis, net, axis, BESIDE)) for axis, of_axis in enumerate(lines)
    ):
        words += f" ({crossed} lines cannot be creased: near the border, threads cross them)"
    raise fold.too_small(words, np.maximum(needed, fold.room).tolist())


def _laid_out(net: Net, lines: tuple[Floats, Floats], fold: Fold, beside: float) -> tuple[Folded, Floats]:
    """The net in the narrowest pleats that the canister demands, and the room (3,) that it needs [m].

    Raises CaseError if an element would not keep its length.
    """
    thread = float(threads(net).max())
    along_y, wide_y = _along(net, 1, lines[1], fold.room[1] - thread, beside)
    # The stack is sheared by a thread a layer.
    sheared = along_y.number * thread
    along_x, wide_x = _along(net, 0, lines[0], fold.room[0] - sheared, beside)
    flat = np.zeros((net.n_nodes, 3))
    flat[:, 0], flat[:, 1] = along_x.place, along_y.place
    offset = thread * _offsets(net, along_x, along_y)
    position = _scale(net, flat, offset, fold) * flat + offset
    nodes = mesh_nodes(net)
    position -= 0.5 * (position[nodes].min(axis=0) + position[nodes].max(axis=0))
    size = np.ptp(position[nodes], axis=0) + thread
    forward = np.stack([along_x.forward, along_y.forward, np.zeros(net.n_nodes)], axis=1)
    position = with_strings(net, position, forward, thread)
    check_chords(net, position, fold)
    check_threads(net, position, fold, thread)
    pleats = f"{along_y.number} pleats along y, {along_x.number} along x"
    needed = np.maximum(size, [wide_x + sheared, wide_y + thread, 0.0])
    return Folded(position, pleats, along_x.number * along_y.number, size), needed


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
    return pleated(np.clip(values, low, high), found, elements, _on_crease(net)), room


def _on_crease(net: Net) -> float:
    """What is no further from a crease lies on it [m]."""
    return 1e-6 * float(net.reference_length.min())


def _offsets(net: Net, along_x: Pleats, along_y: Pleats) -> Floats:
    """(n_nodes, 3) in threads: heights, and the shear of the stack."""
    stack, turns, block = along_y.number, along_x.number, along_x.pleat
    layer = along_y.pleat
    below = np.floor(block)
    height = stack * below + np.where(below % 2 == 0, layer, stack - 1.0 - layer)
    before, after = along_x.towards_creases(net.element_nodes[~net.is_string], _on_crease(net))
    height += before * (stack * below - 0.5 - height) + after * (stack * (below + 1.0) - 0.5 - height)
    height = np.where(block > below, stack * (below + 1.0) - 0.5, height)
    shear = 0.5 * (stack - 1.0) - layer if turns > 1 else np.zeros_like(layer)
    return np.stack([shear, np.zeros_like(layer), height], axis=1)


def _scale(net: Net, flat: Floats, offset: Floats, fold: Fold) -> float:
    """The largest factor of the flat fold, up to 1, that makes no element longer than when free of stress."""
    held = ~net.is_string
    i, j = net.element_nodes[held].T
    a, b = flat[j] - flat[i], offset[j] - offset[i]
    # |s a + b| = L
    aa, ab = np.einsum("ek,ek->e", a, a), np.einsum("ek,ek->e", a, b)
    left = net.reference_length[held] ** 2 - np.einsum("ek,ek->e", b, b)
    if (left <= 0.0).any():
        raise fold.fault("the stack of layers is thicker than an element is long: use thinner threads")
    factor = (np.sqrt(ab * ab + aa * left) - ab) / aa
    return min(1.0, float(factor.min())) * (1.0 - 1e-14)
