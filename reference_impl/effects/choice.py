"""The effects of a case: their record, the reader of `[effects]`, and which of them contradict each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from reference_impl.arrays import Vector
from reference_impl.effects.air_drag import AirDrag, read_air_drag
from reference_impl.effects.bending import Bending, read_bending
from reference_impl.effects.breaking import Breaking, read_breaking
from reference_impl.effects.contact import Contact, read_contact
from reference_impl.effects.earth import EARTH_RADIUS
from reference_impl.effects.frame import Frame
from reference_impl.effects.j2 import J2, read_j2
from reference_impl.effects.launch_force import LaunchForce, read_launch_force
from reference_impl.effects.molecular_drag import MolecularDrag, read_molecular_drag
from reference_impl.effects.orbit import Orbit, read_orbit
from reference_impl.effects.self_contact import SelfContact, read_self_contact
from reference_impl.effects.solar_pressure import SolarPressure, read_solar_pressure
from reference_impl.effects.thermal_strain import ThermalStrain, read_thermal_strain
from reference_impl.effects.thrust import Thrust, read_thrust
from reference_impl.table import Table, number, numbers, refusal

_SAME = 1e-9  # relative difference of two radii, and of two unit vectors, that is none

CONTRADICTIONS = (
    ("orbit", "gravity"),
    ("orbit", "air_drag"),
    ("air_drag", "molecular_drag"),
    ("gravity", "molecular_drag"),
    ("gravity", "solar_pressure"),
    ("breaking", "bending"),
    ("breaking", "self_contact"),
)


@dataclass(frozen=True)
class Effects:
    """What acts on a net beside its elasticity; an absent effect is zero or None."""

    alpha: float = 0.0  # rayleigh_damping [1/s], eq. (13)
    beta: float = 0.0  # rayleigh_damping [s], eq. (13)
    gravity: Vector = (0.0, 0.0, 0.0)  # [m/s2]
    mass_damping: float = 0.0  # [1/s]
    relaxation_time: float = 0.0  # tau of material_damping [s]
    orbit: Orbit | None = None
    j2: J2 | None = None
    molecular_drag: MolecularDrag | None = None
    air_drag: AirDrag | None = None
    solar_pressure: SolarPressure | None = None
    bending: Bending | None = None
    breaking: Breaking | None = None
    thermal_strain: ThermalStrain | None = None
    launch_force: LaunchForce | None = None
    thrust: Thrust | None = None
    contact: Contact | None = None
    self_contact: SelfContact | None = None


@dataclass(frozen=True)
class Surroundings:
    """What the effects must know of the rest of a case; None where that could not be read."""

    bullets: int | None  # how many there are
    end: float | None  # of the scene [s]
    thrown: bool  # by `[launch]`


def read_effects(table: Table, around: Surroundings) -> Effects:
    """Reads and closes the table `[effects]`; values that are faulty have their lines in `table.faults`."""
    for key in ("choose", "threshold"):
        if key in table.values:
            table.seen.add(key)
            table.faults.append(
                refusal(
                    table.name(key),
                    "the case format has no rule by which the displacement of an effect is estimated; here"
                    " every table under [effects] is on, leave out those not wanted",
                )
            )
    names = ("rayleigh_damping", "gravity", "mass_damping", "material_damping", *_READERS)
    tables = {name: table.table(name, required=False) for name in names}
    rayleigh, gravity = tables["rayleigh_damping"], tables["gravity"]
    mass, material = tables["mass_damping"], tables["material_damping"]
    effects = Effects(
        rayleigh.need("alpha", number(0.0)) if rayleigh else 0.0,
        rayleigh.need("beta", number(0.0)) if rayleigh else 0.0,
        gravity.need("acceleration", numbers(3)) if gravity else (0.0, 0.0, 0.0),
        mass.need("alpha", number(0.0)) if mass else 0.0,
        material.need("relaxation_time", number(0.0)) if material else 0.0,
        **{name: read(tables[name], around) for name, read in _READERS.items() if tables[name]},
    )
    present = {name for name, inner in tables.items() if inner}
    table.faults.extend(_contradictions(effects, present, around))
    for inner in (*tables.values(), table):
        inner.close()
    return effects


_READERS: dict[str, Callable[[Table, Surroundings], Any]] = {
    "orbit": lambda table, around: read_orbit(table),
    "j2": lambda table, around: read_j2(table, around.end),
    "molecular_drag": lambda table, around: read_molecular_drag(table, around.bullets != 0),
    "air_drag": lambda table, around: read_air_drag(table, around.bullets != 0),
    "solar_pressure": lambda table, around: read_solar_pressure(table, around.bullets != 0),
    "bending": lambda table, around: read_bending(table),
    "breaking": lambda table, around: read_breaking(table),
    "thermal_strain": lambda table, around: read_thermal_strain(table),
    "launch_force": lambda table, around: read_launch_force(table, around.bullets != 0),
    "thrust": lambda table, around: read_thrust(table, around.bullets),
    "contact": lambda table, around: read_contact(table, around.bullets != 0),
    "self_contact": lambda table, around: read_self_contact(table),
}


def _contradictions(effects: Effects, present: set[str], around: Surroundings) -> list[str]:
    """Faults between effects that are each well formed."""
    faults = [
        f"effects.{one} and effects.{other} contradict each other: leave one out"
        for one, other in CONTRADICTIONS
        if {one, other} <= present
    ]
    if "launch_force" in present and around.thrown:
        faults.append("effects.launch_force and launch contradict each other: leave one out")
    if "breaking" in present and effects.beta:
        faults.append(
            "effects.breaking and effects.rayleigh_damping.beta contradict each other: set beta to 0,"
            " it would damp along broken elements too"
        )
    if "j2" in present and "orbit" not in present:
        faults.append("effects.j2: needs effects.orbit")
    return faults + _disagreements(effects)


def _disagreements(effects: Effects) -> list[str]:
    """Heights or directions that differ between `orbit`, `j2` and `molecular_drag`."""
    faults = []
    radii = {
        f"effects.{name}": frame.radius
        for name, frame in (("orbit", effects.orbit), ("j2", effects.j2))
        if frame is not None
    }
    if effects.molecular_drag is not None and effects.molecular_drag.altitude is not None:
        radii["effects.molecular_drag"] = EARTH_RADIUS + effects.molecular_drag.altitude
    named = list(radii.items())
    for place, (name, radius) in enumerate(named):
        for other, its in named[:place]:
            if not abs(radius - its) <= _SAME * its:
                faults.append(
                    f"{name}: its height, {radius - EARTH_RADIUS:.10g} m, must be that of {other},"
                    f" {its - EARTH_RADIUS:.10g} m"
                )
    if effects.orbit is not None and effects.j2 is not None:
        faults += [
            f"effects.j2.{key}: must be that of effects.orbit"
            for key in ("radial", "along_track")
            if not _alike(effects.orbit, effects.j2, key)
        ]
    return faults


def _alike(one: Frame, other: Frame, key: str) -> bool:
    """Whether two unit vectors agree."""
    return all(abs(a - b) <= _SAME for a, b in zip(getattr(one, key), getattr(other, key), strict=True))
