"""The rectangular topology: a grid of cables with one spacing along x and one along y."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Count, FromArray, Positive
from exunet.net.arrays import Floats, Mesh
from exunet.net.base import ThrownNetConfig, mesh_divides, meshes

Pair = Annotated[tuple[Positive, Positive], FromArray]


class RectangularNet(ThrownNetConfig):
    """A rectangular net of rectangular meshes, with a bullet at each of its four corners."""

    EXACTLY_ONE: ClassVar = ("mesh", "meshes")

    topology: Literal["rectangular"] = Field(description="grid with a spacing along x and another along y")
    size: Pair = Field(description="edges of the net along x and y [m]", examples=[[5.0, 4.0]])
    mesh: Pair | None = Field(
        None, description="edges of a mesh along x and y [m]; each divides its size", examples=[[1.0, 0.5]]
    )
    meshes: Annotated[tuple[Count, Count], FromArray] | None = Field(
        None, description="numbers of meshes along x and y, instead of mesh", examples=[[5, 8]]
    )

    @property
    def counts(self) -> tuple[int, int]:
        """Meshes along x and y; ValueError if the mesh does not divide the size."""
        mesh, given = self.mesh or (None, None), self.meshes or (None, None)
        return meshes(self.size[0], mesh[0], given[0]), meshes(self.size[1], mesh[1], given[1])

    @property
    def n_sides(self) -> int:
        nx, ny = self.counts
        return nx * (ny + 1) + ny * (nx + 1)

    @property
    def n_corners(self) -> int:
        return 4

    def faults(self) -> Iterator[Fault]:
        """Require meshes that divide the size along both axes."""
        for axis, spacing in enumerate(self.mesh or ()):
            yield from mesh_divides(f"mesh[{axis}]", self.size[axis], spacing)
        yield from super().faults()


def mesh(keys: RectangularNet) -> Mesh:
    """The grid on [-Lx/2, Lx/2] x [-Ly/2, Ly/2]; see `grid`."""
    return grid(keys.size, keys.counts)


def fold_lines(keys: RectangularNet) -> tuple[Floats, Floats]:
    """x, and y, of the threads."""
    return grid_lines(keys.size, keys.counts)


def grid_lines(size: tuple[float, float], counts: tuple[int, int]) -> tuple[Floats, Floats]:
    """x, and y, of the threads of a grid, from the middle out exactly symmetric [m]."""
    return _line(counts[0], size[0]), _line(counts[1], size[1])


def _line(count: int, length: float) -> Floats:
    return np.asarray((np.arange(count + 1) - count / 2) * (length / count), dtype=np.float64)


def grid(size: tuple[float, float], counts: tuple[int, int]) -> Mesh:
    """Knots row by row from the corner (-, -), sides along x, then along y; corners anticlockwise from there.

    size, counts : edges of the net [m], and meshes along each
    """
    x, y = grid_lines(size, counts)
    nx, ny = len(x) - 1, len(y) - 1
    number = np.arange((nx + 1) * (ny + 1)).reshape(ny + 1, nx + 1)
    knots = np.zeros((number.size, 3))
    knots[:, 0] = np.tile(x, ny + 1)
    knots[:, 1] = np.repeat(y, nx + 1)
    along_x = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
    along_y = np.stack([number[:-1], number[1:]], axis=-1).reshape(-1, 2)
    loops = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    corners = number[[0, 0, -1, -1], [0, -1, -1, 0]]
    return Mesh(
        knots,
        np.concatenate([along_x, along_y]),
        corners[:, None],
        faces=(loops.reshape(-1, 4),),
        mouth=corners,
    )
