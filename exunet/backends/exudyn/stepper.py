"""Time stepping with Exudyn's own integrators, stretch by stretch, every accepted step looked at."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.events import Events
from exunet.backends.exudyn.build import build
from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.exudyn.loading import exudyn
from exunet.backends.exudyn.observed import Observed
from exunet.backends.exudyn.settings import ends_at, settings_for
from exunet.backends.exudyn.solver import first_line, put, started
from exunet.backends.exudyn.step_choice import StepChoice
from exunet.backends.protocol import Arrays, IntegrationFailed, Observer, StepCounts
from exunet.base.errors import InputError
from exunet.base.interrupt import postponed
from exunet.bodies.port import Piece
from exunet.forces.cable_term import Jump, jump_ahead
from exunet.forces.terms import Seen
from exunet.methods.method import METHODS, Kind
from exunet.methods.plan import Plan
from exunet.system.energy import law_of
from exunet.system.system import Moving, State, System

Floats = NDArray[np.float64]


class Stepper:
    """The integrator that has Exudyn step; see `exunet.backends.protocol.Integrator`.

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
        self._begin: Seen | None = None  # of a step in which a condition is watched
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
            self._stretch(self._events.next_instant(self.time, until))
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
            self.hand_over()
            raise IntegrationFailed(
                words or first_line(self._solver.GetErrorString()) or "the engine stopped"
            )
        if self._attempting:
            self._counts.steps += 1
        self._choice.end_stretch(self._model.system.systemData.GetTime())
        self._idle_at(until)
        self._observed.add(until, self._model.coordinates(), last=True)
        if self._look_for_events(until) and not self.stopped:
            self._renew()

    def _set_stretch(self, until: float) -> None:
        self._until = until
        self._begin = None
        if self._events.watches:
            self._begin = self._watched(self.time, *self._flat(self.time))
        self._model.look_again()
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
        if self._begin is not None:
            end = self._events.seen(np.array([time]), x[None].copy(), v[None].copy())
            self._events.crossing(self._begin, end)
            self._events.steps_done(end)
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

    def _watched(self, time: float, x: Floats, v: Floats) -> Seen | None:
        """The beginning of a step in which conditions are watched."""
        if not self._events.watches:
            return None
        return self._events.seen(np.array([time]), x[None].copy(), v[None].copy())

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

    def hand_over(self) -> None:
        self._observed.hand_over()

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

    def tell(self, inputs: Arrays) -> None:
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


class _BeginAnew(Exception):
    """An event has changed what the engine's solver has in hand."""
