"""`[[script]]` of a case: what happens when in a mission. Each entry has a trigger and an action.

A condition is the name of a quantity, a comparison and a number; nothing of it is ever run as code.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import ConfigDict, Field, StringConstraints, ValidationError, field_validator

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.base.table import NonNegative, Positive, Table
from exunet.case.parameters import NEEDS, Bounds
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import Drive, asked_of, too_fast

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


class Quantity(NamedTuple):
    """What a condition may look at; none is ever negative.

    unit  : "1" if it has none
    needs : of the scene: "target", "mouth", "tethers", "line", "contact" or ""
    words : what it is
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
    """`name > bound` if `sign` is 1.0, `name < bound` if it is -1.0; a happening has neither (0.0)."""

    name: str
    sign: float = 0.0
    bound: float = 0.0


def condition_of(text: str) -> Condition:
    """Read a condition; raises ValueError with what is allowed."""
    found = _CONDITION.fullmatch(text.strip())
    name = found[1] if found else ""
    if found is None or (name not in QUANTITIES and name not in HAPPENINGS):
        known = f"{', '.join(HAPPENINGS)}, or one of {', '.join(QUANTITIES)} with < or > and a number"
        raise ValueError(f"unknown condition {text[:60]!r}; known are {known}")
    if (found[2] is None) != (name in HAPPENINGS):
        words = "is compared with nothing" if name in HAPPENINGS else "needs < or > and a number"
        raise ValueError(f"{name} {words}")
    if found[2] is None:
        return Condition(name)
    condition = Condition(name, 1.0 if found[2] == ">" else -1.0, float(found[3]))
    if not math.isfinite(condition.bound):
        raise ValueError(f"{found[3][:60]} is beyond the largest number that there is")
    if condition.sign < 0.0 and condition.bound <= 0.0:
        raise ValueError(f"{name} is never below 0, so {text.strip()!r} is never true")
    if condition.sign > 0.0 and condition.bound < 0.0:
        raise ValueError(f"{name} is never below 0, so {text.strip()!r} is always true: leave it out")
    return condition


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
_VALUES = ("rate", "force", "value", "verdict")


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
    verdict: str | None = Field(None, description="what is told of a run that this entry ends")
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


@dataclass(frozen=True)
class Stage:
    """What of a scene a script may look at and act on.

    has    : what quantities need and the scene has
    drives : damping [N s/m] of each drive by name, None for one without
    fastest : largest rate of each drive [m/s]
    taken  : drives that have commands of their own in the case
    tethers : those without a reel, which may be cut
    settable : parameters that a script may set here, or why it may not, by name
    ties   : what is fixed to bodies, by the name of `Entry.tie`; why it cannot be released, "": it can
    holds_net : why no body holds the net until a script ejects it; "": one does
    end    : of the run [s]
    """

    has: frozenset[str]
    drives: Mapping[str, float | None]
    fastest: Mapping[str, float]
    taken: frozenset[str]
    tethers: frozenset[str]
    settable: Mapping[str, Bounds]
    ties: Mapping[str, str]
    holds_net: str
    end: float


_LACKS = {
    "target": "needs [verdict], which names the target",
    "mouth": "needs a net with a mouth, which one of listed elements has not",
    "tethers": "needs a tether, and the scene has none",
    "line": 'needs [closing] of kind = "line"',
    "contact": "needs [effects.contact]",
}


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


def cross_checks(entries: tuple[Entry | None, ...], stage: Stage) -> Iterator[Fault]:
    """What entries demand of each other and of the scene; None stands for one that is not a table."""
    known = [(k, one) for k, one in enumerate(entries) if one is not None]
    names: dict[str, int] = {}
    for k, one in known:
        if "name" in one.__dict__:
            names.setdefault(one.name, k)
    for k, one in known:
        checks = (
            _named_once(k, one, names),
            _triggered(one),
            _refers(one, names),
            _looks(one, stage),
            _acts(one, stage),
            _repeats(one),
        )
        yield from (Fault(key_of(k, fault.key), fault.reason) for fault in each(*checks))
    yield from each(_cycles(known, names))


