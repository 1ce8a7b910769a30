"""How long a step of a host in Exudyn may be: as long as its user says, or the largest stable one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from exunet.base.errors import InputError
from exunet.coupling.prediction import LongestStep


class StepLimit:
    """The limit of each step of a run.

    longest : [s], as the user says; None: the largest stable step for the ports
    """

    def __init__(self, longest: float | None) -> None:
        self._longest = None if longest is None else _positive(longest)
        self._largest: LongestStep | None = None

    def begin(self, largest: LongestStep) -> None:
        """The largest stable step of the run that begins."""
        self._largest = largest

    def refuse_long(self, begin: float, until: float, others: Callable[[], str]) -> None:
        """Raise InputError for a step between times [s] that is too long; others : words on what counts."""
        step, largest = until - begin, self._largest
        assert largest is not None  # a run is followed
        if largest.allows(step) if self._longest is None else step <= self._longest * (1.0 + 1e-9):
            return
        raise InputError(
            f"couple: the host's step of {step:.4g} s at t = {begin:.6g} s is beyond the largest stable one "
            f"of its method, {self._longest or largest.now:.4g} s, for the ports' masses, stiffnesses that "
            f"grow with the stretch, and turns{others()}: use shorter steps, or couple(..., longest=...)"
        )


def _positive(longest: object) -> float:
    if isinstance(longest, int | float | np.number) and not isinstance(longest, bool) and longest > 0.0:
        return float(longest)
    raise InputError(f"couple: longest must be positive, got {longest!r}")
