"""Advance a simulation under its guards; go back to the last safe state and retry with finer steps.

A retry goes through the same times again, with the same external forces and inputs: it ends where the caller
is.
"""

from __future__ import annotations

import time as clock
from bisect import bisect_right
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exunet.base.arguments import finite_number, finite_vector, shown, whole_number
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.interrupt import postponed
from exunet.integrators import integrator
from exunet.integrators.protocol import IntegrationFailed, Integrator, StepCounts, StepsCollapsed
from exunet.methods.method import Plan
from exunet.model.system import State, System
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import Recorder

LEAST_TOLERANCE = 1e-12  # below it, steps are rejected for round-off without a gain
FINER_STEP = 0.5
FINER_TOLERANCE = 0.1  # of a method of order 5, steps that are 0.63 times as long


def finer(plan: Plan) -> Plan | None:
    """Return the plan with half the step, or a tenth of the tolerance; None if neither can be reduced."""
    if plan.step is not None:
        return replace(plan, step=FINER_STEP * plan.step)
    if plan.tolerance is None or plan.tolerance <= LEAST_TOLERANCE:
        return None
    return replace(
        plan,
        tolerance=max(LEAST_TOLERANCE, FINER_TOLERANCE * plan.tolerance),
        first_step=FINER_STEP * plan.first_step,
        longest_step=FINER_STEP * plan.longest_step,
        least_step=FINER_STEP * plan.least_step,
    )


