"""When entries of a script happen, as far as the case tells it; which contradict each other at one time.

A moment is a time after a beginning: the start of the run, or that a condition comes true, of which no time
is known before the run. Entries with one beginning and one time after it happen at one instant in any run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

from exunet.base.errors import Fault
from exunet.base.table import Unknown
from exunet.case.script import ACTIONS, Condition, Entry, key_of

AT_ONE_TIME = 1e-6  # [s]: to which the times of events are promised


@dataclass(frozen=True)
class Moment:
    """When an entry happens, if it does.

    begin : the condition from which the time counts, `fall` of it, and from when on it is looked at; none:
            the start of the run
    after : time after that [s]
    barred : entries after which it, or one for which it waits, happens no more
    """

    begin: tuple[Condition, float, Moment] | None
    after: float
    barred: frozenset[str] = frozenset()

    def is_with(self, other: Moment) -> bool:
        """True if both happen at one instant, if they happen."""
        return self.begins_with(other) and abs(self.after - other.after) <= AT_ONE_TIME

    def begins_with(self, other: Moment) -> bool:
        """True if the times of both count from one instant."""
        if self.begin is None or other.begin is None:
            return self.begin is other.begin
        return self.begin[:2] == other.begin[:2] and self.begin[2].is_with(other.begin[2])


def moment_of(entry: Entry, known: Mapping[str, Entry]) -> Moment:
    """Of an entry among those that are known by name; raises Unknown in a cycle, or if one is not valid."""
    return _moment(entry, known, ())


def _moment(entry: Entry, known: Mapping[str, Entry], waiting: tuple[str, ...]) -> Moment:
    if entry.name in waiting or (entry.after is not None and entry.after not in known):
        raise Unknown(entry.name)
    armed = Moment(None, entry.at or 0.0)
    if entry.after is not None:
        armed = _moment(known[entry.after], known, (*waiting, entry.name))
        armed = replace(armed, after=armed.after + entry.delay)
    if entry.unless is not None:
        armed = replace(armed, barred=armed.barred | {entry.unless})
    condition = entry.condition
    if condition is None:
        return armed
    if condition.name == "time" and armed.begin is None:
        if condition.sign > 0.0:
            return replace(armed, after=max(armed.after, condition.bound))
        if armed.after < condition.bound:
            return armed
    fall = entry.fall if condition.name == "largest_area" else 0.0
    return Moment((condition, fall, armed), 0.0, armed.barred)


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


def contradictions(entries: Sequence[Entry | None]) -> Iterator[Fault]:
    """A fault of each of two entries that happen at one time and ask one thing for different things.

    Entries of which either may be barred while the other one is not are told in the timeline only. None
    stands for an entry that has other faults.
    """
    valid = [(k, one) for k, one in enumerate(entries) if one is not None and "name" in one.__dict__]
    known = {one.name: one for _, one in valid}
    rivals: dict[int, Entry] = {}
    for (k, one), (n, other) in combinations(valid, 2):
        with suppress(Unknown):
            if differ(one, other) and _surely_together(one, other, known):
                rivals.setdefault(k, other)
                rivals.setdefault(n, one)
    for number, rival in sorted(rivals.items(), key=lambda one: one[0]):
        words = f"contradicts {rival.name}, which acts on {acted_on(rival)} at the same time"
        yield Fault(key_of(number, "do"), f"{words}: give another time, or leave one out")


def _surely_together(one: Entry, other: Entry, known: Mapping[str, Entry]) -> bool:
    """True if both happen at one instant, or neither does."""
    mine, theirs = moment_of(one, known), moment_of(other, known)
    return mine.is_with(theirs) and mine.barred == theirs.barred
