"""What became of a capture, by the rule of the case: captured, touched, missed or escaped."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from exunet.results.capture import Measures
from exunet.scene.capture import CaptureCriterion

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Outcome(StrEnum):
    """captured : the conditions hold until the end, for as long as they must
    escaped  : they did once, or the target was enclosed as asked, and not at the end
    touched  : the net has touched the target, and neither of these
    missed   : it has not
    """

    CAPTURED = "captured"
    ESCAPED = "escaped"
    TOUCHED = "touched"
    MISSED = "missed"


@dataclass(frozen=True)
class Found:
    """An outcome; since : from when on the conditions hold until the end [s], None: they do not."""

    outcome: Outcome
    since: float | None


def conditions(rule: CaptureCriterion, measures: Measures, touching: Floats) -> dict[str, Bools]:
    """The conditions of a rule that are given: (t,) True where each holds; touching : (t,) elements."""
    found = {}
    if rule.enclosed is not None:
        found["enclosed"] = measures.enclosed >= rule.enclosed
    for name in ("relative_speed", "relative_spin", "cqi", "mcqi", "mouth"):
        if (most := getattr(rule, name)) is not None:
            found[name] = getattr(measures, name) <= most
    if rule.touching is not None:
        found["touching"] = touching >= rule.touching
    return found


def found(
    rule: CaptureCriterion, time: Floats, measures: Measures, touching: Floats, *, touched: bool
) -> Found:
    """What became of the target by the last of the times (t,) [s]; touched : the net has touched it."""
    holding = conditions(rule, measures, touching)
    every = np.logical_and.reduce([*holding.values()])
    begins = np.flatnonzero(every & ~np.append(False, every[:-1]))
    ends = np.flatnonzero(every & ~np.append(every[1:], False))
    lasts = time[ends] - time[begins]
    since = float(time[begins[-1]]) if every[-1] else None
    enough = rule.duration * (1.0 - 1e-12)
    if since is not None and lasts[-1] >= enough:
        return Found(Outcome.CAPTURED, since)
    enclosed = holding.get("enclosed", np.zeros(len(time), dtype=bool))
    if (lasts >= enough).any() or (enclosed.any() and not enclosed[-1]):
        return Found(Outcome.ESCAPED, since)
    return Found(Outcome.TOUCHED if touched else Outcome.MISSED, since)
