"""Outcome of a capture by the criterion of the case, and the cause of what was not reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import scipy

from exunet.base.arrays import Bools, Floats
from exunet.bodies.distance import reach_of
from exunet.net.areas import mouth_diameter
from exunet.results.capture import Measures, nodes_of_net, pieces
from exunet.results.clearance import shapes_of
from exunet.results.loads import broken_at
from exunet.results.observables import EDGE, LINE, NODES, THREADS, Observables, touched_bodies
from exunet.results.penetration import Touch, net_contact, threads_inside
from exunet.results.provenance import SceneProvenance, WinchLimits, done
from exunet.scene.capture import CaptureCriterion

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
AT_LEAST = {"enclosed", "touching"}  # the others are at most their bound
UNITS = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}  # of conditions, in keys
WRAPPED = 0.5  # part of the target in the net's hull from which on it is in the net, whatever the criterion
_MOVES = 0.05  # of its fastest rate: a drive, or a net, that is slower is at rest


class Outcome(StrEnum):
    """Outcome of a capture.

    undetermined : a guard stopped the run, or it ended too early: the target is in the net, or the conditions
                   hold, but not yet for the duration; or the net's centre nears the target, which the net
                   has touched, or would reach on a straight way
    captured     : the conditions hold until the end, for their duration
    closing      : the target is in the net, and what closes the mouth still moves at the end
    wrapped      : the target is in the net at the end, and a condition does not hold
    escaped      : it was enclosed, or all conditions held, and it is not in the net at the end
    touched      : the net has touched the target, and none of these
    missed       : it has not

    Conditions count while they hold from the first contact on, or from when half of the target is in the net.
    """

    UNDETERMINED = "undetermined"
    CAPTURED = "captured"
    CLOSING = "closing"
    WRAPPED = "wrapped"
    ESCAPED = "escaped"
    TOUCHED = "touched"
    MISSED = "missed"


class Condition(NamedTuple):
    """A condition of a criterion at the stored times: its bound, the values (t,) and where they keep it."""

    bound: float
    values: Floats
    holds: Bools


class Verdict(NamedTuple):
    """Outcome of a run.

    since    : time from which all conditions hold until the end [s]; None if they do not
    time     : of a target that was lost: the stored time at which it was in the net, or the net touched it,
               last; of one that is in the net, but not yet for the duration: from which on; of one that was
               missed: at which the net was nearest [s]; else None
    distance : least distance of the net's nodes from the target over the stored times [m]
    """

    outcome: Outcome
    since: float | None
    conditions: dict[str, Condition]
    time: float | None
    distance: float


class Motion(NamedTuple):
    """What a verdict depends on beside measures and contact.

    closes    : what closes the mouth moves at the end
    complete  : no guard has stopped the run
    braked    : a tether took the speed of the net before the target
    nears     : the net's centre nears that of the target at the end
    on_course : straight on, it passes the target within the net's reach
    """

    closes: bool = False
    complete: bool = True
    braked: bool = False
    nears: bool = False
    on_course: bool = False


def outcome(run: Observables) -> Verdict | None:
    """Judge a run by the criterion of its case; None without a criterion."""
    criterion, measures = run.criterion, run.capture
    if criterion is None or measures is None:
        return None
    touch, path = net_contact(run, criterion.target), _Path(run, criterion.target)
    braked = touch.first is None and _braked(run, path) is not None
    motion = Motion(_closes(run), run.result.complete, braked, path.nears, path.on_course)
    return judge(criterion, run.time, measures, touch, motion)


def judge(
    criterion: CaptureCriterion, time: Floats, measures: Measures, touch: Touch, motion: Motion
) -> Verdict:
    """Judge the measures of a capture by a criterion."""
    conditions: dict[str, Condition] = {}
    for name in CONDITIONS:
        if (bound := getattr(criterion, name)) is not None:
            values = touch.elements if name == "touching" else getattr(measures, name)
            holds = values >= bound if name in AT_LEAST else values <= bound
            conditions[name] = Condition(bound, values, holds)
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

    def verdict(state: Outcome, at: float | None = None) -> Verdict:
        return Verdict(state, since, conditions, at, float(measures.distance[nearest]))

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


def leaves_through(run: Observables, criterion: CaptureCriterion, time: float) -> str:
    """Return through what a target left the net after a stored time [s]: "mouth", "side" or "".

    It is the facet of the net's convex hull that the target's centre is nearest to, or furthest beyond, at
    the next stored time: the mouth if its corners are nodes of the rim, bullets or strings. "": a flat net.
    """
    row = min(int(np.searchsorted(run.time, time, side="right")), len(run.time) - 1)
    nodes, _ = nodes_of_net(run.result.net)
    try:
        hull = scipy.spatial.ConvexHull(run.result.position[row][nodes])
    except scipy.spatial.QhullError:
        return ""
    centre = np.asarray(run.result.bodies[criterion.target].position[row])
    facet = int((hull.equations[:, :3] @ centre + hull.equations[:, 3]).argmax())
    net = run.result.net
    rim = {*net.rim, *net.bullet_nodes.tolist(), *net.element_nodes[net.is_string].ravel().tolist()}
    return "mouth" if rim.issuperset(nodes[hull.simplices[facet]].tolist()) else "side"


# Part of the speed of approach that a tether takes, and part of the momentum lost that its pull must explain,
# for the tether to be the cause.
_BRAKED = 0.5
_ROUNDING = 1e-9  # of its largest speed: a slower approach is round-off
_SHOWN = 4  # broken threads that are named
_AT_LIMIT = 0.95  # part of its largest force from which on a winch is at it
_STRAINED = 0.5  # part of its largest force with which a winch pulls that a lock does not stop too early
_WOUND = 0.98  # part of the length that a winch can wind up, from which on it is at its end
_TAUT = 0.1  # part of its largest tension above which a tether counts as taut


class Cause(StrEnum):
    """Binding cause of a capture that did not succeed.

    stopped         : a guard stopped the run
    ended early     : the run ended before the target had been in the net, or the conditions had held, for
                      their duration
    not reached     : the net did not approach the target at first, or turned before it without a pull
    too slow        : the net would have reached the target after the end
    moving in       : the run ended while a net that touched the target neared it
    reel brakes     : a reel's pull took the speed of the net; tether taut: a tether without reel did
    stopped by body : the net met another body, and lost its speed
    flew through    : threads went through the target: their contact with it is not enabled
    missed sideways : the net passes the target farther away than half of the mouth without folds
    passed by       : it passed within that, beside its mouth as it was open then
    thread broke    : threads broke before
    rebounded       : the net touched the target, of which less than half was ever in the net
    slipped off     : the net lost a target that was in it
    winch too weak  : the winch pulled until the end, or its lock, and had more to wind up
    winch stopped   : it was paid out, locked before it pulled with half of its force, or a script stopped it
    still closing   : the run ended while it moved
    mouth open      : nothing closes the mouth, or what does is at its end
    condition       : another condition of the criterion does not hold
    """

    STOPPED = "stopped"
    ENDED_EARLY = "ended early"
    NOT_REACHED = "not reached"
    TOO_SLOW = "too slow"
    MOVING_IN = "moving in"
    REEL_BRAKES = "reel brakes"
    TETHER_TAUT = "tether taut"
    STOPPED_BY_BODY = "stopped by body"
    FLEW_THROUGH = "flew through"
    MISSED_SIDEWAYS = "missed sideways"
    PASSED_BY = "passed by"
    THREAD_BROKE = "thread broke"
    REBOUNDED = "rebounded"
    SLIPPED_OFF = "slipped off"
    WINCH_TOO_WEAK = "winch too weak"
    WINCH_STOPPED = "winch stopped"
    STILL_CLOSING = "still closing"
    MOUTH_OPEN = "mouth open"
    CONDITION = "condition"


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
        words = _WORDS[self.cause].format(**values, **interval, subject=self.subject)
        return f"{words}: {self.remark}" if self.remark else words


_WORDS = {
    Cause.STOPPED: "a guard stopped the run at {end} s: {subject}",
    Cause.ENDED_EARLY: "{subject} since {start} s: {held_s} of {duration_s} s",
    Cause.NOT_REACHED: "the net did not reach the target: {speed_m_s} m/s towards it at launch, "
    "nearest {distance_m} m at {end} s",
    Cause.TOO_SLOW: "at the end the net is {distance_m} m from the target, {arrival_s} s at {speed_m_s} m/s",
    Cause.REEL_BRAKES: "reel of '{subject}' pulled with up to {force_N} N from {start} s to {end} s: "
    "speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target",
    Cause.TETHER_TAUT: "tether '{subject}', {length_m} m long, pulled with up to {force_N} N from {start} s "
    "to {end} s: speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target",
    Cause.MOVING_IN: "the run ended while the net was moving in on '{subject}' at {speed_m_s} m/s: "
    "enclosed {enclosed} at most",
    Cause.STOPPED_BY_BODY: "'{subject}' stopped the net, which touched it from {start} s on: "
    "speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target",
    Cause.FLEW_THROUGH: "elements of the net or of tethers that went through '{subject}': {elements}, "
    "from {start} s on, first element {element}",
    Cause.MISSED_SIDEWAYS: "the net passes {offset_m} m beside the target's centre at {end} s: "
    "its mouth was {largest_m} m wide at most",
    Cause.PASSED_BY: "the net passed {offset_m} m beside the target's centre at {end} s, "
    "its mouth {mouth_m} m wide",
    Cause.THREAD_BROKE: "threads broke from {start} s to {end} s",
    Cause.REBOUNDED: "the net touched '{subject}' from {start} s on, last at {end} s: "
    "enclosed {enclosed} at most",
    Cause.SLIPPED_OFF: "'{subject}' left the net at {end} s: enclosed {enclosed} at most, "
    "mouth {mouth_m} m wide",
    Cause.WINCH_TOO_WEAK: "the winch pulled with up to {force_N} N from {start} s to {end} s, "
    "{wound_m} of {windable_m} m wound up",
    Cause.WINCH_STOPPED: "the winch pulled with up to {force_N} N from {start} s to {end} s, "
    "{wound_m} of {windable_m} m wound up",
    Cause.STILL_CLOSING: "the run ended while the mouth was closing, {mouth_m} m wide",
    Cause.MOUTH_OPEN: "the mouth stays {mouth_m} m wide",
    Cause.CONDITION: "{subject} is {value} at the end, its bound {bound}",
}


def reason(run: Observables) -> Reason | None:
    """Return the cause of a capture that did not succeed; None of one that did, and without a criterion."""
    found = outcome(run)
    if found is None or run.criterion is None or found.outcome is Outcome.CAPTURED:
        return None
    cause = _cause(run, run.criterion, found)
    words = _broken_words(run, cause.end if cause.cause is Cause.THREAD_BROKE else float(run.time[-1]))
    return replace(cause, remark="; ".join(filter(None, (cause.remark, words))))


def _cause(run: Observables, criterion: CaptureCriterion, found: Verdict) -> Reason:
    end, target = float(run.time[-1]), criterion.target
    if not run.result.complete:
        return Reason(Cause.STOPPED, end, end, run.result.verdict)
    if found.since is not None:
        return _early(criterion, found.since, end, "the conditions hold")
    path, touch = _Path(run, target), net_contact(run, target)
    if found.outcome is Outcome.UNDETERMINED:
        if found.time is not None:
            return _early(criterion, found.time, end, f"'{target}' is in the net")
        return _approaching(run, path, target, touch.first)
    if (through := _through(run, target)) is not None:
        return through
    if found.outcome in (Outcome.WRAPPED, Outcome.CLOSING):
        return _open(run, found) or _condition(run, found)
    lost = end if found.time is None else found.time
    if found.outcome is Outcome.MISSED:
        turned = float(run.time[path.turning])
        broke = _broken(run, target, turned) if _torn(run, turned) else None
        stop = broke or _braked(run, path) or _walled(run, path)
        return stop or _beside(run, path, touch) or _not_reached(run, path, found)
    if (broke := _broken(run, target, lost)) is not None:
        return broke
    if found.outcome is Outcome.ESCAPED or _largest_part(run, lost) >= WRAPPED:
        return _lost(run, Cause.SLIPPED_OFF, lost)
    if touch.holds[-1]:
        return _braked(run, path) or _condition(run, found)
    beside = _beside(run, path, touch) or _braked(run, path) or _walled(run, path)
    return beside or _lost(run, Cause.REBOUNDED, lost, touch.first)


def _early(criterion: CaptureCriterion, since: float, end: float, subject: str) -> Reason:
    numbers = {"held_s": end - since, "duration_s": criterion.duration}
    return Reason(Cause.ENDED_EARLY, since, end, subject, numbers)


class _Path:
    """Path of the net's centre of mass relative to that of a target, at the stored times (t,).

    along     : distance still to go in the direction of the first approach [m]
    offset    : distance beside the target in that direction [m]
    approach  : speed [m/s]
    at_first  : speed of approach in the first motion [m/s]
    at_end    : speed at which the distance of the centres falls at the end [m/s]
    nears     : that is more than a part of the largest relative speed
    beside    : distance at which the net, straight on from the end, passes the target's centre [m]
    on_course : that is less than the target's radius and half of the mouth, the largest of the run, or as
                wide as it becomes at its last rate, without strain
    """

    def __init__(self, run: Observables, target: str) -> None:
        body = run.result.bodies[target]
        centre, velocity = run.net_motion
        relative, rate = np.asarray(body.position[:]) - centre, np.asarray(body.velocity[:]) - velocity
        speeds, apart = (np.linalg.norm(values, axis=1) for values in (rate, relative))
        towards = -np.einsum("tk,tk->t", rate, relative) / np.where(apart > 0.0, apart, 1.0)
        start = int(np.argmax(speeds > _MOVES * speeds.max()))
        self.at_first = float(towards[start]) if abs(towards[start]) > _ROUNDING * speeds.max() else 0.0
        first = int(np.argmax(towards > 0.0))
        speed = float(speeds[first])
        direction = -rate[first] / speed if speed else relative[0] / (apart[0] or 1.0)
        self.along = relative @ direction
        self.offset = np.linalg.norm(relative - np.multiply.outer(self.along, direction), axis=1)
        self.approach = -(rate @ direction)
        self.at_end = float(towards[-1])
        moved = self.at_end * float(run.time[-1] - run.time[0])
        self.nears = self.at_end > _MOVES * speeds.max() and moved > _ROUNDING * apart[-1]
        along = float(towards[-1] * apart[-1] / (speeds[-1] or 1.0))
        self.beside = float(np.sqrt(max(0.0, apart[-1] ** 2 - along**2)))
        later = along / (float(speeds[-1]) or 1.0)
        self.on_course = self.nears and self.beside < 0.5 * _widest(run, later) + reach_of(
            shapes_of(run.result)[target]
        )

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


def _widest(run: Observables, later: float = 0.0) -> float:
    """Return the largest mouth of a run [m], or that to which it grows within a time after the end [s]."""
    assert run.capture is not None
    mouth, net = run.capture.mouth, run.result.net
    if not (widest := float(mouth.max())):
        return net.size
    if later > 0.0 and len(mouth) > 1 and mouth[-1] > mouth[-2]:
        grown = mouth[-1] + (mouth[-1] - mouth[-2]) / (run.time[-1] - run.time[-2]) * later
        widest = max(widest, min(float(grown), _unfolded(run)))
    return widest


def _unfolded(run: Observables) -> float:
    """Return the diameter of the mouth in the reference configuration [m]."""
    return float(mouth_diameter(run.result.net, run.result.net.reference_position[None])[0])


def _braked(run: Observables, path: _Path) -> Reason | None:
    """A tether whose pull took most of the net's speed before the net reached the target, or turned back."""
    if path.at_first <= 0.0:
        return None
    stop = path.turning
    measures, net = run.capture, run.result.net
    assert measures is not None
    mass = float(net.mass[: net.n_net_nodes].sum())
    for name, elements in net.tether_elements.items():
        tension = np.asarray(run.result.tension[:, list(elements)]).max(axis=1)[: stop + 1]
        taut = np.flatnonzero(tension > _TAUT * float(tension.max(initial=0.0)))
        if not len(taut):
            continue
        before = int(np.argmax(path.approach[: stop + 1]))
        slowest = before + int(np.argmin(path.approach[before : stop + 1]))
        first = max(before, int(taut[0]))
        fast, slow = float(path.approach[before]), float(path.approach[slowest])
        pulled = float(np.trapezoid(tension[before : slowest + 1], run.time[before : slowest + 1]))
        if slow > _BRAKED * fast or pulled < _BRAKED * mass * (fast - slow):
            continue
        numbers = {
            "force_N": float(tension[before : slowest + 1].max()),
            "speed_before_m_s": fast,
            "speed_after_m_s": slow,
            "distance_m": float(measures.distance[: slowest + 1].min()),
        }
        if name in run.reels:
            return Reason(Cause.REEL_BRAKES, float(run.time[first]), float(run.time[slowest]), name, numbers)
        numbers["length_m"] = float(net.reference_length[list(elements)].sum())
        return Reason(Cause.TETHER_TAUT, float(run.time[first]), float(run.time[slowest]), name, numbers)
    return None


