"""Outcome of a capture by the criterion of the case, and the cause of what was not reached."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from exunet.base.arrays import Bools, Floats
from exunet.bodies.distance import reach_of, times_round
from exunet.forces.contact.status import NODES, THREADS
from exunet.net.areas import mouth_diameter
from exunet.results.capture import Measures, pieces_at
from exunet.results.clearance import shapes_of
from exunet.results.observables import EDGE, LINE, Observables, touched_bodies
from exunet.results.penetration import Touch, net_contact, threads_inside
from exunet.scene.capture import CONDITIONS, Capture

AT_LEAST = {"enclosed", "touching"}  # the others are at most their bound
UNITS = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}  # of conditions, in keys
WRAPPED = 0.5  # part of the target in the net's hull from which on it is in the net, whatever the criterion
_MOVES = 0.05  # of its fastest rate: a drive, or a net, that is slower is at rest


class Outcome(StrEnum):
    """Outcome of a capture, see docs/explanation/theory_bodies.md."""

    UNDETERMINED = "undetermined"
    CAPTURED = "captured"
    CLOSING = "closing"
    WRAPPED = "wrapped"
    ESCAPED = "escaped"
    TOUCHED = "touched"
    MISSED = "missed"


class ConditionSeries(NamedTuple):
    """A condition of a criterion at the stored times: its bound, the values (t,) and where they keep it."""

    bound: float
    values: Floats
    holds: Bools


class RunOutcome(NamedTuple):
    """Outcome of a run.

    since    : time from which all conditions hold until the end [s]; None if they do not
    time     : of a target that was lost: the stored time at which it was in the net, or the net touched it,
               last; of one that is in the net, but not yet for the duration: from which on; of one that was
               missed: at which the net was nearest [s]; else None
    distance : least distance of the net's nodes from the target over the stored times [m]
    """

    outcome: Outcome
    since: float | None
    conditions: dict[str, ConditionSeries]
    time: float | None
    distance: float


class CaptureFacts(NamedTuple):
    """Facts that a verdict depends on beside measures and contact.

    closes    : what closes the mouth moves at the end
    complete  : no guard has stopped the run
    braked    : a tether, or a body that it touches, took the speed of the net before the target
    nears     : the net's centre nears that of the target at the end
    on_course : straight on, it passes the target within the net's reach
    """

    closes: bool = False
    complete: bool = True
    braked: bool = False
    nears: bool = False
    on_course: bool = False


def outcome(run: Observables) -> RunOutcome | None:
    """Judge a run by the criterion of its case; None without a criterion."""
    return None if run.criterion is None else _Flight(run, run.criterion).verdict


def judge(
    criterion: Capture, time: Floats, measures: Measures, touch: Touch, motion: CaptureFacts
) -> RunOutcome:
    """Judge the measures of a capture by a criterion."""
    conditions: dict[str, ConditionSeries] = {}
    for name in CONDITIONS:
        if (bound := getattr(criterion, name)) is not None:
            values = touch.elements if name == "touching" else getattr(measures, name)
            holds = values >= bound if name in AT_LEAST else values <= bound
            conditions[name] = ConditionSeries(bound, values, holds)
    inside = measures.enclosed >= WRAPPED
    if "enclosed" in conditions:
        inside |= conditions["enclosed"].holds
    near = inside | touch.holds
    if touch.first is not None:
        near[min(int(np.searchsorted(time, touch.first)), len(time) - 1)] = True
    every = np.logical_and.reduce([item.holds for item in conditions.values()])
    rows = zip(every, near, strict=True)
    held = np.array(
        [*accumulate(rows, lambda seen, row: row[0] and (seen or row[1]), initial=False)][1:], bool
    )
    since, within = holds_since(time, held), holds_since(time, inside)
    nearest, enough = int(measures.distance.argmin()), criterion.duration * (1.0 - 1e-12)

    def verdict(state: Outcome, at: float | None = None) -> RunOutcome:
        return RunOutcome(state, since, conditions, at, float(measures.distance[nearest]))

    if not motion.complete:
        return verdict(Outcome.UNDETERMINED)
    if since is not None:
        return verdict(Outcome.CAPTURED if time[-1] - since >= enough else Outcome.UNDETERMINED)
    if within is not None:
        if time[-1] - within < enough:
            return verdict(Outcome.UNDETERMINED, within)
        return verdict(Outcome.CLOSING if motion.closes else Outcome.WRAPPED)
    lost = max(float(time[near][-1]) if near.any() else 0.0, touch.first or 0.0)
    if (conditions["enclosed"].holds if "enclosed" in conditions else held).any():
        return verdict(Outcome.ESCAPED, lost)
    if touch.first is not None:
        nears = motion.nears and not inside.any()
        return verdict(Outcome.UNDETERMINED) if nears else verdict(Outcome.TOUCHED, lost)
    if motion.nears and motion.on_course and not motion.braked:
        return verdict(Outcome.UNDETERMINED)
    return verdict(Outcome.MISSED, float(time[nearest]))


def _closes(run: Observables) -> bool:
    """Whether a winch winds up, or an edge becomes shorter, in the last interval of stored times."""
    name = next((name for name in (f"{LINE}wound_up", EDGE) if name in run.result.states), None)
    if name is None or len(run.time) < 2:
        return False
    rates = np.diff(run.state(name)[:, 0]) / np.diff(run.time) * (-1.0 if name == EDGE else 1.0)
    return bool(rates[-1] > _MOVES * rates.max())


def holds_since(time: Floats, holds: Bools) -> float | None:
    """Return the stored time from which a condition (t,) holds until the end [s]; None if it does not."""
    if not holds[-1]:
        return None
    fails = np.flatnonzero(~holds)
    return float(time[fails[-1] + 1 if len(fails) else 0])


def leaves_through(run: Observables, target: str) -> str:
    """Return through what a target's centre left the net last: "mouth", "side" or "" if it was never in it.

    Net and mouth together go once round a point inside. Of both, that changes most whose solid angle, as seen
    from the centre, changes by a whole sphere as it goes through.
    """
    after = np.zeros(2)
    for row in range(len(run.time) - 1, -1, -1):
        now = _around(run, target, row)
        if abs(now[0] - now[1]) > 0.5:
            side, mouth = np.abs(now - after)
            return "" if row == len(run.time) - 1 else "side" if side > mouth else "mouth"
        after = now
    return ""


def _around(run: Observables, target: str, row: int) -> Floats:
    """Return the parts of a turn that net and mouth go round a target's centre at a stored time."""
    net, place = run.result.net, np.asarray(run.result.position[row])
    centre = np.asarray(run.result.bodies[target].position[row])[None]
    parts = []
    for loops in (net.faces, (net.rim,) if net.rim else ()):
        fans = [
            np.stack([np.broadcast_to(x.mean(axis=0), x.shape), x, np.roll(x, -1, axis=0)], axis=1)
            for x in (place[list(loop)] for loop in loops)
        ]
        parts.append(float(times_round(centre, np.concatenate(fans))[0]) if fans else 0.0)
    return np.array(parts)


