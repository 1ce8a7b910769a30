"""The scene: what a case file says, as frozen records in SI units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Tag, field_validator

from exunet.base.errors import Fault
from exunet.base.record import (
    FromArray,
    NonNegative,
    Positive,
    Record,
    Vector,
    increasing,
    one_of,
    shortened,
)
from exunet.base.times import reached
from exunet.bodies.config import Bodies, Placed, Quaternion
from exunet.forces.corner_units import AnyControl
from exunet.forces.effects import Effects as _Effects
from exunet.methods.config import AUTO, Solver
from exunet.methods.method import Backend
from exunet.net import AnyNetConfig
from exunet.net.closing import Closing
from exunet.net.folding import Fold
from exunet.net.tether import Tethers
from exunet.scene.capture import CaptureCriterion
from exunet.scene.script import Entry

if TYPE_CHECKING:
    Effects = Record
    BackendKey = Backend | Literal["auto"]
else:  # made from the registry of effects and from enums, which a type checker cannot follow
    Effects = _Effects
    BackendKey = Literal[(*Backend, AUTO)]

MAX_STATES = 10_000_000
SHORTEST = 1e-9  # [s]
LINE_BREAK = r"[\n\r\u000b\u000c\u001c-\u001e\u0085\u2028\u2029]"  # what str.splitlines takes for one
UNPRINTED = r"[\u0000-\u0008\u000a-\u001f\u007f-\u009f\u2028\u2029]"  # these, and what steers a terminal


class Time(Record):
    """Duration and stored times."""

    EXACTLY_ONE: ClassVar = ("output_step", "output_times")

    end: Positive = Field(description="end of the simulation [s]; it starts at 0", examples=[2.0])
    output_step: Positive | None = Field(
        None, description="spacing of the stored states [s]: k output_step and end", examples=[0.005]
    )
    output_times: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        description="stored times [s], increasing, within [0, end], instead of output_step; 0 and end are "
        "stored anyway",
        examples=[[0.5, 1.0]],
    )

    @field_validator("end")
    @classmethod
    def _measurable(cls, end: float) -> float:
        if end < SHORTEST:
            raise ValueError(f"must be at least {SHORTEST:g} s, got {end:g}")
        return end

    def faults(self) -> Iterator[Fault]:
        """Require stored times that increase until the end, and not too many."""
        step, end, times = self.output_step, self.end, self.output_times or ()
        if step and end / step > MAX_STATES:
            reason = f"to {end:g} s, a state each {step:g} s are {end / step:.3g} states"
            yield Fault("output_step", f"{reason}; at most {MAX_STATES:,} are allowed", against=("end",))
        yield from shortened(
            Fault(f"output_times[{k}]", f"must not be after time.end, {end:g} s, got {time:g}")
            for k, time in enumerate(times)
            if not reached(end, time)
        )
        yield from shortened(increasing("output_times", times))

    @property
    def stored_times(self) -> NDArray[np.float64]:
        """(n_times,) times at which a run stores its state [s]: 0, the output times, and the end."""
        if self.output_times is not None:
            inner = np.array([t for t in self.output_times if t > 0.0 and not reached(t, self.end)])
        else:
            step = self.output_step or self.end
            number = int(np.floor(self.end / step * (1 + 1e-12)))
            inner = step * np.arange(1, number + 1)
            inner = inner[inner < self.end * (1 - 1e-12)]
        return np.concatenate([[0.0], inner, [self.end]])


class NetFrame(Placed):
    """The axes in which the net starts, in the frame of a body that carries them."""

    body: str = Field(description="name of the body that carries the packed net", examples=["chaser"])
    position: Vector = Field((0.0, 0.0, 0.0), description="of the net's origin in the body's frame [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns the net's axes into those of the body's frame; "
        "brought to length 1",
    )
    eject_at: NonNegative = Field(
        0.0,
        description="until when the body holds the packed net [s], before time.end; then velocity, spin and "
        "[launch] act",
    )


class Initial(Record):
    """State at time 0."""

    EXACTLY_ONE: ClassVar = ("packing", "fold", "restart")

    packing: NonNegative | None = Field(
        None, description="initial position = packing x reference position", examples=[0.1]
    )
    fold: Fold | None = Field(
        None, description="the net folded into a canister with 90 to 100 % of each length, instead of packing"
    )
    restart: Annotated[str, Field(min_length=1)] | None = Field(
        None,
        description="the state of another run, instead of packing: its folder or result.h5, relative to the "
        "folder of the case, then @ and a stored time [s] or end, which is the default",
        examples=["../results/capture@2.5"],
    )
    frame: NetFrame | None = Field(
        None,
        description="the net starts in axes that a body carries, and a launch acts back on the body; without "
        "it, in the scene's axes",
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

    def faults(self) -> Iterator[Fault]:
        """Require one source of positions and velocities."""
        if self.restart is not None:
            words = "excludes initial.restart, whose state has positions and velocities: remove one"
            for name in ("frame", "velocity", "spin", "node_positions", "node_velocities"):
                if self.is_given(name):
                    yield Fault(name, words, against=("restart",))
        elif self.node_positions is not None and self.packing is not None and self.packing != 1:
            words = f"requires initial.packing = 1, got {self.packing:g}"
            yield Fault("node_positions", words, against=("packing",))

    @property
    def deployed(self) -> float:
        """The part of its size that the net has: packing; 0 where it is folded, 1 in another run's state."""
        if self.restart is not None:
            return 1.0
        return 0.0 if self.packing is None else self.packing


