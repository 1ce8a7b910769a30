"""Integration plan of a scene from the keys of [solver]: method, and tolerance or step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from exunet.base.errors import Fault
from exunet.kernels.compile import numba_installed
from exunet.methods.config import ACCURACY, AUTO
from exunet.methods.method import METHODS, Backend, Kind, Method, Plan, turning_polynomial
from exunet.model.limits import (
    SAFETY,
    WEAK_GROWTH,
    largest_damping_rate,
    largest_frequency,
    relative_speed,
    rotation_step_limit,
    sets_the_step,
    stable_step,
    step_limit,
)
from exunet.model.system import State, System
from exunet.scene.scene import Scene
from exunet.simulation import pilot
from exunet.simulation.guards import ENERGY_BOUND

# Longest adaptive step, times the highest angular frequency. In free flight the error estimate would allow
# any step; one that ends deep inside a snap overflows, and the engine accepts the step whose error is not a
# number.
LONGEST = 30.0
# Part of half the thickness of a touched body by which the net may approach it in an adaptive step. A slack
# net in free flight has no error that makes steps shorter, so that a step may pass a thin body unseen.
APPROACH = 0.5
# Damping rate over the highest frequency from which on damping, not accuracy, sets an explicit method's step.
STIFF = 10.0
# Elements times end time over stable step (of central differences), up to which 32 perturbed runs follow a
# run and not 8. The compiled loop takes 0.1 s at this bound. The deployment of the paper's net of 64 elements
# over 2 s has 7.1e5, captures by larger nets have 1e6 to 2e8.
SHORT = 7.5e5
_NO_LIMIT = "step = that between stored times: nothing in the scene swings or is damped, which would limit it"
# Part of the stable step of a scene with contact, reels and closing lines for metrics: bounds of their rates
# are added, and contact has few periods. At 0.6 the momentum that a captured box gets changes by less than
# 2 % with half of the step (benchmarks/divisions.md).
OF_WHOLE = 0.5
# Elements times end time over stable step, below which a run for metrics takes a part of that step, at least
# `FINEST`: the square root of the work, as time allows it. It resolves single snaps. With four times the step
# 38 of 561 medians of 18 random scenes were off by more than range and 1 %, with twice 21, with this one 6.
FINER_BELOW = 1.2e7
FINEST = 0.025
# Tolerance over the launch speed: (FINENESS x accuracy)^POWER. Errors grow until the horizon, the later the
# looser the accuracy is: benchmarks/accuracy_promise.md.
FINENESS, POWER = 1e-10, 0.75
LEAST_TOLERANCE = 1e-12  # over the launch speed: below it round-off is larger


def make_plan(scene: Scene, system: System, state: State) -> tuple[Plan, list[Fault]]:
    """Return the integration plan of a scene from a state, and its faults."""
    plan, faults = _by_forces(scene, system, state)
    faults = [*faults, *_below_round_off(scene.solver.tolerance, state)]
    limit = rotation_limit(scene, system, state, plan)
    if plan.step is None or plan.step <= SAFETY * limit:
        return plan, faults
    if scene.solver.step is None:
        note = f"step = {SAFETY:g} x the {limit:.4g} s that {plan.method} allows for the rotation of bodies"
        return replace(plan, step=SAFETY * limit, notes=(*plan.notes, note)), faults
    if plan.step > limit:
        spin = state.bodies.angular_velocity[system.moves_freely]
        words = (
            f"bodies rotate at up to {np.linalg.norm(spin, axis=1).max():.4g} rad/s: above {limit:.4g} s "
            f"{plan.method} may change their energy by more than {ENERGY_BOUND:.0%} until time.end: "
            "use a smaller step, or an adaptive method (DOPRI5)"
        )
        faults = [*faults, Fault("solver.step", words)]
    return plan, faults


def _below_round_off(tolerance: float | None, state: State) -> list[Fault]:
    """Return the fault of a tolerance [m/s] below the round-off of the initial speeds."""
    velocity = np.concatenate([state.velocity, state.bodies.velocity])
    speed = float(np.linalg.norm(velocity, axis=1).max(initial=0.0))
    least = float(np.finfo(np.float64).eps) * speed
    if tolerance is None or tolerance >= least:
        return []
    words = (
        f"{tolerance:g} is below the round-off {least:.1g} m/s of initial speeds up to {speed:.4g} m/s: "
        "increase it, or use solver.accuracy"
    )
    return [Fault("solver.tolerance", words)]


def rotation_limit(scene: Scene, system: System, state: State, plan: Plan) -> float:
    """Compute the longest fixed step [s] for bodies with the spin of a state, or infinity."""
    backend = scene.engine.backend
    if backend == AUTO:
        backend, _ = choose_backend(scene, plan.method)
    polynomial = turning_polynomial(plan.method, Backend(backend))
    if not (polynomial and system.moves_freely.any()):
        return math.inf
    return rotation_step_limit(
        system, state.bodies.angular_velocity, polynomial, scene.time.end, ENERGY_BOUND
    )


def _by_forces(scene: Scene, system: System, state: State) -> tuple[Plan, list[Fault]]:
    """Return plan and faults by forces and accuracy, without regard to rotation."""
    solver = scene.solver
    spacing = float(np.diff(scene.time.stored_times).max())
    if solver.for_metrics:
        return _for_metrics(scene, system, state, spacing), []
    method = Method.DOPRI5 if solver.method == AUTO else Method(solver.method)
    if METHODS[method].kind == Kind.ADAPTIVE:
        return _adaptive(method, scene, system, state), []
    limit = step_limit(method, largest_frequency(system), largest_damping_rate(system))
    if solver.step is not None:
        words, faults = _above(limit, min(solver.step, spacing), solver.step, method, system), []
        if words and not solver.force:
            less = "a smaller one" if METHODS[method].needs_step else "a smaller one or none"
            advice = f"give {less}, or an adaptive method (DOPRI5); solver.force = true runs it anyway"
            faults = [Fault("solver.step", f"{words}; {advice}")]
        notes = [f"step {words}: forced"] if words else []
        return _fixed(method, solver.step, spacing, *notes), faults
    kind = "step limit" if METHODS[method].weak else "stable step"
    if math.isinf(limit):
        return Plan(method, step=spacing, notes=(_NO_LIMIT,)), []
    note = f"step = {SAFETY:g} x the {kind} {limit:.4g} s of {method}{limited_by(system)}"
    return _fixed(method, SAFETY * limit, spacing, note), []


def _for_metrics(scene: Scene, system: System, state: State, spacing: float) -> Plan:
    """Plan VelocityVerlet at a part of its stable step that a short run shows to be safe.

    Beyond the horizon of predictability a run is one sample, however small its error: only the distribution
    of a metric can be right. Velocity Verlet is symplectic, and its energy does not drift.
    """
    alone = system.alone
    net, whole = (
        stable_step(Method.VELOCITY_VERLET, largest_frequency(some), largest_damping_rate(some))
        for some in (alone, system)
    )
    if math.isinf(whole):
        return _adaptive(Method.DOPRI5, scene, system, state)
    finer = min(1.0, max(FINEST, math.sqrt(system.net.n_elements * scene.time.end / (FINER_BELOW * whole))))
    part = pilot.part_of_stable_step(alone)
    words = f"{part:g} x the stable step of the net, from a short run"
    if OF_WHOLE * whole < part * net:
        words = f"{OF_WHOLE:g} x the stable step of the scene{limited_by(system)}"
    if finer < 1.0:
        words += f"; {finer:.2g} x that, as the run is short"
    words = f"auto: {Method.VELOCITY_VERLET} for metrics, {words}"
    return _fixed(Method.VELOCITY_VERLET, finer * min(part * net, OF_WHOLE * whole), spacing, words)


def relative_tolerance(accuracy: float) -> float:
    """Return the tolerance over the launch speed for an accuracy of the bullets' velocities."""
    return max(LEAST_TOLERANCE, math.exp(POWER * math.log(FINENESS * accuracy)))