# Part of the speed of approach that a tether takes, and part of the momentum lost that its pull must explain,
# for the tether to be the cause.
_BRAKED = 0.5
_ROUNDING = 1e-9  # of its largest speed: a slower approach is round-off
_STILL = 1e-6  # of the distance: a centre of mass that moves less does not move
_LET_OUT = "paid out"
_BESIDE = 0.25  # part of a turn that a net goes round a point in it, which is half, and outside its edge none
_SHOWN = 4  # broken threads that are named
_AT_LIMIT = 0.95  # part of its largest force from which on a winch is at it
_STRAINED = 0.5  # part of its largest force with which a winch pulls that a lock does not stop too early
_WOUND = 0.98  # part of the length that a winch can wind up, from which on it is at its end
_TAUT = 0.1  # part of its largest tension above which a tether counts as taut


_PULL = "pulled with up to {force_N} N from {start} s to {end} s"
_SPEEDS = "speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target"
_WINCH = f"the winch {_PULL}, {{wound_m}} of {{windable_m}} m wound up"


class Cause(StrEnum):
    """Binding cause of a capture that did not succeed, with a sentence on it; see docs/how_to/captures.md."""

    words: str

    def __new__(cls, value: str, words: str) -> Cause:
        member = str.__new__(cls, value)
        member._value_, member.words = value, words
        return member

    STOPPED = "stopped", "a guard stopped the run at {end} s"
    ENDED_EARLY = "ended early", "{subject} since {start} s: {held_s} of {duration_s} s"
    NOT_REACHED = (
        "not reached",
        "the net did not reach the target: {speed_m_s} m/s towards it at launch, nearest {distance_m} m at "
        "{end} s",
    )
    TOO_SLOW = (
        "too slow",
        "at the end the net is {distance_m} m from the target, {arrival_s} s at {speed_m_s} m/s",
    )
    MOVING_IN = (
        "moving in",
        "the run ended while the net moved in on '{subject}' at {speed_m_s} m/s: enclosed {enclosed} at most",
    )
    REEL_BRAKES = "reel brakes", f"reel of '{{subject}}' {_PULL}: {_SPEEDS}"
    TETHER_TAUT = "tether taut", f"tether '{{subject}}', {{length_m}} m long, {_PULL}: {_SPEEDS}"
    STOPPED_BY_BODY = "stopped by body", f"'{{subject}}' stopped the net from {{start}} s on: {_SPEEDS}"
    FLEW_THROUGH = (
        "flew through",
        "threads flew through '{subject}' from {start} s on: {elements} elements, the first {element}",
    )
    MISSED_SIDEWAYS = (
        "missed sideways",
        "the net passes {offset_m} m beside the target's centre at {end} s: its mouth was {largest_m} m wide "
        "at most",
    )
    WOULD_MISS = (
        "would miss",
        "straight on from {end} s, the net would pass {offset_m} m beside the target's centre: its mouth was "
        "{largest_m} m wide at most",
    )
    PASSED_BY = (
        "passed by",
        "the net passed {offset_m} m beside the target's centre at {end} s, its mouth {mouth_m} m wide",
    )
    THREAD_BROKE = "thread broke", "threads broke from {start} s to {end} s"
    REBOUNDED = (
        "rebounded",
        "the net touched '{subject}' from {start} s on, last at {end} s: enclosed {enclosed} at most",
    )
    SLIPPED_OFF = (
        "slipped off",
        "'{subject}' left the net at {end} s: enclosed {enclosed} at most, mouth {mouth_m} m wide",
    )
    WINCH_TOO_WEAK = "winch too weak", _WINCH
    WINCH_STOPPED = "winch stopped", _WINCH
    STILL_CLOSING = "still closing", "the run ended while the mouth was closing, {mouth_m} m wide"
    MOUTH_OPEN = "mouth open", "the mouth stays {mouth_m} m wide"
    CONDITION = "condition", "{subject} is {value} at the end, its bound {bound}"


