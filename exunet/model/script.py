"""Scripts in a run: which entries are due, when conditions become true within a step, what actions change."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.base.run_events import ScriptEvent
from exunet.base.times import reached
from exunet.forces.body_thrust import burnt, discrete_name
from exunet.forces.cable_term import INTACT
from exunet.forces.closing import STATE_NAME as LINE
from exunet.forces.closing import LineStatus, elastic_once_slid
from exunet.forces.contact.sphere_contact import SphereContact
from exunet.forces.contact.status import OF_BODY, STATUS, ContactStatus
from exunet.forces.contact.thread_contact import ThreadContact
from exunet.forces.corner_units import STATE_NAME as CONTROL
from exunet.forces.corner_units import released, started
from exunet.forces.effects.thrust import FACTOR, Knots, begun_at
from exunet.forces.effects.thrust import STATE_NAME as THRUST
from exunet.forces.reel import command_name
from exunet.forces.terms import (
    Change,
    DiscreteState,
    DiscreteStates,
    Input,
    KernelTerm,
    Seen,
    Term,
    Watch,
    copied,
)
from exunet.forces.total import Forces
from exunet.model.ejection import HELD, LET_GO, NODES
from exunet.model.states import States
from exunet.model.system import System
from exunet.net.areas import mouth_against, mouth_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import WITHOUT_LIMIT
from exunet.scene.script import QUANTITIES, ScriptEntry, begins_a_thrust, conflict, drive_of

_CONTACT = "contact/"
_OF_CENTRE = frozenset(("range", "relative_speed"))


@dataclass(frozen=True, eq=False)
class Sources:
    """Parts of a system that quantities depend on.

    target    : number of the target among the rigid bodies; None without a target
    tensions, touching, touched : entries (name, number) of discrete states: tensions at the ends of the
                closing line; of each contact, the number of touching pairs, and the time of first contact
    """

    system: System
    target: int | None
    tensions: tuple[tuple[str, int], ...]
    touching: tuple[tuple[str, int], ...]
    touched: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, system: System, target: str | None) -> Sources:
        """Find the parts in a system; target : name of its body."""
        rigid = system.blocks.rigid
        contacts = [
            name
            for name in system.discrete
            if name.startswith(_CONTACT) and not name.startswith(_CONTACT + OF_BODY)
        ]
        ends = [LineStatus._fields.index(name) for name in ("tension_start", "tension_end")]
        tensions = tuple((LINE, place) for place in ends if LINE in system.discrete)
        touching, touched = (
            tuple((name, ContactStatus._fields.index(field) - STATUS) for name in contacts)
            for field in ("touching", "first_touch")
        )
        number = rigid.index(target) if target in rigid else None
        return cls(system, number, tensions, touching, touched)

    @property
    def reports(self) -> tuple[tuple[str, int], ...]:
        """Entries of discrete states, in the order in which `VALUES` gets them."""
        return (*self.tensions, *self.touching, *self.touched)


class EndStates:
    """Ends of k steps: states, made at their first use, and entries of discrete states (k, n).

    See `Seen` for `mean`.
    """

    def __init__(self, states: Callable[[], States], reported: Floats, mean: Floats | None = None) -> None:
        self._states, self.reported, self.mean = states, reported, mean

    @cached_property
    def states(self) -> States:
        """States of the batch."""
        return self._states()


def weights(sources: Sources) -> Floats:
    """Return (n_net_nodes,) weights of the nodes in the centre of mass of the net."""
    mass = sources.system.net.mass[: sources.system.net.n_net_nodes]
    return np.asarray(mass / mass.sum())


def centre_weights(sources: Sources, names: Collection[str]) -> Floats:
    """Return the weights if quantities depend on the centre of mass, else an empty array.

    Empty also if nodes of the net are attached to bodies: within steps, their velocities may be of a stage.
    """
    attached = (sources.system.kinematics.tied < sources.system.net.n_net_nodes).any()
    return np.zeros(0) if attached or not _OF_CENTRE.intersection(names) else weights(sources)


def _offset(sources: Sources, sample: EndStates, *, rates: bool) -> Floats:
    """Return (k, 3) vectors from the centre of mass of the target to that of the net [m], or rates [m/s]."""
    assert sources.target is not None
    states, bodies = sample.states, sample.states.bodies
    if sample.mean is not None:
        centre = sample.mean[:, 3:] if rates else sample.mean[:, :3]
    else:
        values = (states.velocity if rates else states.position)[:, : sources.system.net.n_net_nodes]
        centre = np.einsum("n,kna->ka", weights(sources), values)
    return np.asarray(centre - (bodies.velocity if rates else bodies.position)[:, sources.target])


def _range(sources: Sources, sample: EndStates) -> Floats:
    return np.linalg.norm(_offset(sources, sample, rates=False), axis=1)


def _relative_speed(sources: Sources, sample: EndStates) -> Floats:
    return np.linalg.norm(_offset(sources, sample, rates=True), axis=1)


def _mouth_diameter(sources: Sources, sample: EndStates) -> Floats:
    return mouth_diameter(sources.system.net, sample.states.position)


def _area(sources: Sources, sample: EndStates) -> Floats:
    return mouth_area(sources.system.net, sample.states.position[:, : sources.system.net.n_nodes])


def _tether_tension(sources: Sources, sample: EndStates) -> Floats:
    net = sources.system.net
    first = net.n_net_elements
    i, j = net.element_nodes[first:].T
    span = sample.states.position[:, j] - sample.states.position[:, i]
    length, law = np.linalg.norm(span, axis=2), sample.states.law.of_elements(slice(first, None))
    rate = None
    if law.relaxation_time is not None:
        along = np.einsum("kea,kea->ke", span, sample.states.velocity[:, j] - sample.states.velocity[:, i])
        rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    tension = law.tension(length, rate)
    for winding in sources.system.forces.cable.reels:
        element, _, pull = winding.outlets(sample.states.discrete, sample.states.x, sample.states.v)
        tension[:, element - first] = pull
    return np.asarray(tension.max(axis=1))


def _by_columns(ufunc: Callable[..., Floats], values: Floats, initial: float) -> Floats:
    """Reduce few columns (k, n) to (k,): far faster than by rows."""
    return reduce(ufunc, values.T, np.full(len(values), initial))


def _closing_tension(sources: Sources, sample: EndStates) -> Floats:
    reported = sample.reported[:, : len(sources.tensions)]
    return _by_columns(np.maximum, reported, 0.0)


def _touching(sources: Sources, sample: EndStates) -> Floats:
    first = len(sources.tensions)
    return _by_columns(np.add, sample.reported[:, first : first + len(sources.touching)], 0.0)


def _time(sources: Sources, sample: EndStates) -> Floats:
    return sample.states.time


VALUES: Mapping[str, Callable[[Sources, EndStates], Floats]] = {
    "time": _time,
    "range": _range,
    "relative_speed": _relative_speed,
    "mouth_diameter": _mouth_diameter,
    "area": _area,
    "tether_tension": _tether_tension,
    "closing_tension": _closing_tension,
    "touching": _touching,
}
DIFFERENCES: Mapping[str, Callable[[Sources, EndStates, float], Floats]] = {
    "mouth_diameter": lambda sources, sample, bound: mouth_against(
        sources.system.net, sample.states.position, bound
    ),
}  # numbers with the sign of a quantity less a bound, where they are cheaper than the quantity
OF_VELOCITIES = ("relative_speed", "tether_tension")


def has_touched(sources: Sources, reported: Floats) -> NDArray[np.bool_]:
    """Return (k,) True from the first contact on."""
    return _by_columns(np.maximum, reported[:, len(reported[0]) - len(sources.touched) :], -1.0) >= 0.0


def observed_entries(sources: Sources, names: Collection[str]) -> tuple[Ints, Ints]:
    """Return the entries of x and v that quantities depend on: of some points, and all not of points."""
    system, nodes, speeds = sources.system, set[int](), set[int]()
    net, points = system.net, 3 * system.blocks.n_points
    if _OF_CENTRE.intersection(names) and not centre_weights(sources, names).size:
        nodes.update(range(net.n_net_nodes))
        speeds.update(range(net.n_net_nodes))
    nodes.update(net.mouth if {"area", "largest_area"}.intersection(names) else ())
    nodes.update(net.rim if "mouth_diameter" in names else ())
    if "tether_tension" in names:
        ends = net.element_nodes[net.n_net_elements :].ravel().tolist()
        nodes.update(ends)
        speeds.update(ends)
    return _entries(nodes, points, system.blocks.n_x), _entries(speeds, points, system.blocks.n_v)


def _entries(nodes: Iterable[int], points: int, size: int) -> Ints:
    """Return the entries of nodes, and all entries after those of points."""
    of_nodes = [3 * node + axis for node in sorted(nodes) for axis in range(3)]
    return np.array([*of_nodes, *range(points, size)], dtype=np.int64)


def observed_discrete_states(system: System) -> tuple[str, ...]:
    """Return the discrete states that quantities depend on: of threads, reels, and points held by bodies."""
    threads = system.forces.cable
    kept = [] if threads.discrete is None else [threads.discrete.name]
    for winding in threads.reels:
        kept += [name for name in system.discrete if name in (f"{winding.name}/reel", f"reel/{winding.name}")]
    return tuple(dict.fromkeys((*kept, *(item.discrete for item in system.kinematics.held))))


MAX_ACTIVATIONS = 100  # of an entry with `repeat`
LOCATED_TO = 1e-7  # [s] to which a crossing is located
_NOTHING = np.zeros(0, dtype=np.int64)
_TOUCH = ("touching", "first_contact")  # jumps, known at the ends of steps only
_FRICTION = ("contact.friction", f"{CLOSING}.friction")
WAITING, ARMED, DONE, RESTING, BARRED, HOLDING = map(float, range(6))
_EVALUATED = (ARMED, RESTING, HOLDING)


class EntryState(NamedTuple):
    """Discrete state of an entry.

    state : WAITING for its time or for another entry; ARMED: its condition is evaluated; DONE; RESTING until
            its condition has been false; BARRED by another entry;
            HOLDING: its condition is true, but not yet for the time of `for`
    since : time of arming, or of the last activation [s]
    times : number of activations
    value : of its quantity at the last activation; of "largest_area" the largest area so far [m2]
    true  : when its condition became true [s], of HOLDING
    """

    state: float
    since: float
    times: float
    value: float
    true: float = 0.0


WIDTH = len(EntryState._fields)


def interpolated(begin: Seen, end: Seen, part: float, moved: int) -> Seen:
    """Interpolate within a step: cubic Hermite polynomial for points and centres, else linear.

    begin, end : ends of the step, one state each
    part       : fraction of the step, 0 to 1
    moved      : number of entries of x with rates in v (points and centres, which come first in both)
    """
    h, s = float(end.time[0] - begin.time[0]), part
    x = (1.0 - s) * begin.x + s * end.x
    v = (1.0 - s) * begin.v + s * end.v
    x0, x1, v0, v1 = (values[:, :moved] for values in (begin.x, end.x, begin.v, end.v))
    change = x1 - x0
    x[:, :moved] = x0 + s * (h * v0 + s * (3.0 * change - h * (2.0 * v0 + v1)))
    x[:, :moved] += s**3 * (h * (v0 + v1) - 2.0 * change)
    v[:, :moved] = v0 + s * (6.0 * change / h - 4.0 * v0 - 2.0 * v1)
    v[:, :moved] += s**2 * (3.0 * (v0 + v1) - 6.0 * change / h)
    return Seen(begin.time + s * h, x, v, end.discrete, end.reported)


def input_name(parameter: str) -> str:
    """Return the name of the input that sets a coefficient of friction."""
    return f"set/{parameter}"


def inputs_of(entries: Iterable[ScriptEntry]) -> frozenset[str]:
    """Return the names of the inputs that entries set."""
    return frozenset(input_name(entry.on) for entry in entries if entry.do == "set" and entry.on in _FRICTION)


def with_inputs(forces: Forces, entries: Iterable[ScriptEntry]) -> Forces:
    """Return the forces with inputs for what entries set, and elements that may become softer."""
    names = inputs_of(entries)
    kernels = tuple(_with_friction(term, names) for term in forces.kernels)
    softer = any(entry.do == "set" and (entry.on or "").endswith(".youngs_modulus") for entry in entries)
    cable = replace(forces.cable, may_be_cut=True) if softer else forces.cable
    return replace(forces, kernels=kernels, cable=cable)


def _with_friction(term: KernelTerm, names: frozenset[str]) -> KernelTerm:
    data: Any = term.data
    touches = isinstance(data, ThreadContact | SphereContact)
    drawn = term.discrete is not None and term.discrete.name == LINE
    name = input_name(_FRICTION[0] if touches else _FRICTION[1])
    if not (touches or drawn) or name not in names:
        return term
    field, value = ("law.friction", data.law.friction) if touches else ("friction", data.friction)
    return replace(term, inputs=(*term.inputs, Input(name, field, np.array([value]))))


def changed(
    system: System, parameter: str, value: float, now: tuple[float, Floats, Floats], every: DiscreteStates
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the keyword arguments of the `Change` by a new value of a parameter, and keys of its event.

    now : time [s], and x, v of all blocks
    """
    name, _, what = parameter.rpartition(".")
    if parameter == "thrust.factor":
        return {"others": {THRUST: np.array([*every[THRUST][:FACTOR], value])}}, {}
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
    """Return the command of a drive with another force or rate; unchanged if the command has none."""
    after, has = asked.copy(), 0.0 < abs(asked[1]) < WITHOUT_LIMIT if what == "rate" else asked[3] > 0.0
    if asked[0] == 0.0 or not has:
        words = f"set {drive}.{what}; no effect: the command of {drive} does not have a {what}"
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
    every: DiscreteStates,
    what: dict[str, Any],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the change of a closing line that slides at once under less friction."""
    time, x, v = now
    moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, time, every)
    x, v = system.layout.pack(moving)
    (term,) = (
        kernel
        for kernel in system.forces.kernels
        if kernel.discrete is not None and kernel.discrete.name == LINE
    )
    line: Any = copied(term.data_at(every)[0])
    taken = elastic_once_slid(x, line, line.friction) - elastic_once_slid(x, line, friction)
    first = int(line.state[0])  # wound up, work, energy taken by friction, elastic energy
    x[first + 2] += taken
    x[first + 3] -= taken
    return {**what, "x": x, "v": v, "work_given": -taken}, {"energy_taken_J": taken}


class ScriptEvents(Watch):
    """Event function of a script.

    An entry is armed at its time, or after another entry. From then on it is due as soon as its condition
    holds, at once without a condition. Entries due at one instant happen in the order of the script.
    """

    def __init__(
        self, entries: tuple[ScriptEntry, ...], sources: Sources, damping: Mapping[str, float | None]
    ) -> None:
        self._entries, self._sources, self._damping = entries, sources, damping
        self._conditions = [entry.condition for entry in entries]
        self._names = [entry.condition_name for entry in entries]
        self._numbers = {entry.name: k for k, entry in enumerate(entries)}
        self._size = WIDTH * len(entries) + 1
        self.sees, self.reports = observed_discrete_states(sources.system), sources.reports
        self.of_x, self.of_v = observed_entries(sources, set(self._names))
        self.weights = centre_weights(sources, set(self._names))
        self._ends = np.cumsum([self._size, *(len(sources.system.discrete[name]) for name in self.sees)])
        terms = (term for term in sources.system.forces if term.discrete and term.discrete.name == THRUST)
        knots = [term.switch.knots for term in terms if isinstance(term.switch, Knots)]
        self._knots = np.array([time for times in knots for time in times])
        self._came_true: dict[int, float] = {}  # when [s]
        self._key: bytes = b""
        self._decoded: tuple[list[EntryState], list[tuple[int, EntryState]]] = [], []
        self._nothing_at = -math.inf  # [s] at which no condition holds

    # Discrete state

    def _read(self, discrete: Floats) -> tuple[list[EntryState], list[tuple[int, EntryState]]]:
        """Decode all rows, and those with a condition to evaluate; cached by the discrete state."""
        key = discrete[: self._size].tobytes()
        if key != self._key:
            rows = [EntryState(*values) for values in discrete[: self._size - 1].reshape(-1, WIDTH).tolist()]
            watched = [
                (k, row) for k, row in enumerate(rows) if row.state in _EVALUATED and self._conditions[k]
            ]
            self._key, self._decoded = key, (rows, watched)
        return self._decoded

    def _rows(self, discrete: Floats) -> list[EntryState]:
        return self._read(discrete)[0]

    def _watched(self, discrete: Floats) -> list[tuple[int, EntryState]]:
        return self._read(discrete)[1]

    def stops(self, discrete: Floats) -> bool:
        """Return True once an entry has ended the run."""
        return bool(discrete[self._size - 1])

    def in_steps(self, discrete: Floats) -> bool:
        """Return True while a condition is evaluated."""
        return bool(self._watched(discrete))

    def _moment(self, entry: ScriptEntry, rows: list[EntryState]) -> float:
        """Return the time from which an entry may happen [s]; infinite while unknown."""
        if entry.at is not None:
            return entry.at
        if entry.after is None:
            return 0.0
        other = rows[self._numbers[entry.after]]
        return other.since + entry.delay if other.times else math.inf

    def instants(self, discrete: Floats) -> tuple[float, ...]:
        """Return the times at which entries are armed, and knots of thrusts that have started [s]."""
        rows = self._rows(discrete)
        pairs = list(zip(rows, self._entries, strict=True))
        armed = (self._moment(entry, rows) for row, entry in pairs if row.state == WAITING)
        thrusts = (row.since for row, entry in pairs if row.state == DONE and begins_a_thrust((entry,)))
        held = (self._until(k, row) for k, row in enumerate(rows) if row.state == HOLDING)
        return (*armed, *held, *(float(time) for since in thrusts for time in since + self._knots))

    # Due entries

    def _states(self, steps: Seen, *, completed: bool = True) -> States:
        """Return states with the discrete states of the last of them.

        completed : if False, velocities of attached points and prescribed bodies may be those of a stage
        """
        system, ends = self._sources.system, self._ends
        observed = (steps.discrete[a:b] for a, b in pairwise(ends))
        discrete = system.discrete | dict(zip(self.sees, observed, strict=True))
        states = States(system, steps.time, steps.x, steps.v, discrete)
        return states.completed() if completed else states

    def _now(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Seen:
        """Return one state as the end of a step."""
        reported = discrete[None, len(discrete) - len(self.reports) :]
        return Seen(np.array([time]), x[None], v[None], discrete, reported)

    def _look(self, steps: Seen, *, completed: bool = True) -> EndStates:
        return EndStates(lambda: self._states(steps, completed=completed), steps.reported, steps.mean)

    def _beyond(self, number: int, row: EntryState, sample: EndStates, *, signs: bool = False) -> Floats:
        """Return (k,) numbers above 0 where a condition holds, in the unit of its quantity.

        signs : only the signs are needed
        """
        condition = self._conditions[number]
        assert condition is not None
        if condition.name == "first_contact":
            return np.where(has_touched(self._sources, sample.reported), 1.0, -1.0)
        if condition.name == "largest_area":
            area = VALUES["area"](self._sources, sample)
            largest = np.maximum.accumulate(np.maximum(row.value, area))
            return np.asarray((1.0 - self._entries[number].fall) * largest - area)
        if signs and condition.name in DIFFERENCES:
            difference = DIFFERENCES[condition.name](self._sources, sample, condition.bound)
        else:
            difference = VALUES[condition.name](self._sources, sample) - condition.bound
        beyond = condition.sign * difference
        if row.times and row.state == ARMED:
            rests = sample.states.time < row.since + self._entries[number].rest
            beyond = np.where(rests, -np.abs(beyond), beyond)
        return np.asarray(beyond)

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Find the first entry to arm, to activate, or whose rest ends.

        Of due entries, the entry whose condition became true first.
        """
        rows = self._rows(discrete)
        for k, (row, entry) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state == WAITING and reached(time, self._moment(entry, rows)):
                return np.array([k])
        sample: EndStates | None = None
        due: list[int] = []
        for k, (row, entry) in enumerate(zip(rows, self._entries, strict=True)):
            if row.state not in _EVALUATED:
                continue
            over = row.state == HOLDING and reached(time, self._until(k, row))
            if over or entry.when is None or self._is_barred(entry, rows):
                due.append(k)
            elif time != self._nothing_at:
                sample = sample or self._look(self._now(time, x, v, discrete))
                if (self._beyond(k, row, sample, signs=True)[0] > 0.0) == (row.state == ARMED):
                    due.append(k)
        if not due:
            return _NOTHING
        return np.array([min(due, key=lambda k: (self._came_true.get(k, time), k))])

    def _until(self, number: int, row: EntryState) -> float:
        """Return until when a condition must stay true [s]."""
        return row.true + (self._entries[number].hold or 0.0)

    def _is_barred(self, entry: ScriptEntry, rows: list[EntryState]) -> bool:
        return entry.unless is not None and rows[self._numbers[entry.unless]].times > 0.0

    def comes_true(self, steps: Seen) -> int | None:
        """Find the first step at whose end a condition holds, or that of a resting entry does not."""
        watched = self._watched(steps.discrete)
        speeds = any(self._names[k] in OF_VELOCITIES for k, _ in watched)
        sample = self._look(steps, completed=speeds)
        true = np.zeros(len(steps.time), dtype=bool)
        for k, row in watched:
            true |= (self._beyond(k, row, sample, signs=True) > 0.0) == (row.state == ARMED)
        if true.any():
            self._nothing_at = -math.inf
            return int(true.argmax())
        self._nothing_at = float(steps.time[-1])
        return None

    def remembered(self, steps: Seen) -> Floats | None:
        """Return the discrete state with the largest area so far; None if unchanged."""
        after = None
        for k, row in self._watched(steps.discrete):
            if self._entries[k].when == "largest_area":
                area = float(VALUES["area"](self._sources, self._look(steps, completed=False)).max())
                if area > row.value:
                    after = steps.discrete[: self._size].copy() if after is None else after
                    after[WIDTH * k + EntryState._fields.index("value")] = area
        return after

    # Crossings within a step

    def crossing(self, begin: Seen, end: Seen) -> float | None:
        """Return the time [s] just before the first crossing in a step, or just after one at its start."""
        self._came_true = crossings = self._crossings(begin, end)
        self._nothing_at = -math.inf
        if not crossings:
            return None
        first, last = float(begin.time[0]), float(end.time[0])
        within = max(LOCATED_TO, 64.0 * math.ulp(last))
        if last - first <= 2.0 * within:
            return last
        # Contact is known at the ends of steps only: bisection.
        middle = 0.5 * (first + last)
        root = min(middle if self._names[k] in _TOUCH else time for k, time in crossings.items())
        return root - 0.5 * within if root - first > within else first + 2.0 * within

    def _crossings(self, begin: Seen, end: Seen) -> dict[int, float]:
        """Return when conditions became true in a step [s], by entry."""
        armed = [(k, row) for k, row in self._watched(begin.discrete) if row.state == ARMED]
        crossings: dict[int, float] = {}
        if not armed:
            return crossings
        first, last = self._look(begin), self._look(end)
        for k, row in armed:
            after = float(self._beyond(k, row, last)[0])
            if after > 0.0 and (before := float(self._beyond(k, row, first)[0])) <= 0.0:
                if self._names[k] in _TOUCH:
                    crossings[k] = float(end.time[0])
                else:
                    crossings[k] = self._root(k, row, (begin, end), (before, after))
        return crossings

    def _root(
        self, number: int, row: EntryState, step: tuple[Seen, Seen], ends: tuple[float, float]
    ) -> float:
        """Locate a crossing by the cubic Hermite polynomial of the step; linearly for `closing_tension`."""
        begin, end = (float(state.time[0]) for state in step)
        if self._names[number] == "closing_tension":
            return begin + (end - begin) * ends[0] / (ends[0] - ends[1])

        def beyond(part: float) -> float:
            if part in (0.0, 1.0):
                return ends[int(part)]
            within = interpolated(*step, part, self._sources.system.blocks.centres)
            return float(self._beyond(number, row, self._look(within))[0])

        if ends[0] == 0.0:
            return begin
        least = 0.01 * LOCATED_TO / (end - begin)
        return begin + (end - begin) * float(scipy.optimize.brentq(beyond, 0.0, 1.0, xtol=least, maxiter=100))

    # Actions

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """Arm or activate an entry; others may be due at the same time."""
        k, rows = int(items[0]), self._rows(discrete)
        entry, row = self._entries[k], rows[k]
        self._nothing_at = -math.inf
        if row.state == WAITING:
            return self._put(discrete, k, row._replace(state=ARMED, since=time))
        if self._is_barred(entry, rows):
            event = self._event(entry, time, f"not done: {entry.unless} has happened")
            return self._put(discrete, k, row._replace(state=BARRED), events=(event,))
        if row.state == RESTING:
            return self._put(discrete, k, row._replace(state=ARMED))
        if entry.hold is not None and row.state == ARMED:
            return self._put(discrete, k, row._replace(state=HOLDING, true=self._came_true.pop(k, time)))
        if row.state == HOLDING:
            if self._beyond(k, row, self._look(self._now(time, x, v, discrete)))[0] <= 0.0:
                return self._put(discrete, k, row._replace(state=ARMED))
            self._came_true[k] = row.true
        times, state = row.times + 1.0, RESTING if entry.repeat else DONE
        words = "; ".join((entry.action_words, *self._remarks(k, rows, time, every)))
        details: dict[str, Any] = {"verdict": entry.verdict} if entry.do == "stop" else {}
        events = [replace(self._event(entry, time, words), done=True)]
        if entry.repeat and times >= MAX_ACTIVATIONS:
            state = DONE
            words = f"disabled after {MAX_ACTIVATIONS} activations"
            events.append(replace(self._event(entry, time, words), used_up=True))
        row = row._replace(state=state, since=time, times=times)
        if entry.condition_name in QUANTITIES:
            now = self._look(self._now(time, x, v, discrete))
            value = VALUES[entry.condition_name](self._sources, now)
            row = row._replace(value=float(value[0]))
        if entry.when is not None:
            unit = QUANTITIES[entry.condition_name].unit if entry.condition_name in QUANTITIES else "1"
            crossed = self._came_true.pop(k, time)
            details |= {"crossed_s": crossed, "value": row.value, "unit": unit}
        what: dict[str, Any] = {"stops": entry.do == "stop"}
        if entry.do == "cut":
            first = self._cut_at(entry)
            if every[INTACT][first]:
                after = every[INTACT].copy()
                after[first], details["element"] = 0.0, first
                what |= {"others": {INTACT: after}, "energy_lost": None}
        elif entry.tie is not None:
            what |= self._release(entry.tie, time, x, v, every)
            details |= {
                "tie": entry.tie,
                "node": int(self._sources.system.kinematics.ties[entry.tie].points[0]),
            }
        elif entry.action.on == "body":
            assert entry.on is not None
            duration = math.inf if entry.duration is None else entry.duration
            what["others"] = {discrete_name(entry.on): burnt(time, duration, *entry.load)}
        elif entry.do == "thrust":
            what["others"] = {THRUST: begun_at(time, self._knots, float(every[THRUST][FACTOR]))}
        elif entry.do == "set":
            assert entry.on is not None
            assert entry.value is not None
            effect, more = changed(self._sources.system, entry.on, entry.value, (time, x, v), every)
            what |= effect
            details |= more
        elif entry.do == "control":
            what["others"] = {CONTROL: started(every[CONTROL], time)}
        elif entry.do == "release_control":
            what["others"] = {CONTROL: released(every[CONTROL])}
        elif entry.do == "eject":
            what["others"] = {HELD: np.array([every[HELD][NODES], 1.0])}
        else:
            what["others"] = self._commands(entry)
        return self._put(discrete, k, row, events=(replace(events[0], **details), *events[1:]), **what)

    def _remarks(
        self, number: int, rows: list[EntryState], time: float, every: DiscreteStates
    ) -> Iterator[str]:
        """Yield remarks on an entry: that it replaces a command, or has no effect."""
        entry, ties = self._entries[number], self._sources.system.kinematics.ties
        for k, (row, other) in enumerate(zip(rows, self._entries, strict=True)):
            if k != number and row.times and row.since == time and conflict(other, entry):
                yield f"replaces the command of {other.name} at the same time"
        if entry.do == "cut" and not every[INTACT][self._cut_at(entry)]:
            yield "no effect: already cut or broken there"
        if entry.do == "eject" and (not every[HELD][NODES] or every[HELD][LET_GO]):
            yield "no effect: the net has already been ejected"
        for name, tie in ties.items():
            if every[tie.discrete][0]:
                continue
            if name == entry.tie:
                yield "no effect: already released"
            elif entry.do != "release" and name.startswith(f"tethers.{entry.drive}."):
                yield f"no effect: its {name.rpartition('.')[2]} has been released"

    def _cut_at(self, entry: ScriptEntry) -> int:
        """Return the element to cut: the first of a tether."""
        assert entry.on is not None
        return self._sources.system.net.tether_elements[entry.on].start

    def _release(self, tie: str, time: float, x: Floats, v: Floats, every: DiscreteStates) -> dict[str, Any]:
        """Release a point with its velocity on the body, which conserves momenta and energy."""
        system = self._sources.system
        moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, time, every)
        x, v = system.layout.pack(moving)
        return {"x": x, "v": v, "others": {system.kinematics.ties[tie].discrete: np.zeros(1)}}

    def _commands(self, entry: ScriptEntry) -> dict[str, Floats]:
        """Return the input of the drive that an entry commands."""
        if entry.drive is None:
            return {}
        drive = drive_of(entry, self._damping[entry.drive])
        values = [1.0, drive.rate, drive.force, drive.gives]
        return {command_name(entry.drive): np.array(values)}

    def _put(self, discrete: Floats, number: int, row: EntryState, **what: Any) -> Change:
        after = discrete[: self._size].copy()
        after[WIDTH * number : WIDTH * (number + 1)] = np.array(row)
        stops = bool(what.get("stops"))
        after[-1] = max(after[-1], float(stops))
        return Change(after, more=not stops, **what)

    @staticmethod
    def _event(entry: ScriptEntry, time: float, words: str) -> ScriptEvent:
        return ScriptEvent(time_s=time, entry=entry.name, cause=entry.trigger_words, event=words)


