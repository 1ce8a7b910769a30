"""What a run will cost, before it begins: wall time, memory, disk.

Disk follows from the states that are stored. Memory is bounded, whatever is stored. The time is that of a
right-hand side times their number: exact for equal steps; for an adaptive method counted by a trial in the
compiled loop, or where there is none guessed from the net's highest frequency. benchmarks/estimates.md lists
estimates beside what was measured, from which the constants and factors below are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exunet.bodies.rigid import RigidBody
from exunet.forces.effects import switched_on
from exunet.methods.method import METHODS, Form, Kind, Method, TimeLoop
from exunet.methods.plan import Plan
from exunet.net.tether import reels_of
from exunet.results.course import instants
from exunet.simulation import auto
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import columns_of
from exunet.simulation.trial import Trial
from exunet.system.stability import largest_frequency

# Seconds of a right-hand side of the compiled loop: of the call, of each element, and of each body.
_LOOP, _LOOP_ELEMENT, _LOOP_BODY = 1.5e-7, 7e-9, 1e-7
_STEP = 5e-5  # [s] of looking at a step, where Exudyn steps
# [s] of a look of Python at the end of a step, in the compiled loop: of the look, and of each element
# (benchmarks/estimates.md).
_LOOK, _LOOK_ELEMENT = 2e-5, 8e-8
_CONDITION = 4e-6  # [s] of a step whose conditions of a script the compiled loop looks at: 3 to 5 us
# Seconds of contact in a right-hand side, as means over whole shipped captures, which lie within a factor of
# 1.8 of it (benchmarks/estimates.md): with something that the net touches, of each element, of each where
# that is a mesh, and of each pair of bodies. Before contact it is a quarter, of a wrapped net twice as much.
_TOUCHING, _TOUCHING_ELEMENT, _TOUCHING_MESH, _TOUCHING_PAIR = 4e-6, 3e-8, 2.8e-7, 1.5e-6
_WITH_CONTACT = "equal steps, with contact; less where that comes late or never"
_LOOKED_AT = "equal steps, each looked at"
_STORED, _STORED_ELEMENT = 3e-5, 4e-8  # [s] of storing a state
_REST = 1.2  # [s] of starting, and of drawing the figures
_NEWTON = 5.0  # right-hand sides of an implicit step, each of them dearer by
_IMPLICIT = 10.0

# Of the reference: seconds of a right-hand side, of each element, of contact and of each element where there
# is contact (a mean: little before anything touches, some 7 ms then), of bodies if there are some, and of
# starting. Its right-hand sides over those of a run of DOPRI5 with the tolerance [m/s] of most cases, without
# bodies and with some, and those of a stored state at least, at which a step ends
# (benchmarks/reference_rate.md).
_REFERENCE, _REFERENCE_ELEMENT = 3.5e-5, 1.2e-7
_REFERENCE_TOUCHING, _REFERENCE_TOUCHING_ELEMENT = 3e-3, 2e-5
_REFERENCE_BODIES, _REFERENCE_REST = 2.4e-4, 1.0
_REFERENCE_OVER_RUN, _REFERENCE_OVER_RUN_BODIES = 1.6, 2.5
_TOLERANCE, _REFERENCE_STORED = 2.5e-9, 12.0

# Right-hand sides of a period of the highest frequency, over 2 pi: folded, nearly deployed.
_PER_RADIAN = (6.0, 60.0)

# A measured time lies within the estimate divided by this and multiplied by it.
EXACT, COUNTED, EXTRAPOLATED, GUESSED = 2.0, 2.5, 5.0, 15.0

# Bytes: Python with the libraries, by the largest resident memory of whole commands with figures and moved
# starts: 408 MB of cases/planar_deployment.toml, 463 MB of bodies/release.toml, 487 MB of
# missions/throw_close_tow.toml, 572 MB of capture/satellite.toml. What is compiled anew takes up to 160 MB.
_PROGRAM = 460 << 20
COMPILING = 160 << 20
_ELEMENT = 8 << 10  # bytes of an element and its nodes in the engine and in tables
_SEEN = 4  # times the states that are looked at in one go, with what is derived from them
_WHOLE = 3 * (64 << 20)  # bytes of a result that is read at once, and of what its measures and figures make
_FILES = 4 << 20  # bytes of figures and summary


@dataclass(frozen=True)
class ExpectedCost:
    """What a run is expected to cost.

    seconds : wall time [s]; a measured one lies within a factor of `factor`
    factor  : of uncertainty
    counted : how the number of right-hand sides was found, in words
    right_hand_sides : how many
    memory  : bytes, at most
    disk    : bytes, at most, while the run joins its states into the result
    kept    : bytes, at most, of the result
    states  : number of stored states
    least   : wall time [s] at least, where a trial was cut short: `seconds` is then that if all that follow
              are as short as the steps there; None: elsewhere
    """

    seconds: float
    factor: float
    counted: str
    right_hand_sides: float
    memory: int
    disk: int
    kept: int
    states: int
    least: float | None = None

    @property
    def known(self) -> float | None:
        """The number of right-hand sides, where it was counted."""
        return self.right_hand_sides if self.factor <= COUNTED else None


def expected_cost(start: Start, trial: Trial | None = None) -> ExpectedCost:
    """The cost of a run from this start; trial: of `exunet.simulation.trial.try_out`, if there was one."""
    states = len(start.scene.time.stored_times)
    row = sum(column.row_bytes for column in columns_of(start.system))
    number, factor, counted = _right_hand_sides(start, trial)
    each = _seconds_each(start)
    if trial is not None and start.scene.engine.loop == TimeLoop.COMPILED:
        each = trial.seconds_each
    seconds = _REST + number * each + states * _seconds_stored(start)
    least = None if trial is None else trial.least
    kept = states * row + _FILES
    return ExpectedCost(
        seconds=seconds,
        factor=factor,
        counted=counted,
        right_hand_sides=number,
        memory=_memory(start, states * row, row),
        disk=kept + states * row,
        kept=kept,
        states=states,
        least=None if least is None else _REST + _stages(start) * least * each,
    )


@dataclass(frozen=True)
class ExpectedCheck:
    """What the reference is expected to take on the same case, beside a run.

    seconds : wall time [s]; a measured one lies within a factor of `factor`
    factor  : of uncertainty
    right_hand_sides : how many
    """

    seconds: float
    factor: float
    right_hand_sides: float


def expected_check(start: Start, trial: Trial | None = None) -> ExpectedCheck:
    """The cost of the reference on a run from this start, with its own method and tolerances.

    The trial has counted the right-hand sides of DOPRI5, whose number falls with the fifth root of the
    tolerance; without one, or if it was cut short, they are guessed as those of a run are. So they are where
    the run's steps are equal and a trial with adaptive ones did not come to the end.
    """
    touching = not {"contact", "self_contact"}.isdisjoint(switched_on(start.scene.effects))
    adaptive = METHODS[start.plan.method].kind == Kind.ADAPTIVE
    factor = GUESSED
    if trial is None or trial.least is not None or not (trial.complete or adaptive):
        number = _guessed(start)
    else:
        looser = (trial.start.plan.tolerance or _TOLERANCE) / _TOLERANCE
        number = trial.right_hand_sides * looser**0.2
        factor = EXTRAPOLATED if trial.complete and not touching else GUESSED  # who knows what touches when
    stored = len(start.scene.time.stored_times) - 1
    over = _REFERENCE_OVER_RUN_BODIES if start.system.bodies else _REFERENCE_OVER_RUN
    number = max(over * number, _REFERENCE_STORED * stored)
    each = _REFERENCE + _REFERENCE_ELEMENT * start.net.n_elements
    each += (_REFERENCE_TOUCHING + _REFERENCE_TOUCHING_ELEMENT * start.net.n_elements) if touching else 0.0
    each += _REFERENCE_BODIES if start.system.bodies else 0.0
    return ExpectedCheck(_REFERENCE_REST + number * each, factor, number)


def _right_hand_sides(start: Start, trial: Trial | None) -> tuple[float, float, str]:
    """How many, the factor of uncertainty of the time, and how it was found."""
    plan = start.plan
    if plan.step is not None and _seconds_touching(start):
        return _of_equal_steps(start, plan), COUNTED, _WITH_CONTACT
    if plan.step is not None and _is_looked_at(start):
        return _of_equal_steps(start, plan), COUNTED, _LOOKED_AT
    if plan.step is not None:
        return _of_equal_steps(start, plan), EXACT, "equal steps"
    if trial is not None and trial.complete:
        return _stages(start) * trial.right_hand_sides, COUNTED, "by a trial"
    if trial is not None and trial.least is not None:
        return _stages(start) * trial.right_hand_sides, GUESSED, f"a trial to {trial.until:.3g} s"
    if trial is not None:
        words = f"by a trial to {trial.until:.3g} s"
        return _stages(start) * trial.right_hand_sides, EXTRAPOLATED, words
    return _guessed(start), GUESSED, "by the net's frequencies"


def _guessed(start: Start) -> float:
    """Right-hand sides of an adaptive method."""
    per_radian = _PER_RADIAN[start.scene.initial.deployed >= auto.NEARLY_DEPLOYED]
    return start.scene.time.end * (per_radian * largest_frequency(start.system) + 100.0)


def _stages(start: Start) -> float:
    """Right-hand sides of a step over those of the compiled loop, which uses the last again as the first."""
    in_exudyn = start.scene.engine.loop == TimeLoop.EXUDYN and start.plan.method == Method.DOPRI5
    return 7.0 / 6.0 if in_exudyn else 1.0


def _of_equal_steps(start: Start, plan: Plan) -> float:
    assert plan.step is not None
    gaps = np.diff(start.scene.time.stored_times)
    steps = float(np.ceil(gaps / plan.step - 1e-9).sum())
    facts = METHODS[plan.method]
    return steps * (facts.stages if facts.kind != Kind.IMPLICIT else _NEWTON)


def _seconds_each(start: Start) -> float:
    """Wall time of a right-hand side [s], with its part of what a step costs beside."""
    return _seconds_without_contact(start) + _seconds_touching(start)


def _seconds_touching(start: Start) -> float:
    """What contact adds to a right-hand side [s]; 0 without."""
    scene, number = start.scene, start.net.n_elements
    on: Any = switched_on(scene.effects)
    contact, found = on.get("contact"), 0.0
    touched = () if contact is None else {*contact.threads, *contact.nodes, *contact.bullets}
    if touched or "self_contact" in on:
        found += _TOUCHING + _TOUCHING_ELEMENT * number
    if any(body.name in touched and _is_mesh(body) for body in start.system.bodies):
        found += _TOUCHING_MESH * number
    return found + (0.0 if contact is None else _TOUCHING_PAIR * len(contact.bodies))


def _is_looked_at(start: Start) -> bool:
    """True if something may happen at the end of any step for long: a reel that turns, elements that break.

    Not counted are bullets in barrels, which leave soon, and reels that only a script lets turn.
    """
    reels = reels_of(start.net, start.scene.tethers)
    turns = any(not drive.is_locked for reel in reels for drive in reel.drives)
    return turns or "breaking" in switched_on(start.scene.effects)


def _is_mesh(body: RigidBody) -> bool:
    return body.shape is not None and body.shape.mesh is not None


def _seconds_without_contact(start: Start) -> float:
    number, facts = float(max(start.net.n_elements, 1)), METHODS[start.plan.method]
    if start.scene.engine.loop == TimeLoop.COMPILED:
        look = _LOOK + _LOOK_ELEMENT * number if _is_looked_at(start) else 0.0
        look += _CONDITION if any(one.when is not None for one in start.scene.script) else 0.0
        return _LOOP + _LOOP_ELEMENT * number + _LOOP_BODY * len(start.system.bodies) + look / facts.stages
    measured = auto.table().seconds
    seconds = measured.of_form[Form(start.scene.engine.net)]
    each = float(np.interp(number, measured.elements, seconds))
    if number > measured.elements[-1]:
        each *= number / float(measured.elements[-1])
    if facts.kind == Kind.IMPLICIT:
        return _IMPLICIT * each
    return each + _STEP / facts.stages


def _seconds_stored(start: Start) -> float:
    return _STORED + _STORED_ELEMENT * start.net.n_elements


def _memory(start: Start, stored: int, row: int) -> int:
    """At most, in bytes."""
    elements = max(start.net.n_elements, start.net.n_nodes)
    segments = 2 * max(8 << 20, row)
    seen = _SEEN * max(16 * row, min(256 * row, 16 << 20))
    return _PROGRAM + elements * _ELEMENT + seen + segments + min(3 * stored, _WHOLE)


def seconds_of_a_course(start: Start, trial: Trial | None) -> float:
    """Wall time [s] of one run for its course only, as `cost_of_a_course`."""
    return cost_of_a_course(start, trial).seconds


def cost_of_a_course(start: Start, trial: Trial | None) -> ExpectedCost:
    """The cost of one run for its course only (see `exunet.results.headlines`), in the compiled loop.

    Nothing is started and no figure is drawn for it. A method that the compiled loop has not is replaced by
    DOPRI5, which takes about as many right-hand sides.
    """
    scene, plan = start.scene, start.plan
    times = tuple(instants(scene.time.end).tolist())
    time = scene.time.model_copy(update={"output_step": None, "output_times": times})
    engine = scene.engine.model_copy(update={"loop": TimeLoop.COMPILED})
    if not METHODS[plan.method].compiled:
        plan = Plan(Method.DOPRI5, tolerance=plan.tolerance or 1.0)
    there = replace(start, scene=scene.model_copy(update={"time": time, "engine": engine}), plan=plan)
    return integration_alone(expected_cost(there, trial))


def integration_alone(cost: ExpectedCost) -> ExpectedCost:
    """The cost of a run among many of one process: nothing is started and no figure is drawn for it."""
    least = None if cost.least is None else cost.least - _REST
    return replace(cost, seconds=cost.seconds - _REST, least=least)


def courses_in_a_run(start: Start) -> float:
    """How many times as long as one run for its course (`seconds_of_a_course`) the run takes, figures apart.

    It follows from stored numbers alone, nothing is timed: it is the same on every machine.
    """
    return (expected_cost(start).seconds - _REST) / seconds_of_a_course(start, None)


def in_the_compiled_loop(start: Start, trial: Trial | None) -> ExpectedCost | None:
    """The cost with `engine.loop = "auto"`; None if that changes nothing, or cannot be told."""
    if start.scene.engine.loop == TimeLoop.COMPILED:
        return None
    if start.plan.step is None:
        if trial is None:
            return None
        other = replace(start, scene=trial.start.scene, plan=trial.start.plan)
    elif METHODS[start.plan.method].compiled and start.scene.solver.step is not None:
        engine = start.scene.engine.model_copy(update={"loop": TimeLoop.COMPILED})
        other = replace(start, scene=start.scene.model_copy(update={"engine": engine}))
    else:
        return None
    found = expected_cost(other, trial)
    return found if math.isfinite(found.seconds) else None
