"""`thrust`: a given force over time on chosen bullets, linear between its knots, zero outside them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reference_impl.arrays import Floats, Vector
from reference_impl.table import Table, counts, numbers, triples


@dataclass(frozen=True)
class Thrust:
    """The same `force` [N] on each of `bullets` (numbers), given at `time` [s]."""

    bullets: tuple[int, ...]
    time: tuple[float, ...]
    force: tuple[Vector, ...]

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
            return np.zeros(3)
        begin, end = self.time[segment - 1 : segment + 1]
        share = (t - begin) / (end - begin)
        return np.asarray(
            (1.0 - share) * np.array(self.force[segment - 1]) + share * np.array(self.force[segment])
        )


def read_thrust(table: Table, bullets: int | None) -> Thrust | None:
    """The force over time; None with faults noted where it cannot be read.  `bullets`: how many, if known."""
    chosen = table.need("bullets", counts)
    time, force = table.need("time", numbers(None, minimum=0.0)), table.need("force", triples)
    if bullets == 0:
        table.faults.append(f"{table.path}: needs net.bullets")
    if chosen is not None:
        if len(set(chosen)) < len(chosen):
            table.faults.append(f"{table.name('bullets')}: must name each bullet once")
        if bullets and (outside := [b for b in chosen if b >= bullets]):
            table.faults.append(
                f"{table.name('bullets')}: there is no bullet {outside[0]}, they go from 0 to {bullets - 1}"
            )
    if time is not None and (len(time) < 2 or any(b <= a for a, b in pairwise(time))):
        table.faults.append(f"{table.name('time')}: must be at least two times that increase")
    if time is not None and force is not None and len(time) != len(force):
        table.faults.append(f"{table.name('force')}: {len(force)} vectors for {len(time)} times")
    if chosen is None or time is None or force is None:
        return None
    return Thrust(chosen, time, force)