class RadialLaunch(Record):
    """Velocities added to those of the bullets: radial and axial speed."""

    radial_speed: float = Field(
        description="away from the origin, in the net's plane; relative to a body before its recoil [m/s]",
        examples=[3.5],
    )
    axial_speed: float = Field(
        description="along +z, the direction of the launch, likewise before the recoil [m/s]", examples=[2.0]
    )

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        return self.radial_speed, self.axial_speed


class ConeLaunch(Record):
    """Velocities added to those of the bullets: speed and spread angle."""

    speed: NonNegative = Field(
        description="speed of each bullet, relative to a body before its recoil [m/s]",
        examples=[2.5],
    )
    spread_angle: float = Field(
        ge=0.0,
        le=math.pi / 2,
        description="between the bullets' velocities and +z, the direction of the launch [rad]",
        examples=[0.6],
    )

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        return self.speed * math.sin(self.spread_angle), self.speed * math.cos(self.spread_angle)


Launch = Annotated[
    Annotated[RadialLaunch, Tag("radial_speed and axial_speed")]
    | Annotated[ConeLaunch, Tag("speed and spread_angle")],
    one_of(RadialLaunch, ConeLaunch),
]


class Engine(Record):
    """Backend of a run; the results of both agree. The reference ignores this table."""

    backend: BackendKey = Field(
        AUTO,
        description="integrator: Exudyn, with a connector for each element, or exunet's compiled loop; "
        "auto: the compiled loop if it has the method and Numba is installed, else Exudyn",
    )


class Scene(Record):
    """A whole case; exunet.scene.validation checks its tables against each other."""

    format: Literal[1] = Field(description="version of the case format", examples=[1])
    title: str = Field(
        description="one line for tables and figures",
        examples=["Deployment of a net"],
        json_schema_extra={"pattern": rf"^(?![\s\S]*{UNPRINTED})"},
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = Field(
        0, description="seed of the perturbed runs of a run and of an ensemble"
    )
    time: Time = Field(description="duration and stored times")
    solver: Solver = Field(
        default_factory=lambda: Solver.model_validate({}), description="how the equations are integrated"
    )
    engine: Engine = Field(
        default_factory=lambda: Engine.model_validate({}), description="backend that integrates"
    )
    net: AnyNetConfig = Field(description="the net in its reference configuration")
    initial: Initial = Field(description="state at time 0")
    launch: Launch | None = Field(None, description="velocities added to those of the bullets")
    bodies: Bodies = Field(
        {},
        description="rigid bodies",
        json_schema_extra={"additionalProperties": False},
    )
    tethers: Tethers = Field(
        {},
        description="cables beside the net, each between two of its nodes, bullets and bodies",
        json_schema_extra={"additionalProperties": False},
    )
    closing: Closing | None = Field(
        None, description="line or shortened edge that closes the mouth of the net"
    )
    control: AnyControl | None = Field(
        None, description="corner units (bullets with thrusters) and their controller"
    )
    capture: CaptureCriterion | None = Field(None, description="criterion of a capture")
    script: Annotated[tuple[Entry, ...], FromArray] = Field(
        (),
        description="events of the mission, each a trigger and an action",
        examples=[[{"name": "lock", "at": 2.5, "do": "lock", "on": "closing"}]],
    )
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
        if found := re.search(UNPRINTED, title):
            raise ValueError(f"must not hold control characters, got {found[0]!r}")
        return title