def _walled(run: Observables, path: _Path) -> Reason | None:
    """Another body that the net touched before it lost most of its speed."""
    assert run.capture is not None
    assert run.criterion is not None
    stop, carried = path.turning, SceneProvenance.of(run.result.provenance).carried
    others = {run.criterion.target, *(() if carried is None else (carried.body,))}
    for name in run.touched_bodies:
        first = None if name in others else net_contact(run, name).first
        if first is None or first > run.time[stop]:
            continue
        before = max(0, int(np.searchsorted(run.time, first)) - 1)
        after = before + int(np.argmin(path.approach[before : stop + 1]))
        fast, slow = float(path.approach[before]), float(path.approach[after])
        if fast > 0.0 and slow <= _BRAKED * fast:
            nearest = float(run.capture.distance[: after + 1].min())
            numbers = {"speed_before_m_s": fast, "speed_after_m_s": slow, "distance_m": nearest}
            return Reason(Cause.STOPPED_BY_BODY, first, float(run.time[after]), name, numbers)
    return None


def _approaching(run: Observables, path: _Path, target: str, touched: float | None) -> Reason:
    """How a net nears its target at the end of the run."""
    assert run.capture is not None
    begin, end = float(run.time[0]), float(run.time[-1])
    if touched is not None:
        numbers = {"speed_m_s": path.at_end, "enclosed": float(run.capture.enclosed.max())}
        return Reason(Cause.MOVING_IN, touched, end, target, numbers)
    distance = float(run.capture.distance[-1])
    numbers = {"speed_m_s": path.at_end, "distance_m": distance, "arrival_s": distance / path.at_end}
    return Reason(Cause.TOO_SLOW, begin, end, numbers=numbers)


