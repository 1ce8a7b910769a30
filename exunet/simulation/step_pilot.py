"""What equal step keeps the book of energy of a scene with bodies: measured on the scene, before the run.

A fifth of the stable step keeps a net within the guards, 5 % of the energy that can deform it, but not its
book: at each snap the force has a kink, which costs RK44 its order. How often a net snaps, and how hard, no
frequency says: of the shipped scenes some need no less than that step for 1e-5, one a sixty-fourth. So the
scene is run in the compiled loop to its end, with half the step each time, until the book is kept.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.integration import loop_kernel
from exunet.backends.compiled.loop import CompiledLoop
from exunet.backends.protocol import Arrays, Batch, Extremes, IntegrationFailed
from exunet.base.errors import RunStopped
from exunet.case.scene import Scene
from exunet.codegen.compile import numba_installed
from exunet.codegen.kernel import Kernel
from exunet.forces.blocks import AWAKE
from exunet.forces.effects import switched_on
from exunet.forces.terms import Change
from exunet.methods.method import METHODS
from exunet.methods.plan import Plan
from exunet.simulation.guards import Guards
from exunet.simulation.pilot import MOST
from exunet.system.states import States
from exunet.system.system import State, System

Floats = NDArray[np.float64]

BOOK = 1e-5  # largest error of the energy book at the stored times, over the energy scale
MARGIN = 2.0  # for Exudyn, whose errors are those of the compiled loop until round-off has moved the snaps
_CALL = 21.0  # elements that take as long as the rest of a right-hand side (`expected_cost`)


def keeping_the_book(scene: Scene, system: System, state: State, plan: Plan) -> Plan:
    """The plan with the longest of its step, half of it, a quarter ... that keeps the book, and what it says.

    plan : of RK44, with the step that follows from the scene's frequencies
    """
    assert plan.step is not None
    if why := why_none(scene):
        words = f"for this step nothing is promised of the energy balance but the guards' bound: {why}"
        return replace(plan, notes=(*plan.notes, words))
    times, kernel = scene.time.stored_times, loop_kernel(system)
    step, found, tried = plan.step, math.inf, 0.0
    while found > BOOK / MARGIN:
        tried += _evaluations(plan, system, step, times)
        if tried > MOST:
            words = f"the energy balance is not promised to {BOOK:g}: runs before this one took too long"
            if math.isfinite(found):
                words += f"; with steps of {2.0 * step:.4g} s its error was {found:.1g}"
            return replace(plan, step=min(2.0 * step, plan.step), notes=(*plan.notes, words))
        found = _error(replace(plan, step=step), system, state, times, kernel)
        step *= 0.5
    taken = 2.0 * step  # of the last run
    part = "that" if taken == plan.step else f"1/{plan.step / taken:g} of that, {taken:.4g} s,"
    words = f"{part} keeps the energy balance to {BOOK:g}: {found:.1g} in a compiled run before this one"
    return replace(plan, step=taken, notes=(*plan.notes, words))


def why_none(scene: Scene) -> str:
    """Why no step is tried; "" if steps are."""
    if not numba_installed():
        return "Numba is not installed"
    if not {"contact", "self_contact"}.isdisjoint(switched_on(scene.effects)):
        return "contact would take runs before it too long"
    return ""


def _evaluations(plan: Plan, system: System, step: float, times: Floats) -> float:
    """Of elements, in a run with a step [s]."""
    steps = float(np.ceil(np.diff(times) / step - 1e-9).sum())
    return METHODS[plan.method].compiled_stages * steps * (system.net.n_elements + _CALL)


def _error(plan: Plan, system: System, state: State, times: Floats, kernel: Kernel) -> float:
    """The largest error of the energy balance over its scale; infinite if the run did not come to its end."""
    book = _Book(system, state)
    loop = CompiledLoop(system, state, plan, book, kernel)
    try:
        for until in times[1:].tolist():
            loop.advance(until)
            loop.hand_over()
            if loop.stopped:
                break
    except (RunStopped, IntegrationFailed):
        return math.inf
    return book.error


class _Book:
    """The observer of a run (see `exunet.backends.protocol.Observer`) that is handed over at stored times.

    off : the largest error of the energy balance so far [J]
    """

    asks_for_elements = False

    def __init__(self, system: System, state: State) -> None:
        self._system, self._memory = system, dict(state.memory)
        self._guards = Guards(system, state)
        self._left = system.lost_at_start + float(system.given_work(state.first_order))
        self.off = 0.0

    @property
    def error(self) -> float:
        """Over the energy scale."""
        return self.off / self._guards.scale if self.off else 0.0

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
