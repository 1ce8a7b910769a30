"""When entries of a script happen, as far as the case tells it; which contradict each other at one time.

A moment is a time after a beginning: the start of the run, or that a condition comes true, of which no time
is known before the run. Entries with one beginning and one time after it happen at one instant in any run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

from exunet.base.errors import Fault
from exunet.base.table import Unknown
from exunet.case.script import ACTIONS, Entry, key_of

AT_ONE_TIME = 1e-6  # [s]: to which the times of events are promised
_Begins = dict[tuple[object, ...], int]


@dataclass(frozen=True)
class Moment:
    """When an entry happens, if it does.

    begin  : number of the instant from which the time counts; 0: the start of the run
    after  : time after that [s]
    barred : entries after which it, or one for which it waits, happens no more
    """

    begin: int = 0
    after: float = 0.0
    barred: frozenset[str] = frozenset()

    def is_with(self, other: Moment) -> bool:
        """True if both happen at one instant, if they happen."""
        return self.begin == other.begin and abs(self.after - other.after) <= AT_ONE_TIME


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


def moments(entries: Iterable[Entry]) -> dict[str, Moment]:
    """Of the entries by name; without those whose keys are not valid, and what waits for these."""
    found: dict[str, Moment] = {}
    begins: _Begins = {}
    for one in in_order(entries):
        with suppress(Unknown, KeyError):
            found[one.name] = _moment(one, Moment() if one.after is None else found[one.after], begins)
    return found


def _moment(entry: Entry, before: Moment, begins: _Begins) -> Moment:
    """Of an entry, from that of the one for which it waits; begins : numbers of instants by what they are."""
    armed = (
        replace(before, after=before.after + entry.delay) if entry.after else Moment(after=entry.at or 0.0)
    )
    if entry.unless is not None:
        armed = replace(armed, barred=armed.barred | {entry.unless})
    condition = entry.condition
    if condition is None:
        return armed
    if condition.name == "time" and armed.begin == 0:
        if condition.sign > 0.0:
            return replace(armed, after=max(armed.after, condition.bound))
        if armed.after < condition.bound:
            return armed
    fall = entry.fall if condition.name == "largest_area" else 0.0
    # Rounded as sums of times are, far below what any two times differ by on purpose.
    what = (condition, fall, armed.begin, round(armed.after, 9))
    return Moment(begins.setdefault(what, len(begins) + 1), 0.0, armed.barred)


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
    """True if both act on one thing, otherwise."""
    return acted_on(one) != "" and acted_on(one) == acted_on(other) and asked(one) != asked(other)


def at_odds(entries: Iterable[Entry]) -> Iterator[tuple[Entry, Entry]]:
    """Pairs of entries that act on one thing, otherwise, in the order of the script."""
    groups: dict[str, list[Entry]] = {}
    for one in entries:
        with suppress(Unknown):
            groups.setdefault(acted_on(one), []).append(one)
    groups.pop("", None)
    for group in groups.values():
        for one, other in combinations(group, 2):
            with suppress(Unknown):
                if asked(one) != asked(other):
                    yield one, other


def contradictions(entries: Sequence[Entry | None]) -> Iterator[Fault]:
    """A fault of each of two entries that happen at one time and ask one thing for different things.

    Entries of which either may be barred while the other one is not are told in the timeline only. None
    stands for an entry that has other faults.
    """
    numbers = {one.name: k for k, one in enumerate(entries) if one is not None and "name" in one.__dict__}
    valid = [one for one in entries if one is not None and "name" in one.__dict__]
    when, rivals = moments(valid), dict[int, Entry]()
    for one, other in at_odds(valid):
        mine, theirs = when.get(one.name), when.get(other.name)
        if mine and theirs and mine.is_with(theirs) and mine.barred == theirs.barred:
            rivals.setdefault(numbers[one.name], other)
            rivals.setdefault(numbers[other.name], one)
    for number, rival in sorted(rivals.items(), key=lambda one: one[0]):
        words = f"contradicts {rival.name}, which acts on {acted_on(rival)} at the same time"
        yield Fault(key_of(number, "do"), f"{words}: give another time, or leave one out")