def _through(run: Observables, target: str) -> Reason | None:
    """Threads that went through a target that threads, and nodes, do not touch."""
    others = {*run.result.bodies, *touched_bodies(run.result, (THREADS, NODES))}
    if target not in touched_bodies(run.result, (THREADS, NODES)):
        others.discard(target)
    for item in threads_inside(run.result, but=tuple(others)):
        numbers = {"elements": float(item.elements), "element": float(item.element)}
        remark = "contact of threads with it is not enabled"
        return Reason(Cause.FLEW_THROUGH, item.time, float(run.time[-1]), target, numbers, remark)
    return None


def _beside(run: Observables, path: _Path, touch: Touch) -> Reason | None:
    """A net whose centre passed the target outside its mouth, or would after the end."""
    assert run.capture is not None
    row, widest, remark = path.passing, _widest(run), ""
    if row is None and not (path.nears and not path.on_course):
        return None
    if row is None:
        row, offset, remark = len(run.time) - 1, path.beside, "on its straight way after the end"
    else:
        offset = float(path.offset[row])
    time, mouth = float(run.time[row]), float(run.capture.mouth[row])
    numbers = {"offset_m": offset, "mouth_m": mouth, "largest_m": widest}
    if remark or offset > 0.5 * max(widest, _unfolded(run)):
        return Reason(Cause.MISSED_SIDEWAYS, time, time, numbers=numbers, remark=remark)
    if offset > 0.5 * mouth:
        return Reason(Cause.PASSED_BY, time, time, numbers=numbers)
    if touch.first is None:
        remark = "through a mesh, or past an edge"
        return Reason(Cause.PASSED_BY, time, time, numbers=numbers, remark=remark)
    return None


