"""Runs of both codes for the known answers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification.check import Check
from exunet.verification.horizon import fixed_plan, with_tolerance
from exunet.verification.tolerances import Tolerance

CODES = ("Exudyn", "reference", "compiled loop")


def best(
    case: BothCodes, times: Floats, tolerance: float = 1e-11, *, booked: bool = False
) -> Iterator[tuple[str, Trajectory]]:
    """(code, motion at `times`) with the best adaptive method of each code; tolerance in m and m/s.

    Rigid bodies turn by equations of their own in Exudyn and in exunet's compiled loop, so scenes with bodies
    run in that too, where Numba is installed. booked : with the dissipated energy
    """
    plan = with_tolerance(case, "DOPRI5", tolerance)
    yield CODES[0], case.run_exunet(times, plan, booked=booked)
    yield CODES[1], case.run_reference(times, rtol=1e-11, atol=1e-13)
    if case.start.system.bodies and numba_installed():
        yield CODES[2], case.on_backend(Backend.COMPILED).run_exunet(times, plan, booked=booked)


def in_steps(case: BothCodes, times: Floats, part: float) -> Iterator[tuple[str, Trajectory]]:
    """(code, motion at `times`) with the classical Runge-Kutta method at a part of its stable step.

    Its errors are in proportion to the motion, however small that is.
    """
    plan = fixed_plan(case, float(np.diff(times).min()), part)
    yield CODES[0], case.run_exunet(times, plan)
    yield CODES[1], case.run_reference_in_steps(times, plan.step)


def against(name: str, found: float, known: float, allowed: Tolerance, unit: str) -> Check:
    """A measured value against a known one, relative to the latter."""
    words = f"{found:.10g} {unit}, known: {known:.10g} {unit}"
    return Check(f"{name}: relative error", abs(found - known) / abs(known), allowed, words)
