"""Outcome of a capture by the criterion of the case, and the cause of what was not reached."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
import scipy

from exunet.base.arrays import Bools, Floats
from exunet.results.capture import Measures, nodes_of_net
from exunet.results.observables import EDGE, LINE, Observables
from exunet.results.provenance import SceneProvenance
from exunet.scene.capture import CaptureCriterion

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
AT_LEAST = {"enclosed", "touching"}  # the others are at most their bound
UNITS = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}  # of conditions, in keys
WRAPPED = 0.5  # part of the target in the net's hull from which on it is in the net, whatever the criterion
_MOVES = 0.05  # of its fastest rate: a drive, or a net, that is slower is at rest


class Outcome(StrEnum):
    """Outcome of a capture.

    undetermined : a guard stopped the run, or it ended before the criterion could hold: the target is in the
                   net, or the conditions hold, but not yet for the duration, or the net would reach the
                   target within as long again
    captured     : the conditions hold until the end, for their duration
    closing      : the target is in the net, and what closes the mouth still moves at the end
    wrapped      : the target is in the net at the end, and a condition does not hold
    escaped      : it was enclosed, or all conditions held, and it is not in the net at the end
    touched      : the net has touched the target, and none of these
    missed       : it has not
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
    time     : of a target that escaped: the stored time at which it was in the net last; of one that is in
               the net, but not yet for the duration: first; of one that was missed: at which the net was
               nearest [s]; else None
    distance : least distance of the net's nodes from the target over the stored times [m]
    """

    outcome: Outcome
    since: float | None
    conditions: dict[str, Condition]
    time: float | None
    distance: float


class Motion(NamedTuple):
    """What a verdict depends on beside the measures.

    touched  : the net has touched the target
    closes   : what closes the mouth moves at the end
    complete : no guard has stopped the run
    braked   : a tether took the speed of the net before the target
    """

    touched: bool
    closes: bool = False
    complete: bool = True
    braked: bool = False


def outcome(run: Observables) -> Verdict | None:
    """Judge a run by the criterion of its case; None without a criterion."""
    criterion, measures = run.criterion, run.capture
    if criterion is None or measures is None:
        return None
    touching = run.contacts(criterion.target, "touching")[:1] or [np.zeros(len(run.time))]
    touched = run.first_contact(criterion.target) is not None
    braked = not touched and _braked(run, _Path(run, criterion.target)) is not None
    motion = Motion(touched, _closes(run), run.result.complete, braked)
    return judge(criterion, run.time, measures, touching[0], motion)


def judge(
    criterion: CaptureCriterion, time: Floats, measures: Measures, touching: Floats, motion: Motion
) -> Verdict:
    """Judge the measures of a capture by a criterion.

    touching : (t,) number of elements in contact with the target
    """
    conditions: dict[str, Condition] = {}
    for name in CONDITIONS:
        if (bound := getattr(criterion, name)) is not None:
            values = touching if name == "touching" else getattr(measures, name)
            holds = values >= bound if name in AT_LEAST else values <= bound
            conditions[name] = Condition(bound, values, holds)
    every = np.logical_and.reduce([item.holds for item in conditions.values()])
    since = holds_since(time, every)
    begins = np.flatnonzero(every & ~np.append(False, every[:-1]))
    ends = np.flatnonzero(every & ~np.append(every[1:], False))
    lasts = time[ends] - time[begins]
    enough = lasts >= criterion.duration * (1.0 - 1e-12)
    inside = measures.enclosed >= WRAPPED
    if "enclosed" in conditions:
        inside |= conditions["enclosed"].holds
    nearest = int(measures.distance.argmin())

    def verdict(state: Outcome, at: float | None = None) -> Verdict:
        return Verdict(state, since, conditions, at, float(measures.distance[nearest]))

    if not motion.complete:
        return verdict(Outcome.UNDETERMINED)
    if since is not None:
        return verdict(Outcome.CAPTURED if enough[-1] else Outcome.UNDETERMINED)
    if inside[-1]:
        first = float(time[inside.argmax()])
        if time[-1] - first < criterion.duration * (1.0 - 1e-12):
            return verdict(Outcome.UNDETERMINED, first)
        return verdict(Outcome.CLOSING if motion.closes else Outcome.WRAPPED)
    held = conditions["enclosed"].holds if "enclosed" in conditions else every
    if held.any():
        return verdict(Outcome.ESCAPED, float(time[np.flatnonzero(held | inside)[-1]]))
    if motion.touched:
        return verdict(Outcome.TOUCHED)
    if not motion.braked and arrival(time, measures.distance) <= time[-1] - time[0]:
        return verdict(Outcome.UNDETERMINED)
    return verdict(Outcome.MISSED, float(time[nearest]))


def arrival(time: Floats, distance: Floats) -> float:
    """Return the time [s] from the end until a distance (t,) [m] is 0 at its last mean rate.

    The mean is over the last tenth of the time: the distance of the nearest node is not smooth. Infinite if
    the distance does not fall, or has grown before by more than it falls: the net has turned.
    """
    row = max(0, int(np.searchsorted(time, time[-1] - 0.1 * (time[-1] - time[0]), side="right")) - 1)
    row = min(row, len(time) - 2) if len(time) > 1 else row
    falls = float(distance[row] - distance[-1])
    if falls <= 0.0 or float((distance - np.minimum.accumulate(distance)).max()) > falls:
        return float("inf")
    return float(distance[-1]) * float(time[-1] - time[row]) / falls


def _closes(run: Observables) -> bool:
    """Whether a winch winds up, or an edge becomes shorter, in the last interval of stored times."""
    name = next((name for name in (f"{LINE}wound_up", EDGE) if name in run.result.states), None)
    if name is None or len(run.time) < 2:
        return False
    rates = np.abs(np.diff(run.state(name)[:, 0])) / np.diff(run.time)
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
_AT_LIMIT = 0.95  # part of its largest force from which on a winch is at it: it only creeps then
_WOUND = 0.98  # part of the length that a winch can wind up, from which on it is at its end
_TAUT = 0.1  # part of its largest tension above which a tether counts as taut


class Cause(StrEnum):
    """Binding cause of a capture that did not succeed.

    stopped         : a guard stopped the run
    ended early     : the run ended before the target had been in the net, or the conditions had held, for
                      their duration
    not reached     : the net did not approach the target at first, or turned before it without a pull
    too slow        : the net would have reached the target after the end
    reel brakes     : a reel's pull took the speed of the net; tether taut: a tether without reel did
    missed sideways : the net passed the target farther away than its mouth can be wide
    passed by       : it passed within that, beside its mouth as it was open then
    thread broke    : threads broke before
    slipped off     : the net lost a target that it had enclosed, or touched within its mouth
    winch too weak  : what closes the mouth pulled until its lock or the end, and had more to wind up
    still closing   : the run ended while it moved
    mouth open      : nothing closes the mouth, or what does is at its end
    condition       : another condition of the criterion does not hold
    """

    STOPPED = "stopped"
    ENDED_EARLY = "ended early"
    NOT_REACHED = "not reached"
    TOO_SLOW = "too slow"
    REEL_BRAKES = "reel brakes"
    TETHER_TAUT = "tether taut"
    MISSED_SIDEWAYS = "missed sideways"
    PASSED_BY = "passed by"
    THREAD_BROKE = "thread broke"
    SLIPPED_OFF = "slipped off"
    WINCH_TOO_WEAK = "winch too weak"
    STILL_CLOSING = "still closing"
    MOUTH_OPEN = "mouth open"
    CONDITION = "condition"


@dataclass(frozen=True)
class Reason:
    """A cause with its numbers.

    subject    : tether, body, condition or verdict of a guard that it is about
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
        words = _WORDS[self.cause].format(**values, **interval, subject=self.subject.replace("_", " "))
        return f"{words}: {self.remark}" if self.remark else words