@dataclass(frozen=True)
class Reason:
    """A cause with its numbers.

    subject    : tether, body, condition or verdict of a guard that it is about, as the case writes it
    start, end : interval of time [s]; equal: an instant
    numbers    : by name with unit, such as "force_N"
    remark     : what else a sentence on it says
    """

    cause: Cause
    start: float
    end: float
    subject: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""

    def __str__(self) -> str:
        values = {name: f"{value:.3g}" for name, value in self.numbers.items()}
        interval = {"start": f"{self.start:.3g}", "end": f"{self.end:.3g}"}
        words = self.cause.words.format(**values, **interval, subject=self.subject)
        return f"{words}: {self.remark}" if self.remark else words


def reason(run: Observables) -> Reason | None:
    """Return the cause of a capture that did not succeed; None of one that did, and without a criterion."""
    flight = None if run.criterion is None else _Flight(run, run.criterion)
    if flight is None or flight.verdict.outcome is Outcome.CAPTURED:
        return None
    cause = flight.cause()
    words = flight.broken_words(cause.end if cause.cause is Cause.THREAD_BROKE else flight.end)
    tether = run.first_contact(flight.target) if flight.touch.first is None else None
    touched = "" if tether is None else f"the tether touched '{flight.target}' at {tether:.3g} s"
    return replace(cause, remark="; ".join(filter(None, (cause.remark, touched, words))))


