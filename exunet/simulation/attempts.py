"""How a simulation goes on under the guards' eyes: by steps, and back to try again with finer ones."""

from __future__ import annotations

import time as clock
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends import integrator
from exunet.backends.protocol import IntegrationFailed, Integrator, StepCounts, StepsCollapsed
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.interrupt import postponed
from exunet.methods.method import TimeLoop
from exunet.methods.plan import Plan
from exunet.simulation.arguments import finite_number
from exunet.simulation.monitor import Monitor
from exunet.simulation.outside import Outside
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import Recorder
from exunet.simulation.refinement import finer
from exunet.simulation.stops import Stops
from exunet.system.system import State

Floats = NDArray[np.float64]


class Attempts:
    """The integrator of a simulation, its guards, the times it was taken to, and what acts from outside.

    recorder : stores the states that its times ask for; None: nothing is stored
    """

    def __init__(self, start: Start, recorder: Recorder | None) -> None:
        self._start, self._recorder = start, recorder
        self._plan, self._retries = start.plan, start.scene.solver.retry
        self._outside = Outside(start.system)
        self._acting = self._outside.at_start
        self._stops = Stops()
        kept: dict[str, Any] = {}
        if recorder is not None:
            kept = {"store": recorder.store, "envelope": recorder.envelope}
            kept |= {"element_peaks": recorder.element_peaks, "series": recorder.series}
        self._monitor = Monitor(start.system, start.state, **kept)
        self._spent = StepCounts()
        self._seconds = 0.0
        self._integrator = self._begin(start.state)

    def _begin(self, state: State) -> Integrator:
        """An integrator at a state, by the plan as it is now."""
        self._monitor.explain(self._plan, TimeLoop(self._start.scene.engine.loop))
        began, start = clock.perf_counter(), self._start
        try:
            made = integrator(start.scene.engine, start.system, state, self._plan, self._monitor)
        except IntegrationFailed as failure:
            raise RunStopped(f"not started: {failure}") from failure
        self._let_act(made, self._outside.at_start)
        if self._recorder is not None:
            self._recorder.built(made.items, clock.perf_counter() - began)
        return made

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return self._integrator.time

    @property
    def plan(self) -> Plan:
        """How it is integrated; finer than at the start after a retry."""
        return self._plan

    @property
    def counts(self) -> StepCounts:
        """Steps and evaluations of the forces so far, all attempts together."""
        return self._spent + self._integrator.counts

    def _through(self, stop: int) -> None:
        """Go to a stop and those after it, with what acts until there."""
        stops = self._stops
        try:
            while stop < len(stops):
                time, acting = stops[stop]
                arrived = self._act(acting) and self.attempt(time)
                stop = stop + 1 if arrived else stops.after(self.time)
        except BaseException:
            stops.forget_after(self.time)
            raise
        stops.forget_until(self._monitor.safe.time)

    def settle(self) -> None:
        """Let the guards see all states; if steps failed, the simulation comes here again with finer ones."""
        while not self.finish():
            self._through(self._stops.after(self.time))

    def attempt(self, until: float) -> bool:
        """Go on to a time [s], or to where the script of the case ends the run; False if steps failed and the
        simulation went back to an earlier state.

        Raises RunStopped if it cannot, Interrupted on Ctrl-C, and InputError for what is no time.
        """
        if finite_number(until) is None:
            raise InputError(f"attempt: needs a finite time [s], got {until!r}")
        self._monitor.mark(until)
        began = clock.perf_counter()
        try:
            with postponed():  # so that Ctrl-C does not cut a look at a batch in two
                self._integrator.advance(until)
                if self._recorder is not None:
                    self._recorder.flush(all_of_them=False)
        except (RunStopped, IntegrationFailed) as failure:
            self._seconds += clock.perf_counter() - began
            self._retry(self._gave_up(failure) if isinstance(failure, IntegrationFailed) else failure)
            return False
        except KeyboardInterrupt:
            self._seconds += clock.perf_counter() - began
            error = self.interrupted()
            self._to_safe_state()
            raise error from None
        self._seconds += clock.perf_counter() - began
        return True

    def interrupted(self) -> Interrupted:
        """The error for Ctrl-C, after the guards have seen what was computed; tells until when that is."""
        with suppress(RunStopped):  # the monitor knows until when states are good
            self._integrator.hand_over()
        if self._recorder is None:
            until = self._monitor.safe.time
            return Interrupted(f"interrupted; the simulation is at its last good state, t = {until:.6g} s")
        until = self._recorder.until
        return Interrupted(f"interrupted after t = {until:.6g} s")

    def _to_safe_state(self) -> None:
        """After a failure: be at the last good state that was asked for, with the books of that state.

        A run that stores has its states in the record, and is over.
        """
        if self._recorder is None:
            self._spent = self._spent + self._integrator.counts
            self._integrator = self._begin(self._monitor.go_back())

    def finish(self) -> bool:
        """Let the guards see the last states; False if one was wrong and the simulation went back."""
        try:
            self._integrator.hand_over()
        except RunStopped as stop:
            self._retry(stop)
            return False
        return True

    def _gave_up(self, failure: IntegrationFailed) -> RunStopped:
        """The error for an integrator that gave up: what the guards find in its last states, else its own."""
        try:
            self._integrator.hand_over()
        except RunStopped as found:
            return found
        return self._monitor.engine_failed(failure, step_cause=not isinstance(failure, StepsCollapsed))

    def _retry(self, stop: RunStopped) -> None:
        """Go back to the last safe state with finer steps; raises the error if there are none."""
        plan = finer(self._plan) if stop.step_cause and self._retries else None
        if plan is None:
            self._to_safe_state()
            raise stop
        self._spent = self._spent + self._integrator.counts
        self._plan, self._retries = plan, self._retries - 1
        state = self._monitor.go_back()
        if self._recorder is not None:
            self._recorder.go_back(state.time)
            self._recorder.retried(str(stop), state.time, plan)
        self._integrator = self._begin(state)

    def _act(self, acting: Floats) -> bool:
        """Let this act from outside from now on; False if the simulation went back."""
        if acting is self._acting or np.array_equal(acting, self._acting):
            return True
        if not self.finish():
            return False
        before, self._acting = self._acting, acting
        self._let_act(self._integrator, before)
        return True

    def _let_act(self, integrator: Integrator, before: Floats) -> None:
        """Tell the books and the integrator, as far as it is not as it was."""
        force, inputs = self._outside.forces(self._acting), self._outside.inputs(self._acting)
        self._monitor.push(force)
        if inputs:
            self._monitor.tell(inputs)
            integrator.tell(inputs)
        if not np.array_equal(force, self._outside.forces(before)):
            integrator.push(force)

    def spent(self) -> tuple[StepCounts, float]:
        """What the integration has cost so far, and the wall time in it [s]."""
        return self.counts, self._seconds

    @property
    def monitor(self) -> Monitor:
        """The guards, balances and records of this simulation."""
        return self._monitor
