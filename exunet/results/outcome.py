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


class Verdict(NamedTuple):
    """Outcome of a run.

    since      : from when on the conditions hold until the end [s], None: they do not
    conditions : (t,) True where each condition holds
    """

    outcome: Outcome
    since: float | None
    conditions: dict[str, Bools]


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
    holding: dict[str, Bools] = {}
    if criterion.enclosed is not None:
        holding["enclosed"] = measures.enclosed >= criterion.enclosed
    for name in ("relative_speed", "relative_spin", "cqi", "mcqi", "mouth"):
        if (bound := getattr(criterion, name)) is not None:
            holding[name] = getattr(measures, name) <= bound
    if criterion.touching is not None:
        holding["touching"] = touching >= criterion.touching
    every = np.logical_and.reduce([*holding.values()])
    begins = np.flatnonzero(every & ~np.append(False, every[:-1]))
    ends = np.flatnonzero(every & ~np.append(every[1:], False))
    lasts = time[ends] - time[begins]
    since = float(time[begins[-1]]) if every[-1] else None
    enough = criterion.duration * (1.0 - 1e-12)
    if since is not None and lasts[-1] >= enough:
        return Verdict(Outcome.CAPTURED, since, holding)
    enclosed = holding.get("enclosed", np.zeros(len(time), dtype=bool))
    if (lasts >= enough).any() or (enclosed.any() and not enclosed[-1]):
        return Verdict(Outcome.ESCAPED, since, holding)
    return Verdict(Outcome.TOUCHED if touched else Outcome.MISSED, since, holding)


def summary_of_capture(run: Observables) -> dict[str, Any] | None:
    """Return the outcome with the criterion, for summary.json; None without a criterion."""
    found = outcome(run)
    if found is None or run.criterion is None:
        return None
    bounds = {name: getattr(run.criterion, name) for name in found.conditions}
    return {
        "outcome": found.outcome.value,
        "since_s": found.since,
        "duration_s": run.criterion.duration,
        "target": run.criterion.target,
        "conditions": {name + UNITS.get(name, ""): bound for name, bound in bounds.items()},
        "hold_at_end": {
            name + UNITS.get(name, ""): bool(values[-1]) for name, values in found.conditions.items()
        },
    }