def _adaptive(method: Method, scene: Scene, system: System, state: State) -> Plan:
    """Plan an adaptive method with the tolerance of the case, or of its accuracy."""
    solver = scene.solver
    tolerance, note = solver.tolerance, "of the case"
    if tolerance is None:
        accuracy = solver.accuracy or ACCURACY
        tolerance = relative_tolerance(accuracy) * relative_speed(system, state)
        whose, speed = ("bullets", "launch") if len(system.net.bullet_nodes) else ("nodes", "largest")
        note = f"for velocities of the {whose} to {accuracy:g} of the {speed} speed before the horizon"
    notes = [f"auto: {method}, tolerance {tolerance:.2g}, {note}"] if solver.method == AUTO else []
    rate, frequency = largest_damping_rate(system), largest_frequency(system)
    if rate > STIFF * frequency:
        # Implicit steps longer than the time constant of damping misjudge its work, and the guards stop them.
        steps = scene.time.end / stable_step(Method.RK44, frequency, rate)
        notes.append(f"stiff damping ({rate:.2g}/s): it, not the accuracy, requires some {steps:.2g} steps")
    period = 1.0 / frequency if frequency else math.inf
    first = min(scene.time.end, 0.1 * period)
    return Plan(
        method,
        tolerance=tolerance,
        first_step=first,
        longest_step=min(LONGEST * period, approach_step(system)),
        least_step=1e-6 * first,
        notes=tuple(notes),
    )


