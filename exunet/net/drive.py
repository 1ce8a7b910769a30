"""The drive that reels and the winch of a closing line share: a motor with a rate, a limit of force, a lock.

Its commands come in force at their times; `exunet.forces.reel.winding_rate` is its law.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from exunet.base.errors import Fault
from exunet.base.record import FromArray, NonNegative, Positive, Record, increasing

WITHOUT_LIMIT = 1e9  # [m/s]


@dataclass(frozen=True)
class Drive:
    """Numbers of the law that a command sets: see `exunet.forces.reel.winding_rate`.

    rate  : of winding up, at most [m/s]; `WITHOUT_LIMIT` if only a force is requested
    force : at which it stands still, and above which it pays out [N]
    gives : rate per force below it, and above it [m/(N s)]; 0.0: it turns at `rate`, whatever pulls
    """

    rate: float = 0.0
    force: float = 0.0
    gives: float = 0.0

    @property
    def is_locked(self) -> bool:
        """True if it does not turn, whatever pulls."""
        return self.rate == self.gives == 0.0

    @property
    def action(self) -> str:
        """Return the action of the drive: "lock", "pull" or, at a rate or above a force, "pay out"."""
        return "lock" if self.is_locked else "pull" if self.rate > 0.0 else "pay out"


class _Command(Record):
    at: NonNegative = Field(description="time of the command [s]", examples=[0.0])

    def drive(self, damping: float | None) -> Drive:
        """The drive from `at` on, for a damping [N s/m]."""
        rate, force = getattr(self, "rate", 0.0), getattr(self, "force", None)
        return Drive(rate) if force is None or damping is None else Drive(rate, force, 1.0 / damping)


class Brake(_Command):
    """Pay out above a force."""

    mode: Literal["brake"] = Field(description="pay out above a force")
    force: NonNegative = Field(description="tension above which it pays out [N]", examples=[20.0])


class Lock(_Command):
    """Hold the length."""

    mode: Literal["lock"] = Field(description="hold the length")


class Rate(_Command):
    """Wind up or pay out at a rate."""

    mode: Literal["rate"] = Field(description="wind up or pay out")
    rate: float = Field(
        description="rate of winding up, negative: of paying out [m/s]; at most largest_rate either way",
        examples=[0.2],
    )
    force: NonNegative | None = Field(
        None, description="largest pull of winding up, above which it pays out [N]", examples=[20.0]
    )


class Tension(_Command):
    """Hold a force."""

    mode: Literal["tension"] = Field(description="hold a force")
    force: NonNegative = Field(description="tension that it holds [N]", examples=[20.0])

    def drive(self, damping: float | None) -> Drive:
        """The drive from `at` on, for a damping [N s/m]."""
        return Drive(WITHOUT_LIMIT, self.force, 1.0 / damping if damping else 0.0)


Command = Annotated[Brake | Lock | Rate | Tension, Field(discriminator="mode")]


class DriveConfig(Record):
    """A motor that winds up and pays out."""

    largest_rate: Positive | None = Field(
        None, description="limit of the rate either way [m/s]; default: none", examples=[1.0]
    )
    damping: Positive | None = Field(
        None,
        description="damping c of the drive [N s/m], required by a command with a force: difference of force "
        "from that of the command, per rate",
        examples=[200.0],
    )
    commands: Annotated[tuple[Command, ...], FromArray] = Field(
        (),
        description="commands with increasing times; before the first the drive is locked",
        examples=[[{"at": 0.0, "mode": "brake", "force": 20.0}]],
    )

    @property
    def rate_limit(self) -> float:
        """[m/s]."""
        return WITHOUT_LIMIT if self.largest_rate is None else self.largest_rate

    @property
    def times(self) -> tuple[float, ...]:
        """Return the times of the commands [s]."""
        return tuple(command.at for command in self.commands)

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Before the first command, and of each."""
        return (Drive(), *(command.drive(self.damping) for command in self.commands))

    def faults(self) -> Iterator[Fault]:
        """Require increasing times, rates within the limit, and a damping where there is a force."""
        for k, command in enumerate(self.commands):
            if self.damping is None and getattr(command, "force", None) is not None:
                yield Fault(f"commands[{k}].force", "requires the damping of the drive")
            if words := too_fast(getattr(command, "rate", 0.0), self.rate_limit):
                yield Fault(f"commands[{k}].rate", words)
        yield from increasing("commands", self.times, ".at")


def command_of(damping: float | None, **values: Any) -> Drive:
    """The drive of a command outside a case, of keys mode, rate and force; raises ValueError."""
    given = {key: value for key, value in values.items() if value is not None}
    try:
        command: _Command = TypeAdapter(Command).validate_python({"at": 0.0, **given})
    except ValidationError as error:
        raise ValueError("; ".join(_reason(item) for item in error.errors(include_url=False))) from None
    if damping is None and getattr(command, "force", None) is not None:
        raise ValueError("requires the damping of the drive")
    return command.drive(damping)


def _reason(error: Any) -> str:
    mode, key = (*error["loc"], "", "")[:2]
    if error["type"] == "missing":
        return f'mode "{mode}" requires {key}'
    if error["type"] == "extra_forbidden":
        return f'mode "{mode}" does not have {key}'
    return f"{key}: {error['msg']}" if key else str(error["msg"])


def too_fast(rate: float, largest: float) -> str:
    """Return the reason why a rate [m/s], either way, exceeds the largest of a drive; "" if it does not."""
    if abs(rate) <= largest:
        return ""
    beyond = f"above {largest:g}" if rate > 0.0 else f"below {-largest:g}"
    return f"is {beyond} m/s, the largest_rate of the drive"


def softest(damping: float | None) -> Drive:
    """The drive that gives the most of all that a script may ask of one with a damping."""
    return Drive(gives=0.0 if damping is None else 1.0 / damping)
