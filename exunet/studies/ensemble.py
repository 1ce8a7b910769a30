"""Ensembles: many runs of a case from perturbed starts, by the compiled loop on all cores."""

from __future__ import annotations

import math
import os
import time as clock
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from numbers import Integral, Real
from pathlib import Path
from threading import Event, local
from typing import Any, TypeVar

import numpy as np

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.machine import MEMORY_VARIABLE, memory_left
from exunet.bodies.rigid import RigidStates
from exunet.bodies.rotations import product, quaternion_of
from exunet.forces import cable
from exunet.forces.law import STRETCH_BOUND
from exunet.integrators.compiled.loop import NO_ENERGIES, OUTPUT_EVERY, CompiledStepper, loop_kernel
from exunet.integrators.compiled.vectorised_runs import RunsSideBySide, side_by_side_kernel
from exunet.integrators.protocol import Extremes, StepCounts
from exunet.kernels.compile import WIDTH, numba_installed
from exunet.kernels.kernel import Kernel
from exunet.methods.config import AUTO
from exunet.methods.method import (
    COMPILED_METHODS,
    FINER_TOLERANCE,
    METHODS,
    Backend,
    Kind,
    Plan,
    finer,
)
from exunet.model.system import State
from exunet.net.arrays import Net
from exunet.results.ensemble import INTERVALS, Ensemble, Member, ensemble_of, instants, member_of
from exunet.results.result import Result
from exunet.results.run_record import CaseText, EnsembleRecord
from exunet.scene.casefile import Case, case_of
from exunet.scene.scene import Scene
from exunet.simulation.block import Observed
from exunet.simulation.integrate import Integration
from exunet.simulation.observers import STATES_A_LOOK, Observers
from exunet.simulation.planning import is_short
from exunet.simulation.preparation import Start, in_the_compiled_loop, start_of
from exunet.simulation.recorder import Recorder, initial_record, series_of, stored_bytes
from exunet.simulation.run import case_text

PAPER_SIZE = 7.0  # [m], of the paper's net with its strings
SMALL_MOVE = 1e-12 / PAPER_SIZE  # of the net's size: far above round-off, far below what any figure shows
SEED = 20210616


def perturbed(net: Net, position: Floats, amplitude: float, seed: int | Sequence[int] = SEED) -> Floats:
    """(n_nodes, 3) positions [m] with each coordinate of a free node moved by up to +-amplitude [m].

    A coordinate whose neighbouring floating-point numbers are further away than that moves by its last bit.
    """
    shift = np.random.default_rng(seed).uniform(-amplitude, amplitude, position.shape)
    if amplitude > 0.0:
        last_bit = np.spacing(np.abs(position))
        shift = np.where(last_bit > amplitude, np.copysign(last_bit, shift), shift)
    shift[net.fixed_nodes] = 0.0
    return position + shift


def perturbed_bodies(start: Start, amplitude: float, seed: int | Sequence[int] = SEED) -> RigidStates:
    """States of the bodies: each free one moved by up to +-amplitude [m] along each axis, turned by up to as
    many radians about each, and turning faster by up to as many rad/s.
    """
    states, free = start.state.bodies, start.system.moves_freely[:, None]
    shift = np.random.default_rng(seed).uniform(-amplitude, amplitude, (3, len(free), 3)) * free
    return RigidStates(
        states.position + shift[0],
        states.velocity,
        product(states.attitude, quaternion_of(shift[1])),
        states.angular_velocity + shift[2],
    )


@takes(start=Start)
def perturbed_positions(start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0) -> Floats:
    """(runs, n_nodes, 3) initial positions, each coordinate of free nodes moved by up to +-amplitude [m].

    first : number of the first of the runs
    Run k gets the same perturbation however many runs there are. Raises InputError for a number of runs, a
    seed or an amplitude that is out of range.
    """
    require_whole_number("runs", runs, at_least=0)
    require_whole_number("seed", seed, at_least=0)
    require_whole_number("first", first, at_least=0)
    require_length("amplitude", amplitude)
    found = [
        perturbed(start.net, start.position, amplitude, (seed, run)) for run in range(first, first + runs)
    ]
    return np.array(found).reshape(-1, *start.position.shape)


