"""Pilot runs: the tolerance or the step that a scene needs, measured on the scene before the run.

Tolerance of nearly deployed starts. All threads snap one after the other, and errors grow by a factor of 1e8
within a tenth of a second; inside a snap they are a hundred times those after it. With a tolerance of 3e-10
the paper's net has errors of 1e-9 at 0.08 s and 1e-2 at 0.15 s (packing 0.95, strings of 1.4 m). Measurements
of other starts do not apply. So several tolerances are run in the compiled loop, through the stored times and
the times of poses, to the end of the run.

Fixed step of scenes with bodies. A fifth of the stable step keeps a net within the guards, 5 % of the energy
that can deform it, but not its energy balance: at each snap the force has a kink, and RK44 loses its order.
Frequencies do not give the number and strength of snaps: of the shipped scenes some need no smaller step for
1e-5, one a sixty-fourth. So the scene is run in the compiled loop, with half the step each time, until the
energy balance holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import RunStopped
from exunet.forces.blocks import AWAKE
from exunet.forces.effects import switched_on
from exunet.forces.terms import Change
from exunet.integrators.compiled.loop import CompiledIntegration, CompiledLoop, loop_kernel
from exunet.integrators.protocol import Arrays, Batch, Extremes, IntegrationFailed
from exunet.kernels.compile import numba_installed
from exunet.kernels.kernel import Kernel
from exunet.methods.method import METHODS, Backend, Method, Plan
from exunet.model.stability import largest_frequency
from exunet.model.states import States
from exunet.model.system import State, System
from exunet.scene.scene import Scene
from exunet.simulation.guards import LEAST_ENERGY, Guards

Floats = NDArray[np.float64]

# Tolerances over the launch speed, and the one that they are compared with.
TOLERANCES = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
TIGHT = 1e-13
# Bound of the error of a run over that of the pilot. In the compiled loop both are the same run; the
# comparison has an error of a tenth, and round-off differs. Exudyn does not end steps where a thread becomes
# taut, and its errors there scatter by two decades: at most 212 times the pilot's in runs of 73 starts.
MARGIN_COMPILED, MARGIN_EXUDYN = 3.0, 300.0
# Factor of the accuracy above which the error of a single node is reported.
FAR = 10.0
# Evaluations of elements that a pilot may take, some seconds; and those of an element in a radian of the
# highest frequency, of all tolerances together: 180 were measured.
MOST = 2e8
PER_RADIAN = 200.0
_ROUND_OFF = 1e-15  # perturbation of the start, over the size of the net
_CHUNK = 64  # stored times in memory at once


@dataclass(frozen=True)
class Pilot:
    """Errors of pilot runs.

    time  : (t,) stored times of the run [s]
    error : (k, t) for each of TOLERANCES the error of the bullets' velocities over the launch speed: the
            largest of this and tighter tolerances, and of round-off
    nodes : (k,) the same of the node with the largest error, at the end
    """

    time: Floats
    error: Floats
    nodes: Floats

    def chosen(self, accuracy: float, margin: float) -> int | None:
        """Return the number of the largest tolerance whose error at the end, times `margin`, is allowed."""
        good = np.flatnonzero(margin * self.error[:, -1] <= accuracy)
        return int(good[0]) if len(good) else None

    def at_end(self, number: int) -> float:
        """Return the error at the end with one of TOLERANCES."""
        return float(self.error[number, -1])

    def until(self, accuracy: float, margin: float) -> float:
        """Return the last stored time [s] until which the smallest tolerance keeps an accuracy."""
        lost = np.flatnonzero(margin * self.error[-1] > accuracy)
        return float(self.time[max(0, lost[0] - 1)]) if len(lost) else float(self.time[-1])


def with_tolerance(
    plan: Plan, accuracy: float, backend: Backend, system: System, state: State, times: Floats, speed: float
) -> Plan:
    """Return the plan with the tolerance that keeps an accuracy at the end of this run, and its error.

    plan  : with the tolerance of folded starts
    backend : of the run
    times : (t,) the run's stored times [s]
    speed : the launch speed [m/s]
    """
    why = pilot_excluded(plan, system, float(times[-1]))
    found = None if why else try_tolerances(system, state, plan, times, speed)
    if found is None:
        words = f"accuracy unknown for this nearly deployed start: {why or 'a pilot run failed'}"
        return replace(plan, expected_error=None, notes=(*plan.notes, words))
    margin = MARGIN_COMPILED if backend == Backend.COMPILED else MARGIN_EXUDYN
    number = found.chosen(accuracy, margin)
    taken = len(TOLERANCES) - 1 if number is None else number
    error = found.at_end(taken)
    if number is not None:
        words = (
            f"nearly deployed: tolerance from pilot runs of this start, error of the bullets {error:.1g} of "
            f"the launch speed at the end in the compiled loop, with a margin of {margin:g}"
        )
    else:
        until = found.until(accuracy, margin)
        where = f"until t = {until:.4g} s, not at the end" if until > times[0] else "at no stored time"
        words = (
            f"nearly deployed: accuracy {accuracy:g} of the bullets is reached {where}: snaps cause errors "
            f"of {error:.1g} of the launch speed, and up to {margin:g} times that"
        )
        if backend != Backend.COMPILED and found.chosen(accuracy, MARGIN_COMPILED) is not None:
            words += '; engine.backend = "compiled" reaches it'
    of_one = node_warning(float(found.nodes[taken]), accuracy, margin, best=taken == len(TOLERANCES) - 1)
    notes = [words, of_one] if of_one else [words]
    tolerance = TOLERANCES[taken] * speed
    return replace(
        plan, tolerance=tolerance, expected_error=(error, margin * error), notes=(*plan.notes, *notes)
    )


def node_warning(error: float, accuracy: float, margin: float, *, best: bool) -> str:
    """Warn of single nodes with far larger errors than the bullets; "" without any.

    error : of the node with the largest error, in the compiled loop, over the launch speed
    best  : there is no smaller tolerance
    """
    if margin * error <= FAR * accuracy:
        return ""
    scatter = "" if error > FAR * accuracy else f", up to {margin:g} times that with Exudyn"
    advice = "no tolerance reduces it" if best else "if they matter, use a smaller solver.accuracy"
    return (
        "single nodes exceed the accuracy of the bullets: error of a velocity at the end "
        f"{error:.1g} of the launch speed in the compiled loop{scatter}; {advice}"
    )


def pilot_excluded(plan: Plan, system: System, end: float) -> str:
    """Return why pilot runs to a time [s] are excluded; "" if they are not."""
    if plan.method != Method.DOPRI5:
        return f"not measured for {plan.method}"
    if not numba_installed():
        return "Numba is not installed"
    if system.memory:
        return "the forces change at events"
    if PER_RADIAN * largest_frequency(system) * end * system.net.n_elements > MOST:
        return "pilot runs would take too long"
    return ""


def try_tolerances(system: System, state: State, plan: Plan, times: Floats, speed: float) -> Pilot | None:
    """Run all tolerances from a state through the stored `times`; None if a run fails or takes too long.

    plan  : of the run, for the lengths of its steps
    speed : the launch speed [m/s]
    """
    kernel, stops = loop_kernel(system), stops_of(system, times)
    stored = np.isin(stops, times)
    left = int(MOST / (METHODS[Method.DOPRI5].stages * system.net.n_elements))

    def run(tolerance: float, start: State) -> tuple[Floats, Floats] | None:
        nonlocal left
        loop = CompiledIntegration(system, start, _plan(plan, tolerance * speed), kernel)
        found = _velocities(loop, system.net.bullet_nodes, stops, left)
        left -= loop.counts.steps + loop.counts.rejected
        return None if found is None else (found[0][stored], found[1])

    shift = np.random.default_rng(0).uniform(-_ROUND_OFF, _ROUND_OFF, state.position.shape)
    shift[system.net.fixed_nodes] = 0.0
    moved = state.at(state.position + system.net.size * shift, state.velocity)
    runs = [
        run(TIGHT, state),
        run(TOLERANCES[-1], moved),
        *(run(tolerance, state) for tolerance in TOLERANCES),
    ]
    complete = [velocities for velocities in runs if velocities is not None]
    if len(complete) < len(runs):
        return None
    bullets, nodes = (_errors([velocities[k] for velocities in complete]) / speed for k in (0, 1))
    return Pilot(times, bullets, nodes)


def _errors(velocities: list[Floats]) -> Floats:
    """Compute (k, ...) errors against the first run [m/s]: the largest of this, later and the second run.

    velocities : (..., points, 3) of each run; the second is that of round-off
    """
    off = np.linalg.norm(np.array(velocities[1:]) - velocities[0], axis=-1).max(axis=-1)
    return np.maximum(np.maximum.accumulate(off[:0:-1], axis=0)[::-1], off[0])


def stops_of(system: System, times: Floats) -> Floats:
    """Return the times at which steps end [s]: stored times, and times of poses between them."""
    knots = np.array(system.kinematics.knots)
    return np.union1d(times, knots[(times[0] < knots) & (knots < times[-1])])


def _plan(plan: Plan, tolerance: float) -> Plan:
    return Plan(
        Method.DOPRI5,
        tolerance=tolerance,
        first_step=plan.first_step,
        longest_step=plan.longest_step,
        least_step=plan.least_step,
    )


def _velocities(
    loop: CompiledIntegration, bullets: NDArray[np.int64], times: Floats, most: int
) -> tuple[Floats, Floats] | None:
    """Return velocities (t, bullets, 3) at the times, and (nodes, 3) at the last [m/s].

    None if steps collapse, are more than `most`, or overflow.
    """
    found: list[Floats] = []
    for first in range(0, len(times) - 1, _CHUNK):
        chunk = times[first : first + _CHUNK + 1]
        batch = loop.through(chunk, most)
        if len(batch.time) < len(chunk) or not np.isfinite(batch.velocity[-1]).all():
            return None
        found.append(batch.velocity[1 if first else 0 :, bullets])
    return np.concatenate(found), batch.velocity[-1].copy()


BOOK = 1e-5  # largest error of the energy book at the stored times, over the energy scale
MARGIN = 2.0  # for Exudyn, whose errors are those of the compiled loop until round-off has moved the snaps
_CALL = 21.0  # elements that take as long as the rest of a right-hand side


def with_step(scene: Scene, system: System, state: State, plan: Plan) -> Plan:
    """Return the plan with the longest of its step, a half, a quarter ... that keeps the energy balance.

    plan : of RK44, with the step from the frequencies of the scene
    """
    assert plan.step is not None
    if why := step_pilot_excluded(scene):
        words = f"energy balance of this step within the bound of the guards only: {why}"
        return replace(plan, notes=(*plan.notes, words))
    times, kernel = scene.time.stored_times, loop_kernel(system)
    step, found, tried = plan.step, math.inf, 0.0
    while found > BOOK / MARGIN:
        tried += _evaluations(plan, system, step, times)
        if tried > MOST:
            words = f"energy balance to {BOOK:g} not ensured: pilot runs took too long"
            if math.isfinite(found):
                words += f"; with steps of {2.0 * step:.4g} s its error was {found:.1g}"
            return replace(plan, step=min(2.0 * step, plan.step), notes=(*plan.notes, words))
        found = _error(replace(plan, step=step), system, state, times, kernel)
        step *= 0.5
    taken = 2.0 * step  # of the last run
    part = "that" if taken == plan.step else f"1/{plan.step / taken:g} of that, {taken:.4g} s,"
    words = f"{part} keeps the energy balance to {BOOK:g}: {found:.1g} in a compiled pilot run"
    return replace(plan, step=taken, notes=(*plan.notes, words))


def step_pilot_excluded(scene: Scene) -> str:
    """Return why pilot runs are excluded; "" if they are not."""
    if not numba_installed():
        return "Numba is not installed"
    if not {"contact", "self_contact"}.isdisjoint(switched_on(scene.effects)):
        return "with contact, pilot runs would take too long"
    return ""


def _evaluations(plan: Plan, system: System, step: float, times: Floats) -> float:
    """Return the evaluations of elements in a run with a step [s]."""
    steps = float(np.ceil(np.diff(times) / step - 1e-9).sum())
    return METHODS[plan.method].compiled_stages * steps * (system.net.n_elements + _CALL)


def _error(plan: Plan, system: System, state: State, times: Floats, kernel: Kernel) -> float:
    """Run a pilot; return the largest error of its energy balance over the scale, infinite if it stopped."""
    balance = _Balance(system, state)
    loop = CompiledLoop(system, state, plan, balance, kernel)
    try:
        for until in times[1:].tolist():
            loop.advance(until)
            loop.flush()
            if loop.stopped:
                break
    except (RunStopped, IntegrationFailed):
        return math.inf
    return balance.error


class _Balance:
    """Observer of a pilot run (see `exunet.integrators.protocol.Observer`), flushed at stored times.

    off : largest error of the energy balance so far [J]
    """

    asks_for_elements = False

    def __init__(self, system: System, state: State) -> None:
        self._system, self._memory = system, dict(state.memory)
        self._guards = Guards(system, state)
        self._left = system.lost_at_start + float(system.given_work(state.first_order))
        self.off = 0.0

    @property
    def error(self) -> float:
        """Largest error over the energy scale; round-off counts as 0 where nothing can deform."""
        if scale := self._guards.scale:
            return self.off / scale
        return 0.0 if self.off <= LEAST_ENERGY else math.inf

    def take(self, batch: Batch) -> None:
        assert batch.taken is not None  # the compiled loop sums it
        now = States(self._system, *batch[:4], self._memory, batch.first_order)[-1:]
        look = self._guards.look(now, self._left + batch.taken[-1:] - now.given_work)
        self._guards.accept(look, 0)
        off = float(abs(look.balance[0] + look.of_bodies[0]))
        self.off = max(self.off, off) if math.isfinite(off) else math.inf

    def between(self, until: float, extremes: Extremes) -> None: ...

    def ends(self, time: float) -> None: ...

    def remembered(self, time: float, memory: Arrays) -> None: ...

    def changed(self, time: float, memory: str, change: Change) -> None:
        awake = {} if change.awake is None else {AWAKE: change.awake}
        self._memory = {**self._memory, **change.others, memory: change.memory, **awake}
