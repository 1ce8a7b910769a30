"""Effects: one file each, listed here. A table [effects.NAME] in the case switches NAME on.

An effect's module has

- `Keys`, a Table: keys, units, bounds; no default for a physical quantity;
- `terms(keys, blocks)`: what it adds to the equations of motion, a tuple of `KernelTerm`, `LinearTerm` (see
  `exunet.forces.terms`) or `ElementLaw` (`exunet.forces.cable_term`);
- `nominal(basis) -> (Keys, assumption)`: what to assume for an estimate if the case does not have the
  effect; None if nothing can be assumed for this scene;
- `magnitude(keys, basis) -> Estimate`: the order of magnitude of what leaving it out would change;
- if it contradicts other effects or needs them, `EXCLUDES` or `REQUIRES`: their names, with the reasons;
- if it acts on bullets only, `NEEDS_BULLETS = True`; if it gives them their speed, `REPLACES_LAUNCH = True`;
- if keys must be given if and only if there are bullets, `BULLET_KEYS`: their names;
- for whatever else its keys demand of each other and of the rest of the case,
  `cross_checks(keys, rest) -> Iterator[Fault]` (`exunet.base.errors.Fault`; rest is an
  `exunet.forces.requirements.RestOfCase`);
- if it belongs to tests on the ground, `ON_THE_GROUND = True`;
- if it brings a point mass of its own, `point_masses(keys) -> tuple[PointMass, ...]`;
- if it has first-order states, `first_order_states(keys) -> tuple[FirstOrder, ...]`.

Its energy is that of the terms: a potential, or work that is integrated along the run. A new effect is this
module, one line in `_NAMES`, a section of `cases/README.md` and a test.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, create_model

from exunet.base.errors import BeyondFloats, Fault
from exunet.base.faults import each, within
from exunet.base.table import Positive, Table
from exunet.forces.blocks import Blocks, FirstOrder, PointMass
from exunet.forces.requirements import RestOfCase, declared, excluded, required
from exunet.forces.terms import largest_number
from exunet.forces.total import Contribution, Forces

# The modules in this folder, in the order in which a kernel adds their forces. A new effect is a line here.
_NAMES = (
    "gravity",
    "mass_damping",
    "material_damping",
    "orbit",
    "rayleigh_damping",
    "air_drag",
    "bending",
    "breaking",
    "j2",
    "launch_force",
    "molecular_drag",
    "solar_pressure",
    "thermal_strain",
    "thrust",
)
EFFECTS: dict[str, ModuleType] = {name: import_module(f"{__name__}.{name}") for name in _NAMES}


LARGEST = 1e100  # of a number in an effect's terms; products of three are still numbers


def _pairs_schema() -> dict[str, Any]:
    """What effects demand of each other, as a JSON schema."""
    absent: dict[str, dict[str, Any]] = {
        name: {"properties": dict.fromkeys(excluded(module), False)}
        for name, module in EFFECTS.items()
        if excluded(module)
    }
    undamped = {"rayleigh_damping": {"properties": {"beta": {"const": 0}}}}
    absent["breaking"] = {"properties": undamped}
    needed = {name: list(required(module)) for name, module in EFFECTS.items() if required(module)}
    both = {"choose": ["threshold"], "threshold": ["choose"]}
    return {"dependentRequired": both | needed, "dependentSchemas": absent}


class Choice(Table):
    """The effects that are on."""

    model_config = ConfigDict(json_schema_extra=_pairs_schema())

    choose: Literal["auto"] | None = Field(
        None,
        description="each table is a candidate, switched on if its estimate exceeds the threshold",
        examples=["auto"],
    )
    threshold: Positive | None = Field(
        None,
        description="displacement over the scene that matters, as a part of the net's size (for choose)",
        examples=[1e-3],
    )


_fields: dict[str, Any] = {
    name: (module.Keys | None, Field(None, description=(module.Keys.__doc__ or "").strip()))
    for name, module in EFFECTS.items()
}
Effects = create_model("Effects", __base__=Choice, __doc__="The effects that are on.", **_fields)


def switched_on(effects: Table) -> dict[str, Table]:
    """The keys of each effect that has a table: what is on, and under "auto" what may be chosen."""
    return {name: keys for name in EFFECTS if (keys := getattr(effects, name)) is not None}


def cross_checks(scene: Any) -> Iterator[Fault]:
    """What the effects of a Scene demand of each other and of the rest of the case."""
    effects, rest = scene.effects, RestOfCase(scene)
    given = [name for name in EFFECTS if effects.is_given(name)]
    yield from each(
        _threshold(effects),
        *(within(name, declared(EFFECTS[name], name, rest)) for name in given),
        *(within(name, _own(name, rest)) for name in given if hasattr(EFFECTS[name], "cross_checks")),
    )


def _own(name: str, rest: RestOfCase) -> Iterator[Fault]:
    yield from EFFECTS[name].cross_checks(rest.effect(name), rest)


def _threshold(effects: Table) -> Iterator[Fault]:
    if effects.is_given("choose") and not effects.is_given("threshold"):
        yield Fault("", 'choose = "auto" needs threshold, a part of the net\'s size')
    if effects.is_given("threshold") and not effects.is_given("choose"):
        yield Fault("threshold", 'is for choose = "auto" only')


def point_masses(effects: Table) -> tuple[PointMass, ...]:
    """The point masses that effects bring."""
    return tuple(_brought("point_masses", effects))


def first_order_states(effects: Table) -> tuple[FirstOrder, ...]:
    """The first-order states that effects have."""
    return tuple(_brought("first_order_states", effects))


def _brought(what: str, effects: Table) -> Iterator[Any]:
    for name, keys in switched_on(effects).items():
        yield from getattr(EFFECTS[name], what, lambda _: ())(keys)


def forces_of(effects: Table, blocks: Blocks) -> Forces:
    """The cable elements and the terms of all effects that are on."""
    parts = [terms_of(name, keys, blocks) for name, keys in switched_on(effects).items()]
    return Forces.of(blocks.net, itertools.chain.from_iterable(parts))


def terms_of(name: str, keys: Table, blocks: Blocks) -> tuple[Contribution, ...]:
    """The terms of one effect; raises BeyondFloats if a number in them is beyond `LARGEST`."""
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused below
            terms: tuple[Contribution, ...] = EFFECTS[name].terms(keys, blocks)
            sound = largest_number(number for term in terms for number in term.numbers()) <= LARGEST
    except ArithmeticError:
        sound = False
    if not sound:
        raise beyond_floats(name)
    return terms


def beyond_floats(name: str) -> BeyondFloats:
    """The error for an effect whose numbers cannot be computed with."""
    words = "leads to numbers outside the range of floating-point: give it, or the scene, realistic values"
    return BeyondFloats([Fault(f"effects.{name}", words)])