def perturbed_bodies_of(
    start: Start, runs: int, amplitude: float, seed: int, *, first: int = 0
) -> RigidStates | None:
    """The bodies beside `perturbed_positions`, with a leading axis of runs; None of a scene without bodies.

    amplitude : [m], and of their attitudes and angular velocities [rad], [rad/s]
    """
    if not start.system.bodies or not runs:
        return None
    found = [perturbed_bodies(start, amplitude, (seed, run, 1)) for run in range(first, first + runs)]
    return RigidStates(*(np.stack(parts) for parts in zip(*(item.parts() for item in found), strict=True)))


def require_whole_number(name: str, given: object, at_least: int) -> None:
    """Raise InputError for an argument that is not a whole number, or too small a one."""
    if isinstance(given, bool) or not isinstance(given, Integral) or given < at_least:
        raise InputError(f"{name}: must be a whole number, {at_least} or more, got {given!r}")


def require_length(name: str, given: object) -> None:
    """Raise InputError for an argument that is not a length, or a negative one."""
    if isinstance(given, bool) or not (isinstance(given, Real) and 0.0 <= float(given) < float("inf")):
        raise InputError(f"{name}: must be a finite number of metres, 0 or more, got {given!r}")


def nearby_start(start: Start, part: float = SMALL_MOVE, seed: int = SEED) -> Start:
    """The start with its positions moved by up to a part of the net's size."""
    net = start.net
    return start.moved(perturbed(net, start.position, part * net.size, seed))


def of_other_accuracy(plan: Plan) -> Plan:
    """A finer plan; a coarser one where round-off leaves nothing to gain."""
    if found := finer(plan):
        return found
    assert plan.tolerance is not None  # there is always a shorter step
    return replace(plan, tolerance=plan.tolerance / FINER_TOLERANCE)


def of_much_other_accuracy(plan: Plan) -> Plan:
    """Two steps finer, or coarser where round-off leaves nothing to gain.

    Errors at kinks of the forces scatter by two decades at one tolerance, so
    that a run with a tenth of it often errs as much, and nothing follows from the difference of the two.
    """
    other = of_other_accuracy(plan)
    return finer(other) or other


def tracked_speeds(net: Net, velocity: Floats) -> Floats:
    """(..., k) speeds [m/s] of the bullets, or of all nodes without bullets; velocity (..., n_nodes, 3)."""
    nodes = net.bullet_nodes if len(net.bullet_nodes) else np.arange(net.n_nodes)
    return np.asarray(np.linalg.norm(velocity[..., nodes, :], axis=-1))


_MAX_TIMES = 128  # states that the guards check in one go
_MAX_VALUES = 2**21  # coordinates that runs side by side keep in one go
_MAX_WORK = 1e7  # elements times steps of runs side by side in one go: about 0.2 s


def run_member(start: Start, kernel: Kernel, stop: Event) -> Result:
    """Run through the stored times, with guards and events, in the compiled loop.

    stop : ends the run by KeyboardInterrupt
    """
    recorder, observers = _observed(start)
    system = start.system
    events = bool(start.state.discrete or system.kinematics.knots)

    def make(state: State, plan: Plan) -> CompiledStepper:
        # Without events, many times in one call of compiled code; the steps are the same.
        return CompiledStepper(system, state, plan, kernel, every=OUTPUT_EVERY if events else None)

    def leave() -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    together = 1 if events else _MAX_TIMES
    run = Integration(start.plan, make, observers, together=together)
    run.go(recorder.times[1:].tolist(), leave, settle=True)
    return _result(recorder, run.counts.right_hand_sides)


