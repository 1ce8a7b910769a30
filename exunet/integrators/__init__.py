"""Who steps in time: Exudyn, or the compiled loop, behind one protocol."""

from __future__ import annotations

from exunet.integrators.protocol import Integrator, Observer
from exunet.methods.method import Backend, Plan
from exunet.model.system import State, System
from exunet.scene.scene import Engine


def integrator(engine: Engine, system: System, state: State, plan: Plan, observer: Observer) -> Integrator:
    """The integrator that a case asks for, at a state; raises MissingExtra if Numba is needed and absent."""
    if engine.backend == Backend.COMPILED:
        from exunet.integrators.compiled.loop import CompiledLoop

        return CompiledLoop(system, state, plan, observer)
    from exunet.integrators.exudyn.stepper import Stepper

    return Stepper(system, state, plan, observer)
