"""The square topology: a square grid of cables, the net of the paper's Fig. 3."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from exunet.base.table import Positive
from exunet.net.arrays import Mesh
from exunet.net.base import ThrownNetTable, meshes
from exunet.net.rectangular import grid


class Keys(ThrownNetTable):
    """A square net of square meshes, with a bullet at each of its four corners."""

    topology: Literal["square"] = Field(description="square grid")
    size: Positive = Field(description="edge of the net [m]", examples=[5.0])
    mesh: Positive = Field(description="edge of a mesh [m]; divides size", examples=[1.0])

    @field_validator("mesh")
    @classmethod
    def _divides_the_size(cls, mesh: float, others: ValidationInfo) -> float:
        if "size" in others.data:
            meshes(others.data["size"], mesh)
        return mesh

    @property
    def n_sides(self) -> int:
        n = meshes(self.size, self.mesh)
        return 2 * n * (n + 1)

    @property
    def n_strings(self) -> int:
        return 4


def mesh(keys: Keys) -> Mesh:
    """The grid on [-L/2, L/2]^2; corners anticlockwise from (-, -)."""
    return grid((keys.size, keys.size), (keys.mesh, keys.mesh))