class Stops:
    """Times [s] to which a simulation was advanced, each with the external forces and inputs until there."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._forces: list[Floats] = []

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, k: int) -> tuple[float, Floats]:
        return self._times[k], self._forces[k]

    def add(self, time: float, force: Floats) -> None:
        """Add a later time; equal vectors are stored once, without a copy."""
        last = self._forces[-1] if self._forces else force
        self._times.append(time)
        self._forces.append(last if force is last or np.array_equal(force, last) else force)

    def after(self, time: float) -> int:
        """Return the number of the first stop after a time [s]."""
        return bisect_right(self._times, time)

    def forget_until(self, time: float) -> None:
        """Drop the stops until a time [s]."""
        first = self.after(time)
        del self._times[:first], self._forces[:first]

    def forget_after(self, time: float) -> None:
        """Drop the stops after a time [s]."""
        first = self.after(time)
        del self._times[first:], self._forces[first:]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the stops for a snapshot; each distinct vector once."""
        distinct = {id(force): force for force in self._forces}
        number = {key: k for k, key in enumerate(distinct)}
        return {
            "times": np.array(self._times, dtype=float),
            "force": np.array([number[id(force)] for force in self._forces], dtype=np.int64),
            "forces": np.array(list(distinct.values()), dtype=float),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        forces = [np.array(force) for force in arrays["forces"]]
        self._times = arrays["times"].tolist()
        self._forces = [forces[k] for k in arrays["force"].tolist()]


class ExternalInputs:
    """Layout of the vector of external forces (3 n_points,) [N] and inputs.

    at_start : vector at time 0
    """

    def __init__(self, system: System) -> None:
        self._blocks, self._scripted = system.blocks, system.scripted
        inputs = {name: value for name, value in system.inputs.items() if name not in system.scripted}
        parts = [np.zeros(3 * system.blocks.n_points), *(value.initial for value in inputs.values())]
        self.at_start: Floats = np.concatenate(parts)
        ends = np.cumsum([len(part) for part in parts])
        self._where = {
            name: slice(start, end) for name, start, end in zip(inputs, ends[:-1], ends[1:], strict=True)
        }

    def forces(self, vector: Floats) -> Floats:
        """Return the forces (n_points, 3) [N]."""
        return vector[: 3 * self._blocks.n_points].reshape(-1, 3)

    def inputs(self, vector: Floats) -> dict[str, Floats]:
        """Return the values of each input, by name."""
        return {name: vector[where] for name, where in self._where.items()}

    def with_force(self, vector: Floats, on: int | str, force: ArrayLike) -> Floats:
        """Return a new vector with another force (3,) [N] on a node, or on a point mass by name.

        Raises InputError for an unknown node or point mass, and for a force that is not three finite numbers.
        """
        blocks = self._blocks
        number = blocks.body.get(on) if isinstance(on, str) else whole_number(on)
        if number is None and isinstance(on, str):
            with suppress(ValueError):
                number = blocks.net.node(on)
        if number is None or not (isinstance(on, str) or 0 <= number < blocks.net.n_nodes):
            nodes = ", ".join(filter(None, (f"0 to {blocks.net.n_nodes - 1}", blocks.net.node_names)))
            masses = ", ".join(blocks.body) or "none"
            words = f"nodes: {nodes}; point masses: {masses}"
            raise InputError(f"set_force: unknown node or point mass {on!r} ({words})")
        values = finite_vector(force, 3)
        if values is None:
            raise InputError(f"set_force: force must be three finite numbers, got {force!r}")
        changed = vector.copy()
        changed[3 * number : 3 * number + 3] = values
        return changed

    def with_input(self, vector: Floats, name: str, values: ArrayLike) -> Floats:
        """Return a new vector with other values of an input; raise InputError if they are not valid."""
        where = self._where.get(name) if isinstance(name, str) else None
        if where is None and isinstance(name, str) and name in self._scripted:
            raise InputError(f"set_input: {name!r} is set by the script of the case")
        if where is None:
            words = ", ".join(self._where) or "none"
            raise InputError(f"set_input: unknown input {name!r} (inputs: {words})")
        number = where.stop - where.start
        new = finite_vector(values, number)
        if new is None:
            numbers = "a finite number" if number == 1 else f"{number} finite numbers"
            raise InputError(f"set_input: {name} must be {numbers}, got {values!r}")
        changed = vector.copy()
        changed[where] = new
        return changed

    def with_changes(self, vector: Floats, then: Floats, now: Floats) -> Floats:
        """Return a new vector with the forces and inputs of `now` that differ from those of `then`.

        Raises InputError for arrays of another shape.
        """
        for given in (then, now):
            if not isinstance(given, np.ndarray) or given.shape != vector.shape:
                words = f"needs two arrays of `acting`, ({len(vector)},), got {shown(given)}"
                raise InputError(f"repeat_changes: {words}")
        changed = vector.copy()
        of_a_point = [slice(k, k + 3) for k in range(0, 3 * self._blocks.n_points, 3)]
        for where in (*of_a_point, *self._where.values()):
            if not np.array_equal(then[where], now[where]):
                changed[where] = now[where]
        return changed


class Attempts:
    """Integrator of a simulation with its guards, times, external forces and inputs, and retries.

    recorder : stores the states at its times; None without storage
    """

    def __init__(self, start: Start, recorder: Recorder | None) -> None:
        self._start, self._recorder = start, recorder
        self._plan, self._retries = start.plan, start.scene.solver.retry
        self._external = ExternalInputs(start.system)
        self._acting = self._external.at_start
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
        """Make an integrator at a state with the present plan."""
        self._monitor.explain(self._plan)
        began, start = clock.perf_counter(), self._start
        try:
            made = integrator(start.system, state, self._plan, self._monitor)
        except IntegrationFailed as failure:
            raise RunStopped(f"not started: {failure}") from failure
        self._let_act(made, self._external.at_start)
        if self._recorder is not None:
            self._recorder.built(made.items, clock.perf_counter() - began)
        return made

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._integrator.time

    @property
    def plan(self) -> Plan:
        """Plan of integration; finer after a retry."""
        return self._plan

    @property
    def counts(self) -> StepCounts:
        """Steps and force evaluations so far, of all attempts."""
        return self._spent + self._integrator.counts

    def _through(self, stop: int) -> None:
        """Advance to a stop and those after it, with their external forces and inputs."""
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
        """Check all states; if steps failed, return to this time with finer steps."""
        while not self.finish():
            self._through(self._stops.after(self.time))

    def attempt(self, until: float) -> bool:
        """Advance to a time [s], or to the end of the run by a script.

        Returns
        -------
        bool
            False if steps failed and the simulation went back to an earlier state.

        Raises
        ------
        RunStopped
            If the run diverges and no retry is left.
        Interrupted
            On Ctrl-C.
        InputError
            For a time that is not a finite number.
        """
        if finite_number(until) is None:
            raise InputError(f"attempt: time [s] must be a finite number, got {shown(until)}")
        self._monitor.mark(until)
        began = clock.perf_counter()
        try:
            with postponed():  # Ctrl-C must not interrupt the check of a batch
                self._integrator.advance(until)
                if self._recorder is not None:
                    self._recorder.flush(all_of_them=False)
        except (RunStopped, IntegrationFailed) as failure:
            self._seconds += clock.perf_counter() - began
            self._retry(self._failure(failure) if isinstance(failure, IntegrationFailed) else failure)
            return False
        except KeyboardInterrupt:
            self._seconds += clock.perf_counter() - began
            error = self.interrupted()
            self._to_safe_state()
            raise error from None
        self._seconds += clock.perf_counter() - began
        return True

    def interrupted(self) -> Interrupted:
        """Return the error for Ctrl-C, with the last checked time."""
        with suppress(RunStopped):  # the monitor has the last valid state
            self._integrator.flush()
        if self._recorder is None:
            until = self._monitor.safe.time
            return Interrupted(f"interrupted; the simulation is at its last valid state, t = {until:.6g} s")
        until = self._recorder.until
        return Interrupted(f"interrupted after t = {until:.6g} s")

    def _to_safe_state(self) -> None:
        """Go to the last safe state after a failure, with its energy balance.

        A run with a recorder is over; its states are in the record.
        """
        if self._recorder is None:
            self._spent = self._spent + self._integrator.counts
            self._integrator = self._begin(self._monitor.go_back())

    def finish(self) -> bool:
        """Check the last states; return False if one failed and the simulation went back."""
        try:
            self._integrator.flush()
        except RunStopped as stop:
            self._retry(stop)
            return False
        return True

    def _failure(self, failure: IntegrationFailed) -> RunStopped:
        """Return the error for an integrator that failed: of its last states, else its own."""
        try:
            self._integrator.flush()
        except RunStopped as stop:
            return stop
        return self._monitor.engine_failed(failure, step_cause=not isinstance(failure, StepsCollapsed))

    def _retry(self, stop: RunStopped) -> None:
        """Go back to the last safe state with finer steps; raise the error if no retry is left."""
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
        """Set external forces and inputs from now on; return False if the simulation went back."""
        if acting is self._acting or np.array_equal(acting, self._acting):
            return True
        if not self.finish():
            return False
        before, self._acting = self._acting, acting
        self._let_act(self._integrator, before)
        return True

    def _let_act(self, integrator: Integrator, before: Floats) -> None:
        """Set changed forces and inputs in the monitor and the integrator."""
        force, inputs = self._external.forces(self._acting), self._external.inputs(self._acting)
        self._monitor.push(force)
        if inputs:
            self._monitor.set_inputs(inputs)
            integrator.set_inputs(inputs)
        if not np.array_equal(force, self._external.forces(before)):
            integrator.push(force)

    def spent(self) -> tuple[StepCounts, float]:
        """Return counts of the integration so far, and its wall time [s]."""
        return self.counts, self._seconds

    @property
    def monitor(self) -> Monitor:
        """Guards, balances and records of the simulation."""
        return self._monitor
