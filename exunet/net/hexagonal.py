"""The hexagonal topology: a honeycomb of rings of meshes, held at its six corners by bridles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.net.arrays import Floats, Ints, Mesh
from exunet.net.base import MAX_ELEMENTS, ThrownNetConfig
from exunet.net.cut import MeshShape, lines

# Lattice coordinates are whole numbers: x in units of sqrt(3) a / 2, y in units of a / 2. Shared vertices of
# neighbouring cells are then equal exactly.
_VERTICES = np.array([(1, 1), (0, 2), (-1, 1), (-1, -1), (0, -2), (1, -1)])  # at 30, 90, ... 330 degrees
_CORNER_CELLS = np.array([(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)])  # (q, r) / R at 0, 60, ... 300


class HexagonalNet(ThrownNetConfig):
    """A hexagonal net of hexagonal meshes; each of its six bullets hangs on a bridle of two strings."""

    topology: Literal["hexagonal"] = Field(description="honeycomb")
    mesh: Positive = Field(description="side of a hexagonal mesh [m]", examples=[0.5])
    rings: int = Field(
        ge=0, le=MAX_ELEMENTS, description="rings of meshes round the central one", examples=[3]
    )

    @property
    def n_sides(self) -> int:
        return 9 * self.rings**2 + 15 * self.rings + 6

    @property
    def n_corners(self) -> int:
        return 6

    @property
    def n_strings(self) -> int:
        return 2 * self.n_corners

    def faults(self) -> Iterator[Fault]:
        """Require bridles for bullets, long enough to join two corner knots."""
        if self.bullets is not None and self.strings is None:
            yield Fault("bullets", "bullets of a hexagonal net hang on bridles: [net.strings] is required")
        if self.strings is not None and self.strings.length <= self.mesh / 2:
            reason = f"too short for the bridle: must be greater than half of net.mesh, {self.mesh / 2:g} m"
            yield Fault("strings.length", f"{reason}, got {self.strings.length:g}")
        yield from super().faults()


def mesh(keys: HexagonalNet) -> Mesh:
    """Cells |q|, |r|, |q + r| <= R about (sqrt(3) (q + r/2), 3r/2) a; corners at 0, 60, ... 300 degrees."""
    cells = _cells(keys.rings)
    centres = np.stack([2 * cells[:, 0] + cells[:, 1], 3 * cells[:, 1]], axis=1)
    vertices = centres[:, None] + _VERTICES
    base = 6 * keys.rings + 5  # more than any difference of lattice coordinates
    names, loops = np.unique(vertices[..., 1] * base + vertices[..., 0], return_inverse=True)
    loops = loops.reshape(-1, 6)
    lattice = np.zeros((len(names), 3), dtype=np.int64)
    lattice[loops.ravel(), :2] = vertices.reshape(-1, 2)

    pairs = np.sort(np.stack([loops, np.roll(loops, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    side_names = np.unique(pairs[:, 0] * len(names) + pairs[:, 1])
    anchors = _anchors(cells, loops, keys.rings)
    mouth = anchors.ravel()
    return Mesh(
        knots=lattice * (np.array([math.sqrt(3), 1.0, 0.0]) * (keys.mesh / 2)),
        sides=np.stack(np.divmod(side_names, len(names)), axis=1),
        anchors=anchors,
        faces=(loops,),
        mouth=mouth[mouth != np.roll(mouth, -1)],  # the bridles of a single cell share their knots
    )


def fold_lines(keys: HexagonalNet) -> tuple[Floats, Floats]:
    """x, and y, of the lines through knots that no side crosses."""
    reach = 2.0 * (keys.rings + 1) * keys.mesh
    return lines(MeshShape.HEXAGON, keys.mesh, (reach, reach), odd=False)


def _cells(rings: int) -> Ints:
    """(n_cells, 2) axial coordinates (q, r) of the cells."""
    q, r = np.mgrid[-rings : rings + 1, -rings : rings + 1]
    inside = abs(q + r) <= rings
    return np.stack([q[inside], r[inside]], axis=1)


def _anchors(cells: Ints, loops: Ints, rings: int) -> Ints:
    """(6, 2) the two outermost knots of the corner cell in each direction, anticlockwise."""
    wanted = rings * _CORNER_CELLS
    cell = np.argmax((cells == wanted[:, None]).all(axis=2), axis=1)
    k = np.arange(6)
    return np.stack([loops[cell, k - 1], loops[cell, k]], axis=1)
