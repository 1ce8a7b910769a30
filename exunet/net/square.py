"""The square topology: a square grid of cables, the net of the paper's Fig. 3."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Count, Positive
from exunet.net.arrays import Floats, Mesh
from exunet.net.base import ThrownNetConfig, mesh_divides, meshes
from exunet.net.rectangular import grid, grid_lines


class SquareNet(ThrownNetConfig):
    """A square net of square meshes, with a bullet at each of its four corners."""

    EXACTLY_ONE: ClassVar = ("mesh", "meshes")

    topology: Literal["square"] = Field(description="square grid")
    size: Positive = Field(description="edge of the net [m]", examples=[5.0])
    mesh: Positive | None = Field(None, description="edge of a mesh [m]; divides size", examples=[1.0])
    meshes: Count | None = Field(
        None, description="number of meshes along an edge, instead of mesh", examples=[5]
    )

    @property
    def count(self) -> int:
        """Meshes along an edge; ValueError if the mesh does not divide the size."""
        return meshes(self.size, self.mesh, self.meshes)

    @property
    def n_sides(self) -> int:
        return 2 * self.count * (self.count + 1)

    @property
    def n_corners(self) -> int:
        return 4

    def faults(self) -> Iterator[Fault]:
        """Require a mesh that divides the size."""
        if self.mesh is not None:
            yield from mesh_divides("mesh", self.size, self.mesh)
        yield from super().faults()


def fold_lines(keys: SquareNet) -> tuple[Floats, Floats]:
    """x, and y, of the threads."""
    return grid_lines((keys.size, keys.size), (keys.count, keys.count))


def mesh(keys: SquareNet) -> Mesh:
    """The grid on [-L/2, L/2]^2; corners anticlockwise from (-, -)."""
    return grid((keys.size, keys.size), (keys.count, keys.count))
