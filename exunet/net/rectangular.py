"""The rectangular topology: a grid of cables with one spacing along x and one along y."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import FromArray, Positive
from exunet.net.arrays import Floats, Mesh
from exunet.net.base import ThrownNetConfig, mesh_divides, meshes

Pair = Annotated[tuple[Positive, Positive], FromArray]


class RectangularNetConfig(ThrownNetConfig):
    """A rectangular net of rectangular meshes, with a bullet at each of its four corners."""

    topology: Literal["rectangular"] = Field(description="grid with a spacing along x and another along y")
    size: Pair = Field(description="edges of the net along x and y [m]", examples=[[5.0, 4.0]])
    mesh: Pair = Field(
        description="edges of a mesh along x and y [m]; each divides its size", examples=[[1.0, 0.5]]
    )

    @property
    def n_sides(self) -> int:
        nx, ny = map(meshes, self.size, self.mesh)
        return nx * (ny + 1) + ny * (nx + 1)

    @property
    def n_corners(self) -> int:
        return 4

    def faults(self) -> Iterator[Fault]:
        """Require meshes that divide the size along both axes."""
        for axis, (size, spacing) in enumerate(zip(self.size, self.mesh, strict=True)):
            yield from mesh_divides(f"mesh[{axis}]", size, spacing)
        yield from super().faults()


def mesh(keys: RectangularNetConfig) -> Mesh:
    """The grid on [-Lx/2, Lx/2] x [-Ly/2, Ly/2]; see `grid`."""
    return grid(keys.size, keys.mesh)


def fold_lines(keys: RectangularNetConfig) -> tuple[Floats, Floats]:
    """x, and y, of the threads."""
    return grid_lines(keys.size, keys.mesh)


def grid_lines(size: tuple[float, float], spacing: tuple[float, float]) -> tuple[Floats, Floats]:
    """x, and y, of the threads of a grid, from the middle out exactly symmetric [m]."""
    nx, ny = map(meshes, size, spacing)
    return _line(nx, size[0]), _line(ny, size[1])


def _line(count: int, length: float) -> Floats:
    return np.asarray((np.arange(count + 1) - count / 2) * (length / count), dtype=np.float64)


def grid(size: tuple[float, float], spacing: tuple[float, float]) -> Mesh:
    """Knots row by row from the corner (-, -), sides along x, then along y; corners anticlockwise from there.

    size, spacing : edges of the net and of a mesh [m]
    """
    x, y = grid_lines(size, spacing)
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