def key_of(number: int, key: str) -> str:
    """Of a key of an entry, or of all of it, in the case."""
    return f"script[{number}].{key}" if key else f"script[{number}]"


def _named_once(number: int, entry: Entry, names: Mapping[str, int]) -> Iterator[Fault]:
    if names[entry.name] != number:
        yield Fault("name", f"entry {names[entry.name]} has this name already")


def _triggered(entry: Entry) -> Iterator[Fault]:
    given = [key for key in Entry.TRIGGERS if entry.is_given(key)]
    if not given:
        yield Fault("", "needs a trigger: at, after, or when")
    if "at" in given and "after" in given:
        yield Fault("after", "give either at or after")
    if entry.is_given("delay") and "after" not in given:
        yield Fault("delay", "is a time after another entry: give after")
    if entry.is_given("fall") and (entry.condition is None or entry.condition.name != "largest_area"):
        yield Fault("fall", 'is for when = "largest_area"')


def _refers(entry: Entry, names: Mapping[str, int]) -> Iterator[Fault]:
    for key in ("after", "unless"):
        other = getattr(entry, key)
        if other is not None and other not in names:
            yield Fault(key, f"there is no entry {other!r} (entries: {', '.join(names)})")
    if entry.unless is not None and entry.unless == entry.name:
        yield Fault("unless", "names the entry itself: without repeat it happens once anyway")


def _looks(entry: Entry, stage: Stage) -> Iterator[Fault]:
    condition = entry.condition
    if condition is None:
        return
    name = condition.name
    needs = QUANTITIES[name].needs if name in QUANTITIES else HAPPENINGS[name][0]
    if needs and needs not in stage.has:
        yield Fault("when", f"{name} {_LACKS[needs]}")


def _acts(entry: Entry, stage: Stage) -> Iterator[Fault]:
    action = ACTIONS[entry.do]
    lacks = bool(action.needs) and not any(entry.is_given(key) for key in action.needs)
    if lacks:
        yield Fault("", f'do = "{entry.do}" needs {" or ".join(action.needs)}')
    for key in _VALUES:
        if entry.is_given(key) and key not in action.may:
            yield Fault(key, f'do = "{entry.do}" has none')
    if action.on not in ("drive", "held", "tether", "parameter") and entry.is_given("on"):
        yield Fault("on", f'do = "{entry.do}" acts on nothing that is to be named')
    if not action.on:
        return
    special = {
        "tether": _cuts,
        "held": _releases,
        "net": _ejects,
        "thrust": _pushes,
        "control": _controls,
        "parameter": _sets,
    }.get(action.on)
    if special is not None:
        yield from special(entry, stage)
        return
    if action.on == "drive" and not entry.is_given("on"):
        yield Fault("", f'do = "{entry.do}" needs on: the name of a tether with a reel, or "{CLOSING}"')
        return
    name, key = entry.drive, "on" if action.on == "drive" else "do"
    assert name is not None
    if name not in stage.drives:
        known = ", ".join(stage.drives) or "none"
        yield Fault(key, f"{name!r} has no reel or winch in this scene (those that have: {known})")
    elif name in stage.taken or not lacks:
        yield from _of_drive(entry, name, key, stage)


def _cuts(entry: Entry, stage: Stage) -> Iterator[Fault]:
    known = ", ".join(sorted(stage.tethers)) or "none"
    if not entry.is_given("on"):
        yield Fault("", f'do = "{entry.do}" needs on: the name of a tether (without a reel: {known})')
    elif entry.on not in stage.tethers:
        yield Fault("on", f"{entry.on!r} is no tether without a reel (those that are: {known})")
    if entry.repeat:
        yield Fault("repeat", "a tether is cut once")


