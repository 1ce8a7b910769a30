"""Time stepping with Exudyn's own integrators, and the steps that its adaptive methods try next.

The engine's control works by itself, but for two things: the first step after a stretch that was cut short
by its end, which a run that is restarted there must repeat; and the way across a jump of the forces, which no
step meets within a tight tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.interrupt import postponed
from exunet.bodies.port import Piece
from exunet.forces.cable_term import Jump, jump_ahead
from exunet.forces.terms import Change, Seen
from exunet.integrators.compiled.steps import TINY_IN_A_ROW
from exunet.integrators.events import Events
from exunet.integrators.exudyn.build import build, remember
from exunet.integrators.exudyn.engine import exudyn
from exunet.integrators.exudyn.model import Coordinates, Model
from exunet.integrators.protocol import Arrays, IntegrationFailed, Observer, StepCounts, StepsCollapsed
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model.energy import law_of
from exunet.model.states import States
from exunet.model.system import Moving, State, System


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


_GAP = 1e-10  # [s]: the engine ends a stretch at a step that ends so near to its end
_FAR = 1e300  # [s]: beyond the end of any run


def settings_for(model: Model, plan: Plan, begin: float) -> Any:
    """Settings of a run that begins at a time [s]."""
    engine, method = exudyn(), METHODS[plan.method]
    settings = engine.SimulationSettings()
    settings.solution.file.write = False  # else the engine writes into the working directory
    settings.solution.sensors.active = False
    settings.solution.solverInformationFileName = ""
    settings.linearSolver.solverType = engine.LinearSolverType.EigenSparse  # the default is dense
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.solverType = getattr(engine.DynamicSolverType, plan.method)
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
    """Of what the engine says, which begins with empty lines; "" if it says nothing."""
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0] if lines else ""


_ROWS = 256  # states that the observer gets in one go: enough to be fast, few enough to come soon
_NUMBERS = 2**19  # of one array; bounds memory


class Accepted:
    """Rows of coordinates, the first of which is the last of those that were taken before."""

    def __init__(self, now: Coordinates) -> None:
        rows = max(16, min(_ROWS, _NUMBERS // max(1, len(now.q))))
        self._time = np.empty(rows)
        self._held = Coordinates(*(np.empty((rows, len(part))) for part in now))
        self._q, self._v, self._y = self._held
        self._rows = 0

    def append(self, time: float, now: Coordinates) -> bool:
        """Add a row; True if there is no room for another."""
        row = self._rows
        self._time[row] = time
        self._q[row], self._v[row] = now.q, now.v
        if len(now.y):
            self._y[row] = now.y
        self._rows = row + 1
        return self._rows == len(self._time)

    @property
    def last_time(self) -> float:
        """[s]"""
        return float(self._time[self._rows - 1])

    @property
    def finite(self) -> bool:
        """True if the last row's velocities are."""
        return bool(np.isfinite(self._held.v[self._rows - 1]).all())

    def take(self) -> tuple[Floats, Coordinates] | None:
        """Times (k,) and copies of all rows; None if there is but one row.

        The last row stays as the first.
        """
        rows = self._rows
        if rows < 2:
            return None
        time, states = self._time, self._held
        all_rows = time[:rows].copy(), Coordinates(*(part[:rows].copy() for part in states))
        for held in (time, *states):
            held[0] = held[rows - 1]
        self._rows = 1
        return all_rows

    def begin_with(self, now: Coordinates) -> None:
        """An event has changed the state at the time of the only row."""
        for held, part in zip(self._held, now, strict=True):
            held[0] = part

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All rows, for a snapshot."""
        held = {"time": self._time, **self._held._asdict()}
        return {f"rows/{name}": part[: self._rows].copy() for name, part in held.items()}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave."""
        self._rows = len(arrays["rows/time"])
        for name, held in {"time": self._time, **self._held._asdict()}.items():
            held[: self._rows] = arrays[f"rows/{name}"]


