"""Hill's frame on a circular orbit, as `orbit` and `j2` state it in the scene's axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reference_impl.arrays import Vector
from reference_impl.effects.earth import EARTH_MU, EARTH_RADIUS
from reference_impl.effects.values import one_of, unit_vector
from reference_impl.table import Table, number

_ORTHOGONAL = 1e-9
_FARTHEST, _SLOWEST = 1e50, 1e-60  # [m], [rad/s]: beyond, powers of them leave the range of numbers


@dataclass(frozen=True)
class Frame:
    """A circular orbit: mean motion n [rad/s] and two unit vectors of Hill's frame in the scene's axes."""

    mean_motion: float
    radial: Vector  # away from Earth's centre
    along_track: Vector

    @cached_property
    def normal(self) -> Vector:
        """Unit vector of the orbit's angular momentum, radial x along-track."""
        x, y, z = np.cross(self.radial, self.along_track).tolist()
        return (x, y, z)

    @cached_property
    def radius(self) -> float:
        """R = (mu / n^2)^(1/3) [m]."""
        return float(np.cbrt(EARTH_MU / self.mean_motion**2))


def read_frame(table: Table) -> Frame | None:
    """The four keys of a frame; None with faults noted where they cannot be read."""
    size = one_of(table, {"altitude": number(above=0.0), "mean_motion": number(above=0.0)})
    mean_motion, altitude = size["mean_motion"], size["altitude"]
    radial, along = unit_vector(table, "radial"), unit_vector(table, "along_track")
    if altitude is not None:
        mean_motion = math.sqrt(EARTH_MU / (EARTH_RADIUS + altitude) ** 3) if altitude < _FARTHEST else 0.0
    if mean_motion is not None and not _SLOWEST < mean_motion < 1.0 / _SLOWEST:
        table.faults.append(
            f"{table.path}: no orbit has this {'mean_motion' if altitude is None else 'altitude'}"
        )
        return None
    if radial is None or along is None or mean_motion is None:
        return None
    if not abs(math.fsum(a * b for a, b in zip(radial, along, strict=True))) <= _ORTHOGONAL:
        table.faults.append(f"{table.path}.along_track: must be orthogonal to {table.path}.radial")
    return Frame(mean_motion, radial, along)
