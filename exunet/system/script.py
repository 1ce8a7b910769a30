"""A script as a term without forces: which of its entries are due, and what they change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.case.script import QUANTITIES, Condition, Entry, drive_of
from exunet.forces.reel import command_name
from exunet.forces.terms import Change, Input, Instant, KernelCall, Memories, Memory
from exunet.system.quantities import KEPT, LOOKS, Sight, has_touched, seen_memories
from exunet.system.states import States
from exunet.system.system import System

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HEADING = "script"
MEMORY = "script/entries"
MOST = 100  # times that an entry repeats
WITHIN = 1e-7  # [s] to which a crossing is located
WAITING, ARMED, DONE, RESTING, BARRED = map(float, range(5))


class Row(NamedTuple):
    """What is known of an entry, in the order of the memory.

    state : WAITING for its time or for another entry; ARMED: its condition is looked at; DONE; RESTING: it
            happens again once its condition has been false; BARRED: it happens no more
    since : when it was armed, or has happened last [s]
    times : how often it has happened
    value : of its quantity when it happened last; of "largest_area" the largest area so far [m2]
    """

    state: float
    since: float
    times: float
    value: float


_WIDTH = len(Row._fields)


@dataclass(frozen=True, eq=False)
class Script:
    """The entries of a case over the system that they look at and act on, which is without the script.

    damping : of each drive [N s/m]
    """

    entries: tuple[Entry, ...]
    sight: Sight
    damping: dict[str, float | None]
    acts_on: str = field(default="nothing", init=False)
    calls: tuple[KernelCall, ...] = field(default=(), init=False)
    inputs: tuple[Input, ...] = field(default=(), init=False)
    dissipates: bool = field(default=False, init=False)
    has_potential: bool = field(default=False, init=False)
    damping_rate: float = field(default=0.0, init=False)

    def data_at(self, memory: Memories) -> tuple[tuple[Any, ...], ...]:
        """It has no calls."""
        return ()

    def numbers(self) -> Iterator[Any]:
        """It has no numbers of its own."""
        yield from ()

    @property
    def memory(self) -> Memory:
        """A `Row` of each entry, and 1.0 once the run has been stopped."""
        rows = [Row(WAITING, 0.0, 0.0, 0.0) for _ in self.entries]
        return Memory(MEMORY, np.append(np.array(rows).ravel(), 0.0), in_steps=True)

    @property
    def switch(self) -> ScriptSwitch:
        """Made anew, for one run."""
        return ScriptSwitch(self)

    @property
    def acts_with(self) -> frozenset[str]:
        """The inputs that it gives."""
        return frozenset(command_name(one.drive) for one in self.entries if one.drive is not None)


def script_of(entries: tuple[Entry, ...], system: System, target: str | None) -> Script:
    """The script of a scene over its system."""
    drives: dict[str, float | None]
    drives = {one.reel.name: one.reel.damping for one in system.forces.cable.reels}
    if system.line is not None and system.line.has_winch:
        drives["closing"] = system.line.damping
    return Script(entries, Sight.of(system, target), drives)


class ScriptSwitch:
    """The events of a script.

    An entry is armed at its time, or after another one; from then on it is due as soon as its condition
    holds, at once if it has none.
    """

    heading = HEADING
    times: tuple[float, ...] = ()

    def __init__(self, script: Script) -> None:
        self._script, self._entries = script, script.entries
        self._system = script.sight.system
        self._numbers = {one.name: k for k, one in enumerate(self._entries)}
        self._size = _WIDTH * len(self._entries) + 1
        self.sees = seen_memories(self._system)
        self._sizes = [len(self._system.memory[name]) for name in self.sees]
        self._crossed_at: dict[int, float] = {}

    # What the memory says

    def _rows(self, memory: Floats) -> list[Row]:
        return [Row(*one) for one in memory[: self._size - 1].reshape(-1, _WIDTH).tolist()]

    def stops(self, memory: Floats) -> bool:
        """True once an entry has ended the run."""
        return bool(memory[self._size - 1])

    def in_steps(self, memory: Floats) -> bool:
        """True while a condition is looked at."""
        rows = zip(self._rows(memory), self._entries, strict=True)
        return any(row.state in (ARMED, RESTING) and one.when is not None for row, one in rows)

    def _moment(self, entry: Entry, rows: list[Row]) -> float:
        """From when on it may happen [s]; infinite as long as that is not known."""
        if entry.at is not None:
            return entry.at
        if entry.after is None:
            return 0.0
        other = rows[self._numbers[entry.after]]
        return other.since + entry.delay if other.times else math.inf

    def instants(self, memory: Floats) -> tuple[float, ...]:
        """When entries are armed."""
        rows = self._rows(memory)
        pairs = zip(rows, self._entries, strict=True)
        return tuple(self._moment(one, rows) for row, one in pairs if row.state == WAITING)

    # What is due

    def _states(self, instants: list[Instant]) -> States:
        """States of which the last one's memories are in force."""
        place, speed = (np.array([one[k] for one in instants]) for k in (1, 2))
        time, system, seen = np.array([one.time for one in instants]), self._system, instants[-1].memory
        parts = np.split(seen[self._size :], np.cumsum(self._sizes)[:-1])
        memory = dict(system.memory) | dict(zip(self.sees, parts, strict=True))
        moving = system.layout.unpack(place, speed).completed(system.kinematics, time, memory)
        return States(system, time, *moving[:3], memory, moving.first_order)

    def _beyond(self, entry: Entry, row: Row, states: States) -> Floats:
        """(k,) above 0 where its condition holds, of its quantity's unit."""
        condition = entry.condition
        assert condition is not None
        if condition.name == "first_contact":
            return np.full(len(states), 1.0 if has_touched(self._script.sight, states) else -1.0)
        if condition.name == "largest_area":
            area = LOOKS["area"](self._script.sight, states)
            return (1.0 - entry.fall) * np.maximum(row.value, area) - area
        return condition.sign * (LOOKS[condition.name](self._script.sight, states) - condition.bound)

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The first entry of the script with which something is to be done: armed, happen, rest no more."""
        rows = self._rows(memory)
        for k, (row, one) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state == WAITING and self._moment(one, rows) <= time:
                return np.array([k])
        now: States | None = None
        for k, (row, one) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state not in (ARMED, RESTING):
                continue
            if one.when is None or self._is_barred(one, rows):
                return np.array([k])
            now = now or self._states([Instant(time, x, v, memory)])
            holds = bool(self._beyond(one, row, now)[0] > 0.0)
            if holds == (row.state == ARMED):
                return np.array([k])
        return np.zeros(0, dtype=np.int64)

    def _is_barred(self, entry: Entry, rows: list[Row]) -> bool:
        return entry.unless is not None and rows[self._numbers[entry.unless]].times > 0.0

    def remembered(self, time: float, x: Floats, v: Floats, memory: Floats) -> Floats | None:
        """The largest area so far, for entries that wait until it has fallen."""
        after = None
        for k, (row, one) in enumerate(zip(self._rows(memory), self._entries, strict=True)):
            if row.state == ARMED and one.when == "largest_area":
                area = LOOKS["area"](self._script.sight, self._states([Instant(time, x, v, memory)]))[0]
                if area > row.value:
                    after = memory[: self._size].copy() if after is None else after
                    after[_WIDTH * k + Row._fields.index("value")] = area
        return after

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """Crossings are located once a step has gone beyond them."""
        return step

    # Where in a step

    def _roots(self, begin: Instant, end: Instant) -> dict[int, float]:
        """When conditions that hold at a step's end came true in it [s], by entry."""
        rows, found = self._rows(begin.memory), {}
        armed = [
            (k, row, one)
            for k, (row, one) in enumerate(zip(rows, self._entries, strict=True))
            if row.state == ARMED and one.when is not None
        ]
        if not armed:
            return {}
        first, last = self._states([begin]), self._states([end])
        for k, row, one in armed:
            before, after = (float(self._beyond(one, row, states)[0]) for states in (first, last))
            if before <= 0.0 < after:
                found[k] = self._root(one, row, begin, end, (before, after))
        return found

    def _root(self, entry: Entry, row: Row, begin: Instant, end: Instant, ends: tuple[float, float]) -> float:
        """By the cubic Hermite polynomial of the step; of what is known at its ends only, a straight line."""
        condition, (before, after), h = entry.condition, ends, end.time - begin.time
        assert condition is not None
        if condition.name in KEPT or condition.name == "first_contact":
            return begin.time + h * before / (before - after)
        low, high = 0.0, 1.0
        for _ in range(60):  # secants that keep the root between them, of Illinois
            if (high - low) * h <= 0.01 * WITHIN or after == before:
                break
            part = high - after * (high - low) / (after - before)
            if not low < part < high:
                part = 0.5 * (low + high)
            value = float(self._beyond(entry, row, self._states([self._hermite(begin, end, part)]))[0])
            if value > 0.0:
                high, after, before = part, value, 0.5 * before
            else:
                low, before, after = part, value, 0.5 * after
        return begin.time + h * high

    def _hermite(self, begin: Instant, end: Instant, part: float) -> Instant:
        """The state in the step: of points and centres by the cubic, of all else by a straight line."""
        h, s, moved = end.time - begin.time, part, self._system.blocks.centres
        x = (1.0 - s) * begin.x + s * end.x
        v = (1.0 - s) * begin.v + s * end.v
        x0, x1, v0, v1 = begin.x[:moved], end.x[:moved], begin.v[:moved], end.v[:moved]
        apart = x1 - x0
        x[:moved] = x0 + s * (h * v0 + s * (3.0 * apart - h * (2.0 * v0 + v1)))
        x[:moved] += s**3 * (h * (v0 + v1) - 2.0 * apart)
        v[:moved] = v0 + s * (6.0 * apart / h - 4.0 * v0 - 2.0 * v1)
        v[:moved] += s**2 * (3.0 * (v0 + v1) - 6.0 * apart / h)
        return Instant(begin.time + s * h, x, v, end.memory)

    def crossing(self, begin: Instant, end: Instant) -> float | None:
        """Just before the first crossing in the step, or where that is at its beginning, just beyond it."""
        roots = self._roots(begin, end)
        if not roots:
            return None
        within = max(WITHIN, 64.0 * math.ulp(end.time))
        if end.time - begin.time <= 2.0 * within:
            return end.time
        root = min(roots.values())
        return root - 0.5 * within if root - begin.time > within else begin.time + 2.0 * within

    def between(self, begin: Instant, end: Instant) -> None:
        """Note the roots, for the events that are told."""
        self._crossed_at = self._roots(begin, end)

    # What happens

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Arm an entry, or let it happen; more may be due at once."""
        k, rows = int(items[0]), self._rows(memory)
        entry, row = self._entries[k], rows[k]
        if row.state == WAITING:
            return self._put(memory, k, row._replace(state=ARMED, since=time))
        if self._is_barred(entry, rows):
            told = self._told(k, time, f"not done: {entry.unless} came before")
            return self._put(memory, k, row._replace(state=BARRED), events=(told,))
        value = self._value(entry, row, Instant(time, x, v, memory))
        if row.state == RESTING:
            return self._put(memory, k, row._replace(state=ARMED))
        times = row.times + 1.0
        told = self._told(k, time, entry.action_words) | {"done": True}
        told |= {"verdict": entry.verdict} if entry.do == "stop" else {}
        if entry.when is not None:
            told |= {"crossed_s": self._crossed_at.get(k, time), "value": value, "unit": self._unit(entry)}
        events = [told]
        state = RESTING if entry.repeat else DONE
        if entry.repeat and times >= MOST:
            state = DONE
            events.append(self._told(k, time, f"happens no more: has happened {MOST} times"))
        after = row._replace(state=state, since=time, times=times)
        after = after if entry.when == "largest_area" else after._replace(value=value)
        others: dict[str, Floats] = {}
        if entry.drive is not None:
            drive = drive_of(entry, self._script.damping[entry.drive])
            values = [1.0, drive.rate, drive.force, drive.gives_way, drive.takes_up]
            others[command_name(entry.drive)] = np.array(values)
        return self._put(memory, k, after, events=tuple(events), others=others, stops=entry.do == "stop")

    def _put(self, memory: Floats, number: int, row: Row, **what: Any) -> Change:
        after = memory[: self._size].copy()
        after[_WIDTH * number : _WIDTH * (number + 1)] = np.array(row)
        if what.get("stops"):
            after[-1] = 1.0
        return Change(after, more=not what.get("stops"), **what)

    def _told(self, number: int, time: float, words: str) -> dict[str, Any]:
        entry = self._entries[number]
        return {
            "time_s": time,
            "entry": entry.name,
            "cause": entry.trigger_words,
            "event": words,
            "done": False,
        }

    def _value(self, entry: Entry, row: Row, now: Instant) -> float:
        condition = entry.condition
        if condition is None:
            return 0.0
        if condition.name == "first_contact":
            return 1.0
        name = "area" if condition.name == "largest_area" else condition.name
        return float(LOOKS[name](self._script.sight, self._states([now]))[0])

    @staticmethod
    def _unit(entry: Entry) -> str:
        condition = entry.condition or Condition("time")
        return QUANTITIES[condition.name].unit if condition.name in QUANTITIES else "1"
