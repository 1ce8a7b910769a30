"""Ensemble of a case: many runs from perturbed starts, in portions, so that what is done survives Ctrl-C."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from pathlib import Path

import numpy as np

from exunet.base.arguments import takes
from exunet.base.errors import InputError, Interrupted, RunStopped
from exunet.base.machine import MEMORY_VARIABLE, memory_left
from exunet.forces import cable
from exunet.forces.cable import STRETCH_BOUND
from exunet.kernels.compile import WIDTH
from exunet.methods.config import AUTO
from exunet.methods.method import COMPILED_METHODS, METHODS, Kind
from exunet.net.areas import achievable_area
from exunet.results.capture_headlines import outcomes
from exunet.results.course import Course
from exunet.results.endings import endings
from exunet.results.ensemble_result import EnsembleResult, ensemble_result
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.simulation import auto
from exunet.simulation.checkpoint import provenance
from exunet.simulation.preparation import Start, start_of
from exunet.simulation.recorder import initial_provenance
from exunet.studies.ensemble import (
    kernel_of_many,
    metres,
    perturbed_bodies_of,
    perturbed_positions,
    require_whole_number,
    run_ensemble,
)
from exunet.studies.measured import course_bytes
from exunet.studies.spread import MOVE, start_of_runs

OF_FIXED_STEPS = 1.4e-5  # of the net's size: above the errors of fixed steps (benchmarks/ensemble.md)
PORTION = 64  # runs that are lost if the ensemble is interrupted; vectors of runs, where they go side by side


@takes(progress=Callable)
def ensemble(
    case: str | Path | Case | Scene | Start,
    runs: int = 1000,
    perturb: float = MOVE,
    seed: int | None = None,
    *,
    progress: Callable[[int], None] | None = None,
) -> EnsembleResult:
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
    story = provenance(case) if isinstance(case, Case) else {}
    story |= {
        name: value
        for name, value in initial_provenance(there).items()
        if name in ("title", "versions", "platform", "method", "tolerance", "step", "end", "effects")
    }
    story |= {"seed": int(seed), "move_m": float(perturb), "runs_asked": int(runs)}
    story["notes"] = [words] if (words := small_perturbation_note(start, perturb)) else []
    began, courses = clock.perf_counter(), list[Course]()
    achievable, retries = achievable_area(there.net), there.scene.solver.retry
    together = kernel_of_many(there, runs) is not None
    portion, evaluations = PORTION * (WIDTH if together else 1), 0

    def made(verdict: str) -> EnsembleResult | None:
        if not courses:
            return None
        found = story | {"seconds": clock.perf_counter() - began, "right_hand_sides": evaluations}
        if counts := outcomes(courses):
            found["outcomes"] = counts
        if ways := endings(courses):
            found["endings"] = ways
        return ensemble_result(courses, complete=verdict == "ok", verdict=verdict, provenance=found)

    try:
        while (done := len(courses)) < runs:
            number = min(portion, runs - done)
            places = perturbed_positions(there, number, perturb, seed, first=done)
            report = None if progress is None else lambda more, done=done: progress(done + more)
            bodies = perturbed_bodies_of(there, number, perturb, seed, first=done)
            found = run_ensemble(
                there,
                places,
                retries=retries,
                progress=report,
                first=done,
                together=together,
                bodies=bodies,
            )
            courses += [found.course(k, achievable) for k in range(number)]
            evaluations += int(found.right_hand_sides.sum())
    except KeyboardInterrupt:
        words = f"interrupted after {len(courses)} of {runs} runs"
        raise Interrupted(words, made(words)) from None
    except RunStopped as stop:
        words = f"{stop}; {len(courses)} of {runs} runs were complete before"
        raise RunStopped(words, made(words), stop.step_cause) from stop
    whole = made("ok")
    assert whole is not None
    return whole


def perturbation_for_medians(start: Start) -> float:
    """Perturbation [m] for medians that hardly depend on the method of the runs."""
    least = auto.perturbation(start.net)
    adaptive = METHODS[start.plan.method].kind == Kind.ADAPTIVE
    return least if adaptive else max(least, OF_FIXED_STEPS * start.net.size)


def small_perturbation_note(start: Start, perturb: float) -> str:
    """Note on perturbations [m] below the errors that runs by a cheap setting share; else ""."""
    if start.scene.solver.accuracy_of == "measures":
        least = auto.perturbation(start.net)
        setting = 'solver.accuracy_of = "measures"'
    elif METHODS[start.plan.method].kind == Kind.ADAPTIVE:
        return ""
    else:
        least, setting = OF_FIXED_STEPS * start.net.size, f"fixed steps of {start.plan.method}"
    if perturb >= least:
        return ""
    return (
        f"perturbations of up to {perturb:g} m are less than the errors of {setting}, which all runs share: "
        f"medians may be shifted (of the paper's net at 1.75 s the median of the largest tension by 30 %); "
        f"give --perturb {_upwards(least):g} or more, or the case's own method (DOPRI5)"
    )


def _upwards(value: float) -> float:
    """To two digits, not less."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit * (1.0 - 1e-12)) * unit:.2g}")


def validate_arguments(runs: object, perturb: object, seed: object) -> None:
    """Raise InputError for arguments of `ensemble` out of range."""
    require_whole_number("runs", runs, at_least=1)
    if seed is not None:
        require_whole_number("seed", seed, at_least=0)
    metres("perturb", perturb)


def validate_method(start: Start) -> None:
    """Raise InputError for a requested method that the compiled loop does not have."""
    requested = start.scene.solver.method
    if requested != AUTO and not METHODS[start.plan.method].compiled:
        able = ", ".join(COMPILED_METHODS)
        raise InputError(f"solver.method: an ensemble runs by {able}, or auto, not by {requested}")


def validate_memory(runs: int, start: Start) -> None:
    """Raise InputError for more runs than the machine has memory for."""
    left, each = memory_left(), course_bytes(start)
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
