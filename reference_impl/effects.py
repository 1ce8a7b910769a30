"""The effects of a case: their record and the reader of `[effects]` (cases/README.md, section Effects)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from reference_impl.table import Table, number, numbers, refusal, text

Vector = tuple[float, float, float]

EARTH_MU = 3.986004418e14  # [m3/s2]
EARTH_RADIUS = 6378137.0  # [m], equatorial
_UNIT = 1e-9  # how far a unit vector may be from length 1 and from being orthogonal to the other


@dataclass(frozen=True)
class Orbit:
    """Hill's frame on a circular orbit: the axes of the scene turn with n about `normal`."""

    mean_motion: float  # n [rad/s]
    radial: Vector  # unit vector away from Earth's centre
    normal: Vector  # unit vector of the orbit's angular momentum, radial x along-track
    two_body: bool  # the full relative motion; else Clohessy and Wiltshire's linear one

    @property
    def radius(self) -> float:
        """R = (mu / n^2)^(1/3) [m]."""
        return float(np.cbrt(EARTH_MU / self.mean_motion**2))


@dataclass(frozen=True)
class Effects:
    """What acts on a net beside its elasticity; an absent effect is zero or None."""

    alpha: float = 0.0  # rayleigh_damping [1/s], eq. (13)
    beta: float = 0.0  # rayleigh_damping [s], eq. (13)
    gravity: Vector = (0.0, 0.0, 0.0)  # [m/s2]
    mass_damping: float = 0.0  # [1/s]
    relaxation_time: float = 0.0  # tau of material_damping [s]
    orbit: Orbit | None = None


def read_effects(table: Table) -> Effects:
    """Reads and closes the table `[effects]`; values that are faulty have their lines in `table.faults`."""
    rayleigh, gravity, mass, material, orbit = (
        table.table(name, required=False)
        for name in ("rayleigh_damping", "gravity", "mass_damping", "material_damping", "orbit")
    )
    effects = Effects(
        rayleigh.need("alpha", number(0.0)) if rayleigh else 0.0,
        rayleigh.need("beta", number(0.0)) if rayleigh else 0.0,
        gravity.need("acceleration", numbers(3)) if gravity else (0.0, 0.0, 0.0),
        mass.need("alpha", number(0.0)) if mass else 0.0,
        material.need("relaxation_time", number(0.0)) if material else 0.0,
        _orbit(orbit) if orbit else None,
    )
    for inner in (rayleigh, gravity, mass, material, orbit, table):
        inner.close()
    return effects


def _orbit(table: Table) -> Any:
    """The orbit; None with faults noted where it cannot be read."""
    altitude = table.get("altitude", number(above=0.0), None)
    mean_motion = table.get("mean_motion", number(above=0.0), None)
    if ("altitude" in table.seen) == ("mean_motion" in table.seen):
        table.faults.append(
            f"{table.path}: give exactly one of {table.path}.altitude and {table.path}.mean_motion"
        )
    radial, along = table.need("radial", numbers(3)), table.need("along_track", numbers(3))
    model = table.need("model", text)
    if model is not None and model not in ("linear", "two_body"):
        table.faults.append(refusal(f'{table.path}.model = "{model}"', "it knows linear, two_body"))
    if altitude is not None:
        mean_motion = math.sqrt(EARTH_MU / (EARTH_RADIUS + altitude) ** 3)
    if radial is None or along is None or mean_motion is None:
        return None
    for key, vector in (("radial", radial), ("along_track", along)):
        if not abs(math.hypot(*vector) - 1.0) <= _UNIT:
            table.faults.append(f"{table.path}.{key}: must be of length 1, not {math.hypot(*vector):.12g}")
    if not abs(math.fsum(a * b for a, b in zip(radial, along, strict=True))) <= _UNIT:
        table.faults.append(f"{table.path}.along_track: must be orthogonal to {table.path}.radial")
    normal = tuple(np.cross(radial, along).tolist())
    return Orbit(mean_motion, radial, normal, model == "two_body")
