"""The effects of the case format (theory_effects.md): their record and the reader of `[effects]`.

Each law has a module with its record, reader and equation.  They know arrays and the record of a net, nothing
of how a system is put together or integrated.  Rayleigh, mass and material damping are parts of the elements'
law: see `reference_impl.forces`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from reference_impl.arrays import Vector
from reference_impl.effects.bending import Bending
from reference_impl.effects.breaking import Breaking
from reference_impl.effects.contact import Contact, SelfContact, read_contact, read_self_contact
from reference_impl.effects.drag import AirDrag, MolecularDrag, read_air_drag, read_molecular_drag
from reference_impl.effects.launch_force import LaunchForce, read_launch_force
from reference_impl.effects.orbit import J2, Orbit, read_j2, read_orbit
from reference_impl.effects.solar_pressure import SolarPressure, read_solar_pressure
from reference_impl.effects.thermal_strain import ThermalStrain, read_thermal_strain
from reference_impl.effects.thrust import Thrust, read_thrust
from reference_impl.table import Table, number, triple, unknown


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


_READERS: dict[str, Callable[[Table], Any]] = {
    "orbit": read_orbit,
    "j2": read_j2,
    "molecular_drag": read_molecular_drag,
    "air_drag": read_air_drag,
    "solar_pressure": read_solar_pressure,
    "bending": lambda table: Bending(table.need("modulus", number)),
    "breaking": lambda table: Breaking(*(table.get(key, number, None) for key in ("strain", "force"))),
    "thermal_strain": read_thermal_strain,
    "launch_force": read_launch_force,
    "thrust": read_thrust,
    "contact": read_contact,
    "self_contact": read_self_contact,
    "gravity": lambda table: table.need("acceleration", triple),
    "rayleigh_damping": lambda table: [table.need(key, number) for key in ("alpha", "beta")],
    "mass_damping": lambda table: table.need("alpha", number),
    "material_damping": lambda table: table.need("relaxation_time", number),
}


def read_effects(table: Table | None) -> Effects:
    """Reads `[effects]`; every table in it is on."""
    if table is None:
        return Effects()
    for key in ("choose", "threshold"):
        if key in table:
            why = "the case format has no rule by which the displacement of an effect is estimated"
            raise unknown(table.name(key), why)
    found: dict[str, Any] = {}
    for name, read in _READERS.items():
        if (inner := table.optional(name)) is not None:
            found[name] = read(inner)
            inner.close()
    table.close()
    found["alpha"], found["beta"] = found.pop("rayleigh_damping", (0.0, 0.0))
    found["relaxation_time"] = found.pop("material_damping", 0.0)
    return Effects(**found)
