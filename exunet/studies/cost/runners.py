"""One run at one setting, in whichever code: wall time, work, and what is measured on it."""

from __future__ import annotations

import math
import statistics
import time as clock
from dataclasses import dataclass, field, replace

import numpy as np

import reference_impl as reference
from exunet.backends.protocol import StepCounts
from exunet.base.errors import Interrupted, RunStopped
from exunet.bodies.rotations import rotation_matrix
from exunet.case.scene import Engine, Scene, Time
from exunet.forces.linear_term import LinearTerm
from exunet.methods.keys import Solver
from exunet.results.measures import Deployment, deployment_of, energy_balance
from exunet.results.result import BodyStates, Result
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import BothCodes, Floats
from exunet.studies.cost.settings import Setting
from exunet.studies.cost.tracked import Motion, tracked
from exunet.studies.neighbours import launch_speed
from exunet.system.energy_scale import EnergyScale
from exunet.system.states import States
from reference_impl import energy

# The four measures of deployment with their units.
FOUR = {
    "largest area": "of the achievable area",
    "time of largest area": "s",
    "distance": "m",
    "time above 80 %": "s",
}


@dataclass(frozen=True)
class RunMeasures:
    """Numbers of one run.

    speeds   : (k,) speeds at the end [m/s], of the bullets, or of all nodes if there are none; then what
               counts of point masses and bodies, see `tracked`
    energy   : largest error of the energy balance at the stored times, over the energy that deforms: the
               guards' energy scale, without the common flight
    momentum : largest change of the linear momentum, relative to the sum of m |v| at the start; None where
               forces from outside change it, or bodies whose motion is given
    deployment : over the stored times; None for a net without a mouth
    """

    speeds: Floats
    energy: float
    momentum: float | None = None
    deployment: Deployment | None = None


def four(found: Deployment) -> tuple[float, ...]:
    """The measures of deployment in the order and units of FOUR."""
    return found.relative_area, found.time_of_largest, found.distance, found.time_open


def _momentum(start: Start, moved: Floats) -> float | None:
    system, state, forces = start.system, start.state, start.system.forces
    scale = float(system.mass @ np.linalg.norm(state.velocity, axis=-1))
    scale += float(system.body_mass @ np.linalg.norm(state.bodies.velocity, axis=-1))
    linear = forces.linear or LinearTerm()
    if system.kinematics.n_free < len(system.bodies):
        return None
    outside = (linear.load, linear.stiffness, linear.gyroscopic)
    if any(term is not None for term in outside) or forces.kernels or len(start.net.fixed_nodes) or not scale:
        return None
    if linear.damping is not None and np.linalg.norm(moved[0]) > 1e-12 * scale:
        return None  # damping of the motion as a whole
    return float(np.linalg.norm(moved - moved[0], axis=-1).max()) / scale


@dataclass(frozen=True)
class TimedTrajectory:
    """The net's states in exunet's numbering, (t, n_nodes, 3), and what is measured on the whole system.

    tracked      : (t, k) [m/s] what runs are compared by, see `exunet.studies.cost.tracked`
    momentum     : (t, 3) of everything [kg m/s]
    energy_error : see `RunMeasures`
    seconds      : time of the stepping [s]
    """

    time: Floats
    position: Floats
    velocity: Floats
    tracked: Floats
    momentum: Floats
    energy_error: float
    work: StepCounts
    seconds: float


@dataclass
class StudyEntry:
    """A setting, its runs so far, and what they showed.

    seconds     : wall times of the repeats [s]
    speed_error : largest difference of a speed at the end from the converged one, over the launch speed
    reason      : why there are no measures: it failed, or was left out
    failed      : it ran and failed
    """

    setting: Setting
    seconds: list[float] = field(default_factory=list)
    work: StepCounts | None = None
    measures: RunMeasures | None = None
    speed_error: float = math.inf
    reason: str = ""
    failed: bool = False

    @property
    def median(self) -> float:
        """Median wall time of the stepping [s]."""
        return statistics.median(self.seconds)

    @property
    def noise(self) -> float | None:
        """Half the range of the repeats relative to the median; None of a single run."""
        if len(self.seconds) < 2:
            return None
        return 0.5 * (max(self.seconds) - min(self.seconds)) / self.median


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

    def scene(self, setting: Setting) -> Scene:
        """The scene with the method and form of a setting of exunet's own, and the stored times."""
        solver: dict[str, object] = {"method": setting.method.value, "retry": 0}
        if setting.tolerance is not None:
            solver["tolerance"] = setting.tolerance * self.speed
        else:  # a setting above the stable step shows what comes of it
            solver |= {"step": setting.step, "force": True}
        assert setting.form is not None
        time = {"end": self.end, "output_times": [t for t in self.times if t > 0.0]}
        engine = Engine.model_validate(setting.form.engine)
        tables = {"solver": Solver.model_validate(solver), "engine": engine}
        return self.start.scene.model_copy(update=tables | {"time": Time.model_validate(time)})


