"""Runs of a scene with a setting, by exunet or the reference: wall time, work, and what is compared."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import reference_impl as reference
from exunet.base.errors import Interrupted, RunStopped
from exunet.bodies.rotations import rotation_matrix
from exunet.integrators.protocol import StepCounts
from exunet.model.limits import relative_speed
from exunet.model.system import System
from exunet.results.measures import energy_balance
from exunet.results.metrics import DEPLOYMENT, Metric, metrics_of
from exunet.results.observables import Observables
from exunet.results.outcome import Outcome, outcome
from exunet.results.result import Result
from exunet.scene.casefile import Case
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.both_codes import BothCodes, Floats, with_arms
from exunet.studies.cost.settings import Setting, changed
from exunet.studies.ensemble import (
    nearby_start,
    perturbed_bodies_of,
    perturbed_positions,
    run_members,
    tracked_speeds,
)

WATCHED = 20  # stored times of a trajectory after its start, at which a run can be stopped
_WARM_UP = 1e-3  # of the run, so that compilation is not timed


@dataclass(frozen=True)
class Subject:
    """Scene of a study.

    case  : with the end of all runs
    start : the scene at its start, without a setting
    both  : the same in both codes; None: the reference does not cover it
    times : stored times of trajectories, from 0 to the end [s]; empty where distributions are compared
    unit  : of positions in errors of bodies: they are divided by this time [s]; None: the end
    """

    case: Case
    start: Start
    both: BothCodes | None = None
    times: tuple[float, ...] = ()
    unit: float | None = None

    @classmethod
    def of(cls, case: Case, times: Sequence[float] = (), both: BothCodes | None = None) -> Subject:
        """Prepare a case whose trajectories are stored at these times, up to the last of them."""
        if times:
            case = changed(case, f"time.end={times[-1]!r}", "time.output_step=", "time.output_times=[]")
        return cls(case, prepare_case(case), both, tuple(times))

    @property
    def end(self) -> float:
        """End of all runs [s]."""
        return self.start.scene.time.end

    @property
    def speed(self) -> float:
        """Unit of errors [m/s], see `relative_speed`."""
        return relative_speed(self.start.system, self.start.state)

    def at(self, times: Sequence[float]) -> Subject:
        """The same with other stored times up to its end."""
        return replace(self, times=tuple(times))

    def until(self, end: float) -> Subject:
        """The trajectory up to an earlier end [s], in the same units."""
        case, times = changed(self.case, f"time.end={end!r}"), np.linspace(0.0, end, WATCHED + 1)
        return Subject(case, prepare_case(case), self.both, tuple(times.tolist()), self.unit or self.end)

    def prepare(self, setting: Setting) -> Start:
        """Prepare the scene with a setting; raises CaseError if the scene does not allow it."""
        case = changed(self.case, *setting.overrides("retry=0"))
        if self.times:
            stored = [t for t in self.times if t > 0.0]
            case = changed(case, f"time={{end={self.end!r},output_times={stored!r}}}")
        return prepare_case(case)


@dataclass(frozen=True)
class Sample:
    """Metrics of a run by key, and the capture outcome ("" of a deployment)."""

    measures: Mapping[str, Metric]
    outcome: str = ""


@dataclass(frozen=True)
class Run:
    """A single run of a setting.

    seconds  : wall time of the integration [s]
    energy   : largest error of the energy balance at the stored times, relative to the energy that deforms:
               the guards' energy scale without the common flight; nan of the reference
    tracked  : (t, k) compared numbers of a trajectory [m/s], see `tracked`
    sample   : None of a trajectory
    """

    seconds: float
    work: StepCounts
    energy: float = math.nan
    tracked: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    sample: Sample | None = None


def run(
    subject: Subject, setting: Setting, watch: Callable[[float], None] | None = None, *, nearby: bool = False
) -> Run:
    """Run a scene with a setting.

    watch  : called with the simulated time [s]; may raise to end the run
    nearby : from a start perturbed by `SMALL_MOVE`, by exunet only
    Raises CaseError if the scene does not allow the setting, RunStopped if the run stops, KeyboardInterrupt
    on Ctrl-C.
    """
    progress = None if watch is None else lambda time, *_: watch(time)
    try:
        if setting.backend is None:
            return _by_reference(subject, setting, progress)
        start = subject.prepare(setting)
        return _measured(subject, simulate(nearby_start(start) if nearby else start, progress=progress))
    except (Interrupted, reference.Interrupted):
        raise KeyboardInterrupt from None
    except reference.Diverged as stop:
        raise RunStopped(f"the reference {stop}") from stop


def warm_up(subject: Subject, setting: Setting) -> None:
    """Run the beginning of a scene by exunet, so that nothing is compiled in a timed run; raises as `run`."""
    end = _WARM_UP * subject.end
    start = subject.prepare(setting)
    time = start.scene.time.model_copy(update={"end": end, "output_step": None, "output_times": ()})
    simulate(replace(start, scene=start.scene.model_copy(update={"time": time})))


def _measured(subject: Subject, result: Result) -> Run:
    cost = result.run.cost
    work = StepCounts(cost.steps, cost.rejected_steps, cost.newton_iterations, cost.right_hand_sides)
    energy = energy_balance(result)
    if not subject.times:
        return Run(cost.integration_seconds, work, energy, sample=sample_of(result))

    def stacked(quantity: str, width: int = 3) -> Floats:
        parts = [np.asarray(getattr(body, quantity)[:]) for body in result.bodies.values()]
        return np.stack(parts, axis=1) if parts else np.zeros((len(result.time), 0, width))

    position, velocity, spin = (stacked(name) for name in ("position", "velocity", "angular_velocity"))
    of_rigid = position, velocity, rotation_matrix(stacked("attitude", 4)), spin
    unit = subject.unit or subject.end
    compared = tracked(subject.start.system, result.velocity[:], of_rigid, unit)
    return Run(cost.integration_seconds, work, energy, compared)


def _by_reference(subject: Subject, setting: Setting, progress: Callable[..., None] | None) -> Run:
    both = subject.both
    assert both is not None
    how: dict[str, object] = {"step": setting.step}
    if setting.tolerance is not None:
        how = {"rtol": setting.tolerance / subject.speed, "atol": setting.tolerance}
    began = clock.perf_counter()
    found = both.reference_trajectory(subject.times, method=setting.method, progress=progress, **how)
    seconds = clock.perf_counter() - began
    work = StepCounts(found.n_steps, found.n_rejected, found.n_newton, found.n_rhs)
    velocity, duration = both.from_reference(found.v), subject.unit or subject.end
    compared = tracked(both.start.system, velocity, both.rigid_of(found), duration)
    return Run(seconds, work, tracked=compared)


def tracked(system: System, velocity: Floats, bodies: Sequence[Floats], duration: float) -> Floats:
    """Return the numbers [m/s] by which trajectories are compared, (t, k), the speeds of the net first.

    Of the net these are speeds of its bullets, or of all nodes. Of each rigid body they are
    velocities and positions of its centre and of the ends of three arms along its axes, as long as its radius
    of gyration: attitude and angular velocity count as what they move. Positions are divided by the duration.

    velocity : (t, n_nodes, 3) of the net [m/s]
    bodies   : positions and velocities (t, b, 3) of rigid bodies, attitudes (t, b, 3, 3), and angular
               velocities (t, b, 3) in body axes
    duration : of the run [s]
    """
    lengths = np.array([np.sqrt(max(body.inertia) / body.mass) for body in system.bodies])
    count = len(velocity)
    none = np.zeros((count, 0, 3))
    position, speed = with_arms((none, none), tuple(bodies), lengths)
    moving = speed.reshape(count, -1), position.reshape(count, -1) / duration
    return np.concatenate([tracked_speeds(system.net, velocity), *moving], axis=1)


def sample_of(result: Result) -> Sample:
    """Metrics of a run that are compared, and its outcome.

    The largest tension; of a deployment its four metrics; of a capture momentum and first contact of each
    target, capture time and quality indices at the end.
    """
    run = Observables(result)
    every, found = metrics_of(run), outcome(run)
    bodies = run.touched_bodies if run.criterion is None else (run.criterion.target,)
    momenta = (metric for body in bodies if (metric := _momentum_of(body, every)) is not None)
    keys = ["largest_tension_N", *([f"contact_{body}_first_s" for body in bodies] or DEPLOYMENT)]
    keys += [] if found is None else ["capture_time_s", "capture_cqi", "capture_mcqi"]
    measures = {metric.key: metric for metric in momenta}
    measures |= {key: every[key] for key in keys if key in every}
    if found is not None:
        return Sample(measures, found.outcome.value)
    touched = any(run.first_contact(body) is not None for body in run.touched_bodies)
    other = Outcome.TOUCHED if touched else Outcome.MISSED
    return Sample(measures, other.value if run.touched_bodies else "")


def _momentum_of(body: str, every: Mapping[str, Metric]) -> Metric | None:
    """Magnitude of the momentum that all forces gave to a body, or that a prescribed body took."""
    names = (f"body_{body}_impulse_{{}}_N_s", f"body_{body}_momentum_gained_{{}}_kg_m_s")
    for name in names:
        parts = [every[key].value for axis in "xyz" if (key := name.format(axis)) in every]
        if len(parts) == 3:
            size, words = float(np.linalg.norm(parts)), f"momentum that {body} got"
            return Metric(f"momentum_{body}", words, "N s", size, resolution=1e-8)
    return None


def perturbed_runs(start: Start, number: int, perturbation: float, first: int) -> list[Sample]:
    """Run a start in the compiled loop with each coordinate perturbed by up to this length [m].

    number, first : how many runs, and the number of the first, which the perturbations follow from
    """
    seed = start.scene.seed
    positions = perturbed_positions(start, number, perturbation, seed, first=first)
    bodies = perturbed_bodies_of(start, number, perturbation, seed, first=first)
    return run_members(start, positions, sample_of, first=first, together=False, bodies=bodies)
