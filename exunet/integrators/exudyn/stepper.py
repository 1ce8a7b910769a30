"""Time stepping with Exudyn's own integrators, and the steps that its adaptive methods try next.

The engine's control works by itself, but for two things: the first step after a stretch that was cut short
by its end, which a run that is restarted there must repeat; and the way across a jump of the forces, which no
step meets within a tight tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.interrupt import postponed
from exunet.bodies.port import Piece
from exunet.forces.cable_term import Jump, jump_ahead
from exunet.forces.terms import Change, DiscreteStates
from exunet.integrators.compiled.steps import TINY_IN_A_ROW
from exunet.integrators.events import Events
from exunet.integrators.exudyn.build import build, remember
from exunet.integrators.exudyn.engine import exudyn, quiet_settings
from exunet.integrators.exudyn.model import Coordinates, Model
from exunet.integrators.protocol import Arrays, IntegrationFailed, StepCounts, Steps, StepsCollapsed
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model.energy import law_of
from exunet.model.states import States
from exunet.model.system import State, System


class StepChoice:
    """Sets the step of each attempt in the engine's `solver.it`.

    jump    : the next jump of the forces within a time [s] from the step's start, or None without one
    begin   : the engine's own time at the start of the step [s]
    attempt : the step that is tried, set for good [s]
    """

    def __init__(
        self, plan: Plan, solver: Any, settings: Any, jump: Callable[[float], Jump | None] | None
    ) -> None:
        self._plan, self._solver, self._settings, self.jump = plan, solver, settings, jump
        self._order = METHODS[plan.method].order
        self._adaptive = plan.tolerance is not None
        self._first = self.attempt = plan.first_step
        self.begin = float(solver.it.currentTime)
        self._until = self.begin
        self._beyond = 0.0  # the step to continue with beyond the jump that is approached
        self._approaching = self._lifted = False
        self._tiny = 4.0 * plan.least_step
        self._tiny_in_a_row = 0

    def numbers(self) -> Floats:
        """Return the engine's time and the first step to try [s], with which the next stretch begins."""
        return np.array([self.begin, self._first])

    def restore(self, numbers: Floats) -> None:
        """Go on from what `numbers` gave, in a solver that was started anew."""
        self.begin, self._first = map(float, numbers)
        progress = self._solver.it
        progress.currentTime = self.begin
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
        self.begin = engines_time

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
        step = self._until - self.begin if self.begin + wanted > self._until else wanted
        if step != progress.currentStepSize:
            progress.currentStepSize = step
            progress.currentTime = self.begin + step
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
        best = self.attempt * math.pow(1.0 / error, 1.0 / self._order)
        most = min(progress.maxStepSize, self.attempt * integration.stepSizeMaxIncrease)
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
        beyond = self._beyond or self.attempt
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


_GAP = 1e-10  # [s]: the engine ends a stretch at a step that ends so near to its end
_FAR = 1e300  # [s]: beyond the end of any run


def settings_for(model: Model, plan: Plan, begin: float) -> Any:
    """Settings of a run that begins at a time [s]."""
    settings, method = quiet_settings(), METHODS[plan.method]
    integration = settings.timeIntegration
    integration.solverType = getattr(exudyn().DynamicSolverType, plan.method)
    integration.startTime, integration.endTime = begin, begin + 1.0
    integration.adaptiveStep = integration.automaticStepSize = method.kind == Kind.ADAPTIVE
    integration.numberOfSteps = 1
    # At its least step the engine accepts one step, whatever its error, and rejects all after it: never.
    integration.minimumStepSize = 1e-300
    if plan.tolerance is not None:
        integration.absoluteTolerance = plan.tolerance
        integration.relativeTolerance = 0.0  # the engine's relative scale lacks an absolute value
        integration.initialStepSize = plan.first_step
    explicit = integration.explicit
    explicit.useLieGroupIntegration = model.has_bodies
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


