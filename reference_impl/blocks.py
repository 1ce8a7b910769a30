"""What a body's surface is made of: boxes and balls, each in its place, rounded for contact.

A rounded box is all points within rho of a smaller box, its core, whose faces lie rho deeper; a ball is one
whose core has no size.  So both are cores with three half-widths, of which some may be zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from reference_impl.arrays import Floats


@dataclass(frozen=True, eq=False)
class Block:
    """A solid of a body by its kind; of boxes and spheres half the widths (3,) [m] along its own axes."""

    kind: str
    half: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))  # columns, in the body's frame
    centre: Floats = field(default_factory=lambda: np.zeros(3))  # [m] in the body's frame

    def moved(self, attitude: Floats, position: Floats) -> Block:
        """Turned by a rotation (3, 3), then shifted by (3,) [m]."""
        return replace(self, axes=attitude @ self.axes, centre=attitude @ self.centre + position)

    def rounding(self, edge_radius: float) -> float:
        """rho [m], that of a body's `edge_radius` [m]."""
        return float(self.half[0]) if self.kind == "sphere" else edge_radius
