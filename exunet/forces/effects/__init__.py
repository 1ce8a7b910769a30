"""Effects: one file each, listed here. A table [effects.NAME] in the case switches NAME on.

An effect's module has

- its record, `AirDrag` in `air_drag`: keys, units, bounds; no default for a physical quantity; where
  there are alternatives, `AnyAirDrag`, a tagged union of its subclasses;
- `terms(keys, blocks)`: what it adds to the equations of motion, a tuple of `KernelTerm`, `LinearTerm` (see
  `exunet.forces.terms`) or `ElementLaw` (`exunet.forces.cable_term`);
- `nominal(basis) -> (AirDrag, assumption)`: what to assume for an estimate if the case does not have
  the effect; None if nothing can be assumed for this scene;
- `magnitude(keys, basis) -> Estimate`: the order of magnitude of what leaving it out would change;
- if it contradicts other effects or needs them, `EXCLUDES` or `REQUIRES`: their names, with the reasons;
- if keys of other effects must be zero beside it, `NEEDS_ZERO`: for each effect its keys, with the reasons;
- if its events change the forces suddenly, `NEEDS_FRESH_STEPS = True`: methods whose steps use the
  acceleration of the step before are refused;
- if it acts on bullets only, `NEEDS_BULLETS = True`; if it gives them their speed, `REPLACES_LAUNCH = True`;
- if keys must be given if and only if there are bullets, `BULLET_KEYS`: their names;
- if keys do not go with a net that a body carries, `NOT_CARRIED`: their names, with the reasons;
- if tethers on reels, or an edge that becomes shorter (`closing.kind = "perimeter"`), cannot have it,
  `not_with_reels(keys)` and `not_with_perimeter(keys)`: the reason, "" if these keys go with them;
- what its keys require of each other in `faults` of the record; of other tables of the case in
  `cross_checks(keys, rest) -> Iterator[Fault]` (`exunet.base.errors.Fault`; rest is an
  `exunet.forces.requirements.RestOfCase`, of a valid scene);
- if it would act on rigid bodies too, but only does on the net, `ON_THE_NET_ALONE = True`, which runs report;
- if nothing outside of the scene gets what it gives, `internal(keys)`, which then is True: it has no line in
  the momentum balance;
- if its terms press on rigid bodies, `touched_bodies(keys)`, the names of those whose surfaces they need
  (`Blocks.surfaces`), `largest_radius(keys, net)` of what touches them [m], and `touching_pairs(keys)`, the
  pairs of names of those that touch each other;
- if it belongs to tests on the ground, `ON_THE_GROUND = True`;
- if it is numerical damping, which is never advised, `NUMERICAL = True`;
- if it brings a point mass of its own, `point_masses(keys) -> tuple[PointMass, ...]`;
- if it has first-order states, `first_order_states(keys) -> tuple[FirstOrder, ...]`.

Its energy is that of the terms: a potential, or work that is integrated along the run. A new effect is this
module, one line in `_NAMES`, its equation in `docs/explanation/theory_effects.md`, and a test.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from types import ModuleType
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, create_model

from exunet.base.errors import LARGEST, CaseError, Fault, joining, within
from exunet.base.record import Positive, Record, class_name, config_of
from exunet.forces.blocks import Blocks, FirstOrder, PointMass
from exunet.forces.from_outside import counted, effects_of
from exunet.forces.requirements import RestOfCase, declared
from exunet.forces.terms import largest_number
from exunet.forces.total import Contribution, Forces
from exunet.net.arrays import Floats, Net

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
    "contact",
    "j2",
    "launch_force",
    "molecular_drag",
    "self_contact",
    "solar_pressure",
    "thermal_strain",
    "thrust",
)
EFFECTS: dict[str, ModuleType] = {name: import_module(f"{__name__}.{name}") for name in _NAMES}


class Choice(Record):
    """The effects that are on."""

    TABLE: ClassVar = "effects"
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

    def faults(self) -> Iterator[Fault]:
        """Require choose and threshold together."""
        if self.choose is not None and self.threshold is None:
            yield Fault("threshold", 'missing: choose = "auto" requires it, a part of the net\'s size')
        if self.threshold is not None and self.choose is None:
            yield Fault("threshold", 'is for choose = "auto" only')


_fields: dict[str, Any] = {
    name: (
        config_of(module) | None,
        Field(None, description=(getattr(module, class_name(module)).__doc__ or "").strip()),
    )
    for name, module in EFFECTS.items()
}
Effects = create_model("Effects", __base__=Choice, __doc__="The effects that are on.", **_fields)


def switched_on(effects: Record) -> dict[str, Record]:
    """The keys of each effect that has a table: what is on, and under "auto" what may be chosen."""
    return {name: keys for name in EFFECTS if (keys := getattr(effects, name)) is not None}


def cross_checks(scene: Any) -> Iterator[Fault]:
    """Yield the contradictions of the effects of a valid scene with each other and with its other tables."""
    rest = RestOfCase(scene)
    for name, keys in switched_on(scene.effects).items():
        yield from within(name, declared(EFFECTS[name], name, rest))
        if hasattr(EFFECTS[name], "cross_checks"):
            yield from within(name, EFFECTS[name].cross_checks(keys, rest))


def on_the_net_alone(effects: Record) -> tuple[str, ...]:
    """Names of the effects that leave rigid bodies out, though they would act on them."""
    return tuple(name for name in switched_on(effects) if getattr(EFFECTS[name], "ON_THE_NET_ALONE", False))


def point_masses(effects: Record) -> tuple[PointMass, ...]:
    """The point masses that effects bring."""
    return tuple(_brought("point_masses", effects))


def first_order_states(effects: Record) -> tuple[FirstOrder, ...]:
    """The first-order states that effects have."""
    return tuple(_brought("first_order_states", effects))


def _brought(what: str, effects: Record) -> Iterator[Any]:
    for name, keys in switched_on(effects).items():
        yield from getattr(EFFECTS[name], what, lambda _: ())(keys)


def touches_bodies(name: str) -> bool:
    """True if an effect presses on rigid bodies."""
    return hasattr(EFFECTS[name], "touched_bodies")


def _touching(effects: Record) -> Iterator[tuple[ModuleType, Any]]:
    """Modules and keys of the effects that press on rigid bodies."""
    return ((EFFECTS[name], keys) for name, keys in switched_on(effects).items() if touches_bodies(name))


def touched_bodies(effects: Record) -> frozenset[str]:
    """Names of the rigid bodies that something touches."""
    return frozenset(name for module, keys in _touching(effects) for name in module.touched_bodies(keys))


def touching_pairs(effects: Record) -> frozenset[frozenset[str]]:
    """Pairs of names of the rigid bodies that touch each other."""
    found = (pair for module, keys in _touching(effects) for pair in module.touching_pairs(keys))
    return frozenset(frozenset(pair) for pair in found)


def largest_touching_radius(effects: Record, net: Net) -> float:
    """Of what touches bodies, in the sense of `touched_bodies` [m]."""
    return max((module.largest_radius(keys, net) for module, keys in _touching(effects)), default=0.0)


def from_outside(effects: Record) -> tuple[str, ...]:
    """Names of the effects that give the scene momentum, or angular momentum."""
    on = switched_on(effects).items()
    return tuple(name for name, keys in on if not getattr(EFFECTS[name], "internal", lambda _: False)(keys))


def breaking_limits(effects: Record, net: Net) -> Floats | None:
    """(n_elements,) axial force at which each element breaks [N]; None if none does."""
    on = switched_on(effects)
    if "breaking" not in on:
        return None
    warm: Any = on.get("thermal_strain")
    limits: Floats = EFFECTS["breaking"].limits(on["breaking"], net, warm.free_strain if warm else 0.0)
    return limits


def forces_of(effects: Record, blocks: Blocks, faults: list[Fault]) -> Forces:
    """The cable elements and the terms of all effects that are on.

    Those with states for what they give (`exunet.forces.from_outside`) keep it there.
    faults : takes those of effects whose numbers cannot be computed with; these have no terms
    """
    terms: list[Contribution] = []
    kept = effects_of(state.name for state in blocks.states)
    for name, keys in switched_on(effects).items():
        with joining(faults):
            own = terms_of(name, keys, blocks)
            terms += counted(name, own, blocks) if name in kept else own
    return Forces.of(blocks.net, terms)


def terms_of(name: str, keys: Record, blocks: Blocks) -> tuple[Contribution, ...]:
    """The terms of one effect; raises CaseError if a number in them is beyond `LARGEST`."""
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused below
            terms: tuple[Contribution, ...] = EFFECTS[name].terms(keys, blocks)
            sound = largest_number(number for term in terms for number in term.numbers()) <= LARGEST
    except ArithmeticError:
        sound = False
    if not sound:
        raise beyond_floats(name)
    return terms


def beyond_floats(name: str) -> CaseError:
    """The error for an effect whose numbers cannot be computed with."""
    words = "leads to numbers outside the range of floating-point: give it, or the scene, realistic values"
    return CaseError([Fault(f"effects.{name}", words, beyond_floats=True)])
