"""`[[script]]` of a case: what happens when in a mission. Each entry has a trigger and an action."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import ConfigDict, Field, StringConstraints, field_validator

from exunet.base.table import NonNegative, Positive, Table
from exunet.case.conditions import Condition, condition_of
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import Drive, asked_of

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
    """What an entry may do.

    on    : on what it acts: "drive", "line" (the winch of the closing line), "held" (a drive, or what is
            fixed to a body), "tether", "net", "thrust", "control", "parameter" or ""
    needs : keys of which it needs at least one
    may   : keys that it may have, these included
    words : what it does
    """

    on: str
    needs: tuple[str, ...]
    may: tuple[str, ...]
    words: str


ACTIONS = {
    "eject": Action("net", (), (), "the body that holds the packed net lets it go"),
    "close": Action("line", ("rate", "force"), ("rate", "force"), "winds up the closing line"),
    "reel": Action("drive", ("rate", "force"), ("rate", "force"), "winds up"),
    "pay_out": Action("drive", ("rate",), ("rate", "force"), "pays out"),
    "brake": Action("drive", ("force",), ("force",), "gives way above a force"),
    "lock": Action("drive", (), (), "holds the length"),
    "release": Action("held", (), (), "lets go: a drive turns freely, a node or a tether leaves a body"),
    "cut": Action("tether", (), (), "breaks the first element of a tether, from its start on"),
    "thrust": Action("thrust", (), (), "the times of [effects.thrust] count from now on"),
    "control": Action("control", (), (), "the units of [control] are controlled from now on"),
    "release_control": Action("control", (), (), "their thrusters fire no more"),
    "set": Action("parameter", ("value",), ("value",), "gives a parameter another value from now on"),
    "checkpoint": Action("", (), (), "the run can be resumed from the next stored time on"),
    "note": Action("", (), (), "nothing: the event is told, and others may come after it"),
    "stop": Action("", ("verdict",), ("verdict",), "ends the run"),
}


class Entry(Table):
    """One thing that happens in a mission."""

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["at"]}, {"required": ["after"]}, {"required": ["when"]}],
            "not": {"required": ["at", "after"]},
            "dependentRequired": {"delay": ["after"], "rest": ["repeat"]},
        }
    )
    TRIGGERS: ClassVar = ("at", "after", "when")

    name: Name = Field(description="by which other entries and results know it", examples=["lock"])
    at: NonNegative | None = Field(
        None, description="when it happens, or from when on `when` is looked at [s]", examples=[2.5]
    )
    after: str | None = Field(
        None, description="name of the entry after which it happens, or `when` is looked at"
    )
    delay: NonNegative = Field(0.0, description="time after that entry [s]")
    when: str | None = Field(
        None, description="condition on a quantity of the run", examples=["mouth_diameter < 0.5"]
    )
    unless: str | None = Field(None, description="name of an entry after which it happens no more")
    fall: float = Field(
        0.01, gt=0.0, lt=1.0, description='part of the largest area by which it has fallen; "largest_area"'
    )
    do: Deed = Field(description="what happens", examples=["lock"])
    on: str | None = Field(
        None,
        description='name of the tether whose reel acts or that is cut, "closing" for the winch of the '
        "closing line; what is released, or a parameter that is set",
        examples=[CLOSING],
    )
    rate: Positive | None = Field(None, description="of winding up or paying out [m/s]")
    force: NonNegative | None = Field(
        None, description="that a drive without a rate holds, or above which it gives way [N]"
    )
    value: NonNegative | None = Field(None, description="of a parameter that is set")
    verdict: Annotated[str, StringConstraints(min_length=1)] | None = Field(
        None, description="what is told of a run that this entry ends"
    )
    repeat: bool = Field(
        False, description="happens each time that `when` comes true again, 100 times at most; default: once"
    )
    rest: NonNegative = Field(
        0.01, description="with repeat: shortest time from one time that it happens to the next [s]"
    )

    @field_validator("when")
    @classmethod
    def _known(cls, when: str | None) -> str | None:
        if when is not None:
            condition_of(when)
        return when

    @property
    def condition(self) -> Condition | None:
        """What `when` asks for."""
        return None if self.when is None else condition_of(self.when)

    @property
    def condition_name(self) -> str:
        """Of the quantity or the happening that `when` asks for; "" without."""
        return "" if self.when is None else condition_of(self.when).name

    @property
    def drive(self) -> str | None:
        """Name of the drive that it acts on."""
        kind = ACTIONS[self.do].on
        if kind == "parameter":
            name, _, what = (self.on or "").rpartition(".")
            return name if what in ("force", "rate") else None
        if kind == "held":
            return None if self.on is None or "." in self.on else self.on
        return CLOSING if kind == "line" else self.on if kind == "drive" else None

    @property
    def tie(self) -> str | None:
        """Name of the attachment, or of the end of a tether, that it releases."""
        return self.on if self.do == "release" and self.drive is None else None

    @property
    def trigger_words(self) -> str:
        """Its trigger, to be read."""
        parts = [] if self.when is None else [self.when]
        if self.at is not None:
            parts.append(f"t = {self.at:g} s" if self.when is None else f"from t = {self.at:g} s on")
        if self.after is not None:
            words = f"{self.delay:g} s after {self.after}" if self.delay else f"after {self.after}"
            parts.append(words if self.when is None or not self.delay else f"from {words} on")
        if self.unless is not None:
            parts.append(f"unless {self.unless} came before")
        return ", ".join(parts)

    @property
    def action_words(self) -> str:
        """Its action, to be read."""
        words = self.do if self.on is None else f"{self.do} {self.on}"
        if self.rate is not None:
            words += f" at {self.rate:g} m/s"
        if self.force is not None:
            words += f" with {self.force:g} N"
        if self.value is not None:
            words += f" to {self.value:g}"
        return words if self.verdict is None else f'{words}: "{self.verdict}"'


def drive_of(entry: Entry, damping: float | None) -> Drive:
    """What an entry asks of a drive; raises ValueError where that is no command of one with this damping."""
    if entry.do == "release":
        return asked_of(damping, "brake", None, 0.0)
    mode, rate = {
        "lock": ("lock", None),
        "brake": ("brake", None),
        "pay_out": ("rate", None if entry.rate is None else -entry.rate),
    }.get(entry.do, ("tension" if entry.rate is None else "rate", entry.rate))
    return asked_of(damping, mode, rate, entry.force)


def released(entries: Iterable[Entry | None]) -> Iterator[str]:
    """The attachments and ends of tethers that entries release."""
    yield from (one.tie for one in entries if one is not None and one.tie is not None)


def awaited_entries(entries: Iterable[Entry]) -> set[str]:
    """Names of entries that wait for what the run does: for a condition, or for or against such an entry."""
    every = list(entries)
    found = {one.name for one in every if one.when is not None}
    while more := {one.name for one in every if {one.after, one.unless} & found} - found:
        found |= more
    return found


def ejects(entries: Iterable[Entry | None]) -> bool:
    """True if an entry ejects the net, which a body holds until then."""
    return any(one is not None and one.do == "eject" for one in entries)


def begins_a_thrust(entries: Iterable[Entry | None]) -> bool:
    """True if [effects.thrust] waits for an entry."""
    return any(one is not None and one.do == "thrust" for one in entries)


def begins_control(entries: Iterable[Entry | None]) -> bool:
    """True if the units of [control] wait for an entry."""
    return any(one is not None and one.do == "control" for one in entries)


def may_end_a_run(entries: Iterable[Entry]) -> bool:
    """True if an entry ends runs, each at its own time."""
    return any(one.do == "stop" for one in entries)


def key_of(number: int, key: str) -> str:
    """Of a key of an entry, or of all of it, in the case."""
    return f"script[{number}].{key}" if key else f"script[{number}]"
