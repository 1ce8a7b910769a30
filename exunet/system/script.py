"""Scripts in a run: which entries are due, when conditions become true within a step, what actions change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from exunet.case.script import QUANTITIES, Entry, conflict, drive_of
from exunet.forces.cable_term import INTACT
from exunet.forces.closing import MEMORY as LINE
from exunet.forces.closing import elastic_once_slid
from exunet.forces.contact.sphere_contact import SphereContact
from exunet.forces.contact.thread_contact import ThreadContact
from exunet.forces.corner_units import MEMORY as CONTROL
from exunet.forces.corner_units import begun, released
from exunet.forces.effects.thrust import FACTOR, Knots, begun_at, with_factor
from exunet.forces.effects.thrust import MEMORY as THRUST
from exunet.forces.kernel_call import KernelCall
from exunet.forces.reel import command_name
from exunet.forces.terms import Change, Input, KernelTerm, Memories, Memory, Seen, copied
from exunet.forces.total import Forces
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import WITHOUT_LIMIT
from exunet.system.ejection import HELD, LET_GO, NODES
from exunet.system.quantities import (
    AGAINST,
    LOOKS,
    OF_VELOCITIES,
    Look,
    Sight,
    has_touched,
    looked_at,
    seen_memories,
    watched_weights,
)
from exunet.system.states import States
from exunet.system.system import System

WAITING, ARMED, DONE, RESTING, BARRED = map(float, range(5))


class Row(NamedTuple):
    """What is known of an entry, in the order of the memory.

    state : WAITING for its time or for another entry; ARMED: its condition is looked at; DONE; RESTING: it
            is looked at again once its condition has been false; BARRED: it happens no more
    since : when it was armed, or has happened last [s]
    times : how often it has happened
    value : of its quantity when it happened last; of "largest_area" the largest area so far [m2]
    """

    state: float
    since: float
    times: float
    value: float


WIDTH = len(Row._fields)


def seen_within(begin: Seen, end: Seen, part: float, moved: int) -> Seen:
    """The state at a part of a step: what v moves by Hermite's cubic, all else by a straight line.

    begin, end : the step's ends, one state each
    part       : of the step, 0 to 1
    moved      : number of entries of x that v moves, those of points and centres, which come first in both;
                 their velocities are the cubic's
    """
    h, s = float(end.time[0] - begin.time[0]), part
    x = (1.0 - s) * begin.x + s * end.x
    v = (1.0 - s) * begin.v + s * end.v
    x0, x1, v0, v1 = (one[:, :moved] for one in (begin.x, end.x, begin.v, end.v))
    apart = x1 - x0
    x[:, :moved] = x0 + s * (h * v0 + s * (3.0 * apart - h * (2.0 * v0 + v1)))
    x[:, :moved] += s**3 * (h * (v0 + v1) - 2.0 * apart)
    v[:, :moved] = v0 + s * (6.0 * apart / h - 4.0 * v0 - 2.0 * v1)
    v[:, :moved] += s**2 * (3.0 * (v0 + v1) - 6.0 * apart / h)
    return Seen(begin.time + s * h, x, v, end.memory, end.told)


Floats = NDArray[np.float64]

_FRICTION = ("contact.friction", f"{CLOSING}.friction")


def input_name(parameter: str) -> str:
    """Of the input by which a script sets a coefficient of friction."""
    return f"set/{parameter}"


def inputs_of(entries: Iterable[Entry]) -> frozenset[str]:
    """The names of those that entries set."""
    return frozenset(input_name(one.on) for one in entries if one.do == "set" and one.on in _FRICTION)


def with_inputs(forces: Forces, entries: Iterable[Entry]) -> Forces:
    """The forces, of which those that entries set have inputs for that; elements that may become softer."""
    names = inputs_of(entries)
    kernels = tuple(_with_friction(term, names) for term in forces.kernels)
    softer = any(one.do == "set" and (one.on or "").endswith(".youngs_modulus") for one in entries)
    cable = replace(forces.cable, may_be_cut=True) if softer else forces.cable
    return replace(forces, kernels=kernels, cable=cable)


def _with_friction(term: KernelTerm, names: frozenset[str]) -> KernelTerm:
    data: Any = term.data
    touches = isinstance(data, ThreadContact | SphereContact)
    drawn = term.memory is not None and term.memory.name == LINE
    name = input_name(_FRICTION[0] if touches else _FRICTION[1])
    if not (touches or drawn) or name not in names:
        return term
    return replace(term, inputs=(*term.inputs, Input(name, "friction", np.array([data.friction]))))


def changed(
    system: System, parameter: str, value: float, now: tuple[float, Floats, Floats], every: Memories
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What of a `Change` a parameter's new value makes, and what is told of it.

    now : time [s], and x, v of all blocks
    """
    name, _, what = parameter.rpartition(".")
    if parameter == "thrust.factor":
        return {"others": {THRUST: with_factor(every[THRUST], value)}}, {}
    if what == "friction":
        others = {"others": {input_name(parameter): np.array([value])}}
        return _slid(system, value, now, every, others) if name == CLOSING else (others, {})
    if what == "youngs_modulus":
        elements = np.array(system.net.tether_elements[name])
        part, after = value / system.net.youngs_modulus[elements], every[INTACT].copy()
        after[elements] = np.where(after[elements] > 0.0, part, 0.0)
        return {"others": {INTACT: after}, "energy_lost": None}, {}
    return _asked(name, what, value, every[command_name(name)])