_WORDS = {
    Cause.STOPPED: "a guard stopped the run at {end} s",
    Cause.ENDED_EARLY: "{subject} since {start} s: {held_s} of {duration_s} s",
    Cause.NOT_REACHED: "the net did not reach the target: {speed_m_s} m/s towards it at launch, "
    "nearest {distance_m} m at {end} s",
    Cause.TOO_SLOW: "at the end the net is {distance_m} m from the target, {arrival_s} s at {speed_m_s} m/s",
    Cause.REEL_BRAKES: "reel of '{subject}' pulled with up to {force_N} N from {start} s to {end} s: "
    "speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target",
    Cause.TETHER_TAUT: "tether '{subject}', {length_m} m long, pulled with up to {force_N} N from {start} s "
    "to {end} s: speed {speed_before_m_s} -> {speed_after_m_s} m/s, {distance_m} m before the target",
    Cause.MISSED_SIDEWAYS: "the net passed {offset_m} m beside the target's centre at {end} s: "
    "its mouth is {achievable_m} m wide at most",
    Cause.PASSED_BY: "the net passed {offset_m} m beside the target's centre at {end} s, "
    "its mouth {mouth_m} m wide",
    Cause.THREAD_BROKE: "broken elements: {broken}, from {start} s to {end} s, first element {element}",
    Cause.SLIPPED_OFF: "'{subject}' left the net at {end} s: enclosed {enclosed} at most, "
    "mouth {mouth_m} m wide",
    Cause.WINCH_TOO_WEAK: "the winch pulled with up to {force_N} N from {start} s to {end} s, "
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
    end = float(run.time[-1])
    if not run.result.complete:
        return Reason(Cause.STOPPED, end, end, run.result.verdict)
    if found.since is not None:
        return _early(run.criterion, found.since, end, "the conditions hold")
    if found.outcome is Outcome.UNDETERMINED and found.time is not None:
        return _early(run.criterion, found.time, end, f"'{run.criterion.target}' is in the net")
    path = _Path(run, run.criterion.target)
    if found.outcome in (Outcome.UNDETERMINED, Outcome.MISSED):
        return (
            _braked(run, path) or _too_slow(run, path) or _beside(run, path) or _not_reached(run, path, found)
        )
    if found.outcome in (Outcome.WRAPPED, Outcome.CLOSING):
        return _open(run, found) or _condition(run, found)
    if (broke := _broken(run, end if found.time is None else found.time)) is not None:
        return broke
    if found.outcome is Outcome.ESCAPED:
        return _slipped(run, found.time or end)
    touch = run.first_contact(run.criterion.target)
    touched = end if touch is None else touch
    beside = _beside(run, path)
    if run.contacts(run.criterion.target, "touching") and _touches(run):
        return _braked(run, path) or _condition(run, found)
    return beside or _braked(run, path) or _slipped(run, touched)


def _early(criterion: CaptureCriterion, since: float, end: float, subject: str) -> Reason:
    numbers = {"held_s": end - since, "duration_s": criterion.duration}
    return Reason(Cause.ENDED_EARLY, since, end, subject, numbers)


class _Path:
    """Path of the net's centre of mass relative to that of a target, at the stored times (t,).

    along    : distance still to go in the direction of the first approach [m]
    offset   : distance beside the target in that direction [m]
    approach : speed [m/s]
    at_first : speed of approach in the first motion [m/s]
    """

    def __init__(self, run: Observables, target: str) -> None:
        body = run.result.bodies[target]
        relative = np.asarray(body.position[:]) - run.centre
        rate = np.gradient(relative, run.time, axis=0) if len(run.time) > 1 else np.zeros_like(relative)
        approach = -np.einsum("tk,tk->t", rate, relative)
        speeds = np.linalg.norm(rate, axis=1)
        start = int(np.argmax(speeds > _MOVES * speeds.max()))
        towards = float(approach[start] / (np.linalg.norm(relative[start]) or 1.0))
        self.at_first = towards if abs(towards) > _ROUNDING * speeds.max() else 0.0
        first = int(np.argmax(approach > 0.0))
        speed = float(speeds[first])
        direction = -rate[first] / speed if speed else relative[0] / (np.linalg.norm(relative[0]) or 1.0)
        self.along = relative @ direction
        self.offset = np.linalg.norm(relative - np.multiply.outer(self.along, direction), axis=1)
        self.approach = -(rate @ direction)

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


def _too_slow(run: Observables, path: _Path) -> Reason | None:
    assert run.capture is not None
    later, distance = arrival(run.time, run.capture.distance), float(run.capture.distance[-1])
    if math.isinf(later) or path.passing is not None:
        return None
    numbers = {"speed_m_s": distance / later, "distance_m": distance, "arrival_s": later}
    return Reason(Cause.TOO_SLOW, float(run.time[0]), float(run.time[-1]), numbers=numbers)


def _beside(run: Observables, path: _Path) -> Reason | None:
    """A net whose centre passed the target outside its mouth."""
    row = path.passing
    if row is None:
        return None
    assert run.capture is not None
    offset, mouth = float(path.offset[row]), float(run.capture.mouth[row])
    achievable = math.sqrt(4.0 * run.achievable_area / math.pi) or run.result.net.size
    time = float(run.time[row])
    numbers = {"offset_m": offset, "mouth_m": mouth, "achievable_m": achievable}
    if offset > 0.5 * achievable:
        return Reason(Cause.MISSED_SIDEWAYS, time, time, numbers=numbers)
    touched = run.criterion is not None and run.first_contact(run.criterion.target) is not None
    if offset > 0.5 * mouth:
        return Reason(Cause.PASSED_BY, time, time, numbers=numbers)
    if not touched:
        remark = "through a mesh, or past an edge"
        return Reason(Cause.PASSED_BY, time, time, numbers=numbers, remark=remark)
    return None


def _not_reached(run: Observables, path: _Path, found: Verdict) -> Reason:
    assert run.capture is not None
    numbers = {"speed_m_s": path.at_first, "distance_m": found.distance}
    nearest = float(run.time[run.capture.distance.argmin()])
    return Reason(Cause.NOT_REACHED, float(run.time[0]), nearest, numbers=numbers)


def _broken(run: Observables, until: float) -> Reason | None:
    broken = [item for item in run.result.provenance.get("broken") or () if item["time_s"] <= until]
    if not broken:
        return None
    times = [float(item["time_s"]) for item in broken]
    numbers = {"broken": float(len(broken)), "element": float(broken[times.index(min(times))]["element"])}
    return Reason(Cause.THREAD_BROKE, min(times), max(times), numbers=numbers)


def _slipped(run: Observables, time: float) -> Reason:
    measures, criterion = run.capture, run.criterion
    assert measures is not None
    assert criterion is not None
    row = int(np.searchsorted(run.time, time * (1.0 + 1e-12), side="right")) - 1
    most = int(measures.enclosed.argmax())
    numbers = {"enclosed": float(measures.enclosed[most]), "mouth_m": float(measures.mouth[row])}
    return Reason(Cause.SLIPPED_OFF, float(run.time[most]), time, criterion.target, numbers)


def _touches(run: Observables) -> bool:
    assert run.criterion is not None
    return any(values[-1] > 0.0 for values in run.contacts(run.criterion.target, "touching"))


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
    winch = SceneProvenance.of(run.result.provenance).winch
    if winch is None or f"{LINE}wound_up" not in run.result.states:
        words = "" if EDGE in run.result.states else "nothing closes it"
        return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark=words)
    wound = run.state(f"{LINE}wound_up")[:, 0]
    moves = np.flatnonzero(np.abs(np.diff(wound)) > 0.0)
    if not len(moves):
        return Reason(Cause.MOUTH_OPEN, end, end, numbers=width, remark="the winch did not move")
    first, last = (float(run.time[row]) for row in (moves[0], moves[-1] + 1))
    if wound[-1] >= _WOUND * winch.windable_m:
        remark = "the winch has wound up all of its line"
        return Reason(Cause.MOUTH_OPEN, first, last, numbers=width, remark=remark)
    pull = max(float(run.state(f"{LINE}{name}")[:, 0].max()) for name in ("tension_start", "tension_end"))
    numbers = {"force_N": pull, "wound_m": float(wound[-1]), "windable_m": winch.windable_m} | width
    remark = ""
    if winch.force_N is not None:
        numbers["limit_N"] = winch.force_N
        reached = pull >= _AT_LIMIT * winch.force_N
        remark = f"{'at' if reached else 'below'} its limit of {winch.force_N:.3g} N"
    return Reason(Cause.WINCH_TOO_WEAK, first, last, numbers=numbers, remark=remark)


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