class Observed:
    """The accepted states of a run, passed to the observer in batches."""

    def __init__(self, system: System, events: Events, observer: Observer) -> None:
        self._system, self._events, self._observer = system, events, observer
        memories = (term.memory for term in system.forces.memories)
        self._keeps = any(memory is not None and memory.kept_in for memory in memories)
        self._lets_remember = any(call.remember is not None for call in system.forces.calls)
        self._accepted: Accepted | None = None

    def open(self, model: Model, state: State) -> None:
        """The steps are those of a model that was built at a state."""
        self._model = model
        self.remember(state.memory)
        if self._accepted is None:
            self._accepted = Accepted(model.coordinates())
            self._append(state.time, model.coordinates())

    @property
    def accepted(self) -> Accepted:
        """The states that the observer has not received."""
        assert self._accepted is not None
        return self._accepted

    def report_memories(self, time: float) -> None:
        """Report the memories at a time [s]; raises what the observer raises."""
        self._events.report(time, self._remembered(), self.flush)

    def end_step(self, end: float, now: Coordinates) -> None:
        """Let compiled code change its memories at the end [s] of a step with these coordinates."""
        if self._lets_remember:
            self._model.applied.accepted(end, now.q, now.v)

    def add(self, end: float, now: Coordinates, *, last: bool) -> None:
        """Take the accepted step that ends at a time [s] with these coordinates.

        last : no other comes before somebody asks for the state
        """
        self._append(end, now)
        if last and not self.accepted.finite:
            self.flush()

    def change(self, time: float, change: Change) -> None:
        """An event is about to change memories, or the state, at a time [s]."""
        if change.quiet:
            return
        if self.accepted.last_time != time:
            self._append(time, self._model.coordinates())
        self.flush()  # so that no batch has states from before and after

    def changed(self, now: Coordinates) -> None:
        """Events have made another state of the last one."""
        self.accepted.begin_with(now)

    def _append(self, time: float, now: Coordinates) -> None:
        if self.accepted.append(time, now):
            self.flush()

    def flush(self) -> None:
        """Let the observer see the states that it has not seen."""
        rows = self.accepted.take()
        if rows is not None:
            time, states = rows
            self.recall()
            moving = self._model.places.unpack(states, time, self._events.memory)
            x, v = self._system.layout.pack(moving)
            self._observer.take(States(self._system, time, x, v, self._events.memory))

    def remember(self, memory: Arrays) -> None:
        """Let all forces take the memories as they are now."""
        remember(self._model, self._system, memory)

    def recall(self) -> None:
        """Take over the memories that compiled code has changed itself."""
        for name, values in self._remembered():
            self._events.memory[name][:] = values

    def _remembered(self) -> Iterator[tuple[str, Floats]]:
        """These memories, with their names; not copies."""
        if self._keeps:
            yield from self._model.applied.remembered.items()

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._model.applied.push(force)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For a snapshot: states that are not flushed, and all memories."""
        self.recall()
        memory = {f"memory/{name}": values.copy() for name, values in self._events.memory.items()}
        return {**self.accepted.arrays(), **memory}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave, in a model that has the memories."""
        self.accepted.restore(arrays)


