"""Load Exudyn quietly, and compile the user-defined law of its connectors."""

from __future__ import annotations

import os
from typing import Any

from exunet.base.machine import installed_version
from exunet.forces import cable, law


def exudyn(*, quiet: bool = True) -> Any:
    """The engine's module, with its shipped settings (a user's ~/.exudyn is not read).

    quiet : it prints nothing; not for a system of the user's own, who may want to read it
    """
    os.environ.setdefault("EXUDYN_NO_USER_SETTINGS", "1")
    import exudyn as engine

    if quiet:
        engine.config.printToConsole = False
        engine.config.suppressWarnings = True
    return engine


def quiet_settings() -> Any:
    """Return settings of the engine by which it writes nothing, and solves by sparse matrices."""
    engine = exudyn()
    settings = engine.SimulationSettings()
    settings.solution.file.write = False  # else the engine writes into the working directory
    settings.solution.sensors.active = False
    settings.solution.solverInformationFileName = ""
    settings.linearSolver.solverType = engine.LinearSolverType.EigenSparse  # the default is dense
    settings.timeIntegration.verboseMode = 0
    return settings


def exudyn_items() -> Any:
    """The engine's module with the constructors of its items."""
    import exudyn.itemInterface as items  # noqa: N813 - a module of the engine

    return items


def exudyn_version() -> str:
    """Version of the installed engine."""
    return installed_version("exudyn")


def compiled_law(system: Any, *, viscous: bool, hooke: bool) -> Any:
    """The `springForceUserFunction` of a system's elements, elastic or viscous too; it must be kept alive.

    hooke : with Hooke's law instead of the paper's
    """
    from exudyn.advancedUtilities import CreateSymbolicUserFunction

    symbolic = exudyn().symbolic
    of_elastic = law.hooke_tension if hooke else law.tension
    of_viscous = cable.hooke_viscous_tension if hooke else cable.viscous_tension

    # The engine compiles these by their exact argument names; `damping` is the slot that holds the length,
    # `force` the one that holds the relaxation time.
    def elastic(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
        return of_elastic(deltaL + damping, damping, stiffness, symbolic.max)

    def with_viscosity(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
        return of_viscous(deltaL + damping, deltaL_t, damping, stiffness, force, symbolic.max, where)

    def where(condition: Any, then: Any, otherwise: float) -> Any:
        return symbolic.IfThenElse(condition, then, symbolic.Real(otherwise))

    function = with_viscosity if viscous else elastic
    kind = "ObjectConnectorSpringDamper"
    return CreateSymbolicUserFunction(system, function, "springForceUserFunction", itemTypeName=kind)
