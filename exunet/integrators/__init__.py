"""Who steps in time: Exudyn, or the compiled loop, behind one protocol."""

from __future__ import annotations

from exunet.integrators.protocol import Stepper
from exunet.methods.method import Backend, Plan
from exunet.model.system import State, System


def stepper_of(
    system: System, state: State, plan: Plan, *, elements: bool = False, every_step: bool = False
) -> Stepper:
    """Make the stepper of a plan at a state; raises MissingExtra if Numba is needed and absent.

    elements   : the largest tension of each element is observed
    every_step : the state after each step is returned; Exudyn does so anyway
    """
    if plan.backend == Backend.COMPILED:
        from exunet.integrators.compiled.loop import OUTPUT_EVERY, CompiledStepper

        every = 1 if every_step else OUTPUT_EVERY
        return CompiledStepper(system, state, plan, elements=elements, every=every)
    from exunet.integrators.exudyn.stepper import ExudynStepper

    return ExudynStepper(system, state, plan)
