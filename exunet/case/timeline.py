"""A script as a timeline: the earliest moment of each entry, and which of them can never happen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from exunet.case.script import Entry
from exunet.case.script_moments import Moment, acted_on, at_odds, in_order, moments, waited_for


@dataclass(frozen=True)
class Planned:
    """An entry of a script, before a run.

    earliest : when it may happen first [s]; infinite if never
    certain  : it happens then, in any run that gets there
    place    : of what is due at one time the order in which it comes
    never    : why it cannot happen; "" if it may
    notes    : what else is to be known of it
    """

    entry: Entry
    earliest: float
    certain: bool
    place: int
    never: str = ""
    notes: tuple[str, ...] = ()

    @property
    def when(self) -> str:
        """In words: "at t = 2 s", "from t = 0 s on"."""
        if self.never:
            return "never"
        return f"t = {self.earliest:g} s" if self.certain else f"from t = {self.earliest:g} s on"

    @property
    def first(self) -> tuple[float, int]:
        """Earlier ones have less."""
        return self.earliest, self.place


def timeline(entries: Sequence[Entry], end: float) -> list[Planned]:
    """The entries of a valid script in the order of their earliest moments; end : of the run [s].

    What never happens forbids nothing, and what waits for it never happens either, and so on: all are planned
    again until no more is found.
    """
    known, order = {one.name: one for one in entries}, {one.name: k for k, one in enumerate(entries)}
    chains, never = in_order(entries), dict[str, str]()
    while True:
        found = _planned(chains, order, never)
        more = _never(found, known, end)
        if more.keys() <= never.keys():
            break
        never = more | never
    notes = _notes(entries, known, never)
    planned = [
        Planned(
            one.entry,
            math.inf if name in never else one.earliest,
            one.certain and name not in never,
            one.place,
            never.get(name, ""),
            () if name in never else tuple(notes[name]),
        )
        for name, one in found.items()
    ]
    return sorted(planned, key=lambda one: (one.earliest, order[one.entry.name]))


def _planned(
    chains: Sequence[Entry], order: Mapping[str, int], never: Mapping[str, str]
) -> dict[str, Planned]:
    """When each may happen first; chains : each after the one that it waits for."""
    found: dict[str, Planned] = {}
    for one in chains:
        unbarred = one.unless is None or one.unless in never
        earliest, certain, place = one.at or 0.0, one.when is None and unbarred, order[one.name]
        before = None if one.after is None else found[one.after]
        if before is not None:
            earliest = before.earliest + one.delay
        condition = one.condition
        if condition is not None and condition.name == "time":
            certain = unbarred and (condition.sign > 0.0 or earliest < condition.bound)
            earliest = max(earliest, condition.bound) if condition.sign > 0.0 else earliest
        if before is not None:
            certain = certain and before.certain
            place = max(place, before.place) if earliest == before.earliest else place
        found[one.name] = Planned(one, earliest, certain and one.name not in never, place)
    return found


def _never(found: Mapping[str, Planned], known: Mapping[str, Entry], end: float) -> dict[str, str]:
    """Why entries cannot happen, of those that cannot; found : each after the one that it waits for."""
    stops = (one for one in found.values() if one.entry.do == "stop" and one.certain)
    stop = min(stops, key=lambda one: one.first, default=None)
    never: dict[str, str] = {}
    for name, one in found.items():
        if one.entry.after in never:
            why = f"{one.entry.after}, for which it waits, never happens"
        elif not (why := _why_never(one, found, known, end)) and stop and stop.first < one.first:
            why = f"{stop.entry.name} ends the run at t = {stop.earliest:g} s"
        if why:
            never[name] = why
    return never


def _why_never(one: Planned, found: Mapping[str, Planned], known: Mapping[str, Entry], end: float) -> str:
    """Why an entry cannot happen although the one happens that it waits for; "" if it may."""
    entry, condition = one.entry, one.entry.condition
    timed = condition is not None and condition.name == "time" and condition.sign < 0.0
    if condition is not None and timed and one.earliest >= condition.bound:
        return f"time is never below {condition.bound:g} s from then on"
    if one.earliest > end:
        return f"t = {one.earliest:g} s is after the end, {end:g} s"
    if entry.unless is None:
        return ""
    if any(before.name == entry.unless for before in waited_for(entry, known)):
        return f"waits for {entry.unless}, after which it happens no more"
    other = found[entry.unless]
    return f"{entry.unless} comes before" if other.certain and other.first < one.first else ""


def _notes(
    entries: Sequence[Entry], known: Mapping[str, Entry], never: Mapping[str, str]
) -> dict[str, list[str]]:
    """What is to be known of entries, by their names."""
    found: dict[str, list[str]] = {one.name: [] for one in entries}
    when, possible = moments(entries), [one for one in entries if one.name not in never]
    for one, other in at_odds(possible):
        thing = acted_on(one)
        if when[one.name].is_with(when[other.name]):
            words = f"acts on {thing} at the same time as {one.name} if both happen: then this one counts"
            found[other.name].append(words)
        if _to_and_fro(one, other):
            words = f"{one.name} and {other.name} switch {thing} to and fro, once in each rest, where "
            words += f"{one.condition_name} is near its bound: leave a band between their bounds"
            found[other.name].append(words)
    released: set[str] = set()
    for first in (one for one in possible if one.tie is not None and one.name not in released):
        for second in possible:
            why = _frees(first, second)
            if why and second is not first and _comes_before(first, second, known, when, entries):
                found[second.name].append(why)
                released.add(second.name)
    return found


def _to_and_fro(one: Entry, other: Entry) -> bool:
    """True if both repeat, and the one's condition comes true as soon as the other one's does not hold."""
    mine, theirs = one.condition, other.condition
    if not (one.repeat and other.repeat) or mine is None or theirs is None or mine.name != theirs.name:
        return False
    below, above = (mine, theirs) if mine.sign < theirs.sign else (theirs, mine)
    return below.sign < above.sign and above.bound <= below.bound


def _comes_before(
    first: Entry,
    second: Entry,
    known: Mapping[str, Entry],
    when: Mapping[str, Moment],
    entries: Sequence[Entry],
) -> bool:
    """True if the second happens only once the first has."""
    if any(one is first for one in waited_for(second, known)):
        return True
    mine, theirs = when[first.name], when[second.name]
    if mine.begin != theirs.begin or not mine.barred <= theirs.barred:
        return False
    if mine.is_with(theirs):
        return entries.index(first) < entries.index(second)
    return mine.after < theirs.after


def _frees(first: Entry, second: Entry) -> str:
    """What an entry does in vain once another one has released something; "" if nothing."""
    if first.tie is None:
        return ""
    if second.tie == first.tie:
        return f"does nothing: {first.name} has released it before"
    name, _, end = first.tie.removeprefix("tethers.").rpartition(".")
    if second.drive == name and first.tie.startswith("tethers.") and second.do != "release":
        return f"pulls nothing: {first.name} has released the {end} of {name} before"
    return ""
