"""The square topology: a square grid of cables, the net of the paper's Fig. 3."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.net.arrays import Floats, Mesh
from exunet.net.base import ThrownNetConfig, mesh_divides, meshes
from exunet.net.rectangular import grid, grid_lines


class SquareNetConfig(ThrownNetConfig):
    """A square net of square meshes, with a bullet at each of its four corners."""

    topology: Literal["square"] = Field(description="square grid")
    size: Positive = Field(description="edge of the net [m]", examples=[5.0])
    mesh: Positive = Field(description="edge of a mesh [m]; divides size", examples=[1.0])

    @property
    def n_sides(self) -> int:
        n = meshes(self.size, self.mesh)
        return 2 * n * (n + 1)

    @property
    def n_corners(self) -> int:
        return 4

    def faults(self) -> Iterator[Fault]:
        """Require a mesh that divides the size."""
        yield from mesh_divides("mesh", self.size, self.mesh)
        yield from super().faults()


def fold_lines(keys: SquareNetConfig) -> tuple[Floats, Floats]:
    """x, and y, of the threads."""
    return grid_lines((keys.size, keys.size), (keys.mesh, keys.mesh))


def mesh(keys: SquareNetConfig) -> Mesh:
    """The grid on [-L/2, L/2]^2; corners anticlockwise from (-, -)."""
    return grid((keys.size, keys.size), (keys.mesh, keys.mesh))
