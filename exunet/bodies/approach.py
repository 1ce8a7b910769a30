"""How near two bodies come to each other between instants at which their states are known.

The distance changes no faster than the surfaces move against each other, which bounds it from below in each
piece of a step (Piyavskii, USSR Comput. Math. Math. Phys. 12 (1972) 57, doi 10.1016/0041-5553(72)90115-2).
Pieces in which the bodies may be nearer than is known are halved, down to a way that is short beside the
bodies; those at the least distance, or where the bodies begin or end to touch, down to a much shorter one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.between import Path
from exunet.bodies.crossing import reach_of
from exunet.bodies.distance import parts_of
from exunet.bodies.shapes import Shape

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Measure = Callable[[Floats, Floats], Floats]  # of poses (n, 7) of two bodies

COARSE, FINE = 0.05, 1e-4  # ways, in least dimensions of the bodies, down to which pieces are halved
_MOST = 40  # halvings
_SAME = 1e-9  # of a step, within which instants are one


@dataclass(frozen=True, eq=False)
class Mover:
    """A body in motion: its path, and its shape from its centre of mass."""

    path: Path
    shape: Shape

    @property
    def reach(self) -> float:
        """Radius of a sphere about the centre of mass that has all of it in it [m]."""
        return reach_of(self.shape)

    @property
    def swing(self) -> float:
        """What turning moves at most: the reach, of a sphere that of its middle [m]."""
        found = [0.0]
        for part in parts_of(self.shape):
            round_ = part.solid is not None and part.solid.kind == "sphere"
            found.append(float(np.linalg.norm(part.middle)) + (0.0 if round_ else part.reach))
        return max(found)

    @property
    def least(self) -> float:
        """The smallest dimension, of all its parts [m]."""
        return least_of(self.shape)

    def during(self, rows: slice) -> Mover:
        """At some of the instants."""
        return replace(self, path=self.path.through(rows))


def least_of(shape: Shape) -> float:
    """The smallest dimension of a shape, of all its parts; of a mesh along the axes of its frame [m]."""
    found = [solid.least for solid in shape.solids]
    if shape.mesh is not None:
        found.append(float(np.ptp(shape.mesh.vertices, axis=0).min()))
    return min(found)


def approach(one: Mover, other: Mover, measure: Measure, *, touching: bool = False) -> tuple[Floats, Floats]:
    """Times (m,) [s], increasing, the instants among them, and what was measured at each (m,) [m].

    measure  : distances, or bounds of them from below where they are above 0; 0: the bodies touch
    touching : look for where they touch only, not for where they are nearest
    """
    a, b = one.path, other.path
    speed = np.linalg.norm(a.velocities - b.velocities, axis=-1).max(axis=0)
    speed = speed + one.swing * a.fastest_turn + other.swing * b.fastest_turn
    size = min(one.least, other.least)
    time, value = a.time, measure(a.poses, b.poses)
    row = np.arange(len(time) - 1)
    begin, end = np.zeros(len(row)), np.ones(len(row))
    at_begin, at_end = value[:-1], value[1:]
    for _ in range(_MOST):
        way = speed[row] * a.step[row] * (end - begin)
        least = float(value.min())
        below = 0.5 * (at_begin + at_end - way) < (0.0 if touching else least)
        edge = (at_begin == 0.0) != (at_end == 0.0)
        beside = _ends_at(a, row, begin, end, float(time[value == least].min())) & (not touching)
        still = way > FINE * size
        kept = still & (below | edge)
        whole = (at_begin == 0.0) & (at_end == 0.0)
        halved = kept & ~whole & ((way > COARSE * size) | edge | beside)
        if not halved.any():
            break
        rows, middle = row[halved], 0.5 * (begin + end)[halved]
        found = measure(a.at(rows, middle), b.at(rows, middle))
        time = np.append(time, a.time[rows] + middle * a.step[rows])
        value = np.append(value, found)
        left = kept & ~halved
        row = np.concatenate([row[left], rows, rows])
        begin, end = (
            np.concatenate([begin[left], begin[halved], middle]),
            np.concatenate([end[left], middle, end[halved]]),
        )
        at_begin, at_end = (
            np.concatenate([at_begin[left], at_begin[halved], found]),
            np.concatenate([at_end[left], found, at_end[halved]]),
        )
    order = np.argsort(time, kind="stable")
    return time[order], value[order]


def _ends_at(path: Path, row: Ints, begin: Floats, end: Floats, time: float) -> Bools:
    """The pieces that begin or end at a time [s]."""
    part, step = time - path.time[row], path.step[row]
    return np.asarray(
        (np.abs(part - begin * step) <= _SAME * step) | (np.abs(part - end * step) <= _SAME * step)
    )
