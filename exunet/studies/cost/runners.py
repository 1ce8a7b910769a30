"""One run at one setting, in whichever code, with its wall time, counts and measures."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.base.errors import Interrupted, RunStopped
from exunet.case.scene import Engine, Scene, Time
from exunet.methods.keys import Solver
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import Pair
from exunet.studies.cost.measure import Measures, launch_speed, measures
from exunet.studies.cost.settings import Setting

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Counts:
    """Work of a run: `right_hand_sides` evaluations of the forces, residuals of implicit methods among them;
    Newton iterations of those (linear systems solved)."""

    steps: int
    rejected: int
    right_hand_sides: int
    newton: int


@dataclass(frozen=True)
class Trial:
    """One run: wall time of its stepping [s], and what came out, or why it failed."""

    seconds: float
    counts: Counts | None = None
    measures: Measures | None = None
    reason: str = ""


@dataclass(frozen=True)
class Subject:
    """The scene under study.

    start  : exunet's, to `times[-1]`
    pair   : the same in both codes; None if the reference does not know it
    times  : stored times from 0 to the end [s]
    moved  : (n_nodes, 3) added to the initial positions [m]
    """

    start: Start
    pair: Pair | None
    times: tuple[float, ...]
    moved: Floats | None = None

    @property
    def end(self) -> float:
        """End of all runs [s]."""
        return self.times[-1]

    @property
    def position(self) -> Floats:
        """Initial positions (n_nodes, 3) [m]."""
        return self.start.position if self.moved is None else self.start.position + self.moved

    def at(self, times: tuple[float, ...]) -> Subject:
        """The same with other stored times."""
        return replace(self, times=times)


def run(subject: Subject, setting: Setting, until: float | None = None) -> Trial:
    """Run to the subject's end (or `until`). Raises KeyboardInterrupt on Ctrl-C, nothing else."""
    subject = subject if until is None else subject.at((0.0, until))
    try:
        return _RUNNERS.get(setting.code, _exunet)(subject, setting)
    except (Interrupted, reference.Interrupted):
        raise KeyboardInterrupt from None


def trajectory(subject: Subject, setting: Setting) -> tuple[Floats, Floats]:
    """Position and velocity (t, n_nodes, 3) at the stored times; raises RunStopped or reference.Diverged."""
    if setting.code == "reference":
        found = _march(subject, setting)
        assert subject.pair is not None
        return subject.pair.take(found.x), subject.pair.take(found.v)
    result = simulate(_start(subject, setting))
    return result.position, result.velocity


def _start(subject: Subject, setting: Setting) -> Start:
    scene = with_setting(subject.start.scene, setting, launch_speed(subject.start), subject.times)
    return replace(prepare(scene), position=subject.position)


def with_setting(scene: Scene, setting: Setting, speed: float, times: tuple[float, ...]) -> Scene:
    """The scene with the setting's method and form, and stored times [s]; speed [m/s] scales tolerances."""
    solver: dict[str, object] = {"method": setting.method, "retry": 0}
    if setting.tolerance is not None:
        solver["tolerance"] = setting.tolerance * speed
    else:
        solver |= {
            "step": setting.step,
            "force": True,
        }  # a setting beyond the stable step shows what comes of it
    loop = setting.code == "compiled loop"
    form = {"loop": "compiled"} if loop else {"net": setting.code}
    end = times[-1]
    time = {"end": end, "output_times": [t for t in times if t > 0.0]}
    return scene.model_copy(
        update={
            "solver": Solver.model_validate(solver),
            "engine": Engine.model_validate(form),
            "time": Time.model_validate(time),
        }
    )


def _exunet(subject: Subject, setting: Setting) -> Trial:
    began = clock.perf_counter()
    try:
        result = simulate(_start(subject, setting))
    except Interrupted:
        raise
    except RunStopped as stop:
        return Trial(clock.perf_counter() - began, reason=str(stop))
    except Exception as error:  # noqa: BLE001 - a method that cannot run the scene stays in the table
        return Trial(clock.perf_counter() - began, reason=str(error))
    cost = result.provenance
    counts = Counts(
        cost["steps"], cost["rejected_steps"], cost["right_hand_sides"], cost.get("newton_iterations", 0)
    )
    found = measures(subject.start, result.time, result.position, result.velocity, result.dissipated)
    return Trial(cost["integration_seconds"], counts, found)


def _reference(subject: Subject, setting: Setting) -> Trial:
    assert subject.pair is not None
    began = clock.perf_counter()
    try:
        found = _march(subject, setting)
    except reference.Diverged as stop:
        return Trial(clock.perf_counter() - began, reason=str(stop))
    seconds = clock.perf_counter() - began
    take: Callable[[Floats], Floats] = subject.pair.take
    counts = Counts(found.n_steps, found.n_rejected, found.n_rhs, found.n_newton)
    x, v = take(found.x), take(found.v)
    return Trial(seconds, counts, measures(subject.start, found.t, x, v, found.dissipated))


def _march(subject: Subject, setting: Setting) -> reference.Trajectory:
    pair = subject.pair
    assert pair is not None
    how: dict[str, float] = {}
    if setting.tolerance is not None:
        how = {"rtol": setting.tolerance, "atol": setting.tolerance * launch_speed(subject.start)}
    else:
        how = {"step": float(setting.step or 0.0)}
    x0, v0 = pair.give(subject.position), pair.give(subject.start.velocity)
    return reference.march(pair.system, x0, v0, subject.times, method=setting.method, **how)  # type: ignore[arg-type]


_RUNNERS: dict[str, Callable[[Subject, Setting], Trial]] = {"reference": _reference}
