"""A script as a timeline: the earliest moment of each entry, and which of them can never happen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from exunet.base.errors import Fault
from exunet.case.foresight import Foreseen, Foresight, Surroundings
from exunet.case.script import Entry, key_of
from exunet.case.script_moments import acted_on, at_odds, in_order, moments

_TOUCH = ("first_contact", "touching")


@dataclass(frozen=True)
class Planned:
    """An entry of a script, before a run.

    earliest : when it may happen first [s]; infinite if never
    certain  : it happens then, in any run that gets there
    never    : why it cannot happen; "" if it may
    notes    : what else is to be known of it
    """

    entry: Entry
    earliest: float
    certain: bool
    never: str = ""
    notes: tuple[str, ...] = ()

    @property
    def when(self) -> str:
        """In words: "at t = 2 s", "from t = 0 s on"."""
        if self.never:
            return "never"
        return f"t = {self.earliest:g} s" if self.certain else f"from t = {self.earliest:g} s on"


def timeline(entries: Sequence[Entry], scene: Surroundings) -> list[Planned]:
    """The entries of a valid script in the order of their earliest moments."""
    foresight, planned = Foresight(entries, scene), []
    notes = _notes(entries, foresight, scene)
    for one in entries:
        seen = foresight.found[one.name]
        earliest = math.inf if seen.never else seen.earliest
        told = () if seen.never else tuple(notes[one.name])
        planned.append(Planned(one, earliest, seen.certain, seen.never, told))
    return sorted(planned, key=lambda one: one.earliest)


def contradictions(entries: Sequence[Entry | None], end: float) -> Iterator[Fault]:
    """A fault of each of two entries that happen at one time and ask one thing for different things.

    Entries of which either may be barred while the other one is not are told in the timeline only. None
    stands for an entry that has other faults; end : of the run [s].
    """
    keys = Entry.model_fields.keys()
    numbers = {
        one.name: k for k, one in enumerate(entries) if one is not None and one.__dict__.keys() >= keys
    }
    valid = [one for one in entries if one is not None and one.__dict__.keys() >= keys]
    rivals: dict[int, Entry] = {}
    foresight = Foresight(valid, Surroundings(end))
    for one, other in at_odds(valid):
        mine, theirs = foresight.found.get(one.name), foresight.found.get(other.name)
        if mine and theirs and foresight.are_together(mine, theirs):
            rivals.setdefault(numbers[one.name], other)
            rivals.setdefault(numbers[other.name], one)
    for number, rival in sorted(rivals.items(), key=lambda one: one[0]):
        words = f"contradicts {rival.name}, which acts on {acted_on(rival)} at the same time"
        yield Fault(key_of(number, "do"), f"{words}: give another time, or leave one out")


def _notes(entries: Sequence[Entry], foresight: Foresight, scene: Surroundings) -> dict[str, list[str]]:
    """What is to be known of entries, by their names."""
    found: dict[str, list[str]] = {one.name: [] for one in entries}
    possible = [foresight.found[one.name] for one in entries if not foresight.found[one.name].never]
    when = moments(in_order(entries), one_touch=True)
    for one, other in at_odds(seen.entry for seen in possible):
        thing = acted_on(one)
        if when[one.name].at.is_with(when[other.name].at):
            words = f"acts on {thing} at the same time as {one.name} if both happen: then this one counts"
            found[other.name].append(words)
        if _to_and_fro(one, other):
            words = f"{one.name} and {other.name} switch {thing} to and fro, once in each rest, where "
            words += f"{one.condition_name} is near its bound: leave a band between their bounds"
            found[other.name].append(words)
    vain: set[str] = set()
    for first in possible:
        for second in possible if first.entry.name not in vain else ():
            why = _in_vain(first.entry, second.entry)
            if why and second is not first and foresight.happens_first(first, second):
                if second.entry.name not in vain:
                    found[second.entry.name].append(f"in vain: {why}")
                vain.add(second.entry.name)
    if scene.packed is not None:
        for name, words in _touched_in_the_canister(possible, foresight):
            found[name].append(words)
    return found


def _to_and_fro(one: Entry, other: Entry) -> bool:
    """True if both repeat, and the one's condition comes true as soon as the other one's does not hold."""
    mine, theirs = one.condition, other.condition
    if not (one.repeat and other.repeat) or mine is None or theirs is None or mine.name != theirs.name:
        return False
    below, above = (mine, theirs) if mine.sign < theirs.sign else (theirs, mine)
    return below.sign < above.sign and above.bound <= below.bound


def _in_vain(first: Entry, second: Entry) -> str:
    """Why an entry does nothing once another one has cut, released or ejected something; "" if it does."""
    if first.do == second.do == "eject":
        return f"{first.name} has ejected the net before"
    if first.do == "cut" and first.on is not None:
        of_it = (f"{first.on}.youngs_modulus", f"tethers.{first.on}.start")
        if second.do in ("cut", "set", "release") and second.on in (first.on, *of_it):
            return f"{first.name} has cut {first.on} before"
    if first.tie is None:
        return ""
    if second.tie == first.tie:
        return f"{first.name} has released it before"
    name, _, end = first.tie.removeprefix("tethers.").rpartition(".")
    its = (second.drive, (second.on or "").removesuffix(".youngs_modulus"))
    if first.tie.startswith("tethers.") and name in its and second.do != "release":
        return f"{first.name} has released the {end} of {name} before"
    return ""


def _touched_in_the_canister(possible: Sequence[Foreseen], foresight: Foresight) -> Iterator[tuple[str, str]]:
    """Conditions of contact, if no entry ejects the net but those that wait for one."""
    ejects = [one.entry for one in possible if one.entry.do == "eject"]
    touches = [one.entry for one in possible if one.entry.condition_name in _TOUCH]
    waiting = [one for one in ejects if any(foresight.waits_for(one, touch) for touch in touches)]
    if len(waiting) < len(ejects):
        return
    names = ", ".join(one.name for one in waiting)
    words = f"is packed until {names}, which waits for a contact" if names else "stays packed"
    for one in touches:
        if one.condition is not None and one.condition.sign >= 0.0:
            yield one.name, f"the net {words}: only what is packed may touch"