class _Flight:
    """Flight of the net's centre of mass to a target at the stored times (t,), with outcome and cause.

    along     : distance still to go in the direction of the first approach [m]
    offset    : distance beside the target in that direction [m]
    approach  : speed [m/s]
    at_first  : speed of approach in the first motion [m/s]; at_end: at the end
    nears     : at_end is more than a part of the largest relative speed
    beside    : distance at which the net, straight on from the end, passes the target's centre [m]
    widest    : largest mouth of the run [m]; unfolded: that of the reference configuration
    on_course : beside is less than the target's radius and half of the mouth, the largest of the run, or as
                wide as it becomes at its last rate, but not more than unfolded
    """

    def __init__(self, run: Observables, criterion: Capture) -> None:
        assert run.capture is not None
        self.run, self.criterion, self.target, self.measures = run, criterion, criterion.target, run.capture
        self.end, body = float(run.time[-1]), run.result.bodies[self.target]
        centre, velocity = run.net_motion
        relative, rate = np.asarray(body.position[:]) - centre, np.asarray(body.velocity[:]) - velocity
        apart = np.linalg.norm(relative, axis=1)
        still = np.linalg.norm(rate, axis=1).max() * (self.end - run.time[0]) <= _STILL * apart.max()
        rate = np.zeros_like(rate) if still else rate
        speeds = np.linalg.norm(rate, axis=1)
        towards = -np.einsum("tk,tk->t", rate, relative) / np.where(apart > 0.0, apart, 1.0)
        start = int(np.argmax(speeds > _MOVES * speeds.max()))
        self.at_first = float(towards[start]) if abs(towards[start]) > _ROUNDING * speeds.max() else 0.0
        first = int(np.argmax(towards > 0.0))
        speed = float(speeds[first])
        direction = -rate[first] / speed if speed else relative[0] / (apart[0] or 1.0)
        self.along = relative @ direction
        self.offset = np.linalg.norm(relative - np.multiply.outer(self.along, direction), axis=1)
        self.approach = -(rate @ direction)
        self.at_end, last = float(towards[-1]), float(speeds[-1]) or 1.0
        self.nears = self.at_end > _MOVES * speeds.max()
        way = self.at_end * float(apart[-1]) / last
        self.beside = math.sqrt(max(0.0, float(apart[-1]) ** 2 - way**2))
        net, mouth = run.result.net, self.measures.mouth
        self.widest = reach = float(mouth.max()) or net.size
        self.unfolded = float(mouth_diameter(net, net.reference_position[None])[0])
        if len(mouth) > 1 and mouth[-1] > mouth[-2]:
            grown = float(mouth[-1] + np.diff(mouth)[-1] / np.diff(run.time)[-1] * way / last)
            reach = max(reach, min(grown, self.unfolded))
        radius = reach_of(shapes_of(run.result)[self.target])
        self.on_course = self.nears and self.beside < 0.5 * reach + radius
        self.touch = net_contact(run, self.target)
        wall = None if self.touch.first is not None else self.walled()
        held = wall is not None and bool(net_contact(run, wall.subject).holds[-1])
        braked = self.touch.first is None and (held or self.braked() is not None)
        motion = CaptureFacts(_closes(run), run.result.complete, braked, self.nears, self.on_course)
        self.verdict = judge(criterion, run.time, self.measures, self.touch, motion)

    @property
    def passing(self) -> int | None:
        """Stored time at which the net's centre passes that of the target; None: it does not."""
        passed = np.flatnonzero((self.along[1:] <= 0.0) & (self.along[:-1] > 0.0))
        return int(passed[0]) + 1 if len(passed) else None

    @property
    def turning(self) -> int:
        """Stored time at which the net has passed the target, or approaches it no longer, or the last."""
        first = int(np.argmax(self.approach > 0.0))
        away = np.flatnonzero((self.approach[first:] <= 0.0) | (self.along[first:] <= 0.0))
        return first + int(away[0]) if len(away) else len(self.along) - 1

    def cause(self) -> Reason:
        """Return the cause of a capture that did not succeed."""
        found, touch, run = self.verdict, self.touch, self.run
        if not run.result.complete:
            return Reason(Cause.STOPPED, self.end, self.end, run.result.verdict)
        if found.since is not None:
            return self.early(found.since, "the conditions hold")
        if found.outcome is Outcome.UNDETERMINED:
            return (
                self.nearing()
                if found.time is None
                else self.early(found.time, f"'{self.target}' is in the net")
            )
        if (through := self.through()) is not None:
            return through
        if found.outcome in (Outcome.WRAPPED, Outcome.CLOSING):
            return self.open() or self.condition()
        if found.outcome is Outcome.MISSED:
            turned = float(run.time[self.turning])
            torn = self.broken(turned) if len(pieces_at(run.result, turned)) > 1 else None
            stopped = torn or self.braked() or self.walled()
            return stopped or self.passed() or self.not_reached()
        lost = self.end if found.time is None else found.time
        if (broke := self.broken(lost)) is not None:
            return broke
        if found.outcome is Outcome.ESCAPED or (self.measures.enclosed[run.time <= lost] >= WRAPPED).any():
            return self.lost(Cause.SLIPPED_OFF, lost)
        if touch.holds[-1]:
            return self.braked() or self.condition()
        return (
            self.passed() or self.braked() or self.walled() or self.lost(Cause.REBOUNDED, lost, touch.first)
        )

    def early(self, since: float, subject: str) -> Reason:
        """The run ended before the conditions had held, or the target been in the net, for the duration."""
        numbers = {"held_s": self.end - since, "duration_s": self.criterion.duration}
        return Reason(Cause.ENDED_EARLY, since, self.end, subject, numbers)

    def nearing(self) -> Reason:
        """The run ended while the net neared the target."""
        numbers, distance = {"speed_m_s": self.at_end}, float(self.measures.distance[-1])
        around = self.run.time[(self.measures.enclosed > 0.0) | (self.measures.distance == 0.0)]
        if (first := self.touch.first) is not None or len(around):
            numbers["enclosed"] = float(self.measures.enclosed.max())
            start, remark = (float(around[0]), "without contact") if first is None else (first, "")
            return Reason(Cause.MOVING_IN, start, self.end, self.target, numbers, remark)
        numbers |= {"distance_m": distance, "arrival_s": distance / self.at_end}
        return Reason(Cause.TOO_SLOW, float(self.run.time[0]), self.end, numbers=numbers)

    def slowed(self, before: int) -> tuple[int, dict[str, float]] | None:
        """Stored time until which the net lost most of its speed at another, and speeds; None: it did not."""
        after = before + int(np.argmin(self.approach[before : self.turning + 1]))
        fast, slow = float(self.approach[before]), float(self.approach[after])
        nearest = float(self.measures.distance[: after + 1].min())
        numbers = {"speed_before_m_s": fast, "speed_after_m_s": slow, "distance_m": nearest}
        return (after, numbers) if fast > 0.0 and slow <= _BRAKED * fast else None

    def braked(self) -> Reason | None:
        """A tether whose pull took most of the net's speed before it reached the target, or turned back."""
        run, net, stop = self.run, self.run.result.net, self.turning
        before = int(np.argmax(self.approach[: stop + 1]))
        if self.at_first <= 0.0 or (slowed := self.slowed(before)) is None:
            return None
        slowest, speeds = slowed
        lost = speeds["speed_before_m_s"] - speeds["speed_after_m_s"]
        mass = float(net.mass[: net.n_net_nodes].sum())
        for name, elements in net.tether_elements.items():
            tension = np.asarray(run.result.tension[:, list(elements)]).max(axis=1)[: stop + 1]
            taut = np.flatnonzero(tension > _TAUT * float(tension.max(initial=0.0)))
            pull, time = tension[before : slowest + 1], run.time[before : slowest + 1]
            if not len(taut) or float(np.trapezoid(pull, time)) < _BRAKED * mass * lost:
                continue
            numbers = {"force_N": float(pull.max()), **speeds}
            interval = float(run.time[max(before, int(taut[0]))]), float(run.time[slowest])
            if name in run.reels:
                return Reason(Cause.REEL_BRAKES, *interval, name, numbers)
            numbers["length_m"] = float(net.reference_length[list(elements)].sum())
            return Reason(Cause.TETHER_TAUT, *interval, name, numbers)
        return None

    def walled(self) -> Reason | None:
        """Another body that the net touched before it lost most of its speed."""
        run, carried = self.run, self.run.result.run.carried
        for name in run.touched_bodies:
            if name == self.target or (carried is not None and name == carried.body):
                continue
            first = net_contact(run, name).first
            if first is None or first > run.time[self.turning]:
                continue
            if slowed := self.slowed(max(0, int(np.searchsorted(run.time, first)) - 1)):
                return Reason(Cause.STOPPED_BY_BODY, first, float(run.time[slowed[0]]), name, slowed[1])
        return None

    def through(self) -> Reason | None:
        """Threads that went through a target that neither threads nor nodes touch."""
        known = touched_bodies(self.run.result, (THREADS, NODES))
        others = tuple({*self.run.result.bodies, *known} - ({self.target} - {*known}))
        for item in threads_inside(self.run.result, but=others):
            numbers = {"elements": float(item.elements), "element": float(item.element)}
            remark = "contact of threads with it is not enabled"
            return Reason(Cause.FLEW_THROUGH, item.time, self.end, self.target, numbers, remark)
        return None

    def passed(self) -> Reason | None:
        """A net whose centre passed the target outside its mouth, or would after the end."""
        row = self.passing
        if row is None:
            numbers = {"offset_m": self.beside, "largest_m": self.widest}
            missed = Reason(Cause.WOULD_MISS, self.end, self.end, numbers=numbers)
            return missed if self.nears and not self.on_course else None
        time, offset, mouth = (float(item[row]) for item in (self.run.time, self.offset, self.measures.mouth))
        numbers = {"offset_m": offset, "mouth_m": mouth, "largest_m": self.widest}
        if offset > 0.5 * max(self.widest, self.unfolded):
            return Reason(Cause.MISSED_SIDEWAYS, time, time, numbers=numbers)
        if offset <= 0.5 * mouth and self.touch.first is not None:
            return None
        near = max(abs(_around(self.run, self.target, k)[0]) for k in (row - 1, row))
        remark = "" if offset > 0.5 * mouth else "through a mesh" if near > _BESIDE else "past an edge"
        return Reason(Cause.PASSED_BY, time, time, numbers=numbers, remark=remark)

    def not_reached(self) -> Reason:
        """A net that did not approach at first, or turned."""
        nearest = float(self.run.time[self.measures.distance.argmin()])
        numbers = {"speed_m_s": self.at_first, "distance_m": self.verdict.distance}
        return Reason(Cause.NOT_REACHED, float(self.run.time[0]), nearest, numbers=numbers)

    def broken(self, until: float) -> Reason | None:
        """Threads that broke before a target was lost."""
        times = [event.time_s for event in self.run.result.run.breaks if event.time_s <= until]
        numbers = {"broken": float(len(times))}
        return Reason(Cause.THREAD_BROKE, min(times), max(times), numbers=numbers) if times else None

    def broken_words(self, until: float) -> str:
        """Name the threads that broke, and the piece that is judged; "" if none broke."""
        net, events = self.run.result.net, self.run.result.run.breaks
        broken = [event.element for event in events if event.time_s <= until]
        ends = (map(net.node_words, net.element_nodes[element].tolist()) for element in broken)
        names = [f"{element} ({' to '.join(pair)})" for element, pair in zip(broken, ends, strict=True)]
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        words = f"broken elements: {', '.join(names[:_SHOWN])}{more}" if names else ""
        number = len(pieces_at(self.run.result, until))
        return f"{words}; the net is in {number} pieces, judged by the largest" if number > 1 else words

    def lost(self, cause: Cause, time: float, since: float | None = None) -> Reason:
        """A target that was in the net, or that the net touched, until a time [s]."""
        row = int(np.searchsorted(self.run.time, time * (1.0 + 1e-12), side="right")) - 1
        enclosed, mouth = self.measures.enclosed[: row + 1], float(self.measures.mouth[row])
        numbers = {"enclosed": float(enclosed.max()), "mouth_m": mouth}
        start = float(self.run.time[enclosed.argmax()]) if since is None else since
        stops = _stops(self.commands(time)) if cause is Cause.SLIPPED_OFF else ""
        return Reason(cause, start, time, self.target, numbers, f"winch {stops}" if _LET_OUT in stops else "")

    def commands(self, until: float) -> list[tuple[float, str, str]]:
        """Return the commands of the winch until a time: when [s], what it does, and the script's entry."""
        run, found = self.run.result.run, list[tuple[float, str, str]]()
        for does, at in () if run.winch is None else run.winch.commands:
            if isinstance(at, str):
                found += [(event.time_s, does, at) for event in run.done if event.entry == at]
            else:
                found.append((at, does, ""))
        return sorted(item for item in found if item[0] <= until)

    def open(self) -> Reason | None:
        """Return why the mouth of a net with its target is open; None if no condition on the mouth fails."""
        run, found, end = self.run, self.verdict, self.end
        mouth = found.conditions.get("mouth")
        if mouth is not None and mouth.holds[-1]:
            return None
        others = [item for name, item in found.conditions.items() if name not in ("enclosed", "mcqi", "cqi")]
        if mouth is None and not all(item.holds[-1] for item in others):
            return None
        width = {"mouth_m": float(self.measures.mouth[-1])}
        if found.outcome is Outcome.CLOSING:
            return Reason(Cause.STILL_CLOSING, end, end, numbers=width)
        winch = run.result.run.winch
        if winch is None or f"{LINE}wound_up" not in run.result.states:
            words = "" if EDGE in run.result.states else "nothing closes it"
            return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark=words)
        wound, commands = run.state(f"{LINE}wound_up")[:, 0], self.commands(end)
        commands = commands if winch.commands else [(float(run.time[0]), "pull", "")]  # a host's
        pulls = np.zeros(len(wound), dtype=bool)
        for (begin, does, _), until in zip(commands, [*(item[0] for item in commands[1:]), end], strict=True):
            pulls |= (does == "pull") & (run.time >= begin) & (run.time <= until)
        if not pulls.any() or (np.diff(wound) <= 0.0).all():
            return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark="the winch did not pull")
        first, last = np.flatnonzero(pulls)[[0, -1]]
        times, stops = (float(run.time[first]), float(run.time[last])), _stops(commands)
        if wound[last] >= _WOUND * winch.windable_m and _LET_OUT not in stops:
            remark = "the winch has wound up all of its line"
            return Reason(Cause.MOUTH_OPEN, *times, numbers=width, remark=remark)
        tension = max(float(run.state(f"{LINE}tension_{side}")[pulls, 0].max()) for side in ("start", "end"))
        pull = min(tension, winch.force_N or math.inf)  # above its force a winch is hauled out
        numbers = {"force_N": pull, "wound_m": float(wound[last]), "windable_m": winch.windable_m} | width
        own_lock = _LET_OUT not in stops and not any(entry for _, _, entry in commands)
        weak = not stops or (own_lock and pull >= _STRAINED * (winch.force_N or math.inf))
        if winch.force_N is not None:
            numbers["limit_N"] = winch.force_N
        if wound[last] >= _WOUND * winch.windable_m:
            stops = f"to the end of its line, then {stops}"
        elif winch.force_N is not None:
            reached = pull >= _AT_LIMIT * winch.force_N
            limit = f"{'at' if reached else 'below'} its limit of {winch.force_N:.3g} N"
            stops = f"{limit}, {stops}" if stops else limit
        cause = Cause.WINCH_TOO_WEAK if weak else Cause.WINCH_STOPPED
        return Reason(cause, *times, numbers=numbers, remark=stops)

    def condition(self) -> Reason:
        """The condition that is farthest from its bound, as a part of it."""
        conditions = self.verdict.conditions

        def excess(name: str) -> float:
            ratio = float(conditions[name].values[-1]) / conditions[name].bound
            return 1.0 - ratio if name in AT_LEAST else ratio - 1.0

        name = max((key for key, item in conditions.items() if not item.holds[-1]), key=excess)
        numbers = {"value": float(conditions[name].values[-1]), "bound": conditions[name].bound}
        closes = any(state.startswith(LINE) for state in self.run.result.states)
        remark = "" if closes else "nothing closes the mouth"
        return Reason(Cause.CONDITION, self.end, self.end, name, numbers, remark)


