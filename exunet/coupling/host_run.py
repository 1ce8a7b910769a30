"""The run of a host in Exudyn that a coupling follows: its solver, and its method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from exunet.base.errors import InputError
from exunet.coupling.prediction import LongestStep
from exunet.integrators.exudyn.engine import exudyn

# A host starts at the net's time but for this [s]: Exudyn adds up times.
SAME_TIME = 1e-9
_UNKNOWN = "couple: the host's method is not known: use mbs.SolveDynamic, with storeSolver=True, for each run"


class HostRun:
    """The run that goes on, as SolveDynamic tells it to the system.

    solver : of that run; None: none is followed
    method : its name; "": none yet
    """

    def __init__(self, mbs: Any) -> None:
        self._mbs = mbs
        self.forget()

    def forget(self) -> None:
        """Follow none; the solver of a run before is not to be taken for a new one."""
        self.solver: Any = None
        self.method = ""
        self._over = self._stored()
        self._asked_of: Any = None  # the solver that `_iteration` is of
        self._number = 0  # of the step that it has begun last, by its solver
        self._asked = 0  # of the step for which `solver_of` was asked last

    def _stored(self) -> Any:
        return self._mbs.sys.get("dynamicSolver")

    @property
    def time(self) -> float:
        """Of the host [s]; in a pre-step function the end of the step that comes."""
        return float(self._mbs.systemData.GetTime())

    def has_left(self, time: float) -> bool:
        """True if the host has gone on from a time [s] by more than the step that comes.

        In a pre-step function its state is still where that step begins.
        """
        if self.time <= time + SAME_TIME:
            return False
        data, kinds = self._mbs.systemData, exudyn(quiet=False).ConfigurationType
        begins = float(data.GetTime(kinds.StartOfStep))
        both = (data.GetODE2Coordinates(kind) for kind in (kinds.StartOfStep, kinds.Current))
        return abs(begins - time) > SAME_TIME or not np.array_equal(*both)

    @property
    def goes_on(self) -> bool:
        """True if a run is followed that has not come to its end."""
        return self.solver is not None and not self.solver.output.finishedSuccessfully

    def solver_of(self, until: float, *, again: bool) -> Any:
        """The solver that steps to a time [s]; again: it takes its last step again, to an earlier end.

        Solvers that are not told to the system leave that of an earlier run there, whose times and steps are
        others. Raises InputError for these.
        """
        solver = self._stored()
        if solver is not self._asked_of:
            if solver is None or solver is self._over:
                raise InputError(_UNKNOWN)
            self._asked_of, self._iteration = solver, solver.it
        now = self._iteration
        if abs(now.currentTime - until) > SAME_TIME:
            raise InputError(_UNKNOWN)
        self._asked = now.currentStepIndex
        if solver is self.solver and not again and self._asked <= self._number:
            raise InputError(_UNKNOWN)
        return solver

    def settings(self, time: float) -> Any:
        """`timeIntegration` of the run that begins; raises InputError if not at the net's time [s]."""
        told = self._mbs.sys.get("simulationSettings")
        if told is None:
            raise InputError(_UNKNOWN)
        begin = float(told.timeIntegration.startTime)
        if abs(begin - time) > SAME_TIME:
            raise InputError(
                f"couple: the host starts at t = {begin:.9g} s, the net is at {time:.9g} s: set "
                "timeIntegration.startTime, restore a snapshot of the coupling, or reset the net and couple "
                "anew"
            )
        return told.timeIntegration

    def follow(self, solver: Any, method: str) -> None:
        """Follow the run of a solver from now on."""
        self.solver, self.method = solver, method

    def has_begun_a_step(self) -> None:
        """The solver has begun a step: the next one has a higher number."""
        self._number = self._asked


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
