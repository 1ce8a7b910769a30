"""When entries of a script happen, as far as the case tells it; which ask one thing for different things.

An instant is a time after a beginning: the start of the run, or that a condition comes true, of which no time
is known before the run. Entries with one beginning and one time after it happen at one instant in any run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from exunet.case.conditions import Condition
from exunet.case.script import ACTIONS, Entry

AT_ONE_TIME = 1e-6  # [s]: to which the times of events are promised
_Begins = dict[tuple[object, ...], int]
_TOUCH = Condition("first_contact")


@dataclass(frozen=True)
class Instant:
    """A time in a run.

    begin : number of the instant from which the time counts; 0: the start of the run
    after : time after that [s]
    late  : a little later, by what a crossing of the time itself is located to
    """

    begin: int = 0
    after: float = 0.0
    late: bool = False

    def is_with(self, other: Instant) -> bool:
        """True if both come at one time, if they come."""
        return self.begin == other.begin and abs(self.after - other.after) <= AT_ONE_TIME

    def is_before(self, other: Instant) -> bool:
        """True if the other one comes later for certain, if both come."""
        return self.begin == other.begin and self.after < other.after - AT_ONE_TIME


@dataclass(frozen=True)
class Moment:
    """When an entry happens, if it does.

    armed : from when on its condition is looked at
    at    : when that is true; without a condition as soon as it is armed
    """

    armed: Instant
    at: Instant


def in_order(entries: Iterable[Entry]) -> list[Entry]:
    """Each after the one that it waits for; without those that wait for none that is there, or in a cycle."""
    known = {one.name: one for one in entries}
    found: dict[str, Entry] = {}
    for first in known.values():
        way: dict[str, Entry] = {}
        one: Entry | None = first
        while one is not None and one.name not in found and one.name not in way:
            way[one.name] = one
            one = None if one.after is None else known.get(one.after)
        for one in reversed(way.values()):
            if one.after is None or one.after in found:
                found[one.name] = one
    return list(found.values())


def moments(entries: Iterable[Entry], *, one_touch: bool = False) -> dict[str, Moment]:
    """Of entries of which each comes after the one that it waits for, by name.

    one_touch : `touching > 0` from the start on counts as the first contact, which it is in a run that begins
                without one
    """
    found: dict[str, Moment] = {}
    begins: _Begins = {}
    repeated: set[str] = set()
    for one in entries:
        armed = Instant(after=one.at or 0.0)
        if one.after in repeated and one.delay:  # which counts from the last time that this happens
            armed = Instant(begins.setdefault((one.after, one.delay), len(begins) + 1))
        elif one.after is not None:
            before = found[one.after].at
            armed = replace(before, after=before.after + one.delay)
        found[one.name] = _moment(one, armed, begins, one_touch)
        repeated |= {one.name} if one.repeat else set()
    return found


def _moment(entry: Entry, armed: Instant, begins: _Begins, one_touch: bool) -> Moment:
    """Of an entry that is armed at an instant; begins : numbers of instants by what they are."""
    condition = entry.condition
    if condition is None:
        return Moment(armed, armed)
    if condition.name == "time" and armed.begin == 0:
        if condition.sign > 0.0:
            late = armed.late or condition.bound >= armed.after
            return Moment(armed, Instant(0, max(armed.after, condition.bound), late))
        if armed.after < condition.bound:
            return Moment(armed, armed)
    if one_touch and armed == Instant() and condition.name == "touching" and condition.sign > 0.0:
        condition = _TOUCH if condition.bound < 1.0 else condition
    fall = entry.fall if condition.name == "largest_area" else 0.0
    # Rounded as sums of times are, far below what any two times differ by on purpose.
    what = (condition, fall, armed.begin, round(armed.after, 9))
    return Moment(armed, Instant(begins.setdefault(what, len(begins) + 1)))


def waited_for(entry: Entry, known: Mapping[str, Entry]) -> Iterator[Entry]:
    """The entries, of a valid script, that must have happened before this one, the last first."""
    while entry.after is not None:
        entry = known[entry.after]
        yield entry


def acted_on(entry: Entry) -> str:
    """What two entries cannot act on differently at one time: a drive, a parameter, ...; "" of others."""
    if entry.do == "stop":
        return "the run"
    if ACTIONS[entry.do].on == "control":
        return "the control"
    return (entry.on if entry.do == "set" else entry.drive) or ""


def asked(entry: Entry) -> tuple[object, ...]:
    """What it asks of that."""
    deed = "reel" if entry.do == "close" else entry.do
    return deed, entry.rate, entry.force, entry.value, entry.verdict


def differ(one: Entry, other: Entry) -> bool:
    """True if both act on one thing, otherwise.

    Of a drive they command it, or set a number of its command.
    """
    if _thing(one) == "" or _thing(one) != _thing(other):
        return False
    numbers = [entry for entry in (one, other) if entry.do == "set"]
    if len(numbers) == 1:
        command = other if one.do == "set" else one
        return bool(getattr(command, (numbers[0].on or "").rpartition(".")[2]) != numbers[0].value)
    return acted_on(one) == acted_on(other) and asked(one) != asked(other)


def _thing(entry: Entry) -> str:
    """What it acts on; of a number of a drive's command the drive."""
    return entry.drive or acted_on(entry)


def at_odds(entries: Iterable[Entry]) -> Iterator[tuple[Entry, Entry]]:
    """Pairs of entries that act on one thing, otherwise, in the order of the script."""
    groups: dict[str, list[Entry]] = {}
    for one in entries:
        groups.setdefault(_thing(one), []).append(one)
    for group in groups.values():
        yield from ((one, other) for one, other in combinations(group, 2) if differ(one, other))