def _stops(commands: list[tuple[float, str, str]]) -> str:
    """Describe how a winch was locked or paid out after it had pulled last."""
    pulls = [k for k, (_, does, _) in enumerate(commands) if does == "pull"]
    verbs = {"lock": "locked", "pay out": _LET_OUT}
    return ", ".join(
        f"{verbs[does]} at {time:.3g} s" + f" by '{entry}'" * bool(entry)
        for time, does, entry in (commands[pulls[-1] + 1 :] if pulls else ())
    )


def summary_of_capture(run: Observables) -> dict[str, Any] | None:
    """Return outcome, cause and conditions of a capture, for summary.json; None without a criterion."""
    found, criterion, why = outcome(run), run.criterion, reason(run)
    if found is None or criterion is None:
        return None
    inside = run.capture is not None and run.capture.enclosed.max() >= WRAPPED
    over_rim = "mouth" if inside else None  # its centre was between the rim and the edge of the hull
    left = found.outcome is Outcome.ESCAPED or (found.outcome is Outcome.TOUCHED and inside)
    return {
        "outcome": found.outcome.value,
        "since_s": found.since,
        "time_s": found.time,
        "least_distance_m": found.distance,
        "left_through": leaves_through(run, criterion.target) or over_rim if left else None,
        "cause": None
        if why is None
        else {
            "cause": why.cause.value,
            "start_s": why.start,
            "end_s": why.end,
            "subject": why.subject,
            "numbers": dict(why.numbers),
            "words": str(why),
        },
        "duration_s": criterion.duration,
        "target": criterion.target,
        "conditions": {
            name + UNITS.get(name, ""): {
                "bound": item.bound,
                "at_end": float(item.values[-1]),
                "since_s": holds_since(run.time, item.holds),
            }
            for name, item in found.conditions.items()
        },
    }
