"""Scripts of missions: entries of `[[script]]` with their triggers, conditions and actions.

A condition is the name of a quantity, a comparison and a number; nothing of it is ever run as code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, StringConstraints, field_validator

from exunet.base.errors import Fault
from exunet.base.record import NonNegative, Positive, Record
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import Drive, command_of


class Quantity(NamedTuple):
    """Quantity of a run that a condition compares with a number; never negative.

    unit  : "1" without a unit
    needs : what the scene must have: "target", "mouth", "tethers", "line", "contact" or ""
    words : description
    """

    unit: str
    needs: str
    words: str


QUANTITIES = {
    "time": Quantity("s", "", "time since the start of the run"),
    "range": Quantity("m", "target", "distance of the centres of mass of net and target"),
    "relative_speed": Quantity("m/s", "target", "speed of the one centre relative to the other"),
    "mouth_diameter": Quantity("m", "mouth", "largest distance of two nodes of the mouth's rim"),
    "area": Quantity("m2", "mouth", "area of the polygon through the corners of the mouth"),
    "tether_tension": Quantity("N", "tethers", "largest tension in any tether"),
    "closing_tension": Quantity("N", "line", "larger one of the tensions at the ends of the closing line"),
    "touching": Quantity("1", "contact", "number of threads, nodes and bullets that touch a body"),
}
HAPPENINGS = {
    "first_contact": ("contact", "a thread or a bullet touches a body for the first time"),
    "largest_area": (
        "mouth",
        "the area of the mouth has fallen by a part, `fall`, of the largest until then",
    ),
}
_CONDITION = re.compile(r"([A-Za-z_]+)(?:\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))?", re.ASCII)


@dataclass(frozen=True)
class Condition:
    """Condition `name > bound` (`sign` 1.0), `name < bound` (-1.0), or that something happens (0.0)."""

    name: str
    sign: float = 0.0
    bound: float = 0.0


def condition_of(text: str) -> Condition:
    """Read a condition; raise ValueError if it is not valid."""
    match = _CONDITION.fullmatch(text.strip())
    name = match[1] if match else ""
    if match is None or (name not in QUANTITIES and name not in HAPPENINGS):
        known = f"{', '.join(HAPPENINGS)}, or {', '.join(QUANTITIES)} with < or > and a number"
        raise ValueError(f"unknown condition {text[:60]!r} (known: {known})")
    if (match[2] is None) != (name in HAPPENINGS):
        words = "takes no comparison" if name in HAPPENINGS else "needs < or > and a number"
        raise ValueError(f"{name} {words}")
    if match[2] is None:
        return Condition(name)
    condition = Condition(name, 1.0 if match[2] == ">" else -1.0, float(match[3]))
    if not math.isfinite(condition.bound):
        raise ValueError(f"{match[3][:60]} is larger than the largest floating-point number")
    if condition.sign < 0.0 and condition.bound <= 0.0:
        raise ValueError(f"{text.strip()!r} is never true: {name} is never negative")
    if condition.sign > 0.0 and condition.bound < 0.0:
        raise ValueError(f"{text.strip()!r} is always true, since {name} is never negative: remove it")
    return condition


Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]


Deed = Literal[
    "eject",
    "close",
    "reel",
    "pay_out",
    "brake",
    "lock",
    "release",
    "cut",
    "thrust",
    "set",
    "control",
    "release_control",
    "checkpoint",
    "note",
    "stop",
]


class Action(NamedTuple):
    """Action of an entry.

    on    : kind of object: "drive", "line" (the winch of the closing line), "held" (a drive, or what is
            fixed to a body), "tether", "net", "thrust", "control", "parameter" or ""
    needs : keys of which at least one is required
    may   : allowed keys, these included
    words : description
    """

    on: str
    needs: tuple[str, ...]
    may: tuple[str, ...]
    words: str


ACTIONS = {
    "eject": Action("net", (), (), "the body that holds the packed net releases it"),
    "close": Action("line", ("rate", "force"), ("rate", "force"), "winds up the closing line"),
    "reel": Action("drive", ("rate", "force"), ("rate", "force"), "winds up"),
    "pay_out": Action("drive", ("rate",), ("rate", "force"), "pays out"),
    "brake": Action("drive", ("force",), ("force",), "slips above a force"),
    "lock": Action("drive", (), (), "holds the length"),
    "release": Action("held", (), (), "a drive turns freely, or a node or tether leaves its body"),
    "cut": Action("tether", (), (), "breaks the first element of a tether, from its start on"),
    "thrust": Action("thrust", (), (), "the times of [effects.thrust] count from now on"),
    "control": Action("control", (), (), "the units of [control] are controlled from now on"),
    "release_control": Action("control", (), (), "the thrusters of the units of [control] stop"),
    "set": Action("parameter", ("value",), ("value",), "changes the value of a parameter from now on"),
    "checkpoint": Action("", (), (), "stores a checkpoint at the next stored time"),
    "note": Action("", (), (), "nothing: records an event, which others may follow"),
    "stop": Action("", ("verdict",), ("verdict",), "ends the run"),
}


_NAMED = ("drive", "held", "tether", "parameter")  # objects that `on` names
_ONCE = ("cut", "eject", "thrust", "stop")


class Entry(Record):
    """Entry of a script: a trigger and an action."""

    name: Name = Field(description="name in other entries and in results", examples=["lock"])
    at: NonNegative | None = Field(
        None, description="time of the entry, or from which `when` is evaluated [s]", examples=[2.5]
    )
    after: str | None = Field(
        None, description="name of the entry after which it happens, or from which `when` is evaluated"
    )
    delay: NonNegative = Field(0.0, description="time after that entry [s]")
    when: str | None = Field(
        None,
        description="condition: first_contact, largest_area, or a quantity, < or >, and a number",
        examples=["mouth_diameter < 0.5"],
    )
    unless: str | None = Field(
        None, description="name of an entry that prevents this one once it has happened"
    )
    fall: float = Field(
        0.01,
        gt=0.0,
        lt=1.0,
        description='for "largest_area": fraction of the largest area by which the area has fallen',
    )
    do: Deed = Field(description="action", examples=["lock"])
    on: str | None = Field(
        None,
        description='object of the action: tether with a reel, tether to cut, "closing" for the winch of the '
        "closing line, attachment to release, or parameter to set",
        examples=[CLOSING],
    )
    rate: Positive | None = Field(None, description="rate of winding up or paying out [m/s]")
    force: NonNegative | None = Field(
        None, description="force that a drive without a rate holds, or above which it slips [N]"
    )
    value: NonNegative | None = Field(None, description="new value of the parameter")
    verdict: Annotated[str, StringConstraints(min_length=1)] | None = Field(
        None, description="outcome reported of a run that this entry ends"
    )
    repeat: bool = Field(
        False, description="repeat each time that `when` becomes true again, at most 100 times; default: once"
    )
    rest: NonNegative = Field(0.01, description="with repeat: shortest time between two activations [s]")

    @field_validator("when")
    @classmethod
    def _known(cls, when: str | None) -> str | None:
        if when is not None:
            condition_of(when)
        return when

    def faults(self) -> Iterator[Fault]:
        """Require a trigger, and the keys of the action and no others."""
        if self.at is None and self.after is None and self.when is None:
            yield Fault("", "requires a trigger: at, after, or when")
        if self.at is not None and self.after is not None:
            yield Fault("after", "excludes at: give either")
        if self.is_given("delay") and self.after is None:
            yield Fault("delay", "requires after")
        if self.is_given("fall") and self.condition_name != "largest_area":
            yield Fault("fall", 'requires when = "largest_area"')
        if self.unless == self.name:
            yield Fault("unless", "names the entry itself")
        action = ACTIONS[self.do]
        if action.needs and not any(self.is_given(key) for key in action.needs):
            yield Fault(action.needs[0], f'missing: do = "{self.do}" requires {" or ".join(action.needs)}')
        for key in ("rate", "force", "value", "verdict"):
            if self.is_given(key) and key not in action.may:
                yield Fault(key, f'do = "{self.do}" excludes {key}')
        if self.on is None and action.on in _NAMED:
            yield Fault("on", f'missing: do = "{self.do}" requires it')
        if self.on is not None and action.on not in _NAMED:
            yield Fault("on", f'do = "{self.do}" excludes on')
        if not self.repeat and self.is_given("rest"):
            yield Fault("rest", "requires repeat = true")
        if self.repeat and self.condition_name not in QUANTITIES:
            yield Fault("repeat", "requires when with a comparison")
        if self.repeat and (self.do in _ONCE or (self.do == "release" and self.drive is None)):
            yield Fault("repeat", f'do = "{self.do}" happens only once')

    @property
    def condition(self) -> Condition | None:
        """Condition of `when`."""
        return None if self.when is None else condition_of(self.when)

    @property
    def condition_name(self) -> str:
        """Name of the quantity or event in `when`; "" without."""
        return "" if self.when is None else condition_of(self.when).name

    @property
    def drive(self) -> str | None:
        """Name of the drive that the entry acts on."""
        kind = ACTIONS[self.do].on
        if kind == "parameter":
            name, _, what = (self.on or "").rpartition(".")
            return name if what in ("force", "rate") else None
        if kind == "held":
            return None if self.on is None or "." in self.on else self.on
        return CLOSING if kind == "line" else self.on if kind == "drive" else None

    @property
    def tie(self) -> str | None:
        """Name of the attachment, or of the end of a tether, that the entry releases."""
        return self.on if self.do == "release" and self.drive is None else None

    @property
    def target(self) -> str:
        """Object that has one command at a time: a drive, a parameter, ...; "" without one."""
        if self.do == "stop":
            return "the run"
        if ACTIONS[self.do].on == "control":
            return "the control"
        return (self.on if self.do == "set" else self.drive) or ""

    @property
    def trigger_words(self) -> str:
        """Describe the trigger."""
        parts = [] if self.when is None else [self.when]
        if self.at is not None:
            parts.append(f"t = {self.at:g} s" if self.when is None else f"from t = {self.at:g} s on")
        if self.after is not None:
            words = f"{self.delay:g} s after {self.after}" if self.delay else f"after {self.after}"
            parts.append(words if self.when is None or not self.delay else f"from {words} on")
        if self.unless is not None:
            parts.append(f"unless {self.unless} has happened")
        return ", ".join(parts)

    @property
    def action_words(self) -> str:
        """Describe the action."""
        words = self.do if self.on is None else f"{self.do} {self.on}"
        if self.rate is not None:
            words += f" at {self.rate:g} m/s"
        if self.force is not None:
            words += f" with {self.force:g} N"
        if self.value is not None:
            words += f" to {self.value:g}"
        return words if self.verdict is None else f'{words}: "{self.verdict}"'


def drive_of(entry: Entry, damping: float | None) -> Drive:
    """Return the command that an entry gives a drive; raise ValueError if its damping does not allow it."""
    if entry.do == "release":
        return command_of(damping, mode="brake", force=0.0)
    mode, rate = {
        "lock": ("lock", None),
        "brake": ("brake", None),
        "pay_out": ("rate", None if entry.rate is None else -entry.rate),
    }.get(entry.do, ("tension" if entry.rate is None else "rate", entry.rate))
    return command_of(damping, mode=mode, rate=rate, force=entry.force)


def conflict(first: Entry, second: Entry) -> bool:
    """Return True if two entries command one object differently, one perhaps by a number."""
    if not first.target or (first.drive or first.target) != (second.drive or second.target):
        return False
    if (first.do == "set") != (second.do == "set"):
        setting, command = (first, second) if first.do == "set" else (second, first)
        return bool(getattr(command, (setting.on or "").rpartition(".")[2]) != setting.value)
    return first.target == second.target and _command(first) != _command(second)


def _command(entry: Entry) -> tuple[object, ...]:
    action = "reel" if entry.do == "close" else entry.do
    return action, entry.rate, entry.force, entry.value, entry.verdict


def released(entries: Iterable[Entry]) -> Iterator[str]:
    """Yield the attachments and ends of tethers that entries release."""
    yield from (entry.tie for entry in entries if entry.tie is not None)


def awaited_entries(entries: Iterable[Entry]) -> set[str]:
    """Return the names of entries whose times depend on the run: by a condition, or by such an entry."""
    every = list(entries)
    names = {entry.name for entry in every if entry.when is not None}
    while more := {entry.name for entry in every if {entry.after, entry.unless} & names} - names:
        names |= more
    return names


def ejects(entries: Iterable[Entry]) -> bool:
    """Return True if an entry ejects the net, which a body holds until then."""
    return any(entry.do == "eject" for entry in entries)


def begins_a_thrust(entries: Iterable[Entry]) -> bool:
    """Return True if [effects.thrust] waits for an entry."""
    return any(entry.do == "thrust" for entry in entries)


def begins_control(entries: Iterable[Entry]) -> bool:
    """Return True if the units of [control] wait for an entry."""
    return any(entry.do == "control" for entry in entries)


def may_end_a_run(entries: Iterable[Entry]) -> bool:
    """Return True if an entry ends runs."""
    return any(entry.do == "stop" for entry in entries)


def key_of(number: int, key: str) -> str:
    """Return the path of an entry's key, or of the entry, in the case."""
    return f"script[{number}].{key}" if key else f"script[{number}]"
