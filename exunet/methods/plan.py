"""The plan of one run: method, tolerance or step, and what the user should know of the choice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, asdict, dataclass
from typing import Any, Self

from exunet.methods.method import Method


@dataclass(frozen=True)
class Plan:
    """How one run is integrated: what follows from the solver keys on this scene.

    tolerance  : absolute tolerance per step [m, m/s] of an adaptive method, else None
    step       : longest step [s] of a fixed-step method, else None
    first_step : first attempt of an adaptive method [s]
    longest_step: longest step of an adaptive method [s]
    least_step : steps below this count as collapsed [s]
    expected_error: speed errors of the measured scenes relative to the launch speed, median and worst
    notes      : what the user should know of the choice
    """

    method: Method
    _: KW_ONLY
    tolerance: float | None = None
    step: float | None = None
    first_step: float = 0.0
    longest_step: float = math.inf
    least_step: float = 0.0
    expected_error: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The plan in JSON, where null stands for infinity."""
        return {name: None if value == math.inf else value for name, value in asdict(self).items()}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """The plan that `as_json` gave."""
        longest = math.inf if stored["longest_step"] is None else stored["longest_step"]
        lists = {name: tuple(value) for name, value in stored.items() if isinstance(value, list)}
        method = Method(stored["method"])
        return cls(**{**stored, **lists, "method": method, "longest_step": longest})
