"""`thrust`: a given force over time on chosen bullets, linear between its knots, zero outside them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.table import Table, counts, numbers, triples


@dataclass(frozen=True)
class Thrust:
    """The same `force` [N] on each of `bullets` (numbers) at `time` [s]; of bodies with torques."""

    bullets: tuple[int, ...]
    time: tuple[float, ...]
    force: tuple[tuple[float, ...], ...]

    def segment(self, t: float) -> int:
        """The number of knots at or before t [s]: in 0 and len(time) the force is zero."""
        return bisect_right(self.time, t)

    def at(self, t: float, segment: int | None = None) -> Floats:
        """The force (3,) [N] at t [s] on one bullet.

        In a `segment` it is that segment's line, also at and beyond its ends: a step that ends at a jump
        must see the force before it.  Without one, t decides; the last knot still belongs to the force.
        """
        if segment is None:
            segment = len(self.time) - 1 if t == self.time[-1] else self.segment(t)
        if not 0 < segment < len(self.time):
            return np.zeros(len(self.force[0]))
        begin, end = self.time[segment - 1 : segment + 1]
        share = (t - begin) / (end - begin)
        return np.asarray(
            (1.0 - share) * np.array(self.force[segment - 1]) + share * np.array(self.force[segment])
        )


def read_thrust(table: Table) -> Thrust:
    """The force over time."""
    return Thrust(table.need("bullets", counts), table.need("time", numbers), table.need("force", triples))
