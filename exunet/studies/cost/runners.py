"""One run at one setting, in whichever code, with its wall time, work and measures."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.base.errors import Interrupted, RunStopped
from exunet.case.scene import Engine, Scene, Time
from exunet.methods.keys import Solver
from exunet.results.result import Result
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import BothCodes
from exunet.studies.cost.measure import Measures, measures
from exunet.studies.cost.settings import Setting
from exunet.studies.neighbours import launch_speed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Work:
    """Work of a run: `right_hand_sides` evaluations of the forces, residuals of implicit methods among them;
    Newton iterations of those (linear systems solved)."""

    steps: int
    rejected: int
    right_hand_sides: int
    newton: int


@dataclass(frozen=True)
class Trajectory:
    """Stored states in exunet's numbering, (t, n_nodes, 3), with the wall time of the stepping [s]."""

    time: Floats
    position: Floats
    velocity: Floats
    dissipated: Floats
    work: Work
    seconds: float


@dataclass(frozen=True)
class Trial:
    """One run: wall time of its stepping [s], and what came out, or why it failed."""

    seconds: float
    work: Work | None = None
    measures: Measures | None = None
    reason: str = ""


@dataclass(frozen=True)
class Subject:
    """The scene under study.

    start : exunet's, to `times[-1]`
    both  : the same in both codes; None if the reference does not know it
    times : stored times from 0 to the end [s]
    """

    start: Start
    both: BothCodes | None
    times: tuple[float, ...]

    @property
    def end(self) -> float:
        """End of all runs [s]."""
        return self.times[-1]

    @property
    def speed(self) -> float:
        """See `launch_speed`."""
        return launch_speed(self.start.velocity)

    def at(self, times: tuple[float, ...]) -> Subject:
        """The same with other stored times."""
        return replace(self, times=times)


def run(subject: Subject, setting: Setting, until: float | None = None) -> Trial:
    """Run to the subject's end (or `until`). Raises KeyboardInterrupt on Ctrl-C, nothing else."""
    began = clock.perf_counter()
    try:
        found = trajectory(subject if until is None else subject.at((0.0, until)), setting)
    except Exception as error:  # noqa: BLE001 - a method that cannot run the scene stays in the table
        return Trial(clock.perf_counter() - began, reason=str(error))
    shown = measures(subject.start, found.time, found.position, found.velocity, found.dissipated)
    return Trial(found.seconds, found.work, shown)


def trajectory(subject: Subject, setting: Setting) -> Trajectory:
    """The stored states; raises RunStopped if the run stops, KeyboardInterrupt on Ctrl-C."""
    try:
        return (_by_reference if setting.code == "reference" else _by_exunet)(subject, setting)
    except (Interrupted, reference.Interrupted):
        raise KeyboardInterrupt from None
    except reference.Diverged as stop:
        raise RunStopped(f"the reference {stop}") from stop


def _by_exunet(subject: Subject, setting: Setting) -> Trajectory:
    scene = with_setting(subject.start.scene, setting, subject.speed, subject.times)
    result = simulate(prepare(scene).moved(subject.start.position))
    cost = result.provenance
    work = Work(
        cost["steps"], cost["rejected_steps"], cost["right_hand_sides"], cost.get("newton_iterations", 0)
    )
    position, velocity = (_of_points(subject.start, result, name) for name in ("position", "velocity"))
    return Trajectory(result.time, position, velocity, result.dissipated, work, cost["integration_seconds"])


def _of_points(start: Start, result: Result, quantity: str) -> Floats:
    """(t, n_points, 3) of the net's nodes and the point masses."""
    bodies = [getattr(result.bodies[name], quantity)[:, None] for name in start.system.points.body]
    return np.concatenate([getattr(result, quantity), *bodies], axis=1)


def _by_reference(subject: Subject, setting: Setting) -> Trajectory:
    assert subject.both is not None
    both = subject.both.from_state(subject.start.position, subject.start.velocity)
    how: dict[str, object] = {"step": setting.step}
    if setting.tolerance is not None:
        how = {"rtol": setting.tolerance, "atol": setting.tolerance * subject.speed}
    began = clock.perf_counter()
    found = both.reference_trajectory(subject.times, method=setting.method, **how)
    seconds = clock.perf_counter() - began
    x, v = both.from_reference(found.x), both.from_reference(found.v)
    work = Work(found.n_steps, found.n_rejected, found.n_rhs, found.n_newton)
    return Trajectory(found.t, x, v, found.dissipated, work, seconds)


def with_setting(scene: Scene, setting: Setting, speed: float, times: tuple[float, ...]) -> Scene:
    """The scene with the setting's method and form, and stored times [s]; speed [m/s] scales tolerances."""
    solver: dict[str, object] = {"method": setting.method, "retry": 0}
    if setting.tolerance is not None:
        solver["tolerance"] = setting.tolerance * speed
    else:  # a setting above the stable step shows what comes of it
        solver |= {"step": setting.step, "force": True}
    form = {"loop": "compiled"} if setting.code == "compiled loop" else {"net": setting.code}
    time = {"end": times[-1], "output_times": [t for t in times if t > 0.0]}
    return scene.model_copy(
        update={
            "solver": Solver.model_validate(solver),
            "engine": Engine.model_validate(form),
            "time": Time.model_validate(time),
        }
    )