def _asked(drive: str, what: str, value: float, asked: Floats) -> tuple[dict[str, Any], dict[str, Any]]:
    """The command of a drive with another force or rate; a drive that has none goes on as it was."""
    after, has = asked.copy(), 0.0 < abs(asked[1]) < WITHOUT_LIMIT if what == "rate" else asked[3] > 0.0
    if asked[0] == 0.0 or not has:
        words = f"set {drive}.{what}, which changes nothing: what {drive} does has no {what}"
        return {}, {"event": words}
    if what == "rate":
        after[1] = np.copysign(value, asked[1])
    else:
        after[2] = value
    return {"others": {command_name(drive): after}}, {}


def _slid(
    system: System,
    friction: float,
    now: tuple[float, Floats, Floats],
    every: Memories,
    what: dict[str, Any],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A closing line that slides at once, as rings hold it less: friction takes what it stores less."""
    time, x, v = now
    moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, time, every)
    x, v = system.layout.pack(moving)
    (term,) = (one for one in system.forces.kernels if one.memory is not None and one.memory.name == LINE)
    line: Any = copied(term.data_at(every)[0])
    taken = elastic_once_slid(x, line, line.friction) - elastic_once_slid(x, line, friction)
    first = int(line.state[0])  # wound up, work, what friction took, elastic energy
    x[first + 2] += taken
    x[first + 3] -= taken
    return {**what, "x": x, "v": v, "work_given": -taken}, {"energy_taken_J": taken}


Ints = NDArray[np.int64]

HEADING = "script"
MOST = 100  # times that an entry repeats
WITHIN = 1e-7  # [s] to which a crossing is located
_NOTHING = np.zeros(0, dtype=np.int64)
_TOUCH = ("touching", "first_contact")  # jumps, and is known at the ends of steps only


class ScriptEvents:
    """The switch of a script.

    An entry is armed at its time, or after another one; from then on it is due as soon as its condition
    holds, at once if it has none. Entries that are due at one instant happen in the order of the script.
    """

    heading = HEADING
    times: tuple[float, ...] = ()

    def __init__(self, entries: tuple[Entry, ...], sight: Sight, damping: Mapping[str, float | None]) -> None:
        self._entries, self._sight, self._damping = entries, sight, damping
        self._conditions = [one.condition for one in entries]
        self._names = [one.condition_name for one in entries]
        self._numbers = {one.name: k for k, one in enumerate(entries)}
        self._size = WIDTH * len(entries) + 1
        self.sees, self.tells = seen_memories(sight.system), sight.tells
        self.of_x, self.of_v = looked_at(sight, set(self._names))
        self.weights = watched_weights(sight, set(self._names))
        self._ends = np.cumsum([self._size, *(len(sight.system.memory[name]) for name in self.sees)])
        thrusts = (term.switch for term in sight.system.forces if isinstance(term.switch, Knots))
        self._knots = np.array([time for switch in thrusts for time in switch.knots])
        self._came_true: dict[int, tuple[float, float]] = {}  # when [s], and after what time at the earliest
        self._key: bytes = b""
        self._found: tuple[list[Row], list[tuple[int, Row]]] = [], []
        self._nothing_at = -math.inf  # [s] at which no condition was found to hold

    # What the memory says

    def _read(self, memory: Floats) -> tuple[list[Row], list[tuple[int, Row]]]:
        """All rows, and those whose condition is looked at, with numbers; made anew for another memory."""
        key = memory[: self._size].tobytes()
        if key != self._key:
            rows = [Row(*one) for one in memory[: self._size - 1].reshape(-1, WIDTH).tolist()]
            watched = [
                (k, row)
                for k, row in enumerate(rows)
                if row.state in (ARMED, RESTING) and self._conditions[k]
            ]
            self._key, self._found = key, (rows, watched)
        return self._found

    def _rows(self, memory: Floats) -> list[Row]:
        return self._read(memory)[0]

    def _watched(self, memory: Floats) -> list[tuple[int, Row]]:
        return self._read(memory)[1]

    def stops(self, memory: Floats) -> bool:
        """True once an entry has ended the run."""
        return bool(memory[self._size - 1])

    def in_steps(self, memory: Floats) -> bool:
        """True while a condition is looked at."""
        return bool(self._watched(memory))

    def _moment(self, entry: Entry, rows: list[Row]) -> float:
        """From when on it may happen [s]; infinite as long as that is not known."""
        if entry.at is not None:
            return entry.at
        if entry.after is None:
            return 0.0
        other = rows[self._numbers[entry.after]]
        return other.since + entry.delay if other.times else math.inf

    def instants(self, memory: Floats) -> tuple[float, ...]:
        """When entries are armed, and at the knots of a thrust that one has begun."""
        rows = self._rows(memory)
        pairs = list(zip(rows, self._entries, strict=True))
        armed = (self._moment(one, rows) for row, one in pairs if row.state == WAITING)
        begun = (row.since for row, one in pairs if row.state == DONE and one.do == "thrust")
        return (*armed, *(float(time) for since in begun for time in since + self._knots))

    # What is due

    def _states(self, steps: Seen, *, completed: bool = True) -> States:
        """States with the memories of the last of them.

        completed : False: velocities of what has no equations of motion may be some stages old
        """
        system, ends = self._sight.system, self._ends
        seen = (steps.memory[a:b] for a, b in pairwise(ends))
        memory = system.memory | dict(zip(self.sees, seen, strict=True))
        moving = system.layout.unpack(steps.x, steps.v)
        if completed:
            moving = moving.completed(system.kinematics, steps.time, memory)
        return States(system, steps.time, *moving[:3], memory, moving.first_order)

    def _now(self, time: float, x: Floats, v: Floats, memory: Floats) -> Seen:
        """One state."""
        told = memory[None, len(memory) - len(self.tells) :]
        return Seen(np.array([time]), x[None], v[None], memory, told)

    def _look(self, steps: Seen, *, completed: bool = True) -> Look:
        return Look(lambda: self._states(steps, completed=completed), steps.told, steps.mean)

    def _beyond(self, number: int, row: Row, look: Look, *, signs: bool = False) -> Floats:
        """(k,) above 0 where a condition holds, in its quantity's unit.

        signs : of the numbers only the signs are asked for
        """
        condition = self._conditions[number]
        assert condition is not None
        if condition.name == "first_contact":
            return np.where(has_touched(self._sight, look.told), 1.0, -1.0)
        if condition.name == "largest_area":
            area = LOOKS["area"](self._sight, look)
            largest = np.maximum.accumulate(np.maximum(row.value, area))
            return np.asarray((1.0 - self._entries[number].fall) * largest - area)
        if signs and condition.name in AGAINST:
            apart = AGAINST[condition.name](self._sight, look, condition.bound)
        else:
            apart = LOOKS[condition.name](self._sight, look) - condition.bound
        beyond = condition.sign * apart
        if row.times and row.state == ARMED:
            rests = look.states.time < row.since + self._entries[number].rest
            beyond = np.where(rests, -np.abs(beyond), beyond)
        return np.asarray(beyond)

    def crossed(self, time: float, x: Floats, v: Floats, memory: Floats) -> Ints:
        """The first entry with which something is to be done: armed, happen, rest no more.

        Of those that are due the one whose condition came true first.
        """
        rows = self._rows(memory)
        for k, (row, one) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state == WAITING and self._moment(one, rows) <= time:
                return np.array([k])
        look: Look | None = None
        due: list[int] = []
        for k, (row, one) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state not in (ARMED, RESTING):
                continue
            if one.when is None or self._is_barred(one, rows):
                due.append(k)
            elif time != self._nothing_at:
                look = look or self._look(self._now(time, x, v, memory))
                if (self._beyond(k, row, look, signs=True)[0] > 0.0) == (row.state == ARMED):
                    due.append(k)
        if not due:
            return _NOTHING
        return np.array([min(due, key=lambda k: (self._came_true.get(k, (time,))[0], k))])

    def _is_barred(self, entry: Entry, rows: list[Row]) -> bool:
        return entry.unless is not None and rows[self._numbers[entry.unless]].times > 0.0

    def comes_true(self, steps: Seen) -> int | None:
        """The first step at whose end one of the conditions holds, or one that rests does not."""
        watched = self._watched(steps.memory)
        speeds = any(self._names[k] in OF_VELOCITIES for k, _ in watched)
        look = self._look(steps, completed=speeds)
        found = np.zeros(len(steps.time), dtype=bool)
        for k, row in watched:
            found |= (self._beyond(k, row, look, signs=True) > 0.0) == (row.state == ARMED)
        if found.any():
            self._nothing_at = -math.inf
            return int(found.argmax())
        self._nothing_at = float(steps.time[-1])
        return None

    def remembered(self, steps: Seen) -> Floats | None:
        """The largest area so far, for entries that wait until it has fallen."""
        after = None
        for k, row in self._watched(steps.memory):
            if self._entries[k].when == "largest_area":
                area = float(LOOKS["area"](self._sight, self._look(steps, completed=False)).max())
                if area > row.value:
                    after = steps.memory[: self._size].copy() if after is None else after
                    after[WIDTH * k + Row._fields.index("value")] = area
        return after

    def step_within(self, step: float, least: float, x: Floats, v: Floats, memory: Floats) -> float:
        """Crossings are located once a step has gone beyond them."""
        return step

    # Where in a step

    def crossing(self, begin: Seen, end: Seen) -> float | None:
        """Just before the first crossing in the step, or where that is at its beginning, just beyond it."""
        self._came_true = found = self._found_in(begin, end)
        self._nothing_at = -math.inf
        if not found:
            return None
        first, last = float(begin.time[0]), float(end.time[0])
        within = max(WITHIN, 64.0 * math.ulp(last))
        if last - first <= 2.0 * within:
            return last
        # What is known at ends of steps only is sought by halving.
        root = min(0.5 * sum(found[k]) if self._names[k] in _TOUCH else found[k][0] for k in found)
        return root - 0.5 * within if root - first > within else first + 2.0 * within

    def _found_in(self, begin: Seen, end: Seen) -> dict[int, tuple[float, float]]:
        """When conditions that hold at a step's end came true in it [s], and at the earliest, by entry."""
        armed = [(k, row) for k, row in self._watched(begin.memory) if row.state == ARMED]
        found: dict[int, tuple[float, float]] = {}
        if not armed:
            return found
        first, last = self._look(begin), self._look(end)
        for k, row in armed:
            after = float(self._beyond(k, row, last)[0])
            if after > 0.0 and (before := float(self._beyond(k, row, first)[0])) <= 0.0:
                if self._names[k] in _TOUCH:
                    found[k] = float(end.time[0]), float(begin.time[0])
                else:
                    root = self._root(k, row, (begin, end), (before, after))
                    found[k] = root, root
        return found

    def _root(self, number: int, row: Row, step: tuple[Seen, Seen], ends: tuple[float, float]) -> float:
        """By the cubic Hermite polynomial of the step; of what is known at its ends only, a straight line."""
        begin, end = (float(one.time[0]) for one in step)
        if self._names[number] == "closing_tension":
            return begin + (end - begin) * ends[0] / (ends[0] - ends[1])

        def beyond(part: float) -> float:
            if part in (0.0, 1.0):
                return ends[int(part)]
            within = seen_within(*step, part, self._sight.system.blocks.centres)
            return float(self._beyond(number, row, self._look(within))[0])

        if ends[0] == 0.0:
            return begin
        least = 0.01 * WITHIN / (end - begin)
        return begin + (end - begin) * float(brentq(beyond, 0.0, 1.0, xtol=least, maxiter=100))

    # What happens

    def change(
        self, time: float, x: Floats, v: Floats, memory: Floats, items: Ints, every: Memories
    ) -> Change:
        """Arm an entry, or let it happen; more may be due at once."""
        k, rows = int(items[0]), self._rows(memory)
        entry, row = self._entries[k], rows[k]
        self._nothing_at = -math.inf
        if row.state == WAITING:
            return self._put(memory, k, row._replace(state=ARMED, since=time))
        if self._is_barred(entry, rows):
            told = self._told(entry, time, f"not done: {entry.unless} has happened")
            return self._put(memory, k, row._replace(state=BARRED), events=(told,))
        if row.state == RESTING:
            return self._put(memory, k, row._replace(state=ARMED))
        times, state = row.times + 1.0, RESTING if entry.repeat else DONE
        words = "; ".join((entry.action_words, *self._besides(k, rows, time, every)))
        told = self._told(entry, time, words) | {"done": True}
        told |= {"verdict": entry.verdict} if entry.do == "stop" else {}
        events = [told]
        if entry.repeat and times >= MOST:
            state = DONE
            words = f"disabled after {MOST} activations"
            events.append(self._told(entry, time, words) | {"used_up": True})
        row = row._replace(state=state, since=time, times=times)
        if entry.condition_name in QUANTITIES:
            now = self._look(self._now(time, x, v, memory))
            value = LOOKS[entry.condition_name](self._sight, now)
            row = row._replace(value=float(value[0]))
        if entry.when is not None:
            unit = QUANTITIES[entry.condition_name].unit if entry.condition_name in QUANTITIES else "1"
            crossed, earliest = self._came_true.pop(k, (time, time))
            told |= {"crossed_s": crossed, "after_s": earliest, "value": row.value, "unit": unit}
        what: dict[str, Any] = {"events": tuple(events), "stops": entry.do == "stop"}
        if entry.do == "cut":
            first = self._cut_at(entry)
            if every[INTACT][first]:
                after = every[INTACT].copy()
                after[first], told["element"] = 0.0, first
                what |= {"others": {INTACT: after}, "energy_lost": None}
        elif entry.tie is not None:
            what |= self._release(entry.tie, time, x, v, every)
            told |= {"tie": entry.tie, "node": int(self._sight.system.kinematics.ties[entry.tie].points[0])}
        elif entry.do == "thrust":
            what["others"] = {THRUST: begun_at(time, self._knots, float(every[THRUST][FACTOR]))}
        elif entry.do == "set":
            assert entry.on is not None
            assert entry.value is not None
            does, found = changed(self._sight.system, entry.on, entry.value, (time, x, v), every)
            what |= does
            told |= found
        elif entry.do == "control":
            what["others"] = {CONTROL: begun(every[CONTROL], time)}
        elif entry.do == "release_control":
            what["others"] = {CONTROL: released(every[CONTROL])}
        elif entry.do == "eject":
            what["others"] = {HELD: np.array([every[HELD][NODES], 1.0])}
        else:
            what["others"] = self._commands(entry)
        return self._put(memory, k, row, **what)

    def _besides(self, number: int, rows: list[Row], time: float, every: Memories) -> Iterator[str]:
        """Yield remarks on an entry: that it replaces a command, or has no effect."""
        entry, ties = self._entries[number], self._sight.system.kinematics.ties
        for k, (row, other) in enumerate(zip(rows, self._entries, strict=True)):
            if k != number and row.times and row.since == time and conflict(other, entry):
                yield f"replaces the command of {other.name} at the same time"
        if entry.do == "cut" and not every[INTACT][self._cut_at(entry)]:
            yield "no effect: already cut or broken there"
        if entry.do == "eject" and (not every[HELD][NODES] or every[HELD][LET_GO]):
            yield "no effect: the net has already been ejected"
        for name, tie in ties.items():
            if every[tie.memory][0]:
                continue
            if name == entry.tie:
                yield "no effect: already released"
            elif entry.do != "release" and name.startswith(f"tethers.{entry.drive}."):
                yield f"no effect: its {name.rpartition('.')[2]} has been released"

    def _cut_at(self, entry: Entry) -> int:
        """The element that is cut: the first of a tether."""
        assert entry.on is not None
        return self._sight.system.net.tether_elements[entry.on].start

    def _release(self, tie: str, time: float, x: Floats, v: Floats, every: Memories) -> dict[str, Any]:
        """A point leaves its body with the velocity that it has there, so all keep momenta and energy."""
        system = self._sight.system
        moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, time, every)
        x, v = system.layout.pack(moving)
        return {"x": x, "v": v, "others": {system.kinematics.ties[tie].memory: np.zeros(1)}}

    def _commands(self, entry: Entry) -> dict[str, Floats]:
        """The input of the drive that an entry acts on."""
        if entry.drive is None:
            return {}
        drive = drive_of(entry, self._damping[entry.drive])
        values = [1.0, drive.rate, drive.force, drive.gives]
        return {command_name(entry.drive): np.array(values)}

    def _put(self, memory: Floats, number: int, row: Row, **what: Any) -> Change:
        after = memory[: self._size].copy()
        after[WIDTH * number : WIDTH * (number + 1)] = np.array(row)
        stops = bool(what.get("stops"))
        after[-1] = max(after[-1], float(stops))
        return Change(after, more=not stops, **what)

    @staticmethod
    def _told(entry: Entry, time: float, words: str) -> dict[str, Any]:
        cause = entry.trigger_words
        return {"time_s": time, "entry": entry.name, "cause": cause, "event": words, "done": False}


@dataclass(frozen=True, eq=False)
class Script:
    """The entries of a case; the system of `sight` is without the script.

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
        """A `Row` of each entry, and 1.0 once the run has been ended."""
        rows = [Row(WAITING, 0.0, 0.0, 0.0) for _ in self.entries]
        return Memory("script/entries", np.append(np.array(rows).ravel(), 0.0), in_steps=True)

    @property
    def switch(self) -> ScriptEvents:
        """Made anew, for one run."""
        return ScriptEvents(self.entries, self.sight, self.damping)

    @property
    def acts_with(self) -> frozenset[str]:
        """The inputs that it gives."""
        drives = frozenset(command_name(one.drive) for one in self.entries if one.drive is not None)
        return drives | inputs_of(self.entries)


def script_of(entries: tuple[Entry, ...], system: System, target: str | None) -> Script:
    """The script of a scene over its system; target : name of the body that is to be captured."""
    drives: dict[str, float | None]
    drives = {one.reel.name: one.reel.damping for one in system.forces.cable.reels}
    if system.line is not None and system.line.has_winch:
        drives[CLOSING] = system.line.damping
    return Script(entries, Sight.of(system, target), drives)
