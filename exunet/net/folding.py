"""Folded nets: creases, accordion, star, strings and the canister that they must fit.

Elements lie between the creases, which pass through nodes, so that a fold without thickness would keep all
lengths. Layers lie a distance d apart, nodes on a crease of the first fold between the two that it joins: one
thread, or as much more as keeps all threads so far from each other.

A net that is pleated along one axis only lies in layers normal to z. Where threads are straight between
nodes, the layers of a stack that is pleated again turn at one crease as wedges, one in the other: to be
d apart all along, each must turn d / sin a further out than the next inner one, a being their slope.
So the stack is a bellows: it rises by a all along x, as high as the canister allows, and its layers, at one
height, are shifted along x by d / sin a each. At a crease on the right the one furthest right is the outer
one, at a crease on the left the one furthest left: no layer has further to go than another.

A corner may lie where layers go round each other, so that threads of other layers are in the way; the string
then leaves it in the direction, nearest to outward, that is clear of them, or where none is, clearest.

Every second spoke lies along the axis, as the ribs of a closed umbrella; those between them point outward and
are the tips of the star. The rings between two spokes go from the axis to a tip and back. Along the spokes
the net goes up and down by some rings each way. A ring that lies further out in the flat net lies further out
in the star too, so the pleats enclose each other and do not cross.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from types import ModuleType
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import CaseError, Fault
from exunet.base.record import FromArray, Positive, Record
from exunet.net import TOPOLOGIES, radial
from exunet.net.arrays import Floats, Ints, Net
from exunet.net.base import NetConfig
from exunet.net.radial import RadialNet, mesh
from exunet.net.weave import NearestElements, between, between_segments, nearest

MEET = 1e-7  # threads between the middles of two: they go through each other, to round-off
THREAD_ROUND_OFF = 1e-6  # of a thread
LEAST_CHORD = 0.9  # of an element's reference length, in a folded net
_ROUND_OFF = 1e-9
_SPREADS = 12  # distances of layers that are tried
_FURTHER = 2.0  # by how much a distance grows at most


class Fold(Record):
    """How the net is folded at the start, and into what; its axis is z, the direction of the throw."""

    TABLE: ClassVar = "initial.fold"
    EXACTLY_ONE: ClassVar = ("box", "cylinder")

    pattern: Literal["accordion", "star"] = Field(description="how the net is folded")
    box: Annotated[tuple[Positive, Positive, Positive], FromArray] | None = Field(
        None, description="the canister: edges along x, y and z [m]", examples=[[0.5, 0.5, 0.2]]
    )
    cylinder: Annotated[tuple[Positive, Positive], FromArray] | None = Field(
        None, description="the canister, instead of box: radius and height [m]", examples=[[0.4, 0.3]]
    )

    @property
    def room(self) -> tuple[float, float, float]:
        """Edges of the canister, or of the upright square prism in the cylinder [m]."""
        if self.box is not None:
            return self.box
        radius, height = self.cylinder or (0.0, 0.0)
        return radius * 2.0**0.5, radius * 2.0**0.5, height

    @property
    def radius_and_height(self) -> tuple[float, float]:
        """Return radius and height of the canister, or of the upright cylinder in the box [m]."""
        if self.box is not None:
            return min(self.box[:2]) / 2.0, self.box[2]
        return self.cylinder or (0.0, 0.0)

    def fault(self, reason: str) -> CaseError:
        """A fault of the canister."""
        key = "box" if self.box is not None else "cylinder"
        return CaseError([Fault(f"initial.fold.{key}", reason)])

    def holding(self, needed: Floats) -> Fold:
        """Return a canister of this kind and round sizes for its content and a prism of these edges [m]."""
        x, y, z = np.maximum(needed, self.room).tolist()
        if self.box is not None:
            return self.model_copy(update={"box": (_rounded_up(x), _rounded_up(y), _rounded_up(z))})
        return self.model_copy(update={"cylinder": (_rounded_up(max(x, y) / 2.0**0.5), _rounded_up(z))})

    def too_small(self, what: str, fitting: Fold) -> CaseError:
        """The fault of this canister, and what would do instead."""
        key, sizes = ("box", fitting.box) if fitting.box is not None else ("cylinder", fitting.cylinder)
        return self.fault(f"{what}; {key} = [{', '.join(f'{size:.4g}' for size in sizes or ())}] would fit")


@dataclass(frozen=True)
class Folded:
    """A folded net, round the origin.

    position : (n_nodes, 3) [m]
    pleats   : their number, in words
    layers   : of threads, one above the other or one round the other
    size     : (3,) edges of the box round the net, without strings and bullets, threads included [m]
    """

    position: Floats
    pleats: str
    layers: int
    size: Floats


def threads(net: Net) -> Floats:
    """(n_elements,) diameters of circles of the elements' cross sections [m]."""
    return np.sqrt(4.0 / np.pi * net.area)


