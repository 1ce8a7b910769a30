"""The next plan after a run that failed because of its steps."""

from __future__ import annotations

from dataclasses import replace

from exunet.methods.plan import Plan

LEAST_TOLERANCE = 1e-12  # below this, steps are rejected for round-off and nothing is gained
FINER_STEP = 0.5
FINER_TOLERANCE = 0.1  # of a method of order 5, steps that are 0.63 times as long


def finer(plan: Plan) -> Plan | None:
    """The plan with half the step, or a tenth of the tolerance; None if neither can be reduced further."""
    if plan.step is not None:
        return replace(plan, step=FINER_STEP * plan.step)
    if plan.tolerance is None or plan.tolerance <= LEAST_TOLERANCE:
        return None
    return replace(
        plan,
        tolerance=max(LEAST_TOLERANCE, FINER_TOLERANCE * plan.tolerance),
        first_step=FINER_STEP * plan.first_step,
        longest_step=FINER_STEP * plan.longest_step,
        least_step=FINER_STEP * plan.least_step,
    )
