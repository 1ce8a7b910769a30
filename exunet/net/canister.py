"""What a folded net is, and the canister that it has to fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import CaseError, Fault
from exunet.base.table import FromArray, Positive, Table
from exunet.net.arrays import Floats, Net
from exunet.net.meeting import NearestElements, nearest

MEET = 1e-7  # threads between the middles of two: they go through each other, to round-off
THREAD_ROUND_OFF = 1e-6  # of a thread
LEAST_CHORD = 0.9  # of an element's reference length, in a folded net
_ROUND_OFF = 1e-9
_SPREADS = 12  # distances of layers that are tried
_FURTHER = 2.0  # by how much a distance grows at most


class Fold(Table):
    """How the net is folded at the start, and into what; its axis is z, the direction of the throw."""

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
        """Of the canister, or of the upright cylinder in the box [m]."""
        if self.box is not None:
            return min(self.box[:2]) / 2.0, self.box[2]
        return self.cylinder or (0.0, 0.0)

    def fault(self, reason: str) -> CaseError:
        """A fault of the canister."""
        key = "box" if self.box is not None else "cylinder"
        return CaseError([Fault(f"initial.fold.{key}", reason)])

    def holding(self, needed: Floats) -> Fold:
        """Of this kind and of round sizes: it holds what this one does, and a prism of these edges [m]."""
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
