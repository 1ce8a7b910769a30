"""`[control]` of a case: corner units, bullets with thrusters, and the controller that commands them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, field_validator

from exunet.base.errors import Fault
from exunet.base.faults import each, increasing
from exunet.base.table import FromArray, NonNegative, Positive, Table, Vector
from exunet.forces.requirements import RestOfCase, chosen_bullets

KINDS = ("table", "point", "formation", "given")
NEEDS: dict[str, tuple[str, ...]] = {
    "table": ("time", "force"),
    "point": ("stiffness", "damping"),
    "formation": ("offsets", "stiffness", "damping"),
    "given": (),
}
MAY_HAVE = {"point": ("point", "body", "offset"), "formation": ("body",)}
OF_KINDS = ("time", "force", "point", "body", "offset", "offsets", "stiffness", "damping")
MOST_SAMPLES = 1_000_000
_SAME = 1e-9  # of the largest offset: a mean that is none


def _only(kind: str) -> dict[str, Any]:
    """The keys of a kind, as a JSON schema."""
    others = set(OF_KINDS) - {*NEEDS[kind], *MAY_HAVE.get(kind, ())}
    rule: dict[str, Any] = {"properties": {"kind": {"const": kind}} | dict.fromkeys(sorted(others), False)}
    if NEEDS[kind]:
        rule["required"] = list(NEEDS[kind])
    if kind == "point":
        rule["anyOf"] = [{"required": ["point"]}, {"required": ["body"]}]
        rule["not"] = {"required": ["point", "body"]}
        rule["dependentRequired"] = {"offset": ["body"]}
    return rule


class Noise(Table):
    """Errors of the units' sensors: normal, independent in each axis, of each unit, at each sample."""

    position: NonNegative = Field(description="standard deviation of a coordinate [m]", examples=[0.01])
    velocity: NonNegative = Field(description="of a component of the velocity [m/s]", examples=[0.005])
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(description="of these random numbers", examples=[1])


