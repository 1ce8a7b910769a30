"""Time stepping with Exudyn's own integrators, stretch by stretch, every state handed to a watcher."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.loading import exudyn
from exunet.backends.exudyn.model import Model
from exunet.base.interrupt import postponed
from exunet.methods.method import METHODS, Kind, Method
from exunet.methods.plan import Plan
from exunet.simulation.breaking import Breaks

Floats = NDArray[np.float64]
Watcher = Callable[[Floats, Floats, Floats], None]

_ROWS = 256  # states that the watcher gets in one go: enough to be fast, few enough to be told soon
_BUFFER_NUMBERS = 2**19  # of one coordinate array; bounds memory
_TINY_ATTEMPTS = 200  # of the least size, one after the other; a snap's beginning may need a few


@dataclass
class StepCounts:
    """What the integration cost: accepted and rejected steps, Newton iterations."""

    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0


class EngineFailed(Exception):
    """The engine gave up; its own words."""


class StepsCollapsed(EngineFailed):
    """No step is small enough for the tolerance; a tighter one cannot help."""


class Stepper:
    """Advances a model to asked times and hands the accepted states, in batches, to a watcher.

    The watcher gets (time (k,), position (k, n, 3), velocity (k, n, 3)) of every step, later than `advance`
    has gone there but before the end of the run or EngineFailed, or when told to `hand_over`; batches overlap
    in one state, so that it can integrate over steps. `begin` is the time of the model's state [s]. An
    exception raised by the watcher, or Ctrl-C, comes out of `advance` unchanged.
    """

    def __init__(self, model: Model, plan: Plan, end: float, watcher: Watcher, begin: float = 0.0) -> None:
        self._model = model
        self._plan = plan
        self._method = METHODS[plan.method]
        self._watcher = watcher
        self.counts = StepCounts()
        self.time = begin
        self.dissipated = self.extremes = self.largest_tension = None  # the watcher has to find them
        self._end = end
        rows = max(16, min(_ROWS, _BUFFER_NUMBERS // max(1, model.n_coordinates)))
        self._times = np.empty(rows)
        self._q = np.empty((rows, model.n_coordinates))
        self._v = np.empty((rows, model.n_coordinates))
        self._rows = 0
        self._step_start = begin
        self._attempt_end = begin
        self._attempting = False
        self._tiny_attempts = 0
        self._stop: BaseException | None = None
        self._breaks: Breaks | None = None
        self._settings = _settings(exudyn(), model, plan, begin, end)
        self._solver = self._start()
        self._append(begin)

    def _start(self) -> Any:
        engine = exudyn()
        self._model.system.SetPreStepUserFunction(self._before_attempt)
        self._model.look_again()
        implicit = self._method.kind == Kind.IMPLICIT
        solver = engine.MainSolverImplicitSecondOrder() if implicit else engine.MainSolverExplicit()
        try:
            started = solver.InitializeSolver(self._model.system, self._settings)
        except Exception as error:  # the engine's own exception types share no narrower base
            raise EngineFailed(_first_line(error)) from error
        if not started:
            raise EngineFailed("the engine could not start this method on this scene")
        return solver

    def advance(self, until: float) -> None:
        """Integrate from the current time to `until` [s] exactly."""
        self._set_stretch(until)
        words = ""
        try:
            with postponed() as self._check_interrupt:
                done = self._solver.SolveSteps(self._model.system, self._settings)
        except Exception as error:  # noqa: BLE001 - as above; told or raised again below
            done, words = False, _first_line(error)
            if self._stop is None and isinstance(error.__cause__, KeyboardInterrupt):
                self._stop = error.__cause__
        self._count_newton()
        if self._stop is not None:
            stop, self._stop = self._stop, None
            raise stop
        if not done:
            self.hand_over()
            raise EngineFailed(words or _first_line(self._solver.GetErrorString()) or "the engine stopped")
        if self._attempting:
            self.counts.steps += 1
        self._attempting = False
        self._tiny_attempts = 0
        self.time = self._step_start = until
        self._append(until)
        if until >= self._end or not np.isfinite(self._v[self._rows - 1]).all():
            self.hand_over()
        self._look_for_breaks(until)

    def _set_stretch(self, until: float) -> None:
        self._model.look_again()
        progress = self._solver.it
        progress.endTime = until
        if self._plan.step is not None:
            # Equal steps, none longer than asked, so that stored times are hit exactly.
            span = until - self.time
            number = max(1, math.ceil(span / self._plan.step * (1 - 1e-9)))
            progress.startTime = self.time
            progress.currentStepIndex = 1
            progress.currentStepSize = progress.maxStepSize = progress.initialStepSize = span / number

    def _before_attempt(self, _mbs: Any, end_of_attempt: float) -> bool:
        """Engine callback before each attempted step; the state is still that of the step's start."""
        try:
            if self._attempting and end_of_attempt <= self._attempt_end:
                self.counts.rejected += 1
            elif self._attempting:
                self._step_done(self._attempt_end)
            self._check_interrupt()
            self._refuse_collapse(end_of_attempt)
            self._attempting = True
            self._attempt_end = end_of_attempt
            if self._breaks is not None and self._method.kind == Kind.ADAPTIVE:
                self._shorten()
        except BaseException as error:
            self._stop = error  # advance() raises it again
            raise  # returning False would not end the engine's search for a smaller step
        return True

    def _refuse_collapse(self, end_of_attempt: float) -> None:
        """The engine goes on for ever with its smallest step when a tolerance cannot be met."""
        if end_of_attempt - self._step_start > 4.0 * self._plan.least_step:
            self._tiny_attempts = 0
            return
        self._tiny_attempts += 1
        if self._tiny_attempts > _TINY_ATTEMPTS:
            raise StepsCollapsed(
                f"the steps collapsed to {end_of_attempt - self._step_start:.1g} s at "
                f"t = {self._step_start:.6g} s: the tolerance {self._plan.tolerance:.2g} cannot be met"
            )

    def _step_done(self, time: float) -> None:
        self.counts.steps += 1
        self._step_start = time
        self._append(time)
        self._look_for_breaks(time)

    def _shorten(self) -> None:
        """Make the step that is about to be tried end near the limit of what it would break."""
        assert self._breaks is not None
        step, least = self._attempt_end - self._step_start, 8.0 * self._plan.least_step
        shorter = self._breaks.step_within(step, least, *self.state())
        if shorter < step:
            progress = self._solver.it
            progress.currentStepSize = shorter
            progress.currentTime = self._attempt_end = self._step_start + shorter

    def watch_for(self, breaks: Breaks) -> None:
        """Look for elements that break at the end of each step from now on."""
        self._breaks = breaks

    def _look_for_breaks(self, time: float) -> None:
        if self._breaks is None:
            return
        position, _ = self.state()
        broken = self._breaks.found(position)
        if len(broken):
            if self._times[self._rows - 1] != time:
                self._append(time)
            self.hand_over()  # so that no batch has states from before and after
            self._breaks.book(time, position, broken)
            self._model.sever(broken)

    def _append(self, time: float) -> None:
        row = self._rows
        data = self._model.system.systemData
        self._times[row] = time
        self._q[row] = data.GetODE2Coordinates(copy=False)
        self._v[row] = data.GetODE2Coordinates_t(copy=False)
        self._rows = row + 1
        if self._rows == len(self._times):
            self.hand_over()

    def hand_over(self) -> None:
        """Let the watcher see the states it has not seen; the last one stays, to begin the next batch."""
        rows = self._rows
        if rows > 1:
            position, velocity = self._model.unpack(self._q[:rows], self._v[:rows])
            time = self._times[:rows].copy()
            for buffer in (self._times, self._q, self._v):
                buffer[0] = buffer[rows - 1]
            self._rows = 1
            self._watcher(time, position, velocity)

    def state(self) -> tuple[Floats, Floats]:
        """Position [m] and velocity [m/s] of all points now, (n, 3) each."""
        return self._model.unpack(*self._model.coordinates())

    def _count_newton(self) -> None:
        self.counts.newton_iterations = int(self._solver.it.newtonStepsCount)

    @property
    def right_hand_sides(self) -> int:
        """Evaluations of the forces so far (implicit methods: residuals, Jacobians not counted)."""
        attempts = self.counts.steps + self.counts.rejected
        if self._method.kind == Kind.IMPLICIT:
            return attempts + self.counts.newton_iterations
        return attempts * self._method.stages


