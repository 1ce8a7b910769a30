"""One run: the time loop over the stored times, and its outcome as a Result."""

from __future__ import annotations

import platform
import time as clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet import cable, energy
from exunet.build import Start, build, prepare
from exunet.casefile import Case
from exunet.effects import switched_on
from exunet.engine.loading import exudyn_version
from exunet.engine.stepper import EngineFailed, Stepper
from exunet.errors import Interrupted, RunStopped
from exunet.monitor import Monitor
from exunet.result import Result
from exunet.scene import Scene
from exunet.times import stored_times

if TYPE_CHECKING:
    from exunet.loop.loop import Loop

Floats = NDArray[np.float64]
Progress = Callable[[float], None]


def run(case: Case | Scene, progress: Progress | None = None) -> Result:
    """Simulate a case (or a scene) and return its result.

    progress : called with the simulated time [s] now and then
    Raises RunStopped (its `partial` holds what was computed) if the run diverges or the engine gives up,
    Interrupted (also with `partial`) on Ctrl-C.
    """
    scene = case if isinstance(case, Scene) else case.scene
    provenance: dict[str, Any] = {}
    if isinstance(case, Case):
        provenance = {"case": case.path.name, "text": case.text, "overrides": list(case.overrides)}
    return simulate(prepare(scene), provenance, progress)


def simulate(
    start: Start, provenance: dict[str, Any] | None = None, progress: Progress | None = None
) -> Result:
    """Run from a prepared start (see `exunet.build.prepare`), which a script may have changed."""
    record = _Record(start, provenance or {})
    times = stored_times(start.scene.time)
    monitor = Monitor(start.net, start.terms, start.position, start.velocity)

    def watch(time: Floats, position: Floats, velocity: Floats, taken: Floats | None = None) -> None:
        monitor(time, position, velocity, taken)
        if progress:
            progress(float(time[-1]))

    record.store(0.0, (start.position, start.velocity), 0.0)
    try:
        stepper = _stepper(start, float(times[-1]), watch, record)
    except EngineFailed as failure:
        raise RunStopped(f"not started: {failure}", record.result("not started")) from failure
    began = clock.perf_counter()
    verdict: RunStopped | None = None
    try:
        for until in times[1:]:
            stepper.advance(float(until))
            taken = monitor.dissipated if stepper.dissipated is None else stepper.dissipated
            record.store(float(until), stepper.state(), taken)
    except RunStopped as stop:
        record.forget_after(monitor.good_until)
        verdict = stop
    except EngineFailed as failure:
        verdict = RunStopped(f"the engine stopped after t = {stepper.time:.6g} s: {failure}")
    except KeyboardInterrupt:
        verdict = Interrupted(f"interrupted after t = {stepper.time:.6g} s; what was computed is kept")
    record.integrated(stepper, clock.perf_counter() - began)
    if verdict:
        verdict.partial = record.result(str(verdict))
        raise verdict
    return record.result("ok")


def _stepper(start: Start, end: float, watch: Callable[..., None], record: _Record) -> Stepper | Loop:
    """The engine, or the compiled loop, at time 0; raises EngineFailed, or MissingExtra without Numba."""
    began = clock.perf_counter()
    if start.scene.engine.loop == "compiled":
        from exunet.loop.loop import Loop

        loop = Loop(start, end, watch)
        record.built({}, clock.perf_counter() - began)
        return loop
    model = build(start)
    record.built(model.items(), clock.perf_counter() - began)
    return Stepper(model, start.plan, end, watch, every=_sampling(start))


def _sampling(start: Start) -> int:
    """Every how many steps the monitor looks: all of them where it integrates the work of a term."""
    return 1 if start.terms.dissipates else 8


class _Record:
    """Gathers the stored states and what the run cost."""

    def __init__(self, start: Start, provenance: dict[str, Any]) -> None:
        self._start = start
        self._provenance = provenance | {
            "title": start.scene.title,
            "versions": _versions(),
            "platform": platform.platform(),
            "method": start.plan.method,
            "tolerance": start.plan.tolerance,
            "step": start.plan.step,
            "end": start.scene.time.end,
            "notes": list(start.plan.notes),
            "engine": start.scene.engine.model_dump(),
            "effects": sorted(switched_on(start.scene.effects)),
        }
        self._time: list[float] = []
        self._states: list[tuple[Floats, Floats]] = []
        self._dissipated: list[float] = []

    def built(self, items: dict[str, int], seconds: float) -> None:
        self._provenance |= {"items": items, "build_seconds": seconds}

    def store(self, time: float, state: tuple[Floats, Floats], dissipated: float) -> None:
        self._time.append(time)
        self._states.append(state)
        self._dissipated.append(dissipated)

    def forget_after(self, time: float) -> None:
        """Drop the states after `time` [s]: the guards look at batches, which may end after one."""
        good = sum(stored <= time for stored in self._time)
        del self._time[good:], self._states[good:], self._dissipated[good:]

    def integrated(self, stepper: Stepper | Loop, seconds: float) -> None:
        self._provenance |= {
            "steps": stepper.counts.steps,
            "rejected_steps": stepper.counts.rejected,
            "right_hand_sides": stepper.right_hand_sides,
            "newton_iterations": stepper.counts.newton_iterations,
            "integration_seconds": seconds,
        }

    def result(self, verdict: str) -> Result:
        net, terms = self._start.net, self._start.terms
        position, velocity = (np.array(states) for states in zip(*self._states, strict=True))
        length = cable.lengths(net, position)
        return Result(
            net=net,
            time=np.array(self._time),
            position=position,
            velocity=velocity,
            strain=cable.green_lagrange_strain(length, net.reference_length),
            tension=cable.element_tension(net, terms.law(net), position, velocity),
            kinetic=energy.kinetic(net, velocity),
            elastic=energy.elastic(net, terms, position),
            potential=energy.potential(terms, position),
            dissipated=np.array(self._dissipated),
            momentum=energy.momentum(net, velocity),
            angular_momentum=energy.angular_momentum(net, position, velocity),
            complete=verdict == "ok",
            verdict=verdict,
            provenance=self._provenance,
        )


def _versions() -> dict[str, str]:
    return {
        "exunet": exunet.__version__,
        "exudyn": exudyn_version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
