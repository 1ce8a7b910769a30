"""From the keys of [solver] to a plan for this scene: tolerance or step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import Fault
from exunet.case.scene import Scene
from exunet.case.stored_times import stored_times
from exunet.methods.keys import AUTO
from exunet.methods.method import COMPILED_METHODS, METHODS, Kind, Method, TimeLoop
from exunet.methods.plan import Plan
from exunet.simulation import auto
from exunet.system.stability import (
    SAFETY,
    WEAK_GROWTH,
    largest_damping_rate,
    largest_frequency,
    stable_step,
    step_limit,
)
from exunet.system.system import System

# Longest adaptive step, times the highest angular frequency. In free flight the error estimate would allow
# any step; one that ends deep inside a snap overflows, and the engine accepts the step whose error is not a
# number.
LONGEST = 30.0
# Damping rate over the highest frequency from which on damping, not accuracy, sets an explicit method's step.
STIFF = 10.0


def make_plan(scene: Scene, system: System, velocity: NDArray[np.float64]) -> tuple[Plan, list[Fault]]:
    """How this scene is integrated, and what is wrong with that; velocity (n_nodes, 3): initial one [m/s]."""
    solver = scene.solver
    if solver.method == AUTO:
        return _chosen(scene, system, velocity), []
    method = Method(solver.method)
    if METHODS[method].kind == Kind.ADAPTIVE:
        return _adaptive(method, scene, system, velocity), []
    spacing = float(np.diff(stored_times(scene.time)).max())
    limit = step_limit(method, largest_frequency(system), largest_damping_rate(system))
    if solver.step is not None:
        words, faults = _above(limit, min(solver.step, spacing), solver.step, method), []
        if words and not solver.force:
            less = "a smaller one" if METHODS[method].needs_step else "a smaller one or none"
            advice = f"give {less}, or an adaptive method (DOPRI5); solver.force = true runs it anyway"
            faults = [Fault("solver.step", f"{words}; {advice}")]
        notes = [f"step {words}: forced"] if words else []
        return _fixed(method, solver.step, spacing, *notes), faults
    kind = "step limit" if METHODS[method].weak else "stable step"
    note = f"step = {SAFETY:g} x the {kind} {limit:.4g} s of {method}"
    return _fixed(method, SAFETY * limit, spacing, note), []


def _chosen(scene: Scene, system: System, velocity: NDArray[np.float64]) -> Plan:
    """What "auto" chooses: an adaptive explicit method, by the accuracy asked for.

    That holds for stiff damping too: implicit steps beyond the damping's own time misjudge the work that it
    takes, and the guards stop them (benchmarks/auto_table.md).
    """
    solver = scene.solver
    measured = auto.table().at(scene.initial.deployed)
    able = tuple(measured.adaptive) if scene.engine.loop == TimeLoop.EXUDYN else COMPILED_METHODS
    method, why = auto.choose_method(solver.accuracy, able, measured)
    if measured is auto.table().nearly_deployed:
        why += " on nearly deployed starts"
    if solver.tolerance is not None:
        method, why = Method.DOPRI5, "for a given tolerance"
    plan = _adaptive(method, scene, system, velocity)
    notes = [f"auto: {method}, tolerance {plan.tolerance:.2g} ({why})"]
    rate, frequency = largest_damping_rate(system), largest_frequency(system)
    if rate > STIFF * frequency:
        steps = scene.time.end / stable_step(Method.RK44, frequency, rate)
        notes.append(f"stiff damping ({rate:.2g}/s): it, not the accuracy, requires some {steps:.2g} steps")
    if plan.expected_error is not None:
        median, worst = plan.expected_error
        notes.append(
            f"expected speed error: median {median:.1g}, worst {worst:.1g} of the launch speed in the "
            "measured scenes, before the horizon of predictability (exunet run --estimate-error measures it)"
        )
    return replace(plan, notes=(*notes, *plan.notes))


def with_forms(scene: Scene, system: System, plan: Plan) -> tuple[Scene, Plan]:
    """The scene with "auto" of engine.net and engine.loop replaced, and the plan that says by what."""
    engine, notes = scene.engine, plan.notes
    if engine.loop == "auto":
        loop, why = auto.choose_loop(plan.method)
        engine, notes = engine.model_copy(update={"loop": loop}), (*notes, why)
    if engine.net == "auto":
        form, why = auto.choose_net(
            system.net.n_elements, implicit=METHODS[plan.method].kind == Kind.IMPLICIT
        )
        # The compiled loop has a form of its own.
        engine, notes = (
            engine.model_copy(update={"net": form}),
            notes if engine.loop == TimeLoop.COMPILED else (*notes, why),
        )
    if engine.loop == TimeLoop.EXUDYN and plan.tolerance is not None:
        # The engine's longest step, a whole part of the run, has always been measured so.
        longest = scene.time.end / max(1, math.ceil(scene.time.end / plan.longest_step))
        plan = replace(plan, longest_step=longest)
    order = METHODS[plan.method].rotation_order
    names = ", ".join([*scene.bodies, *(one.name for one in system.blocks.states)])
    if names and engine.loop == TimeLoop.EXUDYN and order is not None:
        what = "turning bodies and first-order states" if system.blocks.states else "turning bodies"
        words = f"{plan.method} of Exudyn is of first order for {what} ({names}); RK44 is of order 4"
        notes = (*notes, words)
    return scene.model_copy(update={"engine": engine}), replace(plan, notes=notes)


def _above(limit: float, step: float, given_step: float, method: Method) -> str:
    """Words for a step [s] above the limit, else ""; given_step: that of the case."""
    if step <= limit:
        return ""
    given = f"{given_step:.4g} s"
    if step < given_step:
        given += f" (shortened to the {step:.4g} s between stored times)"
    words = f"{given} is above the stable step {limit:.4g} s of {method} on this net"
    if METHODS[method].weak:
        words = f"{given} is above the step limit {limit:.4g} s of {method} on this net, at which its"
        words += f" fastest mode grows by {WEAK_GROWTH:.0%} a step"
    return words


def _fixed(method: Method, step: float, spacing: float, *notes: str) -> Plan:
    """A fixed step no longer than the widest gap between stored times, which are hit exactly."""
    if step > spacing:
        notes = (*notes, f"step shortened from {step:.4g} s to the {spacing:.4g} s between stored times")
    return Plan(method, step=min(step, spacing), notes=notes)


def _adaptive(method: Method, scene: Scene, system: System, velocity: NDArray[np.float64]) -> Plan:
    solver = scene.solver
    notes: tuple[str, ...] = ()
    tolerance, expected = solver.tolerance, None
    if tolerance is None:
        speed = float(np.sqrt((velocity**2).sum(axis=1)).max(initial=0.0)) or 1.0
        known = auto.table().at(scene.initial.deployed).adaptive[method]
        relative = known.tolerance_for(solver.accuracy)
        tolerance, expected = relative * speed, known.expected_error(relative)
        if solver.accuracy < known.best:
            notes = (
                f"accuracy {solver.accuracy:g} is beyond double precision here: "
                f"ran at the best, {known.best:.1g}, tolerance {tolerance:.2g}",
            )
    frequency = largest_frequency(system)
    period = 1.0 / frequency if frequency else math.inf
    first = min(scene.time.end, 0.1 * period)
    return Plan(
        method,
        tolerance=tolerance,
        first_step=first,
        longest_step=LONGEST * period,
        least_step=1e-6 * first,
        expected_error=expected,
        notes=notes,
    )