class Stepper:
    """The integrator that has Exudyn step; see `exunet.integrators.protocol.Integrator`.

    The observer gets every accepted state.
    """

    def __init__(
        self,
        system: System,
        state: State,
        plan: Plan,
        observer: Observer,
    ) -> None:
        self._system, self._plan = system, plan
        self._method = METHODS[plan.method]
        self._adaptive = self._method.kind == Kind.ADAPTIVE
        self._events = Events(system, state.memory, observer)
        self._observed = Observed(system, self._events, observer)
        self._counts = StepCounts()
        self._newton_before = 0  # in solvers that were started before
        self._pushed: Floats | None = None
        self.time = state.time
        self._open(state)
        self._changed: Coordinates | None = None  # by an event, to begin anew with
        self._begin: _Begin | None = None  # of a step in which a condition is watched
        self._aim = math.inf  # [s] just before or after a condition comes true, where a step is to end
        self._until = state.time

    def _open(self, state: State) -> None:
        """Build the model at a state, and start the engine's solver there."""
        room = self._pushed is not None
        self._model = build(self._system, state, self._plan, pushed=room)
        self._observed.open(self._model, state)
        if self._pushed is not None:
            self._observed.push(self._pushed)
        self._settings = settings_for(self._model, self._plan, state.time)
        self._start()
        self._idle_at(state.time)
        jumps = self._system.forces.cable.viscous and self._adaptive
        self._choice = StepChoice(self._plan, self._solver, self._settings, self._jump if jumps else None)

    def _idle_at(self, time: float) -> None:
        """Between two stretches."""
        self.time = self._step_start = self._attempt_end = time
        self._attempting = False
        self._stop: BaseException | None = None

    def _start(self) -> None:
        self._solver = started(self._model, self._plan, self._settings, self._before_attempt)

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
    def stopped(self) -> bool:
        return self._events.stopped

    def advance(self, until: float) -> None:
        if self._events.is_due(self.time) and self._look_for_events(self.time):
            self._renew()
        while self.time < until and not self.stopped:
            self._stretch(self._events.next_instant(self.time, min(until, self._aim)))
        self._observed.report_memories(self.time)

    def _stretch(self, until: float) -> None:
        self._set_stretch(until)
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
            stop, self._stop = self._stop, None
            if not isinstance(stop, _BeginAnew):
                raise stop
            self._choice.end_stretch(self._step_start)
            self._idle_at(self._step_start)
            self._renew()
            return
        if not done:
            self.flush()
            raise IntegrationFailed(
                words or first_line(self._solver.GetErrorString()) or "the engine stopped"
            )
        if self._attempting:
            self._counts.steps += 1
        self._choice.end_stretch(self._model.system.systemData.GetTime())
        self._idle_at(until)
        self._aim = math.inf
        self._observed.end_step(until, self._model.coordinates())
        if self._go_back(until):
            self._idle_at(self._step_start)
            self._choice.accepted(self._step_start)
            self._renew()
            return
        self._observed.add(until, self._model.coordinates(), last=True)
        if self._look_for_events(until) and not self.stopped:
            self._renew()

    def _set_stretch(self, until: float) -> None:
        self._until = until
        self._begin = None
        if self._events.watches:
            self._begin = self._watched(self.time, *self._flat(self.time))
        self._model.refresh()
        progress = self._solver.it
        self._choice.begin_stretch(until)
        progress.endTime = ends_at(until) if self._adaptive else until
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
            rejected = self._attempting and end_of_attempt <= self._attempt_end
            if rejected:
                self._counts.rejected += 1
            elif self._attempting:
                self._step_done(self._attempt_end)
            self._check_interrupt()
            if self._adaptive:
                end_of_attempt = self._choice.choose(end_of_attempt, self._attempting, rejected)
                self._choice.refuse_collapse(self._step_start)
            self._attempting = True
            self._attempt_end = end_of_attempt
            if self._adaptive:
                if self._events.in_steps:
                    self._shorten()
                self._choice.attempted()
        except BaseException as error:
            self._stop = error  # advance() raises it again
            raise  # returning False would not end the engine's search for a smaller step
        return True

    def _step_done(self, time: float) -> None:
        self._counts.steps += 1
        self._step_start = time
        self._choice.accepted(time)
        self._observed.end_step(time, self._model.coordinates_in_call())
        if self._go_back(time):
            raise _BeginAnew
        self._observed.add(time, self._model.coordinates_in_call(), last=time >= self._until)
        if self._look_for_events(time):
            raise _BeginAnew

    def _shorten(self) -> None:
        """Make the step that is about to be tried end near the next event."""
        x, v = self._flat(self._step_start)
        step, least = self._attempt_end - self._step_start, 8.0 * self._plan.least_step
        shorter = self._events.step_within(step, least, x, v)
        if shorter < step:
            progress = self._solver.it
            progress.currentStepSize = shorter
            progress.currentTime = self._attempt_end = self._step_start + shorter

    def _jump(self, within: float) -> Jump | None:
        """The next jump of the forces ahead of the state at a step's start."""
        now = self._model.coordinates()
        # The last stage of the adaptive methods was evaluated at the last step's end.
        after = np.array(self._model.system.systemData.GetODE2Coordinates_tt())
        position, velocity, *_ = self._model.places.unpack(now, self._step_start, self._events.memory)
        acceleration = self._model.places.of_coordinates(now._replace(v=after)).velocity
        law = law_of(self._system.forces, self._events.memory)
        state = (position, velocity, acceleration)
        assert self._plan.tolerance is not None
        return jump_ahead(self._system.blocks, law, within, self._plan.tolerance, self._step_start, state)

    def _flat(self, time: float) -> tuple[Floats, Floats]:
        """The state now, at a time [s], as x and v, see `exunet.forces.blocks`; copies."""
        now = self._model.places.unpack(self._model.coordinates(), time, self._events.memory)
        return self._system.layout.pack(now)

    def _look_for_events(self, time: float) -> bool:
        """True if one, at the end of an accepted step, makes the solver begin anew."""
        if not self._events.any:
            return False
        self._observed.recall()
        found = moved = False
        x, v = self._flat(time)
        for name, change in self._events.at(time, x, v):
            found = True
            self._observed.change(time, change)
            for held, other in ((x, change.x), (v, change.v)):
                if other is not None:
                    held[:] = other
                    moved = True
            self._observed.remember(self._events.memory_after(name, change))
        if moved:
            places, now = self._model.places, self._model.coordinates()
            self._changed = places.pack(self._system.layout.unpack(x, v), now)
            self._observed.changed(self._changed)
        self._begin = self._watched(time, x, v)
        planned = found and self._events.next_instant(time, self._until) < self._until
        return moved or self.stopped or planned or (found and self._method.remembers_acceleration)

    def _watched(self, time: float, x: Floats, v: Floats) -> _Begin | None:
        """The beginning of a step in which conditions are watched."""
        if not self._events.watches:
            return None
        now = self._changed or Coordinates(*(np.array(part) for part in self._model.coordinates()))
        memory = {name: values.copy() for name, values in self._events.memory.items()}
        return _Begin(self._seen(time, x, v), now, memory)

    def _seen(self, time: float, x: Floats, v: Floats) -> Seen:
        return self._events.seen(np.array([time]), x[None].copy(), v[None].copy())

    def _go_back(self, time: float) -> bool:
        """Return to the start of the step that ends at a time [s] if a condition comes true before its end.

        The solver is then to begin anew there, for a step that ends near the crossing.
        """
        if self._begin is None:
            return False
        self._observed.recall()
        end = self._seen(time, *self._flat(time))
        target = self._events.crossing(self._begin.seen, end)
        if target is None or not target < time:
            self._events.steps_done(end)
            return False
        self._counts.steps -= 1
        self._counts.rejected += 1
        self._aim, self._changed = target, self._begin.coordinates
        self._step_start = float(self._begin.seen.time[0])
        self._events.memory.update({name: values.copy() for name, values in self._begin.memory.items()})
        self._observed.remember(self._events.memory)
        return True

    def _renew(self) -> None:
        """Start the solver again where it stands, or at the state that an event has made."""
        now = self._changed or Coordinates(*(np.array(part) for part in self._model.coordinates()))
        self._changed = None
        kinds = exudyn().ConfigurationType
        put(self._model, now, self.time, kinds.Initial)
        self._settings.timeIntegration.startTime = self.time
        newton, choice = self._counts.newton_iterations, self._choice
        self._start()  # which computes the accelerations
        self._choice = StepChoice(self._plan, self._solver, self._settings, choice.jump)
        if self._adaptive:
            self._choice.restore(choice.numbers())
        self._newton_before = newton

    def flush(self) -> None:
        self._observed.flush()

    def state(self) -> State:
        self._observed.recall()
        memory = {name: values.copy() for name, values in self._events.memory.items()}
        now = Coordinates(*(np.array(part) for part in self._model.coordinates()))
        return State.of(self.time, self._model.places.unpack(now, self.time, memory), memory)

    def view(self) -> State:
        return self.state()

    def moving(self) -> Moving:
        return self.state().moving

    def steer(self, port: str, piece: Piece) -> None:
        self.steered(port)

    def steered(self, port: str) -> Piece:
        raise InputError(f'bodies.{port}: a port needs engine.backend = "compiled"')

    def push(self, force: Floats) -> None:
        self._pushed = force.copy()
        if self._model.applied is None:  # connectors alone: build them again with room for other forces
            self._open(self.state())
        self._observed.push(force)
        self._forces_changed()

    def set_inputs(self, inputs: Arrays) -> None:
        self._observed.recall()
        for name, values in inputs.items():
            self._events.memory[name] = values.copy()
        self._observed.remember(self._events.memory)
        self._forces_changed()

    def _forces_changed(self) -> None:
        if self._method.remembers_acceleration:
            self._renew()

    def snapshot(self) -> dict[str, NDArray[Any]]:
        data = self._model.system.systemData
        arrays = {
            "time": np.array(self.time),
            # Displacements: their sum with the reference loses bits.
            **{name: np.array(part) for name, part in self._model.coordinates()._asdict().items()},
            "a": np.array(data.GetODE2Coordinates_tt()),  # what VelocityVerlet's next step begins with
            "counts": np.array([self._counts.steps, self._counts.rejected]),
            "choice": self._choice.numbers(),
            **self._observed.arrays(),
        }
        pushed = np.zeros((0, 3)) if self._pushed is None else self._pushed.copy()
        return {**arrays, "pushed": pushed}

    def restore(self, arrays: Arrays) -> None:
        """The solver is started anew: nothing of what it did since then may be left in it."""
        pushed = np.array(arrays["pushed"]) if len(arrays["pushed"]) else None
        if (pushed is None) != (self._pushed is None):
            self._pushed = pushed
            self._open(self.state())
        if pushed is not None:
            self._pushed = pushed
            self._observed.push(pushed)
        for name in self._events.memory:
            self._events.memory[name] = np.array(arrays[f"memory/{name}"])
        self._observed.remember(self._events.memory)
        time, engines_time = float(arrays["time"]), float(arrays["choice"][0])
        self._settings = settings_for(self._model, self._plan, time)
        kinds, data = exudyn().ConfigurationType, self._model.system.systemData
        now, accelerations = Coordinates(arrays["q"], arrays["v"], arrays["y"]), arrays["a"]
        put(self._model, now, engines_time, kinds.Initial)  # for the solver to start from
        data.SetODE2Coordinates_tt(accelerations, kinds.Initial)
        self._start()
        put(self._model, now, engines_time, kinds.Current)  # starting it has changed the accelerations
        data.SetODE2Coordinates_tt(accelerations, kinds.Current)
        jump = self._choice.jump
        self._choice = StepChoice(self._plan, self._solver, self._settings, jump)
        self._choice.restore(arrays["choice"])
        self._counts = StepCounts(*(int(number) for number in arrays["counts"]))
        self._idle_at(time)
        self._observed.restore(arrays)


class _Begin(NamedTuple):
    """Start of a step: as conditions are evaluated, and what is restored to repeat the step."""

    seen: Seen
    coordinates: Coordinates
    memory: dict[str, Floats]


class _BeginAnew(Exception):
    """An event has changed what the engine's solver has in hand."""