def _not_reached(run: Observables, path: _Path, found: Verdict) -> Reason:
    assert run.capture is not None
    numbers = {"speed_m_s": path.at_first, "distance_m": found.distance}
    nearest = float(run.time[run.capture.distance.argmin()])
    return Reason(Cause.NOT_REACHED, float(run.time[0]), nearest, numbers=numbers)


def _broken(run: Observables, target: str, until: float) -> Reason | None:
    """Threads that broke before a target was lost."""
    times = [float(item["time_s"]) for item in run.result.provenance.get("broken") or ()]
    times = [time for time in times if time <= until]
    if not times:
        return None
    numbers = {"broken": float(len(times))}
    return Reason(Cause.THREAD_BROKE, min(times), max(times), target, numbers)


def _torn(run: Observables, until: float) -> list[float]:
    """Return the part of the thread in each piece of a net, largest first; [] of a whole net."""
    net = run.result.net
    cut = [element for element, time in broken_at(run.result).items() if time <= until]
    if not (cut := [element for element in cut if element < net.n_net_elements]):
        return []
    left = np.setdiff1d(np.arange(net.n_net_elements), cut)
    starts = net.element_nodes[left, 0]
    length = [float(net.reference_length[left[np.isin(starts, own)]].sum()) for own in pieces(net, cut)]
    return [part / (sum(length) or 1.0) for part in length] if len(length) > 1 else []