def _settings(engine: Any, model: Model, plan: Plan, begin: float, end: float) -> Any:
    method = METHODS[plan.method]
    settings = engine.SimulationSettings()
    settings.solution.file.write = False  # else the engine writes into the working directory
    settings.solution.sensors.active = False
    settings.solution.solverInformationFileName = ""
    settings.linearSolver.solverType = engine.LinearSolverType.EigenSparse  # the default is dense
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.solverType = getattr(engine.DynamicSolverType, plan.method)
    integration.startTime, integration.endTime = begin, end
    integration.adaptiveStep = integration.automaticStepSize = method.kind == Kind.ADAPTIVE
    if plan.tolerance is not None:
        integration.absoluteTolerance = plan.tolerance
        integration.relativeTolerance = 0.0  # the engine's relative scale lacks an absolute value
        integration.initialStepSize = plan.first_step
        # The number of steps sets the longest one.
        integration.numberOfSteps = max(1, math.ceil((end - begin) / plan.longest_step))
        integration.minimumStepSize = plan.least_step
    else:
        integration.numberOfSteps = 1
        integration.minimumStepSize = 1e-300  # never the reason to stop
    explicit = integration.explicit
    explicit.useLieGroupIntegration = False
    explicit.computeMassMatrixInversePerBody = model.all_points_alone
    explicit.computeEndOfStepAccelerations = (
        plan.method == Method.VELOCITY_VERLET
    )  # others would pay for nothing
    if method.kind == Kind.IMPLICIT:
        integration.newton.useModifiedNewton = False
        trapezoidal = plan.method == Method.TRAPEZOIDAL_INDEX2
        integration.generalizedAlpha.useNewmark = trapezoidal
        integration.generalizedAlpha.useIndex2Constraints = trapezoidal
    return settings


def _first_line(words: object) -> str:
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0] if lines else ""