def _releases(entry: Entry, stage: Stage) -> Iterator[Fault]:
    known = ", ".join((*stage.drives, *(name for name, why in stage.ties.items() if not why))) or "none"
    what = entry.on
    if what is None:
        yield Fault("", f'do = "{entry.do}" needs on: a drive, or what is fixed to a body ({known})')
    elif what in stage.drives:
        yield from _of_drive(entry, what, "on", stage)
    elif what not in stage.ties:
        yield Fault("on", f"{what!r} is nothing that a script releases (what it may: {known})")
    elif why := stage.ties[what]:
        yield Fault("on", why)
    if entry.repeat and entry.drive is None:
        yield Fault("repeat", "what is fixed to a body is released once")


def _of_drive(entry: Entry, name: str, key: str, stage: Stage) -> Iterator[Fault]:
    if name in stage.taken:
        yield Fault(key, f"{name!r} has commands of its own: remove these, or this entry")
    else:
        yield from _asks(entry, stage.drives[name])
        if entry.rate is not None and (words := too_fast(name, entry.rate, stage.fastest[name])):
            yield Fault("rate", words)


def _ejects(entry: Entry, stage: Stage) -> Iterator[Fault]:
    if stage.holds_net:
        yield Fault("do", stage.holds_net)
    if entry.repeat:
        yield Fault("repeat", "a net is ejected once")


def _pushes(entry: Entry, stage: Stage) -> Iterator[Fault]:
    if "thrust" not in stage.has:
        yield Fault("do", "needs [effects.thrust], whose times then count from the event on")
    if entry.repeat:
        yield Fault("repeat", "a thrust begins once")


def _controls(entry: Entry, stage: Stage) -> Iterator[Fault]:
    if "control" not in stage.has:
        yield Fault("do", "needs [control], whose units it acts on")


def _sets(entry: Entry, stage: Stage) -> Iterator[Fault]:
    known = ", ".join(name for name, bounds in stage.settable.items() if not bounds.why) or "none"
    if entry.on is None:
        yield Fault("", f'do = "{entry.do}" needs on: the name of a parameter (here: {known})')
    elif entry.on not in stage.settable:
        needs = f"{entry.on} needs {NEEDS[entry.on]}" if entry.on in NEEDS else ""
        words = f"{entry.on!r} is no parameter that a script sets (those that are, here: {known})"
        yield Fault("on", needs or words)
    elif why := stage.settable[entry.on].why:
        yield Fault("on", why)
    elif entry.value is not None and (wrong := stage.settable[entry.on].fault(entry.value)):
        yield Fault("value", wrong)


def _asks(entry: Entry, damping: float | None) -> Iterator[Fault]:
    try:
        drive_of(entry, damping)
    except ValidationError:
        return  # of a key that is not valid, which has its own fault
    except ValueError as error:
        yield Fault("force" if entry.is_given("force") else "do", str(error))


def _repeats(entry: Entry) -> Iterator[Fault]:
    if not entry.repeat:
        if entry.is_given("rest"):
            yield Fault("rest", "is the time between two times of an entry with repeat = true")
        return
    if entry.condition is None or entry.condition.name in HAPPENINGS:
        yield Fault("repeat", "needs when with a comparison, which may come true again")
    if entry.do == "stop":
        yield Fault("repeat", "a run ends once")


def _cycles(known: list[tuple[int, Entry]], names: Mapping[str, int]) -> Iterator[Fault]:
    entries, done = dict(known), set[int]()
    for k, _ in known:
        way, at = dict[int, None](), k
        while at not in way and at not in done:
            way[at] = None
            after = entries[at].after if "after" in entries[at].__dict__ else None
            if after is None or after not in names:
                break
            at = names[after]
        else:
            if at in way:
                round_it = list(way)[list(way).index(at) :]
                words = " after ".join(entries[one].name for one in (*round_it, at))
                yield Fault(key_of(max(round_it), "after"), f"waits for itself: {words}")
        done.update(way)