@dataclass(frozen=True, eq=False)
class Script(Term):
    """Script of a case as a term without forces; the system of `sources` does not include it.

    damping : of each drive [N s/m]
    """

    entries: tuple[ScriptEntry, ...]
    sources: Sources
    damping: dict[str, float | None]

    @property
    def discrete(self) -> DiscreteState:
        """Discrete state: an `EntryState` of each entry, then 1.0 once the run has ended."""
        rows = [EntryState(WAITING, 0.0, 0.0, 0.0) for _ in self.entries]
        return DiscreteState("script/entries", np.append(np.array(rows).ravel(), 0.0), in_steps=True)

    @property
    def switch(self) -> ScriptEvents:
        """Event function, new for each run."""
        return ScriptEvents(self.entries, self.sources, self.damping)

    @property
    def acts_with(self) -> frozenset[str]:
        """Inputs that the script sets."""
        drives = frozenset(command_name(entry.drive) for entry in self.entries if entry.drive is not None)
        return drives | inputs_of(self.entries)


def script_of(entries: tuple[ScriptEntry, ...], system: System, target: str | None) -> Script:
    """Make the script of a scene over its system; target : name of the body to capture."""
    drives: dict[str, float | None]
    drives = {winding.reel.name: winding.reel.damping for winding in system.forces.cable.reels}
    if system.line is not None and system.line.has_winch:
        drives[CLOSING] = system.line.damping
    return Script(entries, Sources.of(system, target), drives)
