"""Outcome of a capture by the criterion of the case."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.results.capture import Measures, nodes_of_net
from exunet.results.observables import EDGE, LINE, Observables
from exunet.scene.capture import CaptureCriterion

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
AT_LEAST = {"enclosed", "touching"}  # the others are at most their bound
UNITS = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}  # of conditions, in keys
WRAPPED = 0.5  # part of the target in the net's hull that counts as enclosed without a condition on it
_MOVES = 0.05  # of its fastest rate: a drive that winds slower at the end has come to rest


class Outcome(StrEnum):
    """Outcome of a capture.

    undetermined : a guard stopped the run, or it ended before the criterion could hold: the conditions hold,
                   but not yet for the duration, or the net would reach the target within as long again
    captured     : the conditions hold until the end, for their duration
    closing      : the target is enclosed, and what closes the mouth still moves at the end
    wrapped      : the target is enclosed at the end, and another condition does not hold
    escaped      : it was enclosed, or all conditions held for their duration, and not at the end
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
    time     : of a target that escaped: the stored time at which it was enclosed last; of one that was
               missed: at which the net was nearest [s]; else None
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
    """

    touched: bool
    closes: bool = False
    complete: bool = True


def outcome(run: Observables) -> Verdict | None:
    """Judge a run by the criterion of its case; None without a criterion."""
    criterion, measures = run.criterion, run.capture
    if criterion is None or measures is None:
        return None
    touching = run.contacts(criterion.target, "touching")[:1] or [np.zeros(len(run.time))]
    motion = Motion(run.first_contact(criterion.target) is not None, _closes(run), run.result.complete)
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
    enclosed = conditions["enclosed"].holds if "enclosed" in conditions else measures.enclosed >= WRAPPED
    nearest = int(measures.distance.argmin())

    def verdict(state: Outcome, at: float | None = None) -> Verdict:
        return Verdict(state, since, conditions, at, float(measures.distance[nearest]))

    if not motion.complete:
        return verdict(Outcome.UNDETERMINED)
    if since is not None:
        return verdict(Outcome.CAPTURED if enough[-1] else Outcome.UNDETERMINED)
    if enclosed[-1]:
        return verdict(Outcome.CLOSING if motion.closes else Outcome.WRAPPED)
    held = enclosed if "enclosed" in conditions else every
    if enough.any() or held.any():
        return verdict(Outcome.ESCAPED, float(time[np.flatnonzero(every | held)[-1]]))
    if motion.touched:
        return verdict(Outcome.TOUCHED)
    if arrival(time, measures.distance) <= time[-1] - time[0]:
        return verdict(Outcome.UNDETERMINED)
    return verdict(Outcome.MISSED, float(time[nearest]))


def arrival(time: Floats, distance: Floats) -> float:
    """Return the time [s] from the end until a distance (t,) [m] is 0 at its last mean rate.

    The mean is over the last tenth of the time: the distance of the nearest node is not smooth. Infinite if
    the distance does not fall, or has been smaller before.
    """
    row = max(0, int(np.searchsorted(time, time[-1] - 0.1 * (time[-1] - time[0]), side="right")) - 1)
    row = min(row, len(time) - 2) if len(time) > 1 else row
    falls = float(distance[row] - distance[-1])
    if falls <= 0.0 or float(distance[-1] - distance.min()) > falls:
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
