"""Lint of scripts: what entries require of each other and of the scene, and their timeline."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from exunet.base.errors import Fault, within
from exunet.net.closing import NAME as CLOSING
from exunet.net.closing import ClosingLineConfig
from exunet.net.drive import too_fast
from exunet.net.explicit import ExplicitNetConfig
from exunet.scene.script import ACTIONS, HAPPENINGS, QUANTITIES, Entry, conflict, drive_of, key_of

# Parameters that `do = "set"` may change besides those of tethers and drives ("NAME.…"), and what has them.
NEEDS = {
    "thrust.factor": "[effects.thrust]",
    "contact.friction": "[effects.contact]",
    f"{CLOSING}.friction": "a closing line",
}


@dataclass(frozen=True)
class Bounds:
    """Bounds of a parameter that a script may set.

    least, most : bounds; `open` : `least` is excluded
    because     : reason of the upper bound
    why         : why a script cannot set it in this scene; "" if it can
    """

    least: float = 0.0
    most: float = math.inf
    open: bool = False
    because: str = ""
    why: str = ""

    def fault(self, value: float) -> str:
        """Return the error of a value; "" if it is valid."""
        if self.least < value <= self.most or (value == self.least and not self.open):
            return ""
        words = f"must be {'greater than' if self.open else 'not less than'} {self.least:g}"
        if math.isfinite(self.most):
            words += f" and not above {self.most:g}{self.because}"
        return f"{words}, got {value:g}"


_STIFFEST = ", that of the case, for which the step is chosen"
_FASTEST = " m/s, the largest_rate of the drive"


def settable(scene: Any, drives: Mapping[str, Any]) -> dict[str, Bounds]:
    """Return the parameters that a script may set in a scene, by name; drives : keys of each, by name."""
    bounds = dict(_of_effects(scene))
    line = scene.closing if isinstance(scene.closing, ClosingLineConfig) else None
    if line is not None:
        smooth = "needs closing.friction greater than 0"
        bounds["closing.friction"] = Bounds(most=2.0, open=True, why="" if line.friction else smooth)
    breaks = getattr(scene.effects, "breaking", None) is not None
    for name, tether in scene.tethers.items():
        why = f"tether {name!r} has a reel, whose outlet keeps its stiffness" if tether.reel else ""
        if breaks:
            why = "excludes [effects.breaking], whose limits follow from the stiffness of the case"
        bounds[f"{name}.youngs_modulus"] = Bounds(0.0, tether.youngs_modulus, True, _STIFFEST, why)
    for name, drive in drives.items():
        why = _commanded(name) if drive.commands else ""
        fastest = math.inf if drive.largest_rate is None else drive.largest_rate
        bounds[f"{name}.rate"] = Bounds(0.0, fastest, True, _FASTEST, why)
        weak = f"needs a damping of drive {name!r}" if drive.damping is None else ""
        bounds[f"{name}.force"] = Bounds(why=why or weak)
    return bounds


def _commanded(name: str) -> str:
    return f"drive {name!r} has commands in the case: remove these, or this entry"


def _of_effects(scene: Any) -> Iterator[tuple[str, Bounds]]:
    if getattr(scene.effects, "thrust", None) is not None:
        yield "thrust.factor", Bounds()
    contact = getattr(scene.effects, "contact", None)
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
        if isinstance(scene.closing, ClosingLineConfig) and scene.closing.winch is not None:
            drives[CLOSING] = scene.closing.winch
        return cls(scene, drives)

    def has(self, what: str) -> bool:
        """Return True if the scene meets a requirement of quantities and actions."""
        scene = self.scene
        return {
            "target": scene.capture is not None,
            "mouth": scene.net.topology != "explicit",
            "tethers": bool(scene.tethers),
            "line": isinstance(scene.closing, ClosingLineConfig),
            "contact": getattr(scene.effects, "contact", None) is not None,
            "thrust": getattr(scene.effects, "thrust", None) is not None,
            "control": scene.control is not None,
        }[what]


_LACKS = {
    "target": "needs [capture], which names the target",
    "mouth": "needs a net with a mouth: a net of listed elements does not have one",
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


def _named_once(number: int, entry: Entry, names: Mapping[str, int]) -> Iterator[Fault]:
    if names[entry.name] != number:
        yield Fault("name", f"entry {names[entry.name]} already has this name")


def _refers(entry: Entry, names: Mapping[str, int]) -> Iterator[Fault]:
    for key in ("after", "unless"):
        other = getattr(entry, key)
        if other is not None and other not in names:
            yield Fault(key, f"there is no entry {other!r} (entries: {', '.join(names)})")


def _observes(entry: Entry, stage: Stage) -> Iterator[Fault]:
    condition = entry.condition
    if condition is None:
        return
    name = condition.name
    needs = QUANTITIES[name].needs if name in QUANTITIES else HAPPENINGS[name][0]
    if needs and not stage.has(needs):
        yield Fault("when", f"{name} {_LACKS[needs]}")


def _acts(entry: Entry, stage: Stage) -> Iterator[Fault]:
    """Yield the faults of an action on an object that the scene does not have, or not in this way."""
    kind, name = ACTIONS[entry.do].on, entry.on or ""
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


def _of_drive(entry: Entry, name: str, key: str, stage: Stage) -> Iterator[Fault]:
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


def _sets(entry: Entry, stage: Stage) -> Iterator[Fault]:
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


def _cycles(entries: Sequence[Entry], names: Mapping[str, int]) -> Iterator[Fault]:
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
    """What is fixed to bodies, by the names that a script has for it, and why it cannot be released."""
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
    if isinstance(scene.net, ExplicitNetConfig) and scene.net.fixed:
        return "a net that a body holds until then has no net.fixed nodes"
    return ""


# Timeline

SAME_TIME = 1e-6  # [s]: to which events are located


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

    entry: Entry
    time: float | None

    @property
    def when(self) -> str:
        """Describe the time: "t = 2 s", or the trigger."""
        return self.entry.trigger_words if self.time is None else f"t = {self.time:g} s"


def timeline(entries: Sequence[Entry]) -> list[Planned]:
    """Return the entries of a valid script: those with known times in their order, then those without."""
    moments = _moments(entries)
    planned = [
        Planned(entry, None if moments[entry.name].root else moments[entry.name].time) for entry in entries
    ]
    return sorted(planned, key=lambda row: math.inf if row.time is None else row.time)


def conflicts(entries: Sequence[Entry]) -> Iterator[Fault]:
    """Yield a fault of each of two entries that command one object differently at one time."""
    numbers = {entry.name: k for k, entry in enumerate(entries)}
    moments, objects = _moments(entries), dict[str, list[Entry]]()
    for entry in entries:
        if entry.name in moments:
            objects.setdefault(entry.drive or entry.target, []).append(entry)
    rivals: dict[int, Entry] = {}
    for commands in objects.values():
        for first, second in combinations(commands, 2):
            mine, theirs = moments[first.name], moments[second.name]
            same = mine.root == theirs.root and abs(mine.time - theirs.time) <= SAME_TIME
            if same and conflict(first, second):
                rivals.setdefault(numbers[first.name], second)
                rivals.setdefault(numbers[second.name], first)
    for number, rival in sorted(rivals.items(), key=lambda item: item[0]):
        words = f"contradicts {rival.name}, which acts on {rival.target} at the same time"
        yield Fault(key_of(number, "do"), f"{words}: change the time, or remove one entry")


def _moments(entries: Iterable[Entry]) -> dict[str, Moment]:
    """Return the moments of entries by name, without entries in a cycle or after an unknown entry."""
    known = {entry.name: entry for entry in entries}
    moments: dict[str, Moment] = {}
    roots: dict[
        tuple[object, ...], str
    ] = {}  # entries by the condition and the moment from which it is evaluated
    for name in known:
        chain: dict[str, Entry] = {}
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
                condition = (entry.condition, entry.fall, moment.root, round(moment.time, 9))
                moment = Moment(roots.setdefault(condition, entry.name), 0.0)
            moments[entry.name] = moment
    return moments
