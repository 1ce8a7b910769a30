"""A trial of a run: its steps in the compiled loop, storing nothing, to count the right-hand sides.

The compiled loop takes them some ten times faster than Exudyn. Where it does not have the run's method it
takes the one that `engine.loop = "auto"` would: at the same accuracy the numbers differ by less than half.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from exunet.backends.compiled.integration import loop_kernel
from exunet.base.errors import ExunetError, Interrupted
from exunet.base.interrupt import TimeIsUp, limited
from exunet.codegen.compile import numba_installed, require_numba
from exunet.methods.keys import AUTO, Solver
from exunet.methods.method import METHODS, Kind, Method, TimeLoop
from exunet.simulation.pace import Pace, Remaining
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.simulation import Simulation

_FIRST = 1e-4  # of the run: the first stretch
_STRETCH = 0.05  # of the budget: wall time of a stretch
_CUT = 2.0  # [s] beyond the budget, after which a stretch is cut short whose steps became far shorter


@dataclass(frozen=True)
class Trial:
    """What a trial found.

    start            : from which it was run, in the compiled loop
    complete         : it came to the end of the run; otherwise `right_hand_sides` is extrapolated
    until            : simulated time that it reached [s]
    right_hand_sides : of the whole run
    seconds_each     : wall time of one of them [s]
    least            : of the whole run for certain, where the trial was cut short, as steps became far
                       shorter: `right_hand_sides` is what it takes if all that follow are as short; else None
    """

    start: Start
    complete: bool
    until: float
    right_hand_sides: float
    seconds_each: float
    least: float | None = None


def is_compiled(start: Start) -> bool:
    """True if the compiled loop for this scene has been compiled before, so that a trial begins at once."""
    return numba_installed() and loop_kernel(start.system).compiled_before


def try_out(start: Start, budget: float) -> Trial | None:
    """Try a run out for a wall time of `budget` [s], and some seconds at most, what is compiled apart.

    None for a method with equal steps, which need no trial, without Numba, or if the trial fails.
    """
    if METHODS[start.plan.method].kind != Kind.ADAPTIVE:
        return None
    return _tried_out(start, budget, in_the_compiled_loop)


def try_out_adaptive(start: Start, budget: float) -> Trial | None:
    """As `try_out`, with adaptive steps where those of the run are equal: see `by_adaptive_steps`."""
    return _tried_out(start, budget, by_adaptive_steps)


def _tried_out(start: Start, budget: float, there: Callable[[Start], Start]) -> Trial | None:
    if not numba_installed():
        return None
    try:
        return _tried(there(start), budget)
    except Interrupted:
        raise KeyboardInterrupt from None
    except ExunetError:  # the run itself will say what is wrong
        return None


def in_the_compiled_loop(start: Start) -> Start:
    """The same in the compiled loop: its method where that has it, else the one of `engine.loop = "auto"`.

    Forces and states that a script may have changed stay as they are. Raises MissingExtra without Numba,
    CaseError where the compiled loop cannot have the scene.
    """
    require_numba('engine.loop = "compiled"')
    scene = start.scene
    engine = scene.engine.model_copy(update={"loop": TimeLoop.COMPILED})
    solver = scene.solver
    if not METHODS[start.plan.method].compiled:
        solver = solver.model_copy(update={"method": AUTO})
    effects = scene.effects.model_copy(update={"choose": None, "threshold": None})  # chosen already
    made = prepare(scene.model_copy(update={"engine": engine, "solver": solver, "effects": effects}))
    return replace(start, scene=made.scene, plan=made.plan)


def by_adaptive_steps(start: Start) -> Start:
    """The same by DOPRI5 to the default accuracy, to count what the reference takes where steps are equal.

    Raises as `in_the_compiled_loop`.
    """
    solver = Solver.model_validate({"method": Method.DOPRI5.value})
    plan = replace(start.plan, method=Method.DOPRI5)  # another is chosen when the scene is prepared
    return in_the_compiled_loop(
        replace(start, scene=start.scene.model_copy(update={"solver": solver}), plan=plan)
    )


def _tried(start: Start, budget: float) -> Trial | None:
    times = start.scene.time.stored_times
    end = float(times[-1])
    simulation, pace = Simulation(start), Pace(end)
    stretch, spent, before = _FIRST * end, 0.0, (0.0, 0)
    begun = clock.perf_counter()
    try:
        with limited(budget + _CUT):
            simulation.attempt(min(stretch, float(times[1])))  # compiles
            begun, none = clock.perf_counter(), simulation.counts.right_hand_sides
            pace.look(0.0, simulation.time, none)
            while simulation.time < end and spent < budget:
                before = simulation.time, simulation.counts.right_hand_sides
                following = float(times[np.searchsorted(times, simulation.time, side="right")])
                simulation.attempt(min(following, simulation.time + stretch))
                now = clock.perf_counter() - begun
                stretch *= min(2.0, max(0.2, _STRETCH * budget / max(now - spent, 1e-9)))
                spent = now
                pace.look(spent, simulation.time, simulation.counts.right_hand_sides)
    except TimeIsUp:
        return _cut(start, simulation, before, budget + _CUT, end)
    done = simulation.counts.right_hand_sides
    left = Remaining(0.0, 0.0, 0.0) if simulation.time >= end else pace.right_hand_sides_left()
    if left is None or done <= none:
        return None
    number = done + left.likely
    return Trial(start, simulation.time >= end, simulation.time, number, spent / (done - none))


def _cut(start: Start, simulation: Simulation, before: tuple[float, int], wall: float, end: float) -> Trial:
    """What a trial found that was cut short after a wall time [s]; before: time and count a stretch ago."""
    done, (time, fewer) = simulation.counts.right_hand_sides, before
    passed = simulation.time - time
    number = done + (done - fewer) / passed * (end - simulation.time) if passed > 0.0 else math.inf
    return Trial(start, False, simulation.time, number, wall / max(1, done), float(done))
