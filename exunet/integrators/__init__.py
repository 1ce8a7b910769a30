"""Who steps in time: Exudyn, or the compiled loop, behind one protocol."""

from __future__ import annotations

from exunet.integrators.protocol import Integrator, Observer
from exunet.methods.method import Backend, Plan
from exunet.model.system import State, System


def integrator(system: System, state: State, plan: Plan, observer: Observer) -> Integrator:
    """Make the integrator of a plan at a state; raises MissingExtra if Numba is needed and absent."""
    if plan.backend == Backend.COMPILED:
        from exunet.integrators.compiled.loop import CompiledLoop

        return CompiledLoop(system, state, plan, observer)
    from exunet.integrators.exudyn.stepper import Stepper

    return Stepper(system, state, plan, observer)
