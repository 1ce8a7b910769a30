"""Outcome of a capture by the criterion of the case: captured, touched, missed or escaped."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.results.capture import Measures
from exunet.results.observables import Observables
from exunet.scene.capture import CaptureCriterion

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
AT_LEAST = {"enclosed", "touching"}  # the others are at most their bound
UNITS = {"relative_speed": "_m_s", "relative_spin": "_rad_s", "mouth": "_m"}  # of conditions, in keys


class Outcome(StrEnum):
    """Outcome of a capture.

    captured : the conditions hold until the end, for as long as they must
    escaped  : they did once, or the target was enclosed as required, and not at the end
    touched  : the net has touched the target, and neither of these
    missed   : it has not
    """

    CAPTURED = "captured"
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

    since : time from which all conditions hold until the end [s]; None if they do not
    """

    outcome: Outcome
    since: float | None
    conditions: dict[str, Condition]


def outcome(run: Observables) -> Verdict | None:
    """Judge a run by the criterion of its case; None without a criterion."""
    criterion, measures = run.criterion, run.capture
    if criterion is None or measures is None:
        return None
    touching = run.contacts(criterion.target, "touching")[:1] or [np.zeros(len(run.time))]
    touched = run.first_contact(criterion.target) is not None
    return judge(criterion, run.time, measures, touching[0], touched=touched)


def judge(
    criterion: CaptureCriterion, time: Floats, measures: Measures, touching: Floats, *, touched: bool
) -> Verdict:
    """Judge the measures of a capture by a criterion.

    touching : (t,) number of elements in contact with the target
    touched  : the net has touched the target
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
    enough = criterion.duration * (1.0 - 1e-12)
    if since is not None and lasts[-1] >= enough:
        return Verdict(Outcome.CAPTURED, since, conditions)
    enclosed = conditions["enclosed"].holds if "enclosed" in conditions else np.zeros(len(time), dtype=bool)
    if (lasts >= enough).any() or (enclosed.any() and not enclosed[-1]):
        return Verdict(Outcome.ESCAPED, since, conditions)
    return Verdict(Outcome.TOUCHED if touched else Outcome.MISSED, since, conditions)


def holds_since(time: Floats, holds: Bools) -> float | None:
    """Return the stored time from which a condition (t,) holds until the end [s]; None if it does not."""
    if not holds[-1]:
        return None
    fails = np.flatnonzero(~holds)
    return float(time[fails[-1] + 1 if len(fails) else 0])


def summary_of_capture(run: Observables) -> dict[str, Any] | None:
    """Return the outcome with the criterion, for summary.json; None without a criterion."""
    found = outcome(run)
    if found is None or run.criterion is None:
        return None
    return {
        "outcome": found.outcome.value,
        "since_s": found.since,
        "duration_s": run.criterion.duration,
        "target": run.criterion.target,
        "conditions": {
            name + UNITS.get(name, ""): {
                "bound": item.bound,
                "at_end": float(item.values[-1]),
                "since_s": holds_since(run.time, item.holds),
            }
            for name, item in found.conditions.items()
        },
    }