class Control(Table):
    """Corner units: bullets with thrusters, commanded at a period."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [_only(kind) for kind in KINDS]})

    bullets: Annotated[tuple[Annotated[int, Field(ge=0)], ...], FromArray] = Field(
        min_length=1, description="numbers of the bullets that are units, from 0", examples=[[0, 1]]
    )
    kind: Literal["table", "point", "formation", "given"] = Field(
        description="table: forces over time; point: to a point or a body; formation: to places about the "
        "units' mean or a body; given: by a function, from Python only",
        examples=["point"],
    )
    period: Positive = Field(
        description="between two samples, of which each sets forces that stay until the next [s]",
        examples=[0.1],
    )
    largest_thrust: Positive = Field(description="of each unit [N]", examples=[1.0])
    minimum_impulse: NonNegative = Field(
        0.0, description="of each unit: a thrust that gives less in a period is not fired [N s]"
    )
    specific_impulse: Positive | None = Field(
        None, description="for the propellant that is spent [s]; the mass of the unit stays as it is"
    )
    direction: Literal["any", "flight", "outward"] = Field(
        "any",
        description="any; flight: along the unit's velocity, either way; outward: along the line from the "
        "units' mean to the unit, either way",
    )
    start: NonNegative = Field(0.0, description="first sample [s]")
    noise: Noise | None = Field(None, description="errors of the units' sensors")
    time: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        min_length=2,
        description="table: times [s], increasing; no force before the first and after the last",
        examples=[[0.0, 0.5]],
    )
    force: Annotated[tuple[Annotated[tuple[Vector, ...], FromArray], ...], FromArray] | None = Field(
        None,
        min_length=2,
        description="table: at each of these times a force on each unit [N], linear in between",
        examples=[[[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]],
    )
    point: Vector | None = Field(
        None, description="point: place at rest that the units go to [m]", examples=[[0.0, 0.0, 5.0]]
    )
    body: str | None = Field(
        None,
        description="point, formation: name of the body to whose centre of mass, or about which, they go",
        examples=["target"],
    )
    offset: Vector | None = Field(None, description="point: added to the centre of the body [m]")
    offsets: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        description="formation: place of each unit from the body's centre, or from the units' mean [m]",
        examples=[[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]],
    )
    stiffness: NonNegative | None = Field(
        None, description="point, formation: force per distance from the place [N/m]", examples=[1.0]
    )
    damping: NonNegative | None = Field(
        None, description="point, formation: force per velocity relative to the place [N s/m]", examples=[2.0]
    )

    @field_validator("kind", mode="before")
    @classmethod
    def _no_path(cls, kind: Any) -> Any:
        if isinstance(kind, str) and ("." in kind or ":" in kind):
            raise ValueError(
                'a case names no function: give kind = "given", and the function from Python, as '
                "Simulation(case, controller=function)"
            )
        return kind


def cross_checks(keys: Control, rest: RestOfCase, *, scripted: bool) -> Iterator[Fault]:
    """The keys that the kind needs, and no other; units, bodies and samples that there are.

    scripted : an entry of the script begins the control
    """
    yield from each(
        _has_bullets(rest),
        chosen_bullets(keys.bullets, rest),
        _of_kind(keys),
        _table(keys),
        _goal(keys),
        _places(keys),
        _body(keys, rest),
        _outward(keys),
        _fires_at_all(keys),
        _begins(keys, rest, scripted=scripted),
        _samples(keys, rest),
    )


# In these lists None stands for an item that is not valid.


def _has_bullets(rest: RestOfCase) -> Iterator[Fault]:
    if not rest.has_bullets:
        yield Fault("", "commands bullets, and the net has none: add [net.bullets] or remove this table")


def _of_kind(keys: Control) -> Iterator[Fault]:
    may = {*NEEDS[keys.kind], *MAY_HAVE.get(keys.kind, ())}
    for name in NEEDS[keys.kind]:
        if not keys.is_given(name):
            yield Fault("", f'needs {name}, for kind = "{keys.kind}"')
    for name in OF_KINDS:
        if keys.is_given(name) and name not in may:
            yield Fault(name, f'is not for kind = "{keys.kind}"')


def _table(keys: Control) -> Iterator[Fault]:
    if keys.time is None or keys.force is None:
        return
    yield from increasing("time", keys.time)
    if len(keys.force) != len(keys.time):
        words = f"needs forces for each of the {len(keys.time)} times, got {len(keys.force)}"
        yield Fault("force", words)
    for k, forces in enumerate(keys.force):
        if forces is not None and len(forces) != len(keys.bullets):
            words = f"needs a vector for each of the {len(keys.bullets)} units, got {len(forces)}"
            yield Fault(f"force[{k}]", words)


def _goal(keys: Control) -> Iterator[Fault]:
    if keys.kind != "point":
        return
    if keys.is_given("point") == keys.is_given("body"):
        yield Fault("", 'needs either point or body, for kind = "point"')
    elif keys.is_given("offset") and not keys.is_given("body"):
        yield Fault("offset", "is from the centre of a body: give body, or add it to point")


def _places(keys: Control) -> Iterator[Fault]:
    if keys.kind != "formation" or keys.offsets is None:
        return
    if len(keys.offsets) != len(keys.bullets):
        words = f"needs a vector for each of the {len(keys.bullets)} units, got {len(keys.offsets)}"
        yield Fault("offsets", words)
        return
    if keys.is_given("body") or None in keys.offsets:
        return
    places = np.array(keys.offsets)
    mean = places.mean(axis=0)
    if np.abs(mean).max() > _SAME * np.abs(places).max():
        words = f"their mean must be zero without body, since they are from the units' mean; it is {mean}"
        yield Fault("offsets", words)


def _body(keys: Control, rest: RestOfCase) -> Iterator[Fault]:
    if keys.body is not None and keys.body not in rest.bodies:
        known = ", ".join(rest.bodies) or "none"
        yield Fault("body", f'there is no body "{keys.body}" (bodies: {known})')


def _outward(keys: Control) -> Iterator[Fault]:
    if keys.direction == "outward" and len(keys.bullets) < 2:
        yield Fault("direction", "outward is from the mean of the units, of which there must be two at least")


def _fires_at_all(keys: Control) -> Iterator[Fault]:
    most = keys.largest_thrust * keys.period
    if keys.minimum_impulse > most:
        words = f"no thrust is ever fired: the largest gives {most:g} N s in a period"
        yield Fault("minimum_impulse", words, against=("control.largest_thrust", "control.period"))


def _begins(keys: Control, rest: RestOfCase, *, scripted: bool) -> Iterator[Fault]:
    if scripted and keys.is_given("start"):
        yield Fault("start", "an entry of the script begins the control: remove it, or this key")
    if keys.start >= rest.duration:
        yield Fault("start", f"must be before time.end, {rest.duration:g} s, got {keys.start:g} s")


def _samples(keys: Control, rest: RestOfCase) -> Iterator[Fault]:
    number = rest.duration / keys.period
    if number > MOST_SAMPLES:
        words = f"to {rest.duration:g} s these are {number:.3g} samples; at most {MOST_SAMPLES:,} are allowed"
        yield Fault("period", words, against=("time.end",))