def longest_of(plan: Plan) -> float:
    """The longest step [s], which must not depend on where a run begins; finite, as the engine needs it."""
    return min(plan.longest_step, _FAR)


def ends_at(until: float) -> float:
    """The end to give to the engine, which ends a stretch `_GAP` before it.

    That is some units of round-off before `until`, of the larger of the two numbers in the difference.
    """
    return until - 64.0 * math.ulp(max(until, _GAP)) + _GAP


def started(model: Model, plan: Plan, settings: Any, before_attempt: Callable[[Any, float], bool]) -> Any:
    """A solver at the model's initial state; raises IntegrationFailed, with the engine's words.

    before_attempt : called with the engine's system and the end [s] of each step that is about to be tried
    """
    engine = exudyn()
    model.system.SetPreStepUserFunction(before_attempt)
    model.refresh()
    implicit = METHODS[plan.method].kind == Kind.IMPLICIT
    solver = engine.MainSolverImplicitSecondOrder() if implicit else engine.MainSolverExplicit()
    try:
        done = solver.InitializeSolver(model.system, settings)
    except Exception as error:  # the engine's own exception types share no narrower base
        raise IntegrationFailed(first_line(error)) from error
    if not done:
        raise IntegrationFailed("the engine could not start this method on this scene")
    if plan.tolerance is not None:
        solver.it.maxStepSize = longest_of(plan)
    return solver


def put(model: Model, now: Coordinates, time: float, where: Any) -> None:
    """Set the engine's state and time [s] in one of its configurations."""
    data = model.system.systemData
    data.SetODE2Coordinates(now.q, where)
    data.SetODE2Coordinates_t(now.v, where)
    if len(now.y):
        data.SetODE1Coordinates(now.y, where)
    data.SetTime(time, where)


def first_line(words: object) -> str:
    """Return the first non-empty line of a message of the engine; "" if the message is empty."""
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0] if lines else ""


_NUMBERS = 2**22  # of the positions that a call returns, about, where the method can go on after it


