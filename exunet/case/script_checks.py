"""What the entries of a script demand of each other and of the scene that they act in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pydantic import ValidationError

from exunet.base.errors import Fault
from exunet.base.faults import each
from exunet.case.conditions import HAPPENINGS, QUANTITIES
from exunet.case.parameters import NEEDS, Bounds
from exunet.case.script import ACTIONS, Entry, drive_of, key_of
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import too_fast

_VALUES = ("rate", "force", "value", "verdict")


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
