"""Which step the engine's adaptive methods try next, where its own control has to be helped.

The engine's control works by itself, but for two things: the first step after a stretch that was cut short
by its end, which a run that is restarted there must repeat; and the way across a jump of the forces, which no
step meets within a tight tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces.cable_term import Jump
from exunet.integrators.compiled.steps import TINY_IN_A_ROW
from exunet.integrators.protocol import StepsCollapsed
from exunet.methods.method import METHODS, Plan

Floats = NDArray[np.float64]


class StepChoice:
    """Sets the step of each attempt in the engine's `solver.it`.

    jump : the next jump of the forces within a time [s] from the step's start, or None without one
    """

    def __init__(
        self, plan: Plan, solver: Any, settings: Any, jump: Callable[[float], Jump | None] | None
    ) -> None:
        self._plan, self._solver, self._settings, self.jump = plan, solver, settings, jump
        self._order = METHODS[plan.method].order
        self._adaptive = plan.tolerance is not None
        self._first = self._attempt = plan.first_step
        self._from = float(solver.it.currentTime)  # the engine's own time at the start of the step
        self._until = self._from
        self._beyond = 0.0  # the step to continue with beyond the jump that is approached
        self._approaching = self._lifted = False
        self._tiny = 4.0 * plan.least_step
        self._tiny_in_a_row = 0

    def numbers(self) -> Floats:
        """What the next stretch begins with: the engine's time and the first step to be tried [s]."""
        return np.array([self._from, self._first])

    def restore(self, numbers: Floats) -> None:
        """Go on from what `numbers` gave, in a solver that was started anew."""
        self._from, self._first = map(float, numbers)
        progress = self._solver.it
        progress.currentTime = self._from
        if self._adaptive:
            progress.initialStepSize = self._first

    def begin_stretch(self, until: float) -> None:
        """The steps that come go to a time [s]."""
        self._until, self._beyond = until, 0.0
        self._tiny_in_a_row = 0

    def end_stretch(self, engines_time: float) -> None:
        """The stretch has ended; the engine's sums of steps may be some units in the last place beside it."""
        if self._adaptive:
            self._first = self._controlled()
        self._from = engines_time

    def accepted(self, time: float) -> None:
        """A step has ended at the engine's time [s]."""
        self._from = time

    def attempted(self) -> None:
        """The step that is tried is set for good."""
        self._attempt = self._solver.it.currentStepSize

    def choose(self, end_of_attempt: float, attempting: bool, rejected: bool) -> float:
        """Set the step that is about to be tried; returns its end."""
        progress = self._solver.it
        wanted = progress.currentStepSize
        if end_of_attempt >= self._until and not rejected and attempting:
            wanted = self._controlled()  # the engine has cut it short already
        elif not attempting:  # the stretch before may have been shorter than any sound step
            wanted = max(wanted, self._plan.least_step)
        if self.jump is not None:
            wanted = self._mind_jumps(wanted, rejected)
        step = self._until - self._from if self._from + wanted > self._until else wanted
        if step != progress.currentStepSize:
            progress.currentStepSize = step
            progress.currentTime = self._from + step
        return float(progress.currentTime)

    def refuse_collapse(self, begin: float) -> None:
        """Raise StepsCollapsed where the engine repeats its smallest step, from `begin` [s], without end.

        It does when a tolerance cannot be met. The step's own size counts: after a step that overflowed,
        steps are too small to move the time at all.
        """
        size = self._solver.it.currentStepSize
        if size > self._tiny:
            self._tiny_in_a_row = 0
            return
        self._tiny_in_a_row += 1
        if self._tiny_in_a_row > TINY_IN_A_ROW:
            raise StepsCollapsed(
                f"the steps collapsed to {size:.1g} s at t = {begin:.6g} s: the tolerance "
                f"{self._plan.tolerance:.2g} cannot be met"
            )

    def _controlled(self) -> float:
        """The step that the engine's control chooses after the last one; its own formula, to the last bit."""
        progress, integration = self._solver.it, self._settings.timeIntegration
        error = progress.automaticStepSizeError or 1e-12
        best = self._attempt * math.pow(1.0 / error, 1.0 / self._order)
        most = min(progress.maxStepSize, self._attempt * integration.stepSizeMaxIncrease)
        return float(min(most, max(progress.minStepSize, integration.stepSizeSafety * best)))

    def _mind_jumps(self, wanted: float, rejected: bool) -> float:
        """The step to try where a jump of the forces may have spoiled the last one.

        Only a rejected step makes look for one. Then steps go to just before it, one goes across it, whatever
        its error estimate, and the control continues with the step that it had chosen before. If the way to
        the jump is itself too long a step, the control goes on by itself until it rejects another step.
        """
        assert self.jump is not None
        assert self._plan.tolerance is not None
        integration = self._settings.timeIntegration
        if self._lifted:
            self._lifted = False
            integration.absoluteTolerance = self._plan.tolerance
        if not (rejected or self._beyond):
            return wanted
        beyond = self._beyond or self._attempt
        jump = self.jump(beyond)
        approaching, self._approaching = self._approaching, jump is not None
        if jump is None:
            self._beyond = 0.0
            return wanted if rejected else beyond
        if rejected and approaching:
            self._beyond, self._approaching = 0.0, False
            return wanted
        self._beyond = beyond
        if jump.after > jump.step:
            return jump.to_it
        step = jump.after + jump.step
        integration.absoluteTolerance = max(self._plan.tolerance, jump.size * step)
        self._lifted = True
        return step
