"""Scripts of missions: entries of `[[script]]`, what they require of each other, and their timeline.

A condition is the name of a quantity, a comparison and a number; nothing of it is ever run as code.
"""

from __future__ import annotations

import math
import re
from bisect import bisect
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Field, StringConstraints, create_model, field_validator

from exunet.base.errors import Fault, within
from exunet.base.record import NonNegative, Positive, Record, Vector
from exunet.base.times import same_time
from exunet.forces.effects.breaking import Breaking
from exunet.forces.effects.contact import Contact
from exunet.forces.effects.thrust import Thrust
from exunet.net.closing import NAME as CLOSING
from exunet.net.closing import ClosingLine
from exunet.net.drive import Drive, command_of, too_fast
from exunet.net.explicit import ExplicitNet


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
    "thrust": Action(
        "thrust",
        (),
        (),
        "without `on`, the times of [effects.thrust] count from now on; with it, a constant thrust on a body",
    ),
    "control": Action("control", (), (), "the units of [control] are controlled from now on"),
    "release_control": Action("control", (), (), "the thrusters of the units of [control] stop"),
    "set": Action("parameter", ("value",), ("value",), "changes the value of a parameter from now on"),
    "checkpoint": Action("", (), (), "stores a checkpoint at the next stored time"),
    "note": Action("", (), (), "nothing: records an event, which others may follow"),
    "stop": Action("", ("verdict",), ("verdict",), "ends the run"),
}
if TYPE_CHECKING:
    Deed = str
else:  # made from the table, which a type checker cannot follow
    Deed = Literal[(*ACTIONS,)]


_LOAD = ("force", "torque")
_ON_A_BODY = Action("body", _LOAD, (*_LOAD, "duration"), "a constant thrust on a body")
_NAMED = ("drive", "held", "tether", "parameter", "body")  # objects that `on` names
_ONCE = ("cut", "eject", "thrust", "stop")


_HOLD = Field(
    None,
    description="time for which the comparison of `when` must have been true without interruption before the "
    "entry happens [s]; default: it happens at once",
    examples=[0.5],
)
if TYPE_CHECKING:
    _Lasting = Record
else:  # `for` cannot be written as the name of an attribute
    _Lasting = create_model("_Lasting", __base__=Record, **{"for": (Positive | None, _HOLD)})


