"""The drive that reels and the winch of a closing line share: a motor with a rate, a limit of force, a lock.

Its commands come in force at their times; `exunet.forces.reel.winding_rate` is its law.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.base.table import FromArray, NonNegative, Positive, Table

Mode = Literal["lock", "brake", "rate", "tension"]
_NEEDS = {"lock": (), "brake": ("force",), "rate": ("rate",), "tension": ("force",)}
WITHOUT_LIMIT = 1e9  # [m/s]
_MAY_HAVE = {"rate": ("force",)}


class Command(Table):
    """What a drive does from a time on."""

    at: NonNegative = Field(description="from when on [s]", examples=[2.0])
    mode: Mode = Field(description="lock: holds; brake: pays out under more than force; rate: winds; tension")
    rate: float | None = Field(
        None, description="of winding up, negative: of paying out [m/s]; of mode rate", examples=[0.2]
    )
    force: NonNegative | None = Field(
        None,
        description="largest pull of winding up, above which it pays out [N]; not of mode lock",
        examples=[20.0],
    )


@dataclass(frozen=True)
class Drive:
    """What a command asks for, as numbers of one law: see `exunet.forces.reel.winding_rate`.

    rate  : of winding up, at most [m/s]; `WITHOUT_LIMIT` if a force is asked for alone
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


class DriveKeys(Table):
    """A motor that winds up and pays out."""

    largest_rate: Positive | None = Field(
        None, description="limit of the rate either way [m/s]; absent: none", examples=[1.0]
    )
    damping: Positive | None = Field(
        None,
        description="force below or above that of the command, per rate of winding up or paying out [N s/m]",
        examples=[200.0],
    )
    commands: Annotated[tuple[Command, ...], FromArray] = Field(
        (),
        description="in the order of their times; before the first it is locked",
        examples=[[{"at": 0.0, "mode": "brake", "force": 20.0}]],
    )

    @property
    def rate_limit(self) -> float:
        """[m/s]."""
        return WITHOUT_LIMIT if self.largest_rate is None else self.largest_rate

    @property
    def times(self) -> tuple[float, ...]:
        """Of the commands [s]."""
        return tuple(one.at for one in self.commands)

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Before the first command, and of each."""
        return (Drive(), *(_drive(one, self.damping) for one in self.commands))


def asked_of(damping: float | None, mode: str, rate: float | None, force: float | None) -> Drive:
    """The drive of a command that a script gives, by the rules of those of a case; raises ValueError."""
    given = {"at": 0.0, "mode": mode, "rate": rate, "force": force}
    command = Command.model_validate({key: value for key, value in given.items() if value is not None})
    keys = DriveKeys.model_validate({"commands": [command]} | ({"damping": damping} if damping else {}))
    if faults := list(_of_command(0, command, keys)):
        raise ValueError("; ".join(fault.reason for fault in faults))
    return _drive(command, damping)


def too_fast(name: str, rate: float, largest: float) -> str:
    """What is wrong with a rate [m/s] that a named drive is to turn at, either way; "" if nothing is."""
    if abs(rate) <= largest:
        return ""
    beyond = f"above {largest:g}" if rate > 0.0 else f"below {-largest:g}"
    return f"is {beyond} m/s, the largest_rate of {name!r}: it would turn no faster than that"


def softest(damping: float | None) -> Drive:
    """The drive that gives the most of all that a script may ask of one with a damping."""
    return Drive(gives=0.0 if damping is None else 1.0 / damping)


def _drive(command: Command, damping: float | None) -> Drive:
    rate = WITHOUT_LIMIT if command.mode == "tension" else command.rate or 0.0
    if command.force is None or damping is None:
        return Drive(rate)
    return Drive(rate, command.force, 1.0 / damping)


def cross_checks_of_drive(name: str, keys: DriveKeys) -> Iterator[Fault]:
    """Commands that have what their mode needs and no more, no faster than it turns, in the order of time."""
    every = (_of_command(k, one, keys) for k, one in enumerate(keys.commands) if one is not None)
    valid = [(k, one) for k, one in enumerate(keys.commands) if one is not None]
    within_rate = (_no_faster(name, k, one, keys) for k, one in valid)
    yield from each(*every, *within_rate, *(_in_order(*pair) for pair in pairwise(valid)))


def _no_faster(name: str, number: int, command: Command, keys: DriveKeys) -> Iterator[Fault]:
    if command.rate is not None and (words := too_fast(name, command.rate, keys.rate_limit)):
        yield Fault(f"commands[{number}].rate", words)


def _in_order(before: tuple[int, Command], after: tuple[int, Command]) -> Iterator[Fault]:
    (_, first), (k, second) = before, after
    if second.at <= first.at:
        words = f"must be greater than the time before it, {first.at:g} s, got {second.at:g}"
        yield Fault(f"commands[{k}].at", words)


def _of_command(number: int, command: Command, keys: DriveKeys) -> Iterator[Fault]:
    where = f"commands[{number}]"
    needs = _NEEDS[command.mode]
    may = (*needs, *_MAY_HAVE.get(command.mode, ()))
    for key in ("rate", "force"):
        value = getattr(command, key)
        if value is None and key in needs:
            yield Fault(where, f'mode "{command.mode}" needs {key}')
        if value is not None and key not in may:
            yield Fault(f"{where}.{key}", f'mode "{command.mode}" has none')
    if command.force is not None and keys.damping is None:
        yield Fault(f"{where}.force", "needs the damping of the drive")
