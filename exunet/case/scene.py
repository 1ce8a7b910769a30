"""The scene: what a case file says, as frozen records in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from exunet.base.faults import Wrong, refuse_too
from exunet.base.incomplete import Unknown
from exunet.base.table import FromArray, NonNegative, Positive, Table, Vector, check, exactly_one
from exunet.forces.effects import Effects as _Effects
from exunet.forces.effects import misfits
from exunet.methods.methods import Solver
from exunet.net import NetKeys, common_faults, explicit
from exunet.net.base import ThrownNetTable, other_length

if TYPE_CHECKING:  # made from the registry of effects, which a type checker cannot follow
    Effects = Table
else:
    Effects = _Effects

MAX_STATES = 10_000_000
SHORTEST = 1e-9  # [s]
LINE_BREAK = r"[\n\r\u000b\u000c\u001c-\u001e\u0085\u2028\u2029]"  # what str.splitlines takes for one


class Time(Table):
    """Duration and stored times."""

    model_config = exactly_one("output_step", "output_times")

    end: Positive = Field(description="end of the simulation [s]; it starts at 0", examples=[2.0])
    output_step: Positive | None = Field(
        None, description="spacing of the stored states [s]", examples=[0.005]
    )
    output_times: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        description="stored times [s], instead of output_step; 0 and end are stored anyway",
        examples=[[0.5, 1.0]],
    )

    @field_validator("end")
    @classmethod
    def _measurable(cls, end: float) -> float:
        if end < SHORTEST:
            raise ValueError(f"must be at least {SHORTEST:g} s, got {end:g}")
        return end

    @field_validator("output_step")
    @classmethod
    def _not_absurd(cls, step: float | None, others: ValidationInfo) -> float | None:
        end = others.data.get("end")
        if step and end and end / step > MAX_STATES:
            raise ValueError(f"would store {end / step:.3g} states; at most {MAX_STATES:,} are allowed")
        return step

    @check
    def _one_choice_of_times(self) -> Iterator[Wrong]:
        if self.gives("output_step") == self.gives("output_times"):
            words = "give either time.output_step or time.output_times, exactly one of them"
            yield Wrong(("output_times",), words)

    @check
    def _within_the_run(self) -> Iterator[Wrong]:
        times = self.output_times or ()
        for k in range(len(times)):
            with suppress(Unknown):
                if times[k] > self.end:
                    reason = f"must not be after time.end, {self.end:g} s, got {times[k]:g}"
                    yield Wrong(("output_times", k), reason, times[k])

    @check
    def _increasing(self) -> Iterator[Wrong]:
        times, before = self.output_times or (), -math.inf
        for k in range(len(times)):
            with suppress(Unknown):
                if times[k] <= before:
                    reason = f"must be greater than the time before it, {before:g} s, got {times[k]:g}"
                    yield Wrong(("output_times", k), reason, times[k])
                before = times[k]


class Initial(Table):
    """State at time 0."""

    packing: NonNegative = Field(
        description="initial position = packing x reference position", examples=[0.1]
    )
    velocity: Vector | None = Field(
        None, description="velocity of every node [m/s]", examples=[[0.0, 0.0, 1.0]]
    )
    spin: Vector | None = Field(
        None, description="angular velocity about the origin [rad/s]", examples=[[0.0, 0.0, 0.1]]
    )
    node_positions: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        description="initial positions [m], explicit topology with packing 1 only",
        examples=[[[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]]],
    )
    node_velocities: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        description="velocities added to those of the nodes [m/s], explicit topology only",
        examples=[[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]],
    )

    @field_validator("node_positions")
    @classmethod
    def _in_place_of_packing(cls, positions: tuple[Vector, ...] | None, others: ValidationInfo) -> Any:
        if positions is not None and others.data.get("packing", 1) != 1:
            raise ValueError(f"needs initial.packing = 1, got {others.data['packing']:g}")
        return positions


class Launch(Table):
    """Velocities added to those of the bullets."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [
                {
                    "required": ["radial_speed", "axial_speed"],
                    "properties": {"speed": False, "spread_angle": False},
                },
                {
                    "required": ["speed", "spread_angle"],
                    "properties": {"radial_speed": False, "axial_speed": False},
                },
            ]
        }
    )

    radial_speed: float | None = Field(
        None, description="away from the origin, in the net's plane [m/s]", examples=[2.5]
    )
    axial_speed: float | None = Field(
        None, description="along +z, the direction of the throw [m/s]", examples=[0.0]
    )
    speed: NonNegative | None = Field(
        None, description="of each bullet [m/s], with spread_angle instead of the two above", examples=[2.5]
    )
    spread_angle: float | None = Field(
        None,
        ge=0.0,
        le=math.pi / 2,
        description="between the bullets' velocities and +z, the direction of the throw [rad]",
        examples=[0.6],
    )

    @check
    def _one_form(self) -> Iterator[Wrong]:
        plain, polar = ("radial_speed", "axial_speed"), ("speed", "spread_angle")
        given, other = (polar, plain) if any(map(self.gives, polar)) else (plain, polar)
        for name in given:
            if not self.gives(name):
                yield Wrong((), f"missing {name}: {type(self).model_fields[name].description}")
        for name in other:
            if self.gives(name):
                yield Wrong((name,), "give either radial_speed and axial_speed, or speed and spread_angle")

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        if self.speed is not None and self.spread_angle is not None:
            return self.speed * math.sin(self.spread_angle), self.speed * math.cos(self.spread_angle)
        return self.radial_speed or 0.0, self.axial_speed or 0.0