def is_short(system: System, end: float) -> bool:
    """Return True for a run to a time [s] of little work, on any machine."""
    limit = stable_step(Method.VELOCITY_VERLET, largest_frequency(system), largest_damping_rate(system))
    return system.net.n_elements * end <= SHORT * limit


def choose_backend(scene: Scene, method: Method) -> tuple[Backend, str]:
    """Choose the backend for engine.backend = "auto", and state why where it is Exudyn."""
    hosted = any(body.motion == "port" for body in scene.bodies.values())
    if hosted or (METHODS[method].compiled and numba_installed()):
        return Backend.COMPILED, ""
    if METHODS[method].compiled:
        return Backend.EXUDYN, "Exudyn: Numba is not installed (pip install numba) or disabled"
    return Backend.EXUDYN, f"Exudyn: the compiled loop does not have {method}"


def with_backend(scene: Scene, system: System, plan: Plan) -> Plan:
    """Set the backend of a plan: that of the scene, or for "auto" one that is chosen and noted."""
    backend, notes = scene.engine.backend, plan.notes
    if backend == AUTO:
        backend, why = choose_backend(scene, plan.method)
        notes = (*notes, why) if why else notes
    if backend == Backend.EXUDYN and plan.tolerance is not None:
        # The engine's longest step, a whole part of the run, has always been measured so.
        longest = scene.time.end / max(1, math.ceil(scene.time.end / plan.longest_step))
        plan = replace(plan, longest_step=longest)
    words = slow_turning(scene, system, plan.method)
    if words and backend == Backend.EXUDYN:
        notes = (*notes, words)
    return replace(plan, backend=Backend(backend), notes=notes)


def slow_turning(scene: Scene, system: System, method: Method) -> str:
    """Warn of a method of Exudyn of lower order for the bodies and states of a scene; else ""."""
    names = ", ".join([*scene.bodies, *(state.name for state in system.blocks.states)])
    if not names or METHODS[method].rotation_order is None:
        return ""
    what = "turning bodies and first-order states" if system.blocks.states else "turning bodies"
    return f"{method} of Exudyn is of first order for {what} ({names}); RK44 is of order 4"


def _above(limit: float, step: float, given_step: float, method: Method, system: System) -> str:
    """Describe a step [s] above the limit, else ""; given_step: step of the case."""
    if step <= limit:
        return ""
    given = f"{given_step:.4g} s"
    if step < given_step:
        given += f" (shortened to the {step:.4g} s between stored times)"
    what = limited_by(system) or " on this net"
    words = f"{given} is above the stable step {limit:.4g} s of {method}{what}"
    if METHODS[method].weak:
        words = f"{given} is above the step limit {limit:.4g} s of {method}{what}, at which the"
        words += f" fastest mode grows by {WEAK_GROWTH:.0%} a step"
    return words


def limited_by(system: System) -> str:
    """Describe a term that limits the stable step more than the net; else ""."""
    key, name, _ = sets_the_step(system)
    return "" if key == "net" else f", limited by {name} ({key})"


def _fixed(method: Method, step: float, spacing: float, *notes: str) -> Plan:
    """Plan a fixed step, at most the largest interval between stored times, which are reached exactly."""
    if step > spacing:
        notes = (*notes, f"step shortened from {step:.4g} s to the {spacing:.4g} s between stored times")
    return Plan(method, step=min(step, spacing), notes=notes)


def with_pilots(scene: Scene, system: System, state: State, plan: Plan) -> Plan:
    """Return the plan with the step of RK44 that keeps the energy balance of bodies that no host moves."""
    hosted = any(body.motion == "port" for body in scene.bodies.values())
    if plan.method == Method.RK44 and scene.solver.step is None and scene.bodies and not hosted:
        return pilot.with_step(scene, system, state, plan)
    return plan


def approach_step(system: System) -> float:
    """Compute the step [s] in which the net approaches no touched body by more than `APPROACH` of its half.

    By the speeds at the start, with those of an ejection that comes later; infinite if nothing is touched.
    """
    blocks, speeds = system.blocks, system.blocks.speeds
    longest = math.inf
    for name, surface in blocks.surfaces.items():
        body = blocks.rigid.index(name)
        relative = np.linalg.norm(speeds.points - speeds.bodies[body], axis=1).max(initial=0.0)
        speed = float(relative + np.linalg.norm(speeds.spins[body]) * surface.radius)
        if speed > 0.0:
            longest = min(longest, APPROACH * surface.least / speed)
    return longest
