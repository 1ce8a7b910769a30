"""Spread of a run: the case from perturbed starts in the compiled loop, some of them with a finer setting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from exunet.bodies.rigid import RigidStates
from exunet.methods.method import METHODS, Method
from exunet.model.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.net.areas import achievable_area
from exunet.results.course import Course, instants
from exunet.results.spread import COVERING, FEWEST, Spread
from exunet.simulation import auto
from exunet.simulation.preparation import Start, in_the_compiled_loop
from exunet.studies.ensemble import (
    perturbed_bodies_of,
    perturbed_positions,
    require_whole_number,
    run_ensemble,
)
from exunet.studies.perturbation import of_other_accuracy

MOVE = 1e-9  # [m]: far below what anyone can place, far above what the integrators round off
# Elements times end time over stable step (of central differences), above which 8 perturbed runs follow a run
# and not 32. A run of a net alone takes some 0.1 s at this bound, all 32 a few seconds. The deployment of the
# paper's net of 64 elements over 2 s has 7.1e5, captures by larger nets have 1e6 to 2e8.
LONG_RUN = 7.5e5
NO_NUMBA = "the compiled loop needs Numba, which is not installed (pip install numba)"
FINER_PART = 4  # one in so many perturbed runs has the finer setting
BESIDE = 2  # runs beside the perturbed ones: the unperturbed one, and that with a finer setting


def start_of_runs(start: Start) -> Start:
    """The start in the compiled loop, at the instants of courses, whatever times the case stores.

    Its method and setting are the run's where the compiled loop has the method, else DOPRI5 at the case's
    accuracy. Raises CaseError where the compiled loop cannot have the scene, MissingExtra without Numba.
    """
    times = tuple(instants(start.scene.time.end).tolist())
    time = start.scene.time.model_copy(update={"output_step": None, "output_times": times})
    return in_the_compiled_loop(replace(start, scene=start.scene.model_copy(update={"time": time})))


def move_of(start: Start) -> float:
    """Return the largest perturbation of a coordinate in the runs of a spread [m]."""
    of_measures = start.scene.solver.accuracy_of == "measures"
    return max(MOVE, auto.perturbation(start.net)) if of_measures else MOVE


def default_runs(start: Start) -> int:
    """Return how many perturbed runs follow a run: 32, or 8 of a case above `LONG_RUN`, on any machine."""
    limit = stable_step(
        Method.VELOCITY_VERLET, largest_frequency(start.system), largest_damping_rate(start.system)
    )
    return COVERING if start.net.n_elements * start.scene.time.end <= LONG_RUN * limit else FEWEST


def spread_of(
    start: Start,
    runs: int = COVERING,
    *,
    move: float | None = None,
    seed: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Spread:
    """Run a case from perturbed starts on all cores, whatever times the case stores.

    runs     : number of perturbed runs
    move     : largest perturbation of each coordinate [m]; of free bodies also of attitudes [rad] and angular
               velocities [rad/s]. None: that of `move_of`
    seed     : of the perturbations; None: the case's
    progress : called with the number of completed runs, of `runs` + 2
    Raises RunStopped if one of the runs stops also with finer steps, and as `start_of_runs`.
    """
    require_whole_number("runs", runs, at_least=1)
    there = start_of_runs(start)
    seed = start.scene.seed if seed is None else seed
    move = move_of(start) if move is None else move
    moved = perturbed_positions(there, runs, move, seed)
    bodies = perturbed_bodies_of(there, runs, move, seed)
    achievable, retries = achievable_area(there.net), there.scene.solver.retry

    positions = np.concatenate([there.position[None], moved])
    if bodies is not None:
        pairs = zip(there.state.bodies.parts(), bodies.parts(), strict=True)
        bodies = RigidStates(*(np.concatenate([own[None], other]) for own, other in pairs))

    def courses_of(of: Start, rows: np.ndarray, before: int) -> tuple[tuple[Course, ...], int]:
        """Courses of these rows of the starts, 0 being the unperturbed one; right-hand sides of the first."""
        report = None if progress is None else lambda done: progress(before + done)
        states = None if bodies is None else bodies[rows]
        found = run_ensemble(of, positions[rows], retries=retries, progress=report, bodies=states)
        courses = tuple(found.course(k, achievable) for k in range(len(found)))
        return courses, int(found.right_hand_sides[0])

    own = runs - runs // FINER_PART + 1
    (plain, *others), evaluations = courses_of(there, np.arange(own), 0)
    finer = replace(there, plan=of_other_accuracy(there.plan))
    (converged, *finer_others), _ = courses_of(finer, np.r_[0, own : runs + 1], own)
    return Spread(
        courses=tuple(others),
        finer_courses=tuple(finer_others),
        plain=plain,
        finer=converged,
        seed=seed,
        move=move,
        method=there.plan.method.value,
        tolerance=there.plan.tolerance,
        step=there.plan.step,
        finer_setting=finer.plan.step or finer.plan.tolerance or 0.0,
        mean_step=float(plain.time[-1]) * METHODS[there.plan.method].compiled_stages / max(1, evaluations),
    )
