"""The engine's solvers: started at a model's initial state, between stretches of steps set to another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.exudyn.loading import exudyn
from exunet.backends.exudyn.model import Model
from exunet.backends.exudyn.settings import longest_of
from exunet.backends.protocol import IntegrationFailed
from exunet.methods.method import METHODS, Kind
from exunet.methods.plan import Plan


def started(model: Model, plan: Plan, settings: Any, before_attempt: Callable[[Any, float], bool]) -> Any:
    """A solver at the model's initial state; raises IntegrationFailed, with the engine's words.

    before_attempt : called with the engine's system and the end [s] of each step that is about to be tried
    """
    engine = exudyn()
    model.system.SetPreStepUserFunction(before_attempt)
    model.look_again()
    implicit = METHODS[plan.method].kind == Kind.IMPLICIT
    solver = engine.MainSolverImplicitSecondOrder() if implicit else engine.MainSolverExplicit()
    try:
        done = solver.InitializeSolver(model.system, settings)
    except Exception as error:  # the engine's own exception types share no narrower base
        raise IntegrationFailed(first_line(error)) from error
    if not done:
        raise IntegrationFailed("the engine could not start this method on this scene")
    if plan.tolerance is not None:
        solver.it.maxStepSize = longest_of(plan)
    return solver


def put(model: Model, now: Coordinates, time: float, where: Any) -> None:
    """Set the engine's state and time [s] in one of its configurations."""
    data = model.system.systemData
    data.SetODE2Coordinates(now.q, where)
    data.SetODE2Coordinates_t(now.v, where)
    if len(now.y):
        data.SetODE1Coordinates(now.y, where)
    data.SetTime(time, where)


def first_line(words: object) -> str:
    """Of what the engine says, which begins with empty lines; "" if it says nothing."""
    lines = [line.strip() for line in str(words).splitlines() if line.strip()]
    return lines[0] if lines else ""