def mesh_nodes(net: Net) -> np.ndarray:
    """(n,) nodes of the net without those of strings and bullets beyond the corners."""
    return np.unique(net.element_nodes[~net.is_string])


def check_chords(net: Net, position: Floats, fold: Fold) -> None:
    """Raise CaseError if a chord is not 90 to 100 % of its element's reference length."""
    i, j = net.element_nodes.T
    part = np.linalg.norm(position[j] - position[i], axis=1) / net.reference_length
    short = int(np.argmin(part))
    if not part[short] >= LEAST_CHORD - _ROUND_OFF or not part.max() <= 1.0 + _ROUND_OFF:
        ends = f"element {short} between nodes {i[short]} and {j[short]}"
        words = f"{ends} would keep {part[short]:.1%} of its length, less than {LEAST_CHORD:.0%}: "
        raise fold.fault(words + "the layers are too thick for it. Use a larger canister, or thinner threads")


def spread(lay: Callable[[float], Floats], net: Net, fold: Fold) -> float:
    """How far apart layers have to lie [m]: one thread, or as much further as keeps all threads that far.

    lay : from the distance of layers [m] to positions (n_nodes, 3) [m], where strings do not count
    Raises CaseError if threads that share no node come nearer at any distance.
    """
    thread = layer = float(threads(net).max())
    for _ in range(_SPREADS):
        near = nearest(net, lay(layer), thread * (1.0 - THREAD_ROUND_OFF), strings=False)
        if near is None:
            return layer
        layer *= min(thread / near.distance, _FURTHER) if near.distance > 0.0 else _FURTHER
    assert near is not None
    words = f"would be {near.distance:.2g} m apart, less than a thread, however far apart the layers"
    raise _other_pleats(fold, net, near, words)


def check_strings(net: Net, position: Floats, fold: Fold) -> None:
    """Raise CaseError if a string goes through an element that it shares no node with."""
    if near := nearest(net, position, MEET * float(threads(net).max())):
        raise _other_pleats(fold, net, near, "would go through each other")


def _other_pleats(fold: Fold, net: Net, near: NearestElements, words: str) -> CaseError:
    ends = zip(near.elements.tolist(), net.element_nodes[near.elements].tolist(), strict=True)
    one, other = (f"{element} between nodes {i} and {j}" for element, (i, j) in ends)
    advice = "use a canister of other edges, which gives other pleats, or other meshes"
    return fold.fault(f"folded into it, elements {one} and {other} {words}: {advice}")


def _rounded_up(size: float) -> float:
    """To four digits."""
    unit = 10.0 ** (np.floor(np.log10(size)) - 3)
    return float(f"{np.ceil(size / unit * (1.0 - 1e-12)) * unit:.4g}")


_MOST = 500  # lines, in the middle of the net, whose distances are tried as widths
BESIDE = 0.045  # of an element's length: twice as much leaves each 90 % of it, if nothing else takes some


