"""What a folded net is, and the canister that it has to fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import CaseError, Fault
from exunet.base.table import FromArray, Positive, Table
from exunet.net.arrays import Floats, Net
from exunet.net.meeting import nearest

MEET = 1e-7  # threads between the middles of two: they go through each other, to round-off
LEAST_CHORD = 0.9  # of an element's reference length, in a folded net
_ROUND_OFF = 1e-9


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

    def too_small(self, what: str, needed: Sequence[float]) -> CaseError:
        """The fault of a canister that does not hold `needed`, the edges of a prism in it [m]."""
        x, y, z = needed
        sizes = (x, y, z) if self.box is not None else (max(x, y) / 2.0**0.5, z)
        key = "box" if self.box is not None else "cylinder"
        return self.fault(f"{what}; {key} = {_list(sizes)} would fit")


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


def check_threads(net: Net, position: Floats, fold: Fold, thread: float) -> None:
    """Raise CaseError if elements go through each other that share no node."""
    if found := nearest(net, position, MEET * thread):
        one, other = (
            f"{element} between nodes {i} and {j}"
            for element, (i, j) in zip(
                found.elements.tolist(), net.element_nodes[found.elements].tolist(), strict=True
            )
        )
        words = f"folded into it, elements {one} and {other} would go through each other: use a canister of "
        raise fold.fault(words + "other edges, which gives other pleats, or other meshes")


def _list(sizes: Sequence[float]) -> str:
    """Sizes [m] as a list of TOML, rounded up to three digits."""
    return "[" + ", ".join(f"{_rounded_up(size):.4g}" for size in sizes) + "]"


def _rounded_up(size: float) -> float:
    unit = 10.0 ** (np.floor(np.log10(size)) - 3)
    return float(np.ceil(size / unit * (1.0 - 1e-12)) * unit)