class ExudynStepper:
    """Stepper that has Exudyn step; see `exunet.integrators.protocol.Stepper`.

    A call of `step` is one call of the engine, and returns each state, up to a bound of memory.
    """

    def __init__(self, system: System, state: State, plan: Plan) -> None:
        self._system, self._plan = system, plan
        self._method = METHODS[plan.method]
        self._adaptive = self._method.kind == Kind.ADAPTIVE
        self._discrete = {name: np.array(values, dtype=float) for name, values in state.discrete.items()}
        discrete_states = (term.discrete for term in system.forces.discrete_states)
        self._keeps = any(discrete is not None and discrete.kept_in for discrete in discrete_states)
        self._lets_remember = any(call.remember is not None for call in system.forces.calls)
        self._events = Events(system, self)  # ahead of which adaptive steps end
        self._counts = StepCounts()
        self._newton_before = 0  # in solvers that were started before
        self._external: Floats | None = None
        # Equal steps between two times: begin, end, number, steps before; number 0: none to go on with.
        self._equal = np.zeros(4)
        self._open(state)

    def _open(self, state: State) -> None:
        """Build the model at a state, and start the engine's solver there."""
        room = self._external is not None
        self._model = build(self._system, state, self._plan, has_external=room)
        remember(self._model, self._system, state.discrete)
        if self._external is not None:
            self._model.applied.set_external_force(self._external)
        self._settings = settings_for(self._model, self._plan, state.time)
        self._start()
        self._idle_at(state.time)

    def _idle_at(self, time: float) -> None:
        """Between two calls of the engine."""
        self.time = self._attempt_end = time
        self._attempting = self._stale = False  # stale: the solver is to begin anew
        self._changed: Coordinates | None = None  # by an event, to begin anew with
        self._stop: BaseException | None = None

    def _start(self) -> None:
        """Start the engine's solver at the model's initial state."""
        self._solver = started(self._model, self._plan, self._settings, self._before_attempt)
        jump = self._jump if self._system.forces.cable.viscous and self._adaptive else None
        self._choice = StepChoice(self._plan, self._solver, self._settings, jump)

    @property
    def counts(self) -> StepCounts:
        attempts = self._counts.steps + self._counts.rejected
        if self._method.kind == Kind.IMPLICIT:  # residuals; Jacobians not counted
            evaluations = attempts + self._counts.newton_iterations
        else:
            evaluations = attempts * self._method.stages
        return replace(self._counts, right_hand_sides=evaluations)

    @property
    def items(self) -> dict[str, int]:
        return self._model.items()

    @property
    def can_restart(self) -> bool:
        return self._method.kind != Kind.IMPLICIT  # whose algorithmic accelerations the engine does not give

    @property
    def discrete(self) -> dict[str, Floats]:
        if self._keeps:
            for name, values in self._model.applied.remembered.items():
                self._discrete[name][:] = values
        return self._discrete

    @property
    def kept(self) -> dict[str, Floats]:
        kept = self._model.applied.remembered if self._keeps else {}
        return {name: values.copy() for name, values in kept.items()}

    def flat(self) -> tuple[Floats, Floats]:
        return self._model.places.flat(self._now, self.time, self.discrete, self._system.layout)

    @property
    def _now(self) -> Coordinates:
        return self._changed or self._model.coordinates()

    def _copied(self) -> Coordinates:
        return Coordinates(*(np.array(part) for part in self._now))

    def step(
        self, times: Sequence[float], most: int | None = None, until_true: Callable[[], bool] | None = None
    ) -> Steps:
        if self._stale:
            self._renew()
        until = float(times[-1])
        self._rows: list[tuple[float, Floats, Floats, Floats]] = []
        self._until_true = until_true
        self._begin(until)
        words = ""
        try:
            with postponed() as self._check_interrupt:
                done = self._solver.SolveSteps(self._model.system, self._settings)
        except Exception as error:  # noqa: BLE001 - as above; reported or raised again below
            done, words = False, first_line(error)
            if self._stop is None and isinstance(error.__cause__, KeyboardInterrupt):
                self._stop = error.__cause__
        self._counts.newton_iterations = self._newton_before + int(self._solver.it.newtonStepsCount)
        if self._stop is not None:
            if isinstance(self._stop, IntegrationFailed):
                self._stop.steps = self._steps()
            if not isinstance(self._stop, _Ended):
                stop, self._stop = self._stop, None
                raise stop
            self._choice.end_stretch(self.time)
            self._idle_at(self.time)
            self._stale = True
            return self._steps()
        if not done:
            words = words or first_line(self._solver.GetErrorString()) or "the engine stopped"
            raise IntegrationFailed(words, self._steps())
        self._choice.end_stretch(self._model.system.systemData.GetTime())
        self._counts.steps += self._attempting
        self._idle_at(until)
        self._accept(until, self._model.coordinates())
        return self._steps()

    def _begin(self, until: float) -> None:
        """Set the engine's steps to a time [s]."""
        self._model.refresh()
        progress = self._solver.it
        self._choice.begin_stretch(until)
        progress.endTime = ends_at(until) if self._adaptive else until
        if self._plan.step is not None:
            # Equal steps, none longer than asked, so that stored times are hit exactly.
            if not (self._equal[2] and self._equal[1] == until):
                number = max(1, math.ceil((until - self.time) / self._plan.step * (1 - 1e-9)))
                self._equal[:] = self.time, until, number, self._counts.steps
            begin, _, parts, _ = self._equal.tolist()
            progress.startTime = self.time
            progress.currentStepIndex = 1
            step = (until - begin) / parts
            progress.currentStepSize = progress.maxStepSize = progress.initialStepSize = step

    def _before_attempt(self, _mbs: Any, end_of_attempt: float) -> bool:
        """Engine callback before each attempted step; the state is still that of the step's start."""
        try:
            rejected = self._attempting and end_of_attempt <= self._attempt_end
            if rejected:
                self._counts.rejected += 1
            elif self._attempting:
                self._choice.begin = self._attempt_end
                self._counts.steps += 1
                if self._accept(self._attempt_end, self._model.coordinates_in_call()):
                    raise _Ended
            self._check_interrupt()
            if self._adaptive:
                end_of_attempt = self._choice.choose(end_of_attempt, self._attempting, rejected)
                self._choice.refuse_collapse(self.time)
            self._attempting = True
            self._attempt_end = end_of_attempt
            if self._adaptive:
                if self._events.any:
                    self._shorten()
                self._choice.attempt = self._solver.it.currentStepSize
        except BaseException as error:
            self._stop = error  # step() raises it again
            raise  # returning False would not end the engine's search for a smaller step
        return True

    def _accept(self, time: float, now: Coordinates) -> bool:
        """Take an accepted step that ends at a time [s]; True if a test ends the call there."""
        self.time = time
        if self._equal[2] and self._counts.steps - self._equal[3] >= self._equal[2]:
            self._equal[2] = 0.0
        if self._lets_remember:
            self._model.applied.accepted(time, now.q, now.v)
        self._rows.append((time, now.q.copy(), now.v.copy(), now.y.copy()))
        ends = self._until_true is not None and self._until_true()
        many = len(self._rows) * now.q.size > _NUMBERS
        return ends or (
            many and not self._method.remembers_acceleration
        )  # which would begin anew with others

    def _steps(self) -> Steps:
        """The states of the steps of a call."""
        if not self._rows:
            x, v = (np.zeros((0, size)) for size in (self._system.blocks.n_x, self._system.blocks.n_v))
            return Steps(States(self._system, np.zeros(0), x, v, self._discrete))
        if len(self._rows) == 1:
            ((time, *parts),) = self._rows
            rows, times = Coordinates(*(part[None] for part in parts)), np.array([time])
        else:
            ends, *stacks = zip(*self._rows, strict=True)
            rows, times = Coordinates(*map(np.array, stacks)), np.array(ends)
        x, v = self._model.places.flat(rows, times, self.discrete, self._system.layout)
        return Steps(States(self._system, times, x, v, self._discrete))

    def _shorten(self) -> None:
        """Make the step that is about to be tried end near the next event."""
        step, least = self._attempt_end - self.time, 8.0 * self._plan.least_step
        shorter = self._events.shortened(step, least)
        if shorter < step:
            progress = self._solver.it
            progress.currentStepSize = shorter
            progress.currentTime = self._attempt_end = self.time + shorter

    def _jump(self, within: float) -> Jump | None:
        """The next jump of the forces ahead of the state at a step's start."""
        now = self._model.coordinates()
        # The last stage of the adaptive methods was evaluated at the last step's end.
        after = np.array(self._model.system.systemData.GetODE2Coordinates_tt())
        position, velocity, *_ = self._model.places.unpack(now, self.time, self._discrete)
        acceleration = self._model.places.of_coordinates(now._replace(v=after)).velocity
        law = law_of(self._system.forces, self._discrete)
        state = (position, velocity, acceleration)
        assert self._plan.tolerance is not None
        return jump_ahead(self._system.blocks, law, within, self._plan.tolerance, self.time, state)

    def change(self, change: Change, discrete: DiscreteStates) -> None:
        self._remember(discrete)
        if change.x is not None or change.v is not None:
            x, v = self.flat()
            x, v = (x if change.x is None else change.x), (v if change.v is None else change.v)
            self._changed = self._model.places.pack(self._system.layout.unpack(x, v), self._now)
            self._begin_anew()
        else:
            self._forces_changed()

    def _begin_anew(self) -> None:
        self._stale, self._equal[2] = True, 0.0

    def _forces_changed(self) -> None:
        if self._method.remembers_acceleration:
            self._begin_anew()

    def _remember(self, discrete: DiscreteStates) -> None:
        """Let all forces take the discrete states as they are now."""
        self._discrete = {name: np.array(values, dtype=float) for name, values in discrete.items()}
        remember(self._model, self._system, self._discrete)

    def _renew(self) -> None:
        """Start the solver again where it stands, or at the state that an event has made."""
        now, self._changed, self._stale = self._copied(), None, False
        kinds = exudyn().ConfigurationType
        put(self._model, now, self.time, kinds.Initial)
        self._settings.timeIntegration.startTime = self.time
        self._newton_before, numbers = self._counts.newton_iterations, self._choice.numbers()
        self._start()  # which computes the accelerations
        if self._adaptive:
            self._choice.restore(numbers)

    def state(self) -> State:
        discrete = {name: values.copy() for name, values in self.discrete.items()}
        return State.of(self.time, self._model.places.unpack(self._copied(), self.time, discrete), discrete)

    def view(self) -> State:
        return self.state()

    def steer(self, port: str, piece: Piece) -> None:
        self.steered(port)

    def steered(self, port: str) -> Piece:
        raise InputError(f'bodies.{port}: a port needs engine.backend = "compiled"')

    def set_external_force(self, force: Floats) -> None:
        self._external = force.copy()
        if self._model.applied is None:  # connectors alone: build them again with room for other forces
            self._open(self.state())
        self._model.applied.set_external_force(force)
        self._forces_changed()

    def set_inputs(self, inputs: Arrays) -> None:
        self._remember({**self.discrete, **inputs})
        self._forces_changed()

    def save(self) -> dict[str, NDArray[Any]]:
        if self._stale and not self._attempting:
            self._renew()
        data = self._model.system.systemData
        return {
            "time": np.array(self.time),
            # Displacements: their sum with the reference loses bits.
            **self._copied()._asdict(),
            "a": np.array(data.GetODE2Coordinates_tt()),  # what VelocityVerlet's next step begins with
            "counts": np.array([self._counts.steps, self._counts.rejected]),
            "choice": self._choice.numbers(),
            "equal": self._equal.copy(),
            **{f"discrete/{name}": values.copy() for name, values in self.discrete.items()},
            "external": np.zeros((0, 3)) if self._external is None else self._external.copy(),
        }

    def load(self, arrays: Arrays, rejected: int | None = None) -> None:
        """The solver is started anew: nothing of what it did since then may be left in it."""
        time, engines_time = float(arrays["time"]), float(arrays["choice"][0])
        now = Coordinates(*(np.array(arrays[name]) for name in Coordinates._fields))
        discrete = {name: arrays[f"discrete/{name}"] for name in self._discrete}
        steps = int(arrays["counts"][0])
        self._equal[:] = arrays["equal"]
        if rejected is not None:  # of the same solver, whose control goes on
            self._remember(discrete)
            self._choice.begin = time
            self._counts = replace(self._counts, steps=steps, rejected=rejected)
            self._idle_at(time)
            self._changed, self._stale = now, True
            return
        has_external = np.array(arrays["external"]) if len(arrays["external"]) else None
        if (has_external is None) != (self._external is None):
            self._external = has_external
            self._open(self.state())
        if has_external is not None:
            self._external = has_external
            self._model.applied.set_external_force(has_external)
        self._remember(discrete)
        self._settings = settings_for(self._model, self._plan, time)
        kinds, data = exudyn().ConfigurationType, self._model.system.systemData
        accelerations = arrays["a"]
        put(self._model, now, engines_time, kinds.Initial)  # for the solver to start from
        data.SetODE2Coordinates_tt(accelerations, kinds.Initial)
        self._start()
        put(self._model, now, engines_time, kinds.Current)  # starting it has changed the accelerations
        data.SetODE2Coordinates_tt(accelerations, kinds.Current)
        self._choice.restore(arrays["choice"])
        self._counts = StepCounts(steps, int(arrays["counts"][1]))
        self._newton_before = 0
        self._idle_at(time)


class _Ended(Exception):
    """A test has ended a call of the engine at the end of a step."""