@dataclass(frozen=True)
class Pleats:
    """Values along an axis of the flat net, folded in pleats.

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
            found = [item for item in tried if item is not None and not (even and len(item) % 2)]
            if found:
                return min(
                    found, key=lambda entry: (len(entry), round(abs(entry[0] - low - high + entry[-1]), 9))
                )
    return None


def _to_the_walls(lines: Floats, low: float, high: float, room: float) -> Floats | None:
    """Creases between pleats that each go as far as there is room."""
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
    """Values (k,) folded at the creases `at`.

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


STEEPEST = 0.5  # rise of a bellows, as a part of the way along x
_FURTHEST = (0.5, 0.1)  # of the shortest element: what layers of a bellows are shifted by; tried in turn
_ENLARGED = 8  # canisters that are tried to report one that fits
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
            found, needed = _accordion_folded(net, lines, fold, beside, furthest)
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


def _accordion_folded(
    net: Net, lines: tuple[Floats, Floats], fold: Fold, beside: float, furthest: float
) -> tuple[Folded, Floats]:
    """The net in the widest pleats that the canister allows, and the room (3,) that it needs [m].

    Raises CaseError if an element would not keep its length.
    """
    layer = spread(
        lambda layer: _accordion_laid(net, lines, fold, beside, furthest, layer).position, net, fold
    )
    laid = _accordion_laid(net, lines, fold, beside, furthest, layer)
    position = with_strings(net, laid.position, laid.forward, float(threads(net).max()))
    check_chords(net, position, fold)
    check_strings(net, position, fold)
    x, y = laid.number
    return Folded(position, f"{y} pleats along y, {x} along x", x * y, laid.size), laid.needed


