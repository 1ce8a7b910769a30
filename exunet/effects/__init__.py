"""Effects: one file each, listed here. A table [effects.NAME] in the case switches NAME on.

A new effect is a module with `Keys` (a Record: keys, units, bounds) and `terms(keys, net) -> Terms`, and one
line in `EFFECTS`.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

from pydantic import Field, create_model

from exunet.effects import gravity, mass_damping, material_damping, orbit, rayleigh_damping
from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.record import Record

EFFECTS: dict[str, ModuleType] = {
    "gravity": gravity,
    "mass_damping": mass_damping,
    "material_damping": material_damping,
    "orbit": orbit,
    "rayleigh_damping": rayleigh_damping,
}

_fields: dict[str, Any] = {
    name: (module.Keys | None, Field(None, description=(module.Keys.__doc__ or "").strip()))
    for name, module in EFFECTS.items()
}
Effects = create_model("Effects", __base__=Record, __doc__="The effects that are on.", **_fields)


def switched_on(effects: Record) -> dict[str, Record]:
    """The keys of each effect that the case switches on."""
    return {name: keys for name in EFFECTS if (keys := getattr(effects, name)) is not None}


def total_terms(effects: Record, net: Net) -> Terms:
    """Sum of the terms of all effects that are on."""
    total = Terms()
    for name, keys in switched_on(effects).items():
        total = total + EFFECTS[name].terms(keys, net)
    return total
