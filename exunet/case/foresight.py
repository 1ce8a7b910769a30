"""What a script tells before a run: entries that happen for certain, in which order, and those that never do.

An entry is *sure* if nothing bars it once its beginning has come: the start of the run, or the condition from
which its time counts (see `script_moments`). All is worked out anew, with what has been found before, until
no more is found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from exunet.case.conditions import Condition
from exunet.case.script import Entry
from exunet.case.script_moments import Instant, Moment, differ, in_order, moments, waited_for

_SAME = 1e-9  # of a value: what round-off may make of it


@dataclass(frozen=True)
class Surroundings:
    """What of a scene bounds what a script may see.

    end    : of the run [s]
    most   : largest value of quantities, by name
    packed : values of quantities as long as a body holds the packed net; None: none does until a script
             ejects it
    """

    end: float
    most: Mapping[str, float] = field(default_factory=dict)
    packed: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Foreseen:
    """What is known of an entry before a run.

    earliest : when it may happen first [s]
    open     : what may bar it, or one for which it waits: names of entries, and until when they may
    never    : why it cannot happen; "" if it may
    """

    entry: Entry
    moment: Moment
    earliest: float
    open: frozenset[tuple[str, Instant]] = frozenset()
    never: str = ""

    @property
    def certain(self) -> bool:
        """True if it happens at its earliest time, in any run that gets there."""
        return self.moment.at.begin == 0 and not self.open and not self.never

    def is_covered(self, other: Foreseen) -> bool:
        """True if it happens in any run that gets there in which the other one does."""
        return all(
            any(name == one and (until.is_before(to) or until == to) for one, to in other.open)
            for name, until in self.open
        )


class Foresight:
    """Of valid entries, by their names; `found` is in the order in which entries wait for each other."""

    def __init__(self, entries: Iterable[Entry], scene: Surroundings) -> None:
        chains = in_order(entries)
        self._scene, self._known = scene, {one.name: one for one in chains}
        self._order = {one.name: k for k, one in enumerate(entries)}
        self._at_once = self._places(when := moments(chains))
        unknown = frozenset([("", Instant())])  # until the first time through, any may be barred
        self.found = {one.name: Foreseen(one, when[one.name], 0.0, unknown) for one in chains}
        before = None
        while before != self.found:
            before = self.found
            self.found = self._again(before)

    def _places(self, when: Mapping[str, Moment]) -> dict[str, tuple[int, ...]]:
        """By which entries with one known time are ordered: the first in the script of those that are due.

        One that waits for another comes once that has happened, so before what stands behind both.
        """
        found: dict[str, tuple[int, ...]] = {}
        for name, one in self._known.items():
            number, way = self._order[name], []
            if one.after in found and when[one.after].at == when[name].at:
                way = [place for place in found[one.after] if place >= number]
            if when[name].at.begin == 0:
                found[name] = (*way, number)
        return found

    def _again(self, before: Mapping[str, Foreseen]) -> dict[str, Foreseen]:
        """All once more, with what has been found before."""
        stops = [one for one in before.values() if one.entry.do == "stop" and not one.open and not one.never]
        thrown = self._thrown(before)
        found: dict[str, Foreseen] = {}
        for name, one in before.items():
            entry, own = one.entry, one.moment
            waits = None if entry.after is None else found[entry.after]
            earliest = own.at.after if own.at.begin == 0 else entry.at or 0.0
            if waits is not None:
                earliest = max(earliest, waits.earliest + entry.delay)
            if self._needs_the_net_out(entry):
                earliest = max(earliest, min(thrown.values(), default=math.inf))
            now = replace(one, earliest=earliest, open=frozenset() if waits is None else waits.open)
            if entry.unless is not None and not self._spares(now, before):
                now = replace(now, open=now.open | {(entry.unless, own.at)})
            why = self._why_never(now, waits, stops, before, thrown)
            found[name] = replace(now, never=why or one.never)
        return found

    def _why_never(
        self,
        one: Foreseen,
        waits: Foreseen | None,
        stops: Iterable[Foreseen],
        before: Mapping[str, Foreseen],
        thrown: Mapping[str, float],
    ) -> str:
        """Why an entry cannot happen, as far as is known; "" if it may."""
        entry, own, condition = one.entry, one.moment, one.entry.condition
        if waits is not None and waits.never:
            return f"{entry.after}, for which it waits, never happens"
        if condition is not None and (why := self._never_true(condition, one.earliest)):
            return why
        if not thrown and self._needs_the_net_out(entry):
            return f"the net stays packed: {self._not_thrown(before)}"
        if one.earliest > self._scene.end:
            return f"t = {one.earliest:g} s is after the end, {self._scene.end:g} s"
        for stop in stops:
            if stop.moment.at == own.at and differ(stop.entry, entry):
                continue  # two verdicts: a contradiction
            if stop.entry is not entry and self._precedes(stop, one):
                return f"{stop.entry.name} ends the run {_words_of(stop)}"
        if entry.unless is None:
            return ""
        if any(link.name == entry.unless for link in waited_for(entry, self._known)):
            return f"waits for {entry.unless}, after which it happens no more"
        other = before.get(entry.unless)
        sure = other is not None and not other.open and not other.never
        return f"{entry.unless} comes before" if sure and other and self._comes_before(other, one) else ""

    def _never_true(self, condition: Condition, earliest: float) -> str:
        most = self._scene.most.get(condition.name, math.inf)
        if condition.name == "time" and condition.sign < 0.0 and earliest >= condition.bound:
            return f"time is never below {condition.bound:g} s from then on"
        if condition.name == "time" and condition.sign > 0.0 and condition.bound == self._scene.end:
            return f"time is at most {condition.bound:g} s, the end"
        if condition.sign > 0.0 and condition.bound >= most:
            return f"{condition.name} is at most {most:g} here"
        return ""

    def _spares(self, one: Foreseen, before: Mapping[str, Foreseen]) -> bool:
        """True if the entry after which this one happens no more does not come before it."""
        other = before.get(one.entry.unless or "")
        return other is not None and (bool(other.never) or self._comes_before(one, other))

    # The packed net

    def _needs_the_net_out(self, entry: Entry) -> bool:
        """True if its condition is not true as long as the net is packed."""
        packed, condition = self._scene.packed, entry.condition
        if packed is None or condition is None:
            return False
        value = packed.get(condition.name)
        if value is None:
            return condition.name == "largest_area" and "area" in packed
        return condition.sign * (value - condition.bound) < -_SAME * max(value, condition.bound)

    def _thrown(self, before: Mapping[str, Foreseen]) -> dict[str, float]:
        """Entries that may eject the net, none that waits for one that is out; when at the earliest [s]."""
        return {
            one.entry.name: one.earliest
            for one in before.values()
            if one.entry.do == "eject" and not one.never and not self._waits_for_the_net(one.entry)
        }

    def _waits_for_the_net(self, entry: Entry) -> bool:
        return any(map(self._needs_the_net_out, (entry, *waited_for(entry, self._known))))

    def _not_thrown(self, before: Mapping[str, Foreseen]) -> str:
        ejects = [one.entry for one in before.values() if one.entry.do == "eject"]
        waiting = [one.name for one in ejects if self._waits_for_the_net(one)]
        if waiting:
            return f"{', '.join(waiting)}, which ejects it, waits until it is out"
        return f"{', '.join(one.name for one in ejects) or 'no entry'} ejects it"

    # Which comes first

    def _comes_before(self, one: Foreseen, other: Foreseen) -> bool:
        """True if the one, whenever both beginnings come, happens before the other may; see `_precedes`."""
        if self._precedes(one, other) or self.waits_for(other.entry, one.entry):
            return True
        links = waited_for(other.entry, self._known)
        return any(self._precedes(one, self.found[link.name]) for link in links)

    def _precedes(self, one: Foreseen, other: Foreseen) -> bool:
        """The same, without the entries for which the other one waits."""
        mine, theirs = one.moment, other.moment
        if mine.at.is_before(theirs.at) or mine.at.is_before(theirs.armed):
            return True
        if mine.at.begin == 0 and mine.at.is_before(Instant(0, other.earliest)):
            return True
        number, its = self._order[one.entry.name], self._order[other.entry.name]
        looks_first = mine.armed == theirs.armed or mine.armed.is_before(theirs.armed)
        if number < its and looks_first and _follows(one.entry, other.entry):
            return True
        if theirs.at.late and not mine.at.late:  # a time is crossed once it is over
            return mine.at.begin == theirs.at.begin and mine.at.after <= theirs.at.after
        if mine.at.late or mine.at != theirs.at:
            return False
        if mine.at.begin == 0:
            return self._at_once[one.entry.name] < self._at_once[other.entry.name]
        alike = (one.entry.after, one.entry.delay) == (other.entry.after, other.entry.delay)
        return alike and one.entry.condition is None and other.entry.condition is None and number < its

    def are_together(self, one: Foreseen, other: Foreseen) -> bool:
        """True if both happen at one time in any run in which either does."""
        same = one.moment.at.is_with(other.moment.at)
        return same and not (one.never or other.never) and one.is_covered(other) and other.is_covered(one)

    def waits_for(self, one: Entry, other: Entry) -> bool:
        """True if the one is the other, or happens only after it."""
        return any(link is other for link in (one, *waited_for(one, self._known)))

    def happens_first(self, one: Foreseen, other: Foreseen) -> bool:
        """True if the other one happens only once the first has."""
        if self.waits_for(other.entry, one.entry):
            return True
        return not one.never and one.is_covered(other) and self._comes_before(one, other)


def _follows(one: Entry, other: Entry) -> bool:
    """True if what the one waits for has come true once that of the other has, not looked at any later."""
    mine, theirs = one.condition, other.condition
    if mine is None or theirs is None or (mine.name, mine.sign) != (theirs.name, theirs.sign):
        return False
    if mine.name == "largest_area":
        return one.fall <= other.fall
    return mine.sign * (theirs.bound - mine.bound) >= 0.0


def _words_of(stop: Foreseen) -> str:
    if stop.moment.at.begin == 0:
        return f"at t = {stop.earliest:g} s"
    return "before"
