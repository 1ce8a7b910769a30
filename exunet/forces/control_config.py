"""`[control]` of a case: corner units, bullets with thrusters, and the controller that commands them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import FromArray, NonNegative, Number, Positive, Record, Vector, increasing, once
from exunet.forces.requirements import RestOfCase, existing_body, existing_bullets

MOST_SAMPLES = 1_000_000
_SAME = 1e-9  # of the largest offset: a mean that counts as zero


class Noise(Record):
    """Errors of the units' sensors: normal, independent in each axis, of each unit, at each sample."""

    position: NonNegative = Field(description="standard deviation of a coordinate [m]", examples=[0.01])
    velocity: NonNegative = Field(
        description="standard deviation of a component of the velocity [m/s]", examples=[0.005]
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(description="seed of the noise", examples=[1])


class Control(Record):
    """Corner units, bullets with thrusters, commanded at a period; subclasses are the controllers."""

    kind: str
    bullets: Annotated[tuple[Number, ...], FromArray] = Field(
        min_length=1, description="numbers of the bullets that are units, from 0", examples=[[0, 1]]
    )
    period: Positive = Field(
        description="time between two samples [s]; the forces are constant in between; at most "
        "1,000,000 samples",
        examples=[0.1],
    )
    largest_thrust: Positive = Field(description="limit of the thrust of each unit [N]", examples=[1.0])
    minimum_impulse: NonNegative = Field(
        0.0, description="thrusts of less impulse in a period are not fired [N s]"
    )
    specific_impulse: Positive | None = Field(
        None,
        description="specific impulse, for the propellant spent [s]; the mass of the unit is constant",
        examples=[220.0],
    )
    direction: Literal["any", "flight", "outward"] = Field(
        "any",
        description="any; flight: along the unit's velocity, either way; outward: along the line from the "
        "units' mean to the unit, either way",
    )
    start: NonNegative = Field(
        0.0, description="time of the first sample [s]; not with a script that starts the control"
    )
    noise: Noise | None = Field(None, description="errors of the units' sensors")

    def faults(self) -> Iterator[Fault]:
        """Require each unit once, a mean of two units for `outward`, and thrusters that can fire."""
        yield from once("bullets", self.bullets)
        if self.direction == "outward" and len(self.bullets) < 2:
            yield Fault("direction", "outward is from the mean of the units: it requires at least two")
        most = self.largest_thrust * self.period
        if self.minimum_impulse > most:
            words = f"no thrust is ever fired: the largest gives {most:g} N s in a period"
            yield Fault("minimum_impulse", words, against=("largest_thrust", "period"))

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return None


class PointControl(Control):
    """Units go to a point, or to a body."""

    EXACTLY_ONE: ClassVar = ("point", "body")

    kind: Literal["point"] = Field(description="to a point or a body", examples=["point"])
    point: Vector | None = Field(None, description="target position, at rest [m]", examples=[[0.0, 0.0, 5.0]])
    body: str | None = Field(
        None, description="name of the body whose centre of mass is the target", examples=["target"]
    )
    offset: Vector | None = Field(
        None,
        description="with body: added to its centre of mass, in the scene's axes [m]",
        examples=[[0.0, 0.0, 1.0]],
    )
    stiffness: NonNegative = Field(description="k, force per distance from the target [N/m]", examples=[1.0])
    damping: NonNegative = Field(
        description="c, force per velocity relative to the target [N s/m]", examples=[2.0]
    )

    def faults(self) -> Iterator[Fault]:
        """Require a body for an offset from its centre."""
        yield from super().faults()
        if self.offset is not None and self.body is None:
            yield Fault("offset", "is from the centre of a body: give body, or add it to point")

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return self.body


class FormationControl(Control):
    """Units go to places about their mean, or about a body."""

    kind: Literal["formation"] = Field(description="to places about the units' mean, or about a body")
    offsets: Annotated[tuple[Vector, ...], FromArray] = Field(
        description="target position of each unit from the centre of mass of the body, or from the "
        "units' mean, in the scene's axes [m]; without a body their mean is zero",
        examples=[[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]],
    )
    body: str | None = Field(
        None,
        description="name of the body that the formation surrounds; absent: the units' mean",
        examples=["target"],
    )
    stiffness: NonNegative = Field(description="k, force per distance from the target [N/m]", examples=[1.0])
    damping: NonNegative = Field(
        description="c, force per velocity relative to the target [N s/m]", examples=[2.0]
    )

    def faults(self) -> Iterator[Fault]:
        """Require an offset for each unit, of zero mean without a body."""
        yield from super().faults()
        if len(self.offsets) != len(self.bullets):
            words = f"requires a vector for each of the {len(self.bullets)} units, got {len(self.offsets)}"
            yield Fault("offsets", words)
        elif self.body is None:
            places = np.array(self.offsets)
            mean = places.mean(axis=0)
            if np.abs(mean).max() > _SAME * np.abs(places).max():
                words = "their mean must be zero without body, since they are from the units' mean"
                yield Fault("offsets", f"{words}; it is {mean}")

    @property
    def target(self) -> str | None:
        """Name of the body that the units go to; None: no body."""
        return self.body


class TableControl(Control):
    """Forces over time."""

    kind: Literal["table"] = Field(description="forces over time")
    time: Annotated[tuple[NonNegative, ...], FromArray] = Field(
        min_length=2,
        description="times [s], at least two, increasing; the force is zero before the first and "
        "after the last",
        examples=[[0.0, 0.5]],
    )
    force: Annotated[tuple[Annotated[tuple[Vector, ...], FromArray], ...], FromArray] = Field(
        min_length=2,
        description="at each of these times a force on each unit [N], linear in between",
        examples=[[[[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]],
    )

    def faults(self) -> Iterator[Fault]:
        """Require increasing times, and a force on each unit at each time."""
        yield from super().faults()
        yield from increasing("time", self.time)
        if len(self.force) != len(self.time):
            words = f"requires forces for each of the {len(self.time)} times, got {len(self.force)}"
            yield Fault("force", words)
        for k, forces in enumerate(self.force):
            if len(forces) != len(self.bullets):
                words = f"requires a vector for each of the {len(self.bullets)} units, got {len(forces)}"
                yield Fault(f"force[{k}]", words)


class GivenControl(Control):
    """A function from Python."""

    kind: Literal["given"] = Field(description="a function, Simulation(case, controller=function)")


AnyControl = Annotated[
    PointControl | FormationControl | TableControl | GivenControl, Field(discriminator="kind")
]


def cross_checks(keys: Control, rest: RestOfCase, *, scripted: bool) -> Iterator[Fault]:
    """Require units and bodies that exist, and samples within the run.

    scripted : an entry of the script begins the control
    """
    if not rest.has_bullets:
        yield Fault("", "commands bullets, and the net has none: add [net.bullets] or remove this table")
    yield from existing_bullets(keys.bullets, rest)
    yield from existing_body("body", keys.target, rest)
    if scripted and keys.is_given("start"):
        yield Fault("start", "an entry of the script begins the control: remove it, or this key")
    if keys.start >= rest.duration:
        yield Fault("start", f"must be before time.end, {rest.duration:g} s, got {keys.start:g} s")
    number = rest.duration / keys.period
    if number > MOST_SAMPLES:
        words = f"to {rest.duration:g} s these are {number:.3g} samples; at most {MOST_SAMPLES:,} are allowed"
        yield Fault("period", words)