def _broken_words(run: Observables, until: float) -> str:
    """Name the threads that broke, and the piece that is judged; "" if none broke."""
    net, events = run.result.net, run.result.provenance.get("broken") or ()
    broken = [int(item["element"]) for item in events if item["time_s"] <= until]
    if not broken:
        return ""
    shown = [
        f"{element} ({' to '.join(map(net.node_words, net.element_nodes[element].tolist()))})"
        for element in broken[:_SHOWN]
    ]
    more = f" and {len(broken) - _SHOWN} more" if len(broken) > _SHOWN else ""
    words = f"broken elements: {', '.join(shown)}{more}"
    if parts := _torn(run, until):
        words += f"; the net is in {len(parts)} pieces, judged by the largest, {parts[0]:.0%} of its threads"
    return words


def _largest_part(run: Observables, until: float) -> float:
    """Return the largest part of the target that was in the net until a time [s]."""
    assert run.capture is not None
    return float(run.capture.enclosed[run.time <= until].max(initial=0.0))


def _lost(run: Observables, cause: Cause, time: float, since: float | None = None) -> Reason:
    """A target that was in the net, or that the net touched, until a time [s]."""
    measures, criterion = run.capture, run.criterion
    assert measures is not None
    assert criterion is not None
    row = int(np.searchsorted(run.time, time * (1.0 + 1e-12), side="right")) - 1
    most = int(measures.enclosed[: row + 1].argmax())
    numbers = {"enclosed": float(measures.enclosed[most]), "mouth_m": float(measures.mouth[row])}
    start, winch = float(run.time[most]) if since is None else since, _winch(run)
    stops = "" if winch is None else _stops(_commands(run, winch, time))
    remark = stops if "paid out" in stops and cause is Cause.SLIPPED_OFF else ""
    return Reason(cause, start, time, criterion.target, numbers, remark)


