"""A script as a timeline: the earliest moment of each entry, and which of them can never happen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from exunet.case.script import Entry


@dataclass(frozen=True)
class Planned:
    """An entry of a script, before a run.

    earliest : when it may happen first [s]; infinite if never
    certain  : it happens then, in any run that gets there
    never    : why it cannot happen; "" if it may
    """

    entry: Entry
    earliest: float
    certain: bool
    never: str = ""

    @property
    def when(self) -> str:
        """In words: "at t = 2 s", "from t = 0 s on"."""
        if self.never:
            return "never"
        return f"t = {self.earliest:g} s" if self.certain else f"from t = {self.earliest:g} s on"


def timeline(entries: Sequence[Entry], end: float) -> list[Planned]:
    """The entries of a valid script in the order of their earliest moments; end : of the run [s]."""
    known = {one.name: one for one in entries}
    found: dict[str, Planned] = {}
    for one in entries:
        _plan(one, known, found, end)
    order = {one.name: k for k, one in enumerate(entries)}
    stops = [one for one in found.values() if one.entry.do == "stop" and one.certain and not one.never]
    stop = min(stops, key=lambda one: one.earliest, default=None)
    planned = [_not_beyond(one, found, order, stop) for one in found.values()]
    return sorted(planned, key=lambda one: (one.earliest, order[one.entry.name]))


def _plan(entry: Entry, known: Mapping[str, Entry], found: dict[str, Planned], end: float) -> Planned:
    """Put an entry among those that are planned, and before it the one that it waits for."""
    if entry.name in found:
        return found[entry.name]
    earliest, certain, never = entry.at or 0.0, entry.when is None and entry.unless is None, ""
    if entry.after is not None:
        before = _plan(known[entry.after], known, found, end)
        earliest, certain = before.earliest + entry.delay, certain and before.certain
        if before.never:
            never = f"{entry.after}, for which it waits, never happens"
    condition = entry.condition
    if condition is not None and condition.name == "time":
        if condition.sign > 0.0:
            earliest, certain = max(earliest, condition.bound), certain or entry.unless is None
        elif earliest >= condition.bound:
            never = never or f"time is never below {condition.bound:g} s from then on"
    if not never and earliest > end:
        never = f"t = {earliest:g} s is after the end, {end:g} s"
    found[entry.name] = Planned(entry, math.inf if never else earliest, certain and not never, never)
    return found[entry.name]


def _not_beyond(
    one: Planned, found: Mapping[str, Planned], order: Mapping[str, int], stop: Planned | None
) -> Planned:
    """Whether another entry that certainly happens forbids it, or ends the run before it."""
    name, other = one.entry.name, one.entry.unless
    if one.never:
        return one
    if other is not None and found[other].certain:
        first = found[other].earliest, order[other]
        if first < (one.earliest, order[name]):
            return Planned(one.entry, math.inf, False, f"{other} comes before")
    if stop is not None and stop is not one and stop.earliest < one.earliest:
        words = f"{stop.entry.name} ends the run at t = {stop.earliest:g} s"
        return Planned(one.entry, math.inf, False, words)
    return one