def _accordion_laid(
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


STRAIGHT = 0.95  # of a string's length, between its ends
_ASIDE = 3.0  # threads outward of its corner: where a pleated string turns beside it
_AT_MOST = 0.04  # of an element's length: the same
_TURNS = np.radians(np.arange(5.0, 95.0, 5.0))  # away from outward
_AROUND = np.radians(np.arange(0.0, 360.0, 15.0))


def with_strings(net: Net, position: Floats, forward: Floats, thread: float) -> Floats:
    """Positions (n_nodes, 3) with the strings in place, which leave the corners as they do in the flat net.

    A string of one element is straight, as are those of a bridle, in the plane of its bullet's two; one that
    is divided lies in pleats, its elements a thread apart.

    position : (n_nodes, 3) of the folded net [m]; what it says of strings is not used
    forward  : (n_nodes, 3) 1 or -1 by which an axis of the flat net runs, in the pleat of a corner
    """
    position = position.copy()
    strings = net.element_nodes[net.is_string]
    if not len(strings):
        return position
    chains = _chains(net)
    length = net.reference_length[net.is_string][0]
    order, starts = np.unique(chains[:, 0], return_index=True)
    number = np.bincount(chains[:, 0], minlength=order.max() + 1)[order]
    divisions = chains.shape[1] - 1
    placed = net.element_nodes[~net.is_string]
    for bullet, first, count in zip(order.tolist(), starts.tolist(), number.tolist(), strict=True):
        own = chains[first : first + count]
        corners = own[:, -1]
        outward = _outward(net, bullet, corners, forward)
        pieces = np.stack([own[:, :-1], own[:, 1:]], axis=-1).reshape(-1, 2)
        reach = position[corners[0]] + length * divisions * np.array([[-1.0], [1.0]])
        low, high = position[placed].min(axis=1), position[placed].max(axis=1)
        others = placed[((low < reach[1]) & (high > reach[0])).all(axis=1)]
        strange = (pieces[:, None, :, None] != others[:, None, :]).all(axis=(2, 3))
        clearest, best = -1.0, position
        for way in _ways(outward):
            if count == 1 and divisions > 1:
                position[own[0, ::-1]] = _to_and_fro(position[corners[0]], way, divisions, length, thread)
            else:
                end = _apex(position[corners], way, STRAIGHT * length * divisions)
                part = np.arange(divisions + 1)[:, None] / divisions
                for chain in own:
                    position[chain] = (1.0 - part) * end + part * position[chain[-1]]
            clear = _clear(position[pieces], position[others], strange)
            if clear > clearest:
                clearest, best = clear, position[own]
            if clear >= thread * (1.0 - THREAD_ROUND_OFF):
                break
        position[own] = best
        placed = np.concatenate([placed, pieces])
    return position


def _ways(outward: Floats) -> Iterator[Floats]:
    """Unit vectors (3,): outward, and others round it, the nearest first."""
    yield outward
    across = np.cross(outward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, outward)
    for turn, around in product(_TURNS, _AROUND):
        aside = np.cos(around) * across + np.sin(around) * up
        yield np.cos(turn) * outward + np.sin(turn) * aside


def _clear(pieces: Floats, others: Floats, strange: np.ndarray) -> float:
    """How near pieces of a string (n, 2, 3) come to those threads (m, 2, 3) that are `strange` (n, m) [m]."""
    one, other = np.nonzero(strange)
    return float(between_segments(pieces[one], others[other]).min(initial=np.inf))


def _chains(net: Net) -> Ints:
    """(n_strings, divisions + 1) nodes from the bullet or free end to the corner, bullet by bullet."""
    ends = net.element_nodes[net.is_string]
    begins = np.flatnonzero(np.concatenate([[True], ends[1:, 0] != ends[:-1, 1]]))
    divisions = len(ends) // len(begins)
    chains = np.concatenate([ends[begins, :1], ends[:, 1].reshape(len(begins), divisions)], axis=1)
    return chains[np.argsort(chains[:, 0], kind="stable")]


def _outward(net: Net, bullet: int, corners: Ints, forward: Floats) -> Floats:
    """(3,) unit vector from the corners to the bullet in the flat net, turned as the corners' pleat is."""
    way = net.reference_position[bullet] - net.reference_position[corners].mean(axis=0)
    way = way * forward[corners[0]]
    return np.asarray(way / np.linalg.norm(way))


def _to_and_fro(corner: Floats, outward: Floats, divisions: int, length: float, thread: float) -> Floats:
    """(divisions + 1, 3) from the corner on: outward and back, moved on sideways by a thread each.

    It does not come back to the corner itself, where other threads leave it.
    """
    sideways = np.array([-outward[1], outward[0], 0.0])
    sideways = sideways / math.hypot(*outward[:2]) if sideways.any() else np.array([1.0, 0.0, 0.0])
    chord = 0.5 * (1.0 + STRAIGHT) * length
    reach = math.sqrt(max(chord * chord - thread * thread, 0.0))
    k = np.arange(divisions + 1)[:, None]
    aside = min(_ASIDE * thread, _AT_MOST * length) * (k > 0)
    return np.asarray(corner + np.where(k % 2, reach, aside) * outward + k * thread * sideways)


def _apex(corners: Floats, outward: Floats, length: float) -> Floats:
    """(3,) where strings of a length from one or two corners (n, 3) meet, outward of them."""
    middle = corners.mean(axis=0)
    half = corners[-1] - middle
    across = float(np.linalg.norm(half))
    if across > 0.0:
        outward = outward - (outward @ half) / across**2 * half
        outward = outward / np.linalg.norm(outward)
    height = math.sqrt(max(length * length - across * across, 0.0))
    return np.asarray(middle + height * outward)


def folded(net: Net, keys: NetConfig, fold: Fold) -> Folded:
    """The net that `weave(keys)` gives, folded into its canister.

    Raises CaseError if it does not fit, with a size that would do.
    """
    if fold.pattern == "star" and isinstance(keys, radial.RadialNet):
        return star(net, keys, fold)
    return accordion(net, TOPOLOGIES[keys.topology].fold_lines(keys), fold)


def cross_checks(keys: NetConfig, fold: Fold) -> Iterator[Fault]:
    """A net of this topology can be folded so."""
    if fold.pattern == "accordion" and keys.topology not in _creased():
        known = ", ".join(_creased())
        reason = f"{keys.topology} nets have no lines to crease them along; {known} nets have"
        yield Fault("pattern", reason)
    if fold.pattern == "star":
        if not isinstance(keys, radial.RadialNet):
            why = "a star is creased along spokes"
            if keys.topology == "cut":
                why += ", and a border cut from meshes has no knots there to bend at"
            other = '; use "accordion"' if keys.topology in _creased() else ""
            words = f"{why}: it is for radial nets, not for {keys.topology} ones{other}"
            yield Fault("pattern", words)
        elif keys.spokes % 2:
            reason = f"spokes go in and out in turn: an even number of them, not {keys.spokes}"
            yield Fault("pattern", reason)
        elif keys.spokes < 4:
            yield Fault("pattern", "a star has two arms or more, of two spokes each")


def _creased() -> dict[str, ModuleType]:
    """The topologies whose modules have `fold_lines(keys)`: x, and y, of lines that no side crosses."""
    return {name: module for name, module in TOPOLOGIES.items() if hasattr(module, "fold_lines")}


_KEPT = 0.99  # of lengths, where there is a choice


def star(net: Net, keys: RadialNet, fold: Fold) -> Folded:
    """A radial net with an even number of spokes, folded into the canister.

    Raises CaseError if it does not fit, with a size that would do.
    """
    radius, height = fold.radius_and_height
    room = np.array([2.0 * radius, 2.0 * radius, height]) * (1.0 + 1e-9)
    tried, fault = [], fold.fault("")
    thread = float(threads(net).max())
    for per_pleat in range(keys.rings, 0, -1):
        try:
            _, size = _star_laid(net, keys, per_pleat, thread, fold)
        except CaseError as error:
            fault = error
            continue
        beyond = float((size / room).max())
        tried.append((beyond > 1.0, beyond if beyond > 1.0 else 0.0, -per_pleat))
    # With layers further apart than a thread a star may be wider or lower: one beyond the room may fit too.
    refused: list[Folded] = []
    for _, _, pleat in sorted(tried):
        try:
            found = _star_folded(net, keys, -pleat, fold)
        except CaseError as error:
            fault = error
            continue
        if (found.size <= room).all():
            return found
        refused.append(found)
    if not refused:
        raise fault
    found = min(refused, key=lambda item: float((item.size / room).max()))
    needed = found.size.copy()
    if fold.box is None:  # the radius of a cylinder, not of a prism in it
        needed[:2] *= math.sqrt(0.5)
    words = f"the folded net takes {found.size[0]:.4g} m across and {found.size[2]:.4g} m along the axis"
    raise fold.too_small(words, fold.holding(needed))


def _star_folded(net: Net, keys: RadialNet, per_pleat: int, fold: Fold) -> Folded:
    """The whole net; raises CaseError if its threads are too thick, or it would not keep its lengths."""
    layer = spread(lambda layer: _star_laid(net, keys, per_pleat, layer, fold)[0], net, fold)
    position, size = _star_laid(net, keys, per_pleat, layer, fold)
    position = with_strings(net, position, np.ones_like(position), float(threads(net).max()))
    check_chords(net, position, fold)
    pleats = math.ceil(keys.rings / per_pleat)
    return Folded(position, f"{keys.spokes // 2} arms, {pleats} pleats along the axis", pleats, size)


def _star_laid(net: Net, keys: RadialNet, per_pleat: int, layer: float, fold: Fold) -> tuple[Floats, Floats]:
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


def _knots(keys: RadialNet, per_pleat: int, layer: float) -> Floats | None:
    """(n_knots, 3) places of hub and knots, ring by ring as in `radial.mesh`; None without such places.

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
    """Return the outer of the two points where two circles in a plane meet; None if they do not."""
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
