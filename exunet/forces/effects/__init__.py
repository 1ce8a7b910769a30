"""Effects: one file each, listed here. A table [effects.NAME] in the case switches NAME on.

An effect is the class of its table, `AirDrag` in `air_drag`; where there are alternatives, `AnyAirDrag` is
the tagged union of its subclasses. `exunet.forces.effect.Effect` lists what a class may declare and override.
A new effect is this module, one line in `_NAMES`, its equation in `docs/explanation/theory_effects.md`, and
a test.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field, create_model

from exunet.base.errors import LARGEST, CaseError, Fault, joining, within
from exunet.base.record import Positive, Record, class_name, config_of
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect, RestOfCase
from exunet.forces.from_outside import counted, effects_of
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
    "contact",
    "j2",
    "launch_force",
    "molecular_drag",
    "self_contact",
    "solar_pressure",
    "thermal_strain",
    "thrust",
)
_MODULES = {name: import_module(f"{__name__}.{name}") for name in _NAMES}
EFFECTS: dict[str, type[Effect]] = {
    name: getattr(module, class_name(module)) for name, module in _MODULES.items()
}
Kind = TypeVar("Kind", bound=Effect)


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

    @property
    def on(self) -> dict[str, Effect]:
        """Effects that have a table, by name: what is on, and under "auto" what may be chosen."""
        return {name: effect for name in EFFECTS if (effect := getattr(self, name)) is not None}

    def get(self, kind: type[Kind]) -> Kind | None:
        """Return the effect of a class; None if it has no table."""
        return next((effect for effect in self.on.values() if isinstance(effect, kind)), None)

    @property
    def free_strain(self) -> float:
        """Green-Lagrange strain of the free length of all cables."""
        return sum(effect.free_strain for effect in self.on.values())

    @property
    def touching_pairs(self) -> frozenset[frozenset[str]]:
        """Pairs of names of the rigid bodies that touch each other."""
        return frozenset(frozenset(pair) for effect in self.on.values() for pair in effect.touching_pairs())


_fields: dict[str, Any] = {
    name: (config_of(_MODULES[name]) | None, Field(None, description=(kind.__doc__ or "").strip()))
    for name, kind in EFFECTS.items()
}
Effects = create_model("Effects", __base__=Choice, __doc__="The effects that are on.", **_fields)


def cross_checks(scene: Any) -> Iterator[Fault]:
    """Yield the contradictions of the effects of a valid scene with each other and with its other tables."""
    for name, effect in scene.effects.on.items():
        yield from within(name, effect.contradictions(RestOfCase(scene)))


def forces_of(effects: Choice, blocks: Blocks, faults: list[Fault]) -> Forces:
    """Return the cable elements and the terms of all effects that are on.

    Those with states for what they give (`exunet.forces.from_outside`) keep it there.
    faults : takes those of effects whose numbers cannot be computed with; these have no terms
    """
    terms: list[Contribution] = []
    kept = effects_of(state.name for state in blocks.states)
    for name, effect in effects.on.items():
        with joining(faults):
            own = terms_of(name, effect, blocks)
            terms += counted(name, own, blocks) if name in kept else own
    return Forces.of(blocks.net, terms)


def terms_of(name: str, effect: Effect, blocks: Blocks) -> tuple[Contribution, ...]:
    """Return the terms of one effect; raises CaseError if a number in them is beyond `LARGEST`."""
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused below
            terms = effect.terms(blocks)
            sound = largest_number(number for term in terms for number in term.numbers()) <= LARGEST
    except ArithmeticError:
        sound = False
    if not sound:
        raise beyond_floats(name)
    return terms


def beyond_floats(name: str) -> CaseError:
    """Return the error for an effect whose numbers cannot be computed with."""
    words = "leads to numbers outside the range of floating-point: give it, or the scene, realistic values"
    return CaseError([Fault(f"effects.{name}", words, beyond_floats=True)])