class ScriptEntry(_Lasting):
    """Trigger and action of a script."""

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
        "closing line, attachment to release, body to thrust on, or parameter to set",
        examples=[CLOSING],
    )
    rate: Positive | None = Field(None, description="rate of winding up or paying out [m/s]")
    force: NonNegative | Vector | None = Field(
        None,
        description="force that a drive without a rate holds, or above which it slips [N]; of a thrust on a "
        "body the vector of its force",
    )
    torque: Vector | None = Field(None, description="torque of a thrust on a body [N m]")
    duration: Positive | None = Field(
        None, description="duration of a thrust on a body [s]; default: until the next one, or the end"
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
        if self.hold is not None and self.condition_name not in QUANTITIES:
            yield Fault("for", "requires when with a comparison")
        action = self.action
        if isinstance(self.force, tuple) != (action is _ON_A_BODY) and self.force is not None:
            words = "vector of three numbers for a thrust on a body" if action is _ON_A_BODY else "number"
            yield Fault("force", f"must be a {words}")
        if action.needs and not any(self.is_given(key) for key in action.needs):
            yield Fault(action.needs[0], f'missing: do = "{self.do}" requires {" or ".join(action.needs)}')
        for key in ("rate", "force", "torque", "duration", "value", "verdict"):
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
        once = self.do in _ONCE and action is not _ON_A_BODY
        if self.repeat and (once or (self.do == "release" and self.drive is None)):
            yield Fault("repeat", f'do = "{self.do}" happens only once')

    @property
    def hold(self) -> float | None:
        """Time for which the condition must have been true, the key `for` [s]."""
        hold: float | None = getattr(self, "for")
        return hold

    @property
    def action(self) -> Action:
        """Object and keys of the action."""
        return _ON_A_BODY if self.do == "thrust" and self.on is not None else ACTIONS[self.do]

    @property
    def drive_force(self) -> float | None:
        """Force that a drive holds, or above which it slips [N]."""
        return None if isinstance(self.force, tuple) else self.force

    @property
    def load(self) -> tuple[Vector, Vector]:
        """Force [N] and torque [N m] of a thrust on a body."""
        none = (0.0, 0.0, 0.0)
        return self.force if isinstance(self.force, tuple) else none, self.torque or none

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
        kind = self.action.on
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
        if self.action is _ON_A_BODY:
            return f"bodies.{self.on}"
        return (self.on if self.do == "set" else self.drive) or ""

    @property
    def trigger_words(self) -> str:
        """Describe the trigger."""
        parts = [] if self.when is None else [self.when]
        if self.hold is not None:
            parts = [f"{self.when} for {self.hold:g} s"]
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
        if self.drive_force is not None:
            words += f" with {self.drive_force:g} N"
        if self.action is _ON_A_BODY:
            size, torque = (math.hypot(*vector) for vector in self.load)
            words += f" with {size:g} N" + (f" and {torque:g} N m" if torque else "")
            words += "" if self.duration is None else f" for {self.duration:g} s"
        if self.value is not None:
            words += f" to {self.value:g}"
        return words if self.verdict is None else f'{words}: "{self.verdict}"'


def drive_of(entry: ScriptEntry, damping: float | None) -> Drive:
    """Return the command that an entry gives a drive; raise ValueError if its damping does not allow it."""
    if entry.do == "release":
        return command_of(damping, mode="brake", force=0.0)
    mode, rate = {
        "lock": ("lock", None),
        "brake": ("brake", None),
        "pay_out": ("rate", None if entry.rate is None else -entry.rate),
    }.get(entry.do, ("tension" if entry.rate is None else "rate", entry.rate))
    return command_of(damping, mode=mode, rate=rate, force=entry.drive_force)


def conflict(first: ScriptEntry, second: ScriptEntry) -> bool:
    """Return True if two entries command one object differently, one perhaps by a number."""
    if not first.target or (first.drive or first.target) != (second.drive or second.target):
        return False
    if (first.do == "set") != (second.do == "set"):
        setting, command = (first, second) if first.do == "set" else (second, first)
        return bool(getattr(command, (setting.on or "").rpartition(".")[2]) != setting.value)
    return first.target == second.target and _command(first) != _command(second)


def _command(entry: ScriptEntry) -> tuple[object, ...]:
    action = "reel" if entry.do == "close" else entry.do
    return action, entry.rate, entry.force, entry.torque, entry.duration, entry.value, entry.verdict


def released(entries: Iterable[ScriptEntry]) -> Iterator[str]:
    """Yield the attachments and ends of tethers that entries release."""
    yield from (entry.tie for entry in entries if entry.tie is not None)


def awaited_entries(entries: Iterable[ScriptEntry]) -> set[str]:
    """Return the names of entries whose times depend on the run: by a condition, or by such an entry."""
    every = list(entries)
    names = {entry.name for entry in every if entry.when is not None}
    while more := {entry.name for entry in every if {entry.after, entry.unless} & names} - names:
        names |= more
    return names


def ejects(entries: Iterable[ScriptEntry]) -> bool:
    """Return True if an entry ejects the net, which a body holds until then."""
    return any(entry.do == "eject" for entry in entries)


def begins_a_thrust(entries: Iterable[ScriptEntry]) -> bool:
    """Return True if [effects.thrust] waits for an entry."""
    return any(entry.do == "thrust" and entry.on is None for entry in entries)


def thrust_bodies(entries: Iterable[ScriptEntry]) -> Iterator[str]:
    """Yield the bodies on which entries thrust."""
    yield from (entry.on for entry in entries if entry.do == "thrust" and entry.on is not None)


def begins_control(entries: Iterable[ScriptEntry]) -> bool:
    """Return True if the units of [control] wait for an entry."""
    return any(entry.do == "control" for entry in entries)


def may_end_a_run(entries: Iterable[ScriptEntry]) -> bool:
    """Return True if an entry ends runs."""
    return any(entry.do == "stop" for entry in entries)


def key_of(number: int, key: str) -> str:
    """Return the path of an entry's key, or of the entry, in the case."""
    return f"script[{number}].{key}" if key else f"script[{number}]"


# Parameters that `do = "set"` may change besides those of tethers and drives ("NAME.…"), and what has them.
NEEDS = {
    "thrust.factor": "[effects.thrust]",
    "contact.friction": "[effects.contact]",
    f"{CLOSING}.friction": "a closing line",
}


@dataclass(frozen=True)
class Bounds:
    """Bounds of a parameter that a script may set.

    most     : upper bound; the lower one is 0
    open     : 0 is excluded
    because  : reason of the upper bound
    why      : why a script cannot set it in this scene; "" if it can
    """

    most: float = math.inf
    open: bool = False
    because: str = ""
    why: str = ""

    def fault(self, value: float) -> str:
        """Return the error of a value; "" if it is valid."""
        if 0.0 < value <= self.most or (value == 0.0 and not self.open):
            return ""
        words = f"must be {'greater' if self.open else 'not less'} than 0"
        if math.isfinite(self.most):
            words += f" and not above {self.most:g}{self.because}"
        return f"{words}, got {value:g}"


_STIFFEST = ", that of the case, for which the step is chosen"
_FASTEST = " m/s, the largest_rate of the drive"


def settable(scene: Any, drives: Mapping[str, Any]) -> dict[str, Bounds]:
    """Return the parameters that a script may set in a scene, by name; drives : keys of each, by name."""
    bounds = dict(_of_effects(scene))
    line = scene.closing if isinstance(scene.closing, ClosingLine) else None
    if line is not None:
        smooth = "needs closing.friction greater than 0"
        bounds["closing.friction"] = Bounds(most=2.0, open=True, why="" if line.friction else smooth)
    breaks = scene.effects.get(Breaking) is not None
    for name, tether in scene.tethers.items():
        why = f"tether {name!r} has a reel, whose outlet keeps its stiffness" if tether.reel else ""
        if breaks:
            why = "excludes [effects.breaking], whose limits follow from the stiffness of the case"
        bounds[f"{name}.youngs_modulus"] = Bounds(tether.modulus, True, _STIFFEST, why)
    for name, drive in drives.items():
        why = _commanded(name) if drive.commands else ""
        fastest = math.inf if drive.largest_rate is None else drive.largest_rate
        bounds[f"{name}.rate"] = Bounds(fastest, True, _FASTEST, why)
        weak = f"needs a damping of drive {name!r}" if drive.damping is None else ""
        bounds[f"{name}.force"] = Bounds(why=why or weak)
    return bounds


def _commanded(name: str) -> str:
    return f"drive {name!r} has commands in the case: remove these, or this entry"


def _of_effects(scene: Any) -> Iterator[tuple[str, Bounds]]:
    if scene.effects.get(Thrust) is not None:
        yield "thrust.factor", Bounds()
    contact = scene.effects.get(Contact)
    if contact is not None:
        why = "" if contact.friction is not None else "needs [effects.contact.friction]"
        yield "contact.friction", Bounds(why=why)


@dataclass(frozen=True)
class Stage:
    """Objects of a scene that a script may observe and act on.

    scene    : scene with valid tables
    drives   : keys of each drive, by name
    """

    scene: Any
    drives: Mapping[str, Any]

    @classmethod
    def of(cls, scene: Any) -> Stage:
        """Find the drives of a scene."""
        drives = {name: keys.reel for name, keys in scene.tethers.items() if keys.reel is not None}
        if isinstance(scene.closing, ClosingLine) and scene.closing.winch is not None:
            drives[CLOSING] = scene.closing.winch
        return cls(scene, drives)

    def has(self, what: str) -> bool:
        """Return True if the scene meets a requirement of quantities and actions."""
        scene = self.scene
        return {
            "target": scene.capture is not None,
            "mouth": scene.net.has_mouth,
            "tethers": bool(scene.tethers),
            "line": isinstance(scene.closing, ClosingLine),
            "contact": scene.effects.get(Contact) is not None,
            "thrust": scene.effects.get(Thrust) is not None,
            "control": scene.control is not None,
        }[what]


_LACKS = {
    "target": "needs [capture], which names the target",
    "mouth": "needs a net with a mouth: a net of listed elements has one with net.corners",
    "tethers": "needs a tether",
    "line": 'needs [closing] of kind = "line"',
    "contact": "needs [effects.contact]",
}


def entry_faults(scene: Any) -> Iterator[Fault]:
    """Yield the contradictions of the entries of a script with each other and with the scene."""
    entries, stage = scene.script, Stage.of(scene)
    names: dict[str, int] = {}
    for k, entry in enumerate(entries):
        names.setdefault(entry.name, k)
    for k, entry in enumerate(entries):
        for check in (_named_once(k, entry, names), _refers(entry, names), _observes(entry, stage)):
            yield from within(key_of(k, ""), check)
        yield from within(key_of(k, ""), _acts(entry, stage))
    yield from _cycles(entries, names)


def _named_once(number: int, entry: ScriptEntry, names: Mapping[str, int]) -> Iterator[Fault]:
    if names[entry.name] != number:
        yield Fault("name", f"entry {names[entry.name]} already has this name")


def _refers(entry: ScriptEntry, names: Mapping[str, int]) -> Iterator[Fault]:
    for key in ("after", "unless"):
        other = getattr(entry, key)
        if other is not None and other not in names:
            yield Fault(key, f"there is no entry {other!r} (entries: {', '.join(names)})")


def _observes(entry: ScriptEntry, stage: Stage) -> Iterator[Fault]:
    condition = entry.condition
    if condition is None:
        return
    name = condition.name
    needs = QUANTITIES[name].needs if name in QUANTITIES else HAPPENINGS[name][0]
    if needs and not stage.has(needs):
        yield Fault("when", f"{name} {_LACKS[needs]}")


def _acts(entry: ScriptEntry, stage: Stage) -> Iterator[Fault]:
    """Yield the faults of an action on an object that the scene does not have, or not in this way."""
    kind, name = entry.action.on, entry.on or ""
    if kind == "net":
        if words := _why_not_ejected(stage.scene):
            yield Fault("do", words)
    elif kind in ("thrust", "control"):
        if not stage.has(kind):
            yield Fault("do", f"needs {'[effects.thrust]' if kind == 'thrust' else '[control]'}")
    elif kind == "tether":
        tethers = sorted(set(stage.scene.tethers) - set(stage.drives))
        if name not in tethers:
            known = ", ".join(tethers) or "none"
            yield Fault("on", f"{name!r} is not a tether without a reel (tethers without a reel: {known})")
    elif kind == "body":
        free = [body for body, keys in stage.scene.bodies.items() if keys.motion == "free"]
        if name not in free:
            yield Fault("on", f"{name!r} is not a free body (free bodies: {', '.join(free) or 'none'})")
    elif kind == "parameter":
        yield from _sets(entry, stage)
    elif kind == "held" and name not in stage.drives:
        ties = _ties(stage.scene)
        known = ", ".join((*stage.drives, *(tie for tie, why in ties.items() if not why))) or "none"
        if words := ties.get(name, f"{name!r} cannot be released (a script can release: {known})"):
            yield Fault("on", words)
    elif kind:
        drive, key = entry.drive or "", "do" if kind == "line" else "on"
        if drive in stage.drives:
            yield from _of_drive(entry, drive, key, stage)
        else:
            known = ", ".join(stage.drives) or "none"
            yield Fault(key, f"{drive!r} does not have a reel or winch (drives: {known})")


def _of_drive(entry: ScriptEntry, name: str, key: str, stage: Stage) -> Iterator[Fault]:
    drive = stage.drives[name]
    if drive.commands:
        yield Fault(key, _commanded(name))
        return
    try:
        drive_of(entry, drive.damping)
    except ValueError as error:
        yield Fault("force" if entry.is_given("force") else "do", str(error))
    if entry.rate is not None and (words := too_fast(entry.rate, drive.rate_limit)):
        yield Fault("rate", words)


def _sets(entry: ScriptEntry, stage: Stage) -> Iterator[Fault]:
    bounds = settable(stage.scene, stage.drives)
    known = ", ".join(name for name, bound in bounds.items() if not bound.why) or "none"
    assert entry.on is not None
    if entry.on not in bounds:
        needs = f"{entry.on} needs {NEEDS[entry.on]}" if entry.on in NEEDS else ""
        words = f"{entry.on!r} is not a parameter that a script can set (settable: {known})"
        yield Fault("on", needs or words)
    elif why := bounds[entry.on].why:
        yield Fault("on", why)
    elif entry.value is not None and (wrong := bounds[entry.on].fault(entry.value)):
        yield Fault("value", wrong)


def _cycles(entries: Sequence[ScriptEntry], names: Mapping[str, int]) -> Iterator[Fault]:
    done = set[int]()
    for k in range(len(entries)):
        path, at = dict[int, None](), k
        while at not in path and at not in done:
            path[at] = None
            after = entries[at].after
            if after is None or after not in names:
                break
            at = names[after]
        else:
            if at in path:
                cycle = list(path)[list(path).index(at) :]
                words = " after ".join(entries[number].name for number in (*cycle, at))
                yield Fault(key_of(max(cycle), "after"), f"waits for itself: {words}")
        done.update(path)


def _ties(scene: Any) -> dict[str, str]:
    """Return, for each tie to a body, by its name in scripts, why it cannot be released."""
    ports, found = [name for name, one in scene.bodies.items() if one.motion == "port"], dict[str, str]()
    port = "is fixed to a port, whose mass its host counts: nothing is released from it"
    for name, body in scene.bodies.items():
        for label in body.attachments:
            found[f"bodies.{name}.attachments.{label}"] = port if name in ports else ""
    for name, tether_keys in scene.tethers.items():
        for end in ("start", "end"):
            body_name, reel = getattr(tether_keys, end).body, tether_keys.reel
            drum = f"has the drum of the tether: release the other end, or pay out {name!r}"
            why = drum if reel is not None and reel.at == end else port if body_name in ports else ""
            if body_name is not None:
                found[f"tethers.{name}.{end}"] = why
    return found


def _why_not_ejected(scene: Any) -> str:
    """Why no body holds the net until a script ejects it; "": one does."""
    frame = scene.initial.frame
    if frame is None:
        return "no body holds the net: [initial.frame] names one"
    if frame.is_given("eject_at"):
        return "initial.frame.eject_at ejects the net: remove it, or this entry"
    if frame.body in scene.bodies and scene.bodies[frame.body].motion == "port":
        return f"body {frame.body!r} is a port, which ejects a net at a time known to its host: give eject_at"
    if isinstance(scene.net, ExplicitNet) and scene.net.fixed:
        return "a net that a body holds until then has no net.fixed nodes"
    return ""


# Timeline


@dataclass(frozen=True)
class Moment:
    """Time of an entry, as far as the case gives it.

    root : entry with a condition, or that another one may prevent; "" for the start of the run
    time : time after that [s]
    """

    root: str
    time: float


@dataclass(frozen=True)
class Planned:
    """Entry of a timeline; time : of the entry [s], None where it depends on the run."""

    entry: ScriptEntry
    time: float | None

    @property
    def when(self) -> str:
        """Describe the time: "t = 2 s", or the trigger."""
        return self.entry.trigger_words if self.time is None else f"t = {self.time:g} s"


def timeline(entries: Sequence[ScriptEntry]) -> list[Planned]:
    """Return the entries of a valid script: by their times, those at one time as written, then the others."""
    moments = _moments(entries)
    planned = [
        Planned(entry, None if moments[entry.name].root else moments[entry.name].time) for entry in entries
    ]
    instants: list[float] = []
    for time in sorted(row.time for row in planned if row.time is not None):
        if not instants or not same_time(time, instants[-1]):
            instants.append(time)
    return sorted(planned, key=lambda row: math.inf if row.time is None else bisect(instants, row.time))


def conflicts(entries: Sequence[ScriptEntry]) -> Iterator[Fault]:
    """Yield a fault of each of two entries that command one object differently at one time."""
    numbers = {entry.name: k for k, entry in enumerate(entries)}
    moments, objects = _moments(entries), dict[str, list[ScriptEntry]]()
    for entry in entries:
        if entry.name in moments:
            objects.setdefault(entry.drive or entry.target, []).append(entry)
    rivals: dict[int, ScriptEntry] = {}
    for commands in objects.values():
        for first, second in combinations(commands, 2):
            mine, theirs = moments[first.name], moments[second.name]
            same = mine.root == theirs.root and same_time(mine.time, theirs.time)
            if same and conflict(first, second):
                rivals.setdefault(numbers[first.name], second)
                rivals.setdefault(numbers[second.name], first)
    for number, rival in sorted(rivals.items(), key=lambda item: item[0]):
        words = f"contradicts {rival.name}, which acts on {rival.target} at the same time"
        yield Fault(key_of(number, "do"), f"{words}: change the time, or remove one entry")


def _moments(entries: Iterable[ScriptEntry]) -> dict[str, Moment]:
    """Return the moments of entries by name, without entries in a cycle or after an unknown entry."""
    known = {entry.name: entry for entry in entries}
    moments: dict[str, Moment] = {}
    roots: dict[
        tuple[object, ...], str
    ] = {}  # entries by the condition and the moment from which it is evaluated
    for name in known:
        chain: dict[str, ScriptEntry] = {}
        while name in known and name not in moments and name not in chain:
            chain[name] = known[name]
            name = known[name].after or ""
        for entry in reversed(chain.values()):
            if entry.after is not None and entry.after not in moments:
                break
            before = Moment("", entry.at or 0.0) if entry.after is None else moments[entry.after]
            moment = Moment(before.root, before.time + entry.delay)
            if entry.unless is not None:
                moment = Moment(entry.name, 0.0)
            elif entry.condition is not None:
                condition = (entry.condition, entry.fall, entry.hold, moment.root, round(moment.time, 9))
                moment = Moment(roots.setdefault(condition, entry.name), 0.0)
            moments[entry.name] = moment
    return moments