class Engine(Table):
    """Which form of the engine computes; the results are the same."""

    loop: Literal["exudyn", "compiled", "auto"] = Field(
        "exudyn",
        description="who steps in time: the engine, or a compiled loop of exunet's own (a net alone); "
        "auto: the latter where it can",
    )
    net: Literal["auto", "connectors", "fused"] = Field(
        "auto",
        description="an engine item for each element, or one object for the whole net with compiled forces; "
        "auto: what was measured as faster",
    )


COMPILED_METHODS = ("auto", "DOPRI5", "RK44", "VelocityVerlet")


class Scene(Table):
    """A whole case."""

    model_config = ConfigDict(
        json_schema_extra={"dependentSchemas": {"launch": {"properties": {"net": {"required": ["bullets"]}}}}}
    )

    format: Literal[1] = Field(description="version of the case format", examples=[1])
    title: str = Field(
        description="one line for tables and figures",
        examples=["Deployment of a net"],
        json_schema_extra={"pattern": rf"^(?![\s\S]*{LINE_BREAK})"},
    )
    time: Time = Field(description="duration and stored times")
    solver: Solver = Field(
        default_factory=lambda: Solver.model_validate({}), description="how the equations are integrated"
    )
    engine: Engine = Field(
        default_factory=lambda: Engine.model_validate({}), description="which form of the engine computes"
    )
    net: NetKeys = Field(description="the net in its reference configuration")
    initial: Initial = Field(description="state at time 0")
    launch: Launch | None = Field(None, description="velocities added to those of the bullets")
    effects: Effects = Field(default_factory=_Effects, description="a table present switches its effect on")

    @field_validator("format", mode="before")
    @classmethod
    def _whole_number(cls, value: Any) -> Any:
        if isinstance(value, bool | float):  # which Literal would take for equal to 1
            raise ValueError(f"must be 1, a whole number, got {str(value).lower()}")
        return value

    @field_validator("title")
    @classmethod
    def _one_line(cls, title: str) -> str:
        if re.search(LINE_BREAK, title):
            raise ValueError("must be one line")
        return title

    @field_validator("net", mode="wrap")
    @classmethod
    def _whatever_its_topology(cls, net: Any, handler: Any) -> Any:
        try:
            return handler(net)
        except ValidationError as error:
            if isinstance(net, dict) and error.errors()[0]["type"].startswith("union_tag"):
                refuse_too(error, common_faults(net))
            raise

    @check
    def _knows_the_method(self) -> Iterator[Wrong]:
        method = self.solver.method
        if self.engine.loop == "compiled" and method not in COMPILED_METHODS:
            reason = f"the compiled loop has {', '.join(COMPILED_METHODS)}, not solver.method = {method}"
            yield Wrong(("engine", "loop"), reason)

    @check
    def _lists_fit_the_net(self) -> Iterator[Wrong]:
        for name in ("node_positions", "node_velocities"):
            with suppress(Unknown):
                values = getattr(self.initial, name)
                if values is None:
                    continue
                if not isinstance(self.net, explicit.Keys):
                    reason = f'is for net.topology = "explicit", not "{self.net.topology}"'
                elif not (reason := other_length(values, self.net.nodes)):
                    continue
                yield Wrong(("initial", name), reason)

    @check
    def _launch_has_bullets(self) -> Iterator[Wrong]:
        if not self.gives("launch"):
            return
        if not isinstance(self.net, ThrownNetTable):
            words = f'a net of topology "{self.net.topology}" has no bullets to launch'
            yield Wrong(("launch",), words)
        elif self.net.bullets is None:
            yield Wrong(("launch",), "there are no bullets to launch: add [net.bullets] or remove [launch]")

    @check
    def _effects_fit_the_case(self) -> Iterator[Wrong]:
        for wrong in misfits(self):
            yield Wrong(("effects", *wrong.where), wrong.reason, wrong.value)
