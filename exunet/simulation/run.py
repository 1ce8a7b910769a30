"""One run: the time loop over the stored times, its retries, and its outcome as a Result."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.stepper import EngineFailed, Stepper, StepsCollapsed
from exunet.base.errors import Interrupted, RunStopped
from exunet.base.interrupt import postponed
from exunet.case.casefile import Case
from exunet.case.scene import Scene
from exunet.case.stored_times import stored_times
from exunet.methods.method import TimeLoop
from exunet.results.result import Result
from exunet.simulation.breaking import Breaks
from exunet.simulation.monitor import Monitor
from exunet.simulation.preparation import Start, build, prepare, prepare_case
from exunet.simulation.recorder import GOOD_PART, Recorder
from exunet.simulation.refinement import finer

if TYPE_CHECKING:
    from exunet.backends.compiled.loop import Loop

Floats = NDArray[np.float64]
Progress = Callable[[float], None]
Keep = Callable[[Result], None]

KEEP_EVERY = 30.0  # [s] of wall time between two calls of `keep`
KEEP_PART = 0.02  # of a run's wall time that those calls may take


def run(case: Case | Scene, progress: Progress | None = None, keep: Keep | None = None) -> Result:
    """Simulate a case (or a scene) and return its result.

    progress : called with the simulated time [s] now and then
    keep     : called with the part done so far, marked as incomplete, at the start and every 30 s
    Raises RunStopped (its `partial` holds what was computed) if the run diverges or the engine gives up and
    `solver.retry` finer attempts do not mend it, Interrupted (also with `partial`) on Ctrl-C.
    """
    if isinstance(case, Scene):
        return simulate(prepare(case), {}, progress, keep)
    return simulate(prepare_case(case), provenance(case), progress, keep)


def provenance(case: Case) -> dict[str, Any]:
    """What a result tells of the case that it comes from."""
    return {"case": case.path.name, "text": case.text, "overrides": list(case.overrides)}


def simulate(
    start: Start,
    provenance: dict[str, Any] | None = None,
    progress: Progress | None = None,
    keep: Keep | None = None,
) -> Result:
    """Run from a prepared start, which a script may have changed (see `simulation.preparation.prepare`)."""
    record = Recorder(start, provenance or {})
    record.store(0.0, (start.position, start.velocity), 0.0)
    plan, retries = start.plan, start.scene.solver.retry
    monitor = Monitor(start.net, start.terms, start.position, start.velocity, envelope=record.envelope)
    record.peaks = monitor.peaks
    if start.terms.breaking is not None:
        record.breaks = Breaks(start.net, start.terms, monitor)
        if retries:
            record.note("no retries: elements that broke (effects.breaking) stay broken")
        retries = 0
    keeper = _Keeper(record, monitor, keep)
    while True:
        stop = _Attempt(replace(start, plan=plan), record, monitor, progress, keeper).run()
        if stop is None:
            result = record.result("ok")
            stop = monitor.review(result, record.off_by(result))
            if stop is None:
                return result
            record.forget_after(monitor.good_until)
        next_plan = finer(plan) if stop.step_cause and retries else None
        if next_plan is None:
            record.forget_off()  # what swung out between two looks of the guards, and back
            monitor.forget_after(record.last()[0])
            stop.partial = record.result(str(stop))
            raise stop
        plan, retries = next_plan, retries - 1
        record.forget_off(GOOD_PART)
        record.retried(str(stop), plan)
        monitor.go_back(*record.last())


class _Attempt:
    """One march from the last stored state of a record to the end."""

    def __init__(
        self, start: Start, record: Recorder, monitor: Monitor, progress: Progress | None, keeper: _Keeper
    ) -> None:
        self._begin, position, velocity, self._taken = record.last()
        self._start = replace(start, position=position, velocity=velocity)
        self._record = record
        self._monitor = monitor
        self._progress = progress
        self._keeper = keeper

    def run(self) -> RunStopped | None:
        """What stopped it, or None at the end of the run."""
        record, monitor = self._record, self._monitor
        monitor.explain(self._start.plan)
        times = stored_times(self._start.scene.time)
        try:
            stepper = self._stepper(float(times[-1]))
        except EngineFailed as failure:
            return RunStopped(f"not started: {failure}")
        began = clock.perf_counter()
        stop: RunStopped | None = None
        try:
            with postponed() as check_interrupt:  # else it could cut the storing of a state in two
                self._keeper()
                for until in times[len(record) :].tolist():
                    stepper.advance(until)
                    record.store(until, stepper.state(), self._dissipated(stepper, until))
                    if stepper.extremes is not None:
                        record.envelope.look(np.array([until]), *np.array(stepper.extremes)[:, None])
                    if stepper.largest_tension is not None:
                        monitor.peaks.take(*stepper.largest_tension)
                    self._keeper()
                    check_interrupt()
        except RunStopped as found:
            stop = found
        except EngineFailed as failure:
            stop = self._gave_up(stepper, failure)
        except KeyboardInterrupt:
            stop = self._interrupted(stepper)
        if stop is not None:
            record.forget_after(monitor.good_until)
        record.integrated(stepper, clock.perf_counter() - began)
        return stop

    def _gave_up(self, stepper: Stepper | Loop, failure: EngineFailed) -> RunStopped:
        """The error for an engine that gave up: what the guards find in its last states, else its own."""
        try:
            stepper.hand_over()
        except RunStopped as found:
            return found
        return self._monitor.engine_failed(failure, step_cause=not isinstance(failure, StepsCollapsed))

    def _interrupted(self, stepper: Stepper | Loop) -> Interrupted:
        """Keep all stored states that are good, those that the guards have yet to see among them."""
        with suppress(RunStopped):  # the monitor knows until when they are good
            stepper.hand_over()
        self._record.forget_after(self._monitor.good_until)
        self._record.forget_off()
        until = self._record.last()[0]
        return Interrupted(f"interrupted after t = {until:.6g} s; what was computed is kept")

    def _dissipated(self, stepper: Stepper | Loop, until: float) -> float | None:
        """Energy [J] taken out until now; None: the states of the last steps are still to be looked at."""
        if stepper.dissipated is not None:
            return stepper.dissipated
        seen = float(self._monitor.ledger[0][-1])
        return self._monitor.dissipated if seen >= until else None

    def _watch(self, time: Floats, position: Floats, velocity: Floats, taken: Floats | None = None) -> None:
        try:
            self._monitor(time, position, velocity, taken)
        finally:
            self._record.book(*self._monitor.ledger)
        if self._progress:
            self._progress(float(time[-1]))

    def _stepper(self, end: float) -> Stepper | Loop:
        """The engine, or the compiled loop, at the start; raises EngineFailed, MissingExtra without Numba."""
        start, began = self._start, clock.perf_counter()
        if start.scene.engine.loop == TimeLoop.COMPILED:
            from exunet.backends.compiled.loop import Loop

            loop = Loop(start, end, self._watch, begin=self._begin, taken=self._taken)
            self._record.built({}, clock.perf_counter() - began)
            if self._record.breaks is not None:
                loop.watch_for(self._record.breaks)
            return loop
        model = build(start)
        self._record.built(model.items(), clock.perf_counter() - began)
        stepper = Stepper(model, start.plan, end, self._watch, self._begin)
        if self._record.breaks is not None:
            stepper.watch_for(self._record.breaks)
        return stepper


class _Keeper:
    """Hands the part done to `keep`: at the start, lest an older result pass for this one, and later on."""

    def __init__(self, record: Recorder, monitor: Monitor, keep: Keep | None) -> None:
        self._record = record
        self._monitor = monitor
        self._keep = keep
        self._next = clock.monotonic()

    def __call__(self) -> None:
        if self._keep is None or clock.monotonic() < self._next:
            return
        began = clock.monotonic()
        until = self._monitor.good_until  # what the guards have not seen yet is not told
        self._keep(self._record.result(f"unfinished: written while the run was at t = {until:.6g} s", until))
        ended = clock.monotonic()
        self._next = ended + max(KEEP_EVERY, (ended - began) / KEEP_PART)
