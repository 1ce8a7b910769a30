"""The radial topology: spokes from a hub, joined by rings of straight cables, as in a spider's web."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from exunet.base.record import Positive
from exunet.net.arrays import Mesh
from exunet.net.base import MAX_ELEMENTS, ThrownNetConfig


class RadialNet(ThrownNetConfig):
    """A polygonal net of spokes and rings, with a bullet at the end of each spoke."""

    topology: Literal["radial"] = Field(description="spokes and rings")
    radius: Positive = Field(description="length of a spoke [m]", examples=[2.5])
    spokes: Annotated[int, Field(ge=3, le=MAX_ELEMENTS)] = Field(description="number of spokes", examples=[8])
    rings: Annotated[int, Field(ge=1, le=MAX_ELEMENTS)] = Field(description="number of rings", examples=[5])

    @property
    def n_sides(self) -> int:
        return 2 * self.spokes * self.rings

    @property
    def n_corners(self) -> int:
        return self.spokes


def mesh(keys: RadialNet) -> Mesh:
    """The hub, then the knots ring by ring, anticlockwise from spoke 0 on the x axis; spokes before rings."""
    angle = 2 * np.pi * np.arange(keys.spokes) / keys.spokes
    distance = keys.radius * np.arange(1, keys.rings + 1) / keys.rings
    knots = np.zeros((1 + keys.rings * keys.spokes, 3))
    knots[1:, 0] = np.outer(distance, np.cos(angle)).ravel()
    knots[1:, 1] = np.outer(distance, np.sin(angle)).ravel()

    number = 1 + np.arange(keys.rings * keys.spokes).reshape(keys.rings, keys.spokes)
    following = np.roll(number, -1, axis=1)
    inward = np.concatenate([np.zeros_like(number[:1]), number[:-1]])
    spokes = np.stack([inward, number], axis=-1).reshape(-1, 2)
    rings = np.stack([number, following], axis=-1).reshape(-1, 2)
    triangles = np.stack([inward[0], number[0], following[0]], axis=-1)
    quadrangles = np.stack([number[:-1], number[1:], following[1:], following[:-1]], axis=-1).reshape(-1, 4)
    rim = number[-1]
    return Mesh(
        knots, np.concatenate([spokes, rings]), rim[:, None], faces=(triangles, quadrangles), mouth=rim
    )