def _observed(start: Start, every: int = STATES_A_LOOK) -> tuple[Recorder, Observers]:
    """Return the recorder of a run, and its observers, which have seen the first state."""
    recorder = Recorder(start, stores_energies=False, every=every)
    own = {"balance": recorder.balance, "log": recorder.log, "extremes": recorder.extremes}
    observers = Observers(start.system, start.state, {**own, "record": recorder})
    observers.start()
    return recorder, observers


def _result(recorder: Recorder, evaluations: int) -> Result:
    recorder.integrated(StepCounts(right_hand_sides=evaluations), 0.0)
    return recorder.result("ok")


def run_side_by_side(starts: Sequence[Start], loop: RunsSideBySide, stop: Event) -> list[Result | None]:
    """Run several starts of one scene at once; None for a run that stopped."""
    runs: list[tuple[Recorder, Observers] | None] = []
    for start in starts:
        recorder, observers = _observed(start, every=1)  # the guards check each stored time
        observers.built(start.plan, {}, 0.0)
        runs.append((recorder, observers))
    loop.begin([start.state for start in starts])
    times = starts[0].scene.time.stored_times
    number = _times_side_by_side(starts[0], times)
    for at in range(0, len(times) - 1, number):
        for run, states in enumerate(loop.through(times[at : at + number + 1])):
            if (found := runs[run]) is None:
                continue
            recorder, observers = found
            count = len(states) - 1
            extremes = [*[None] * (count - 1), Extremes(NO_ENERGIES, loop.largest_tensions(run), np.zeros(0))]
            try:
                observers.see(
                    Observed(states, list(range(1, count + 1)), [{}] * count, extremes, np.zeros(0))
                )
            except RunStopped:
                runs[run] = None
            recorder.flush()  # the loop overwrites its states
        if stop.is_set():
            raise KeyboardInterrupt
    return [None if found is None else _result(found[0], loop.right_hand_sides) for found in runs]