def _winch(run: Observables) -> WinchLimits | None:
    known = f"{LINE}wound_up" in run.result.states
    return SceneProvenance.of(run.result.provenance).winch if known else None


class _Command(NamedTuple):
    """Command of a winch that came in force: when [s], its action, and the script's entry, if any."""

    time: float
    does: str
    entry: str


def _commands(run: Observables, winch: WinchLimits, until: float) -> list[_Command]:
    """Return the commands of a winch until a time [s]; of one that a host commands, that it pulls."""
    if not winch.commands:
        return [_Command(float(run.time[0]), "pull", "")]
    own = [_Command(item.at_s, item.does, "") for item in winch.commands if item.at_s is not None]
    does = {item.entry: item.does for item in winch.commands if item.entry}
    events = [event for event in done(run.result.provenance) if event["entry"] in does]
    own += [_Command(event["time_s"], does[event["entry"]], event["entry"]) for event in events]
    return [item for item in own if item.time <= until]


def _stops(commands: list[_Command]) -> str:
    """Describe how a winch was locked or paid out after it had pulled last."""
    pulls = [k for k, item in enumerate(commands) if item.does == "pull"]
    verbs = {"lock": "locked", "pay out": "paid out"}
    return ", ".join(
        f"the winch was {verbs[item.does]} at {item.time:.3g} s" + f" by '{item.entry}'" * bool(item.entry)
        for item in (commands[pulls[-1] + 1 :] if pulls else ())
    )


