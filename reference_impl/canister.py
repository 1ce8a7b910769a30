"""The record of `[initial.fold]` and its reader: how a net is folded, and what it is folded into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.shape import Explicit, Radial, Shape
from reference_impl.table import Table, numbers, one_of_names

PATTERNS = ("accordion", "star")


@dataclass(frozen=True, eq=False)
class Places:
    """Where another program's fold puts nodes: reference positions and places, (n, 3) [m], net's axes."""

    reference_position: Floats
    place: Floats


@dataclass(frozen=True)
class Fold:
    """A pattern and the canister round the origin: edges along x, y, z [m], or radius and height along z.

    `places` that are given stand in for those found here; they keep the same rules, or are refused.
    """

    pattern: str
    box: tuple[float, ...] | None
    cylinder: tuple[float, ...] | None
    places: Places | None = None

    @property
    def room(self) -> Floats:
        """The widths (3,) [m] along x, y, z, of a cylinder those through its axis."""
        if self.box is not None:
            return np.array(self.box)
        assert self.cylinder is not None
        radius, height = self.cylinder
        return np.array([2.0 * radius, 2.0 * radius, height])

    @property
    def prism(self) -> Floats:
        """Edges (3,) [m] of the upright prism in the canister, of a cylinder a square one."""
        if self.cylinder is None:
            return self.room
        return self.room * np.sqrt([0.5, 0.5, 1.0])

    def holds(self, place: Floats, d: float) -> bool:
        """Whether threads of a thickness d [m] through places (n, 3) [m] about the origin lie inside."""
        within = bool(np.all(2.0 * np.abs(place).max(axis=0) + d <= self.room * (1.0 + 1e-12)))
        if self.cylinder is None or not within:
            return within
        return bool(np.hypot(place[:, 0], place[:, 1]).max() + 0.5 * d <= self.cylinder[0] * (1.0 + 1e-12))


def read_fold(table: Table) -> Fold | None:
    """Reads and closes the table; None where it is absent, or with faults noted where it cannot be read."""
    if not table:
        return None
    pattern = table.need("pattern", one_of_names(*PATTERNS))
    box = table.get("box", numbers(3, above=0.0), None)
    cylinder = table.get("cylinder", numbers(2, above=0.0), None)
    table.close()
    if ("box" in table.values) == ("cylinder" in table.values):
        table.faults.append(
            f"{table.path}: give exactly one of {table.name('box')} and {table.name('cylinder')}"
        )
        return None
    return None if pattern is None or (box is None and cylinder is None) else Fold(pattern, box, cylinder)


def fold_faults(fold: Fold, shape: Shape) -> list[str]:
    """Why a net of this shape has no such fold."""
    if fold.pattern == "star":
        if not isinstance(shape, Radial):
            return ["initial.fold.pattern: a star is of radial nets"]
        if shape.spokes is not None and (shape.spokes % 2 or shape.spokes < 4):
            return [
                f"initial.fold.pattern: a star needs an even number of spokes, at least 4, not {shape.spokes}"
            ]
    elif isinstance(shape, Radial | Explicit):
        return ["initial.fold.pattern: an accordion is of square, rectangular, hexagonal and cut nets"]
    return []
