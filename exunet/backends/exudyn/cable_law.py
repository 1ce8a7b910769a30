"""The law of the cable elements as the engine compiles it: one function that all connectors share."""

from __future__ import annotations

from typing import Any

from exunet.backends.exudyn.loading import exudyn
from exunet.forces import cable


def compiled_law(system: Any, *, viscous: bool) -> Any:
    """The `springForceUserFunction` of a system's elements, elastic or viscous too; it must be kept alive."""
    from exudyn.advancedUtilities import CreateSymbolicUserFunction

    symbolic = exudyn().symbolic

    # The engine compiles these by their exact argument names; `damping` is the slot that holds the length,
    # `force` the one that holds the relaxation time.
    def elastic(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
        return cable.tension(deltaL + damping, damping, stiffness, symbolic.max)

    def with_viscosity(mbs, t, itemNumber, deltaL, deltaL_t, stiffness, damping, force):  # type: ignore[no-untyped-def]
        return cable.viscous_tension(
            deltaL + damping, deltaL_t, damping, stiffness, force, symbolic.max, where
        )

    def where(condition: Any, then: Any, otherwise: float) -> Any:
        return symbolic.IfThenElse(condition, then, symbolic.Real(otherwise))

    function = with_viscosity if viscous else elastic
    kind = "ObjectConnectorSpringDamper"
    return CreateSymbolicUserFunction(system, function, "springForceUserFunction", itemTypeName=kind)
