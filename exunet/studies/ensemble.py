"""Ensembles: many runs of a case from perturbed starts, by the compiled loop on all cores."""

from __future__ import annotations

import math
import os
import time as clock
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event, local
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.machine import MEMORY_VARIABLE, memory_left
from exunet.bodies.rigid import RigidStates
from exunet.forces import cable
from exunet.forces.cable import STRETCH_BOUND
from exunet.integrators.compiled.loop import loop_kernel
from exunet.integrators.compiled.vectorised_runs import RunsSideBySide, side_by_side_kernel
from exunet.kernels.compile import WIDTH
from exunet.kernels.kernel import Kernel
from exunet.methods.config import AUTO
from exunet.methods.method import COMPILED_METHODS, METHODS, Kind
from exunet.results.ensemble import INTERVALS, Ensemble, Member, ensemble_of, instants, member_of
from exunet.results.result import Result
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation.checkpoint import provenance
from exunet.simulation.expected_time import stored_bytes
from exunet.simulation.extremes import series_of
from exunet.simulation.planning import is_short
from exunet.simulation.preparation import Start, in_the_compiled_loop, start_of
from exunet.simulation.recorder import initial_provenance
from exunet.simulation.rollback import finer
from exunet.studies.members import run_member, run_side_by_side
from exunet.studies.perturbation import (
    perturbed_bodies_of,
    perturbed_positions,
    require_length,
    require_whole_number,
)

Floats = NDArray[np.float64]
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
    `solver.retry` times. Of a case with [capture] the provenance has "outcomes", the number of runs of each
    capture outcome; of one whose script has ended runs, "endings", with numbers and times. If perturbations
    are less than the errors that all runs by a cheap setting share, the provenance has "notes" on it.

    Raises InputError for a number, a perturbation or a seed out of range, for a method that the compiled loop
    does not have, or for more runs than there is memory; MissingExtra without Numba; RunStopped if a run
    stops, and Interrupted on Ctrl-C, both with the runs that were complete before as their `result`.
    """
    validate_arguments(runs, perturb, seed)
    start = start_of(case)
    seed = start.scene.seed if seed is None else seed
    validate_method(start)
    validate_memory(runs, start)
    validate_perturbation(start, perturb)
    there = start_of_runs(start)
    known = provenance(case) if isinstance(case, Case) else {}
    known |= _settings(there, seed, perturb) | {"runs_requested": int(runs)}
    known["notes"] = [words] if (words := small_perturbation_note(start, perturb)) else []
    began, members = clock.perf_counter(), list[Member]()
    together = kernel_of_many(there, runs) is not None
    portion = PORTION * (WIDTH if together else 1)

    def made(verdict: str) -> Ensemble | None:
        if not members:
            return None
        known["seconds"] = clock.perf_counter() - began
        return ensemble_of(members, complete=verdict == "ok", verdict=verdict, provenance=known)

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
    start: Start,
    runs: int = RUNS,
    *,
    along: dict[str, Floats] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Ensemble:
    """Repeat a run from perturbed starts on all cores, whatever times the case stores.

    along    : directions of the momenta over time, by kind; None: those of the first run
    progress : called with the number of completed runs
    Raises RunStopped if one of the runs stops also with finer steps, and as `start_of_runs`.
    """
    there, move, seed = start_of_runs(start), MOVE, start.scene.seed
    members = _perturbed(there, runs, move, seed, progress)
    return ensemble_of(members, provenance=_settings(there, seed, move), along=along)


def _perturbed(
    there: Start, runs: int, move: float, seed: int, progress: Callable[[int], None] | None, **more: Any
) -> list[Member]:
    first = more.get("first", 0)
    places = perturbed_positions(there, runs, move, seed, first=first)
    bodies = perturbed_bodies_of(there, runs, move, seed, first=first)
    retries = there.scene.solver.retry
    return run_members(there, places, member_of, retries=retries, progress=progress, bodies=bodies, **more)


def _settings(there: Start, seed: int, move: float) -> dict[str, Any]:
    names = ("title", "versions", "platform", "method", "tolerance", "step", "end", "effects")
    known = initial_provenance(there)
    return {name: known[name] for name in names} | {"seed": int(seed), "move_m": float(move)}


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
    return ensemble_of(members, provenance=_settings(start, start.scene.seed, 0.0))


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
    bodies = len(system.bodies) + len(system.blocks.body)
    series = 16 + 20 * bodies + 6 * len(system.blocks.states) + len(series_of(system))
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
    spare = STRETCH_BOUND * start.system.forces.cable.law.natural_length - cable.lengths(net, start.position)
    spare = spare[: net.n_net_elements]  # those of tethers are straight at the start, on a reel or not
    element = int(np.argmin(spare))
    most = float(spare[element]) / (2.0 * math.sqrt(3.0))  # both ends go by as much, along x, y and z
    if perturb > most:
        i, j = net.element_nodes[element]
        raise InputError(
            f"perturb: {perturb:g} m may stretch element {element} between nodes {i} and {j} to more than "
            f"{STRETCH_BOUND:g} times its length, where the cable law ends: give {most:.2g} m or less"
        )