def _times_side_by_side(start: Start, times: Floats) -> int:
    """Number of times that runs side by side go through in one go, without many values or long work."""
    assert start.plan.step is not None  # what such runs go by
    longest = float(np.diff(times).max(initial=0.0))
    work = max(1, start.net.n_elements) * max(1.0, longest / start.plan.step)
    return max(2, min(_MAX_VALUES // (WIDTH * start.system.blocks.n_x), int(_MAX_WORK / work)))


T = TypeVar("T")

MOVE = 1e-9  # [m]: far below what anyone can place, far above what the integrators round off
# Of the net's size: above the errors of fixed and of adaptive steps (benchmarks/ensemble.md, measures.md).
OF_FIXED_STEPS, OF_ADAPTIVE_STEPS = 1.4e-5, 2e-6
RUNS, FEW_RUNS = 32, 8  # perturbed runs that follow a run, and those of a long one
NO_NUMBA = "the compiled loop needs Numba, which is not installed (pip install numba)"
PORTION = 64  # runs that are lost if the ensemble is interrupted; vectors of runs, where they go side by side
# Element forces over all runs, below which side by side is not worth its compilation: some 10 s one by one.
_PAYS = 2e9


@takes(progress=Callable)
def ensemble(
    case: str | Path | Case | Scene | Start,
    runs: int = 1000,
    perturb: float = MOVE,
    seed: int | None = None,
    *,
    progress: Callable[[int], None] | None = None,
) -> Ensemble:
    """Run a case from perturbed starts, in the compiled loop on all cores; deterministic, bit by bit.

    runs     : number of runs
    perturb  : largest perturbation of each coordinate of free nodes and bodies [m], and of attitudes [rad]
               and angular velocities [rad/s] of bodies; 1e-9 is far below what anyone can place, and
               far above round-off
    seed     : of the perturbations, None: the case's; those of run k do not depend on the number of runs
    progress : called with the number of completed runs

    A case of fixed steps goes eight runs at a time through compiled code, where its forces can and it pays;
    each has the bits that it has alone. A run that fails because of its steps restarts with finer ones,
    `solver.retry` times. Of a case with [capture] the record has `outcomes`, the number of runs of each
    capture outcome; of one whose script has ended runs, `endings`, with numbers and times. If perturbations
    are less than the errors that all runs by a cheap setting share, the record has `notes` on it.

    Raises InputError for a number, a perturbation or a seed out of range, for a method that the compiled loop
    does not have, or for more runs than there is memory; MissingExtra without Numba; RunStopped if a run
    stops, and Interrupted on Ctrl-C, both with the runs that were complete before as their `result`.
    """
    validate_arguments(runs, perturb, seed)
    given = case if isinstance(case, Start) else case_of(case, "ensemble")
    start = start_of(given)
    seed = start.scene.seed if seed is None else seed
    validate_method(start)
    validate_memory(runs, start)
    validate_perturbation(start, perturb)
    there = start_of_runs(start)
    words = small_perturbation_note(start, perturb)
    record = replace(
        _record(there, seed, perturb),
        case=case_text(given) if isinstance(given, Case) else CaseText(),
        runs_requested=int(runs),
        notes=(words,) if words else (),
    )
    began, members = clock.perf_counter(), list[Member]()
    together = kernel_of_many(there, runs) is not None
    portion = PORTION * (WIDTH if together else 1)

    def made(verdict: str) -> Ensemble | None:
        if not members:
            return None
        return ensemble_of(
            members, run=replace(record, seconds=clock.perf_counter() - began, verdict=verdict)
        )

    try:
        while (done := len(members)) < runs:
            report = None if progress is None else lambda more, done=done: progress(done + more)
            number = min(portion, runs - done)
            members += _perturbed(there, number, perturb, seed, report, first=done, together=together)
    except KeyboardInterrupt:
        words = f"interrupted after {len(members)} of {runs} runs"
        raise Interrupted(words, made(words)) from None
    except RunStopped as stop:
        words = f"{stop}; {len(members)} of {runs} runs were complete before"
        raise RunStopped(words, made(words), stop.step_cause) from stop
    whole = made("ok")
    assert whole is not None
    return whole


def perturbed_runs(
    start: Start, runs: int = RUNS, *, progress: Callable[[int], None] | None = None
) -> Ensemble:
    """Repeat a run from perturbed starts on all cores, whatever times the case stores.

    progress : called with the number of completed runs
    Raises RunStopped if one of the runs stops also with finer steps, and as `start_of_runs`.
    """
    there, move, seed = start_of_runs(start), MOVE, start.scene.seed
    members = _perturbed(there, runs, move, seed, progress)
    return ensemble_of(members, run=_record(there, seed, move))


def _perturbed(
    there: Start, runs: int, move: float, seed: int, progress: Callable[[int], None] | None, **more: Any
) -> list[Member]:
    first = more.get("first", 0)
    places = perturbed_positions(there, runs, move, seed, first=first)
    bodies = perturbed_bodies_of(there, runs, move, seed, first=first)
    retries = there.scene.solver.retry
    return run_members(there, places, member_of, retries=retries, progress=progress, bodies=bodies, **more)


def _record(there: Start, seed: int, move: float) -> EnsembleRecord:
    return EnsembleRecord(**vars(initial_record(there)), seed=int(seed), move_m=float(move))


@takes(start=Start, progress=Callable, bodies=RigidStates)
def run_ensemble(
    start: Start,
    position: Floats,
    velocity: Floats | None = None,
    *,
    bodies: RigidStates | None = None,
    retries: int = 0,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Ensemble:
    """Run `start` once from each of the given initial states.

    position, velocity : (runs, n_nodes, 3) [m], [m/s]; velocity None: that of `start` for all
    bodies             : states of the rigid bodies, with a leading axis of runs; None: those of `start`
    retries            : how often a run that fails because of its steps restarts with finer ones
    workers            : threads (compiled code runs beside each other); None: one a core
    progress           : called with the number of completed runs
    Raises as `ensemble`, and InputError for states of another shape, or that are not finite numbers.
    """
    options: dict[str, Any] = {"retries": retries, "workers": workers, "progress": progress, "bodies": bodies}
    members = run_members(start, position, member_of, velocity, **options)
    return ensemble_of(members, run=_record(start, start.scene.seed, 0.0))


def run_members(
    start: Start,
    position: Floats,
    measure: Callable[[Result], T],
    velocity: Floats | None = None,
    *,
    workers: int | None = None,
    retries: int = 0,
    progress: Callable[[int], None] | None = None,
    first: int = 0,
    together: bool | None = None,
    bodies: RigidStates | None = None,
) -> list[T]:
    """Run `start` once from each initial state; the bits of a run depend on nothing but its start.

    measure  : what is kept of the result of each run
    first    : number of the first run in the messages of errors
    together : runs go side by side through compiled code where they can; None: where it pays
    Other parameters as of `run_ensemble`. Raises RunStopped, naming the run, if one diverges or its steps
    collapse; KeyboardInterrupt on Ctrl-C.
    """
    if start.plan.method not in COMPILED_METHODS:
        words = f"an ensemble runs by {', '.join(COMPILED_METHODS)}, not by {start.plan.method}"
        raise InputError(words)
    start = replace(start, plan=replace(start.plan, backend=Backend.COMPILED))
    require_whole_number("retries", retries, at_least=0)
    if workers is not None:
        require_whole_number("workers", workers, at_least=1)
    position = _states("position", position, start.system.blocks.n_points, None)
    if velocity is None:
        speeds = np.broadcast_to(start.velocity, position.shape)
    else:
        speeds = _states("velocity", velocity, start.system.blocks.n_points, len(position))
    kernel, stop, own = loop_kernel(start.system), Event(), local()
    shared = kernel_of_many(start, len(position), together)

    def moved(run: int) -> Start:
        return start.moved(position[run], speeds[run], None if bodies is None else bodies[run])

    def alone(run: int) -> T:
        attempt = moved(run)
        for left in range(retries, -1, -1):
            try:
                return measure(run_member(attempt, kernel, stop))
            except RunStopped as failed:
                plan = finer(attempt.plan) if failed.step_cause and left else None
                if plan is None:
                    raise RunStopped(f"run {first + run} of the ensemble {failed}") from failed
                attempt = replace(attempt, plan=plan)
        raise AssertionError("the last attempt returns or raises")

    def begin() -> None:
        """In each thread."""
        if shared is not None:
            own.loop = RunsSideBySide(start.system, start.plan, shared)

    def several(runs: range) -> list[T]:
        if shared is None:
            return [alone(run) for run in runs]
        found = run_side_by_side([moved(run) for run in runs], own.loop, stop)
        # A run that stops among others does so alone, where it may restart with finer steps.
        return [alone(run) if done is None else measure(done) for run, done in zip(runs, found, strict=True)]

    width = WIDTH if shared else 1
    groups = [range(k, min(k + width, len(position))) for k in range(0, len(position), width)]
    with ThreadPoolExecutor(_threads(start, width, workers), initializer=begin) as pool:
        try:
            kept: list[T] = []
            for group in pool.map(several, groups):
                for one in group:
                    kept.append(one)
                    if progress is not None:
                        progress(len(kept))
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return kept


def _threads(start: Start, width: int, workers: int | None) -> int:
    """Number of threads whose results fit into memory, one a core at most."""
    wanted, left = workers or os.cpu_count() or 1, memory_left()
    if left is None:
        return wanted
    return max(1, min(wanted, int(left / (2.0 * width * max(1, stored_bytes(start))))))


def _states(name: str, given: object, n_points: int, runs: int | None) -> Floats:
    """(runs, n_points, 3) finite floats, at least one run."""
    wanted = f"({runs if runs is not None else 'runs'}, {n_points}, 3)"
    try:
        states = np.asarray(given)
    except ValueError:
        raise InputError(f"{name}: initial states must be {wanted}, got rows of different lengths") from None
    if states.ndim != 3 or states.shape[1:] != (n_points, 3) or len(states) != (runs or len(states)):
        raise InputError(f"{name}: initial states must be {wanted}, got {states.shape}")
    if not len(states):
        raise InputError(f"{name}: there is no run in it")
    if states.dtype.kind not in "iuf" or not np.isfinite(states).all():
        raise InputError(f"{name}: initial states must be finite numbers, got an array of {states.dtype}")
    return states.astype(np.float64)


def kernel_of_many(start: Start, runs: int, together: bool | None = None) -> Kernel | None:
    """Return the kernel that takes several runs side by side; None where that cannot be, or does not pay.

    together : True, False: requested or not; None: if it is compiled already, or the runs take long
    """
    kernel = None if together is False else side_by_side_kernel(start.system, start.plan)
    if kernel is None or together or kernel.compiled_before:
        return kernel
    assert start.plan.step is not None  # side by side only fixed steps
    steps = runs * start.scene.time.end / start.plan.step
    return kernel if steps * METHODS[start.plan.method].stages * start.net.n_elements > _PAYS else None


def start_of_runs(start: Start) -> Start:
    """The start in the compiled loop, at the instants of members, whatever times the case stores.

    Its method and setting are the run's where the compiled loop has the method, else DOPRI5 at the case's
    accuracy. Raises CaseError where the compiled loop cannot have the scene, MissingExtra without Numba.
    """
    times = tuple(instants(start.scene.time.end).tolist())
    time = start.scene.time.model_copy(update={"output_step": None, "output_times": times})
    return in_the_compiled_loop(replace(start, scene=start.scene.model_copy(update={"time": time})))


def default_runs(start: Start) -> int:
    """Return how many perturbed runs follow a run: 32, or 8 of a long run, on any machine."""
    return RUNS if is_short(start.system, start.scene.time.end) else FEW_RUNS


def repeats(start: Start) -> list[tuple[int, float]]:
    """Return the runs that follow a run by default, and their work relative to its own."""
    runs = default_runs(start)
    found = [(runs, 1.0)]
    if start.scene.solver.for_metrics:  # with half of the step
        found.append((4 if runs == RUNS else 1, 2.0))
    if runs == RUNS:  # with twice the elements, and half of the step
        found.append((FEW_RUNS, 4.0))
    return found


def wall_times(start: Start) -> tuple[float, float] | str:
    """Estimate the wall times [s] of a run and of its repeats on this machine; or state why not.

    From 100 steps or more of the compiled loop at the start, so without contact that comes later.
    """
    plan, system, state = start.plan, start.system, start.state
    if plan.step is None:
        return f"not estimated: {plan.method} chooses its steps"
    if not numba_installed() or not METHODS[plan.method].compiled:
        return "not estimated: not by the compiled loop"
    kernel = loop_kernel(system)
    if not kernel.compiled_before:
        return "not compiled yet"
    stepper = CompiledStepper(system, state, plan, kernel, every=None)
    run = _step_time(lambda times: stepper.step(times[1:].tolist()), start)
    each, width, shared = run, 1, kernel_of_many(start, default_runs(start))
    if shared is not None and shared.compiled_before:
        loop, width = RunsSideBySide(system, plan, shared), WIDTH
        loop.begin([state] * WIDTH)
        each = _step_time(loop.through, start)
    steps, threads = start.scene.time.end / plan.step, width * _threads(start, width, None)
    return run * steps, each * steps * sum(math.ceil(runs / threads) * work for runs, work in repeats(start))


def _step_time(through: Callable[[Floats], Any], start: Start) -> float:
    """Measure the wall time [s] of a step; the first takes the compiled code from its cache."""
    time, seconds, number = start.state.time, 0.0, 0
    for number in (1, 100, 2000):
        times = np.array([time, time + number * (start.plan.step or math.inf)])
        began = clock.perf_counter()
        through(times)
        seconds, time = clock.perf_counter() - began, times[1]
        if number > 1 and seconds > 0.01:
            break
    return seconds / number


def perturbation_for_medians(start: Start) -> float:
    """Perturbation [m] for medians that hardly depend on the method of the runs.

    All runs of a method share its errors, which act as one perturbation of the start. Where a scene ends soon
    after its horizon, runs with smaller perturbations stay near each other, and far from those of another
    method, however accurate.
    """
    adaptive = METHODS[start.plan.method].kind == Kind.ADAPTIVE
    return max(MOVE, (OF_ADAPTIVE_STEPS if adaptive else OF_FIXED_STEPS) * start.net.size)


def small_perturbation_note(start: Start, perturb: float) -> str:
    """Note on perturbations [m] below the errors that runs by a cheap setting share; else ""."""
    least = perturbation_for_medians(start)
    if METHODS[start.plan.method].kind == Kind.ADAPTIVE or perturb >= least:
        return ""
    unit = 10.0 ** (math.floor(math.log10(least)) - 1)
    enough = float(f"{math.ceil(least / unit * (1.0 - 1e-12)) * unit:.2g}")  # to two digits, not less
    return (
        f"perturbations of up to {perturb:g} m are less than the errors of fixed steps of "
        f"{start.plan.method}, which all runs share: medians may be shifted (of the paper's net at 1.75 s "
        "the median of the largest tension by 30 %); give "
        f"--perturb {enough:g} or more, or a solver.accuracy (DOPRI5)"
    )


def validate_arguments(runs: object, perturb: object, seed: object) -> None:
    """Raise InputError for arguments of `ensemble` out of range."""
    require_whole_number("runs", runs, at_least=1)
    if seed is not None:
        require_whole_number("seed", seed, at_least=0)
    require_length("perturb", perturb)


def validate_method(start: Start) -> None:
    """Raise InputError for a requested method that the compiled loop does not have."""
    requested = start.scene.solver.method
    if requested != AUTO and not METHODS[start.plan.method].compiled:
        able = ", ".join(COMPILED_METHODS)
        raise InputError(f"solver.method: an ensemble runs by {able}, or auto, not by {requested}")


def member_bytes(start: Start) -> int:
    """Return what an ensemble keeps in memory of a member at most: metrics and time series [bytes]."""
    system, units = start.system, start.scene.control
    series = 16 + 20 * len(system.bodies) + 6 * len(system.blocks.states) + len(series_of(system))
    series += 4 * len(system.kinematics.point) + (len(units.bullets) if units is not None else 0)
    return 3 * 8 * series * (INTERVALS + 1)  # with quantiles over many of them


def validate_memory(runs: int, start: Start) -> None:
    """Raise InputError for more runs than the machine has memory for."""
    left, each = memory_left(), member_bytes(start)
    if left is not None and runs * each > left:
        most = left // each
        raise InputError(
            f"runs: there is memory for some {most} of them, got {runs} (another limit: {MEMORY_VARIABLE})"
        )


def validate_perturbation(start: Start, perturb: float) -> None:
    """Raise InputError for perturbations that may make an element longer than the cable law is valid for."""
    net = start.net
    if not net.n_net_elements:
        return
    spare = start.system.forces.cable.law.longest - cable.lengths(net, start.position)
    spare = spare[: net.n_net_elements]  # those of tethers are straight at the start, on a reel or not
    element = int(np.argmin(spare))
    most = float(spare[element]) / (2.0 * math.sqrt(3.0))  # both ends go by as much, along x, y and z
    if perturb > most:
        i, j = net.element_nodes[element]
        raise InputError(
            f"perturb: {perturb:g} m may stretch element {element} between nodes {i} and {j} to more than "
            f"{STRETCH_BOUND:g} times its length, where the cable law ends: give {most:.2g} m or less"
        )
