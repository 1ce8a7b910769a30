"""The engine's settings for a plan."""

from __future__ import annotations

import math
from typing import Any

from exunet.backends.exudyn.loading import exudyn
from exunet.backends.exudyn.model import Model
from exunet.methods.method import METHODS, Kind, Method
from exunet.methods.plan import Plan

_GAP = 1e-10  # [s]: the engine ends a stretch at a step that ends so near to its end
_FAR = 1e300  # [s]: the end of a run, which is asked for stretch by stretch


def settings_for(model: Model, plan: Plan, begin: float) -> Any:
    """Settings of a run that begins at a time [s]."""
    engine, method = exudyn(), METHODS[plan.method]
    settings = engine.SimulationSettings()
    settings.solution.file.write = False  # else the engine writes into the working directory
    settings.solution.sensors.active = False
    settings.solution.solverInformationFileName = ""
    settings.linearSolver.solverType = engine.LinearSolverType.EigenSparse  # the default is dense
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.solverType = getattr(engine.DynamicSolverType, plan.method)
    integration.startTime, integration.endTime = begin, begin + 1.0
    integration.adaptiveStep = integration.automaticStepSize = method.kind == Kind.ADAPTIVE
    integration.numberOfSteps = 1
    # At its least step the engine accepts one step, whatever its error, and rejects all after it: never.
    integration.minimumStepSize = 1e-300
    if plan.tolerance is not None:
        integration.absoluteTolerance = plan.tolerance
        integration.relativeTolerance = 0.0  # the engine's relative scale lacks an absolute value
        integration.initialStepSize = plan.first_step
    explicit = integration.explicit
    explicit.useLieGroupIntegration = model.has_bodies
    explicit.computeMassMatrixInversePerBody = model.all_points_alone
    explicit.computeEndOfStepAccelerations = (
        plan.method == Method.VELOCITY_VERLET
    )  # others would pay for nothing
    if method.kind == Kind.IMPLICIT:
        integration.newton.useModifiedNewton = False
        trapezoidal = plan.method == Method.TRAPEZOIDAL_INDEX2
        integration.generalizedAlpha.useNewmark = trapezoidal
        integration.generalizedAlpha.useIndex2Constraints = trapezoidal
    return settings


def longest_of(plan: Plan) -> float:
    """The longest step [s], which must not depend on where a run begins; finite, as the engine needs it."""
    return min(plan.longest_step, _FAR)


def ends_at(until: float) -> float:
    """The end to give to the engine, which ends a stretch `_GAP` before it.

    That is some units of round-off before `until`, of the larger of the two numbers in the difference.
    """
    return until - 64.0 * math.ulp(max(until, _GAP)) + _GAP