def _open(run: Observables, found: Verdict) -> Reason | None:
    """What keeps the mouth of a net that encloses its target open; None: no condition on the mouth fails."""
    mouth, end = found.conditions.get("mouth"), float(run.time[-1])
    assert run.capture is not None
    if mouth is not None and mouth.holds[-1]:
        return None
    if mouth is None and found.conditions.keys() - {"enclosed", "mcqi", "cqi"}:
        others = (item for name, item in found.conditions.items() if name not in ("enclosed", "mcqi", "cqi"))
        if not all(item.holds[-1] for item in others):
            return None
    width = {"mouth_m": float(run.capture.mouth[-1])}
    if found.outcome is Outcome.CLOSING:
        return Reason(Cause.STILL_CLOSING, end, end, numbers=width)
    if (winch := _winch(run)) is None:
        words = "" if EDGE in run.result.states else "nothing closes it"
        return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark=words)
    wound, commands = run.state(f"{LINE}wound_up")[:, 0], _commands(run, winch, end)
    rates, pulls = np.diff(wound) / np.diff(run.time), np.zeros(len(wound), dtype=bool)
    for item, until in zip(commands, [*(item.time for item in commands[1:]), end], strict=True):
        pulls |= (item.does == "pull") & (run.time >= item.time) & (run.time <= until)
    if not pulls.any() or rates.max() <= 0.0:
        return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark="the winch did not pull")
    first, last = np.flatnonzero(pulls)[[0, -1]]
    times, stops = (float(run.time[first]), float(run.time[last])), _stops(commands)
    released = "paid out" in stops
    if wound[last] >= _WOUND * winch.windable_m and not released:
        remark = "the winch has wound up all of its line"
        return Reason(Cause.MOUTH_OPEN, *times, numbers=width, remark=remark)
    pull = max(float(run.state(f"{LINE}{name}")[pulls, 0].max()) for name in ("tension_start", "tension_end"))
    numbers = {"force_N": pull, "wound_m": float(wound[last]), "windable_m": winch.windable_m} | width
    own_lock = not released and not any(item.entry for item in commands)
    weak = not stops or (own_lock and pull >= _STRAINED * (winch.force_N or np.inf))
    if winch.force_N is not None:
        numbers["limit_N"] = winch.force_N
        reached = pull >= _AT_LIMIT * winch.force_N
        limit = f"{'at' if reached else 'below'} its limit of {winch.force_N:.3g} N"
        stops = f"{limit}, {stops}" if stops else limit
    cause = Cause.WINCH_TOO_WEAK if weak else Cause.WINCH_STOPPED
    return Reason(cause, *times, numbers=numbers, remark=stops)


def _condition(run: Observables, found: Verdict) -> Reason:
    """The condition that is farthest from its bound, as a part of it."""

    def excess(name: str) -> float:
        item = found.conditions[name]
        ratio = float(item.values[-1]) / item.bound
        return 1.0 - ratio if name in AT_LEAST else ratio - 1.0

    name = max((key for key, item in found.conditions.items() if not item.holds[-1]), key=excess)
    item = found.conditions[name]
    numbers = {"value": float(item.values[-1]), "bound": item.bound}
    closes = any(state.startswith(LINE) for state in run.result.states)
    end, remark = float(run.time[-1]), "" if closes else "nothing closes the mouth"
    return Reason(Cause.CONDITION, end, end, name, numbers, remark)


def summary_of_capture(run: Observables) -> dict[str, Any] | None:
    """Return outcome, cause and conditions of a capture, for summary.json; None without a criterion."""
    found, criterion, why = outcome(run), run.criterion, reason(run)
    if found is None or criterion is None:
        return None
    escaped = found.outcome is Outcome.ESCAPED and found.time is not None
    return {
        "outcome": found.outcome.value,
        "since_s": found.since,
        "time_s": found.time,
        "least_distance_m": found.distance,
        "left_through": leaves_through(run, criterion, found.time or 0.0) or None if escaped else None,
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
