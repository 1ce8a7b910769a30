"""From the keys of [solver] to a plan for this scene: tolerance or step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from exunet.effects.terms import Terms
from exunet.net.arrays import Net
from exunet.scene import Scene
from exunet.solvers import METHODS, Plan
from exunet.stability import SAFETY, largest_damping_rate, largest_frequency, stable_step
from exunet.times import stored_times

# Absolute tolerance of DOPRI5, as a part of the speed error asked for: at the paper's undamped net the speed
# error at t = 1.5 s is about 300 to 700 times the tolerance; 10 000 leaves room for harder nets.
TOLERANCE_PER_ACCURACY = 1e-4
# Longest adaptive step, times the highest angular frequency. In free flight the error estimate would allow any
# step; one that ends deep inside a snap overflows, and the engine accepts the step whose error is not a number.
LONGEST = 30.0
LEAST_TOLERANCE = 1e-12  # below this, steps are rejected for round-off and nothing is gained


def make_plan(scene: Scene, net: Net, terms: Terms, velocity: NDArray[np.float64]) -> Plan:
    """How this scene is integrated; velocity (n_nodes, 3) is the initial one [m/s]."""
    solver = scene.solver
    if METHODS[solver.method].kind == "adaptive":
        return _adaptive(scene, net, velocity)
    spacing = float(np.diff(stored_times(scene.time)).max())
    if solver.step is not None:
        return _fixed(solver.method, solver.step, spacing)
    limit = stable_step(solver.method, largest_frequency(net), largest_damping_rate(net, terms))
    note = f"step = {SAFETY:g} x the stable step {limit:.4g} s of {solver.method}"
    return _fixed(solver.method, SAFETY * limit, spacing, note)


def _fixed(method: str, step: float, spacing: float, *notes: str) -> Plan:
    """A fixed step no longer than the widest gap between stored times, which are hit exactly."""
    if step > spacing:
        notes = (*notes, f"step shortened from {step:.4g} s to the {spacing:.4g} s between stored times")
    return Plan(method, step=min(step, spacing), notes=notes)


def _adaptive(scene: Scene, net: Net, velocity: NDArray[np.float64]) -> Plan:
    solver = scene.solver
    notes: tuple[str, ...] = ()
    tolerance = solver.tolerance
    if tolerance is None:
        speed = float(np.sqrt((velocity**2).sum(axis=1)).max(initial=0.0)) or 1.0
        tolerance = TOLERANCE_PER_ACCURACY * solver.accuracy * speed
        if tolerance < LEAST_TOLERANCE:
            tolerance = LEAST_TOLERANCE
            reached = LEAST_TOLERANCE / (TOLERANCE_PER_ACCURACY * speed)
            notes = (
                f"accuracy {solver.accuracy:g} is beyond double precision here: "
                f"ran at {reached:.2g}, tolerance {tolerance:g}",
            )
    frequency = largest_frequency(net)
    period = 1.0 / frequency if frequency else math.inf
    first = min(scene.time.end, 0.1 * period)
    return Plan(
        solver.method,
        tolerance=tolerance,
        first_step=first,
        longest_step=LONGEST * period,
        least_step=1e-6 * first,
        notes=notes,
    )