def run(subject: Subject, setting: Setting, until: float | None = None) -> StudyEntry:
    """Run to the subject's end (or `until`). Raises KeyboardInterrupt on Ctrl-C, nothing else."""
    began = clock.perf_counter()
    try:
        found = trajectory(subject if until is None else subject.at((0.0, until)), setting)
    except Exception as error:  # noqa: BLE001 - a method that cannot run the scene stays in the table
        return StudyEntry(setting, [clock.perf_counter() - began], reason=str(error), failed=True)
    net = subject.start.net
    opening = deployment_of(net, found.time, found.position)
    shown = RunMeasures(
        found.tracked[-1], found.energy_error, _momentum(subject.start, found.momentum), opening
    )
    return StudyEntry(setting, [found.seconds], found.work, shown)


def trajectory(subject: Subject, setting: Setting) -> TimedTrajectory:
    """The stored states; raises RunStopped if the run stops, KeyboardInterrupt on Ctrl-C."""
    try:
        return (_by_reference if setting.form is None else _by_exunet)(subject, setting)
    except (Interrupted, reference.Interrupted):
        raise KeyboardInterrupt from None
    except reference.Diverged as stop:
        raise RunStopped(f"the reference {stop}") from stop


def _by_exunet(subject: Subject, setting: Setting) -> TimedTrajectory:
    result = simulate(prepare(subject.scene(setting)).moved(subject.start.position))
    told = result.provenance
    newton = told.get("newton_iterations", 0)
    work = StepCounts(told["steps"], told["rejected_steps"], newton, told["right_hand_sides"])
    x, v, moved = result.position, result.velocity, result.momentum
    seconds = told["integration_seconds"]
    compared = tracked(subject.start.system, v, *_moving(result), subject.end)
    return TimedTrajectory(result.time, x, v, compared, moved, energy_balance(result), work, seconds)


def _moving(result: Result) -> tuple[tuple[Floats, Floats], Motion]:
    """Of the point masses, and of the rigid bodies of a result."""
    masses = [body for body in result.bodies.values() if body.attitude is None]
    bodies = [body for body in result.bodies.values() if body.attitude is not None]

    def each(of: list[BodyStates], quantity: str, width: int = 3) -> Floats:
        found = [np.asarray(getattr(body, quantity)[:]) for body in of]
        return np.stack(found, axis=1) if found else np.zeros((len(result.time), 0, width))

    turn = rotation_matrix(each(bodies, "attitude", 4))
    rigid = each(bodies, "position"), each(bodies, "velocity"), turn, each(bodies, "angular_velocity")
    return (each(masses, "position"), each(masses, "velocity")), rigid


def _by_reference(subject: Subject, setting: Setting) -> TimedTrajectory:
    assert subject.both is not None
    both = subject.both.from_state(subject.start.position, subject.start.velocity)
    how: dict[str, object] = {"step": setting.step}
    if setting.tolerance is not None:
        how = {"rtol": setting.tolerance, "atol": setting.tolerance * subject.speed}
    began = clock.perf_counter()
    found = both.reference_trajectory(subject.times, method=setting.method, **how)
    seconds = clock.perf_counter() - began
    work = StepCounts(found.n_steps, found.n_rejected, found.n_newton, found.n_rhs)
    books = energy.books(both.theirs.system, found)
    x, v = both.points_of(found)
    states = States(both.start.system, found.t, x, v, both.in_principal_axes(found), both.start.state.memory)
    scales = EnergyScale(States.of(both.start.system, both.start.state))
    scale = scales.start + float(scales.gained(states, found.dissipated)[0].max())
    error = float(np.abs(books.total - books.total[0]).max()) / (scale or float(books.kinetic.max()) or 1.0)
    n = both.start.net.n_nodes
    masses = x[:, n:], v[:, n:]
    compared = tracked(both.start.system, v[:, :n], masses, both.rigid_of(found), subject.end)
    return TimedTrajectory(found.t, x[:, :n], v[:, :n], compared, books.momentum, error, work, seconds)
