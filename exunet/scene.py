"""The scene: what a case file says, as frozen records in SI units."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from exunet.checks import Wrong, refuse, refuse_with
from exunet.effects import Effects as _Effects
from exunet.effects import misfits, switched_on
from exunet.effects.needs import Surroundings
from exunet.net import NetKeys, explicit
from exunet.net.base import ThrownNetTable, refuse_other_length
from exunet.record import FromArray, NonNegative, Positive, Record, Vector
from exunet.solvers import Solver

if TYPE_CHECKING:  # made from the registry of effects, which a type checker cannot follow
    Effects = Record
else:
    Effects = _Effects

MAX_STATES = 10_000_000
SHORTEST = 1e-9  # [s]


class Time(Record):
    """Duration and stored times."""

    end: Positive = Field(description="end of the simulation [s]; it starts at 0", examples=[2.0])
    output_step: Positive | None = Field(
        None, description="spacing of the stored states [s]", examples=[0.005]
    )
    output_times: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        validate_default=True,
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

    @field_validator("output_times")
    @classmethod
    def _increasing(cls, times: tuple[float, ...] | None, others: ValidationInfo) -> tuple[float, ...] | None:
        wrongs = []
        if "output_step" in others.data and (times is None) == (others.data["output_step"] is None):
            wrongs.append(Wrong((), "give either time.output_step or time.output_times, exactly one of them"))
        end = others.data.get("end", float("inf"))
        before = 0.0
        for k, time in enumerate(times or ()):
            if time > end:
                wrongs.append(Wrong((k,), f"must not be after time.end, {end:g} s, got {time:g}", time))
            if k > 0 and time <= before:
                wrongs.append(
                    Wrong((k,), f"must be greater than the time before it, {before:g} s, got {time:g}")
                )
            before = time
        refuse(wrongs)
        return times


class Initial(Record):
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


class Launch(Record):
    """Velocities added to those of the bullets."""

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

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        plain = {"radial_speed": self.radial_speed, "axial_speed": self.axial_speed}
        polar = {"speed": self.speed, "spread_angle": self.spread_angle}
        given, other = (polar, plain) if any(v is not None for v in polar.values()) else (plain, polar)
        wrongs = [
            Wrong((), f"missing {name}: {type(self).model_fields[name].description}")
            for name, value in given.items()
            if value is None
        ]
        wrongs += [
            Wrong((name,), "give either radial_speed and axial_speed, or speed and spread_angle", value)
            for name, value in other.items()
            if value is not None
        ]
        refuse(wrongs)
        return self

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        if self.speed is not None and self.spread_angle is not None:
            return self.speed * math.sin(self.spread_angle), self.speed * math.cos(self.spread_angle)
        return self.radial_speed or 0.0, self.axial_speed or 0.0


class Engine(Record):
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


class Scene(Record):
    """A whole case."""

    format: Literal[1] = Field(description="version of the case format", examples=[1])
    title: str = Field(description="one line for tables and figures", examples=["Deployment of a net"])
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
        if len(title.splitlines()) > 1 or title.endswith("\n"):
            raise ValueError("must be one line")
        return title

    @field_validator("engine")
    @classmethod
    def _knows_the_method(cls, engine: Engine, others: ValidationInfo) -> Engine:
        solver = others.data.get("solver")
        if engine.loop == "compiled" and solver is not None and solver.method not in COMPILED_METHODS:
            reason = (
                f"the compiled loop has {', '.join(COMPILED_METHODS)}, not solver.method = {solver.method}"
            )
            refuse([Wrong(("loop",), reason)])
        return engine

    @field_validator("initial")
    @classmethod
    def _lists_fit_the_net(cls, initial: Initial, others: ValidationInfo) -> Initial:
        wrongs = []
        for name in ("node_positions", "node_velocities"):
            values, net = getattr(initial, name), others.data.get("net")
            if values is None or net is None:
                continue
            if not isinstance(net, explicit.Keys):
                wrongs.append(Wrong((name,), f'is for net.topology = "explicit", not "{net.topology}"'))
                continue
            try:
                refuse_other_length(values, net.nodes)
            except ValueError as error:
                wrongs.append(Wrong((name,), str(error)))
        refuse(wrongs)
        return initial

    @field_validator("launch", mode="wrap")
    @classmethod
    def _needs_bullets(cls, launch: Any, handler: Any, others: ValidationInfo) -> Any:
        net, wrongs = others.data.get("net"), []
        if launch is not None and net is not None:
            if not isinstance(net, ThrownNetTable):
                wrongs = [Wrong((), f'a net of topology "{net.topology}" has no bullets to launch')]
            elif net.bullets is None:
                words = "there are no bullets to launch: add [net.bullets] or remove [launch]"
                wrongs = [Wrong((), words)]
        return refuse_with(wrongs, launch, handler)

    @field_validator("effects")
    @classmethod
    def _fit_the_case(cls, effects: Any, others: ValidationInfo) -> Any:
        known = others.data
        if all(name in known for name in ("net", "time", "solver", "engine", "launch")):
            around = Surroundings(
                on=switched_on(effects),
                has_bullets=getattr(known["net"], "bullets", None) is not None,
                has_launch=known["launch"] is not None,
                duration=known["time"].end,
                method=known["solver"].method,
            )
            refuse(misfits(around))
        return effects
