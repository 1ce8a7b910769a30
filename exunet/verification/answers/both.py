"""Runs of both codes for the known answers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification.horizon import fixed_plan, with_tolerance

CODES = ("Exudyn", "reference", "compiled loop")


def best(
    case: BothCodes, times: Floats, tolerance: float = 1e-11, *, booked: bool = False
) -> Iterator[tuple[str, Trajectory]]:
    """Yield code and motion at `times` with the best adaptive method of each code; tolerance in m and m/s.

    Rigid bodies have different equations of rotation in Exudyn and in the compiled loop: scenes with bodies
    run in the latter too. booked: with the dissipated energy
    """
    plan = with_tolerance(case, "DOPRI5", tolerance)
    yield CODES[0], case.run_exunet(times, plan, booked=booked)
    yield CODES[1], case.run_reference(times, rtol=1e-11, atol=1e-13)
    if case.start.system.bodies and numba_installed():
        yield CODES[2], case.on_backend(Backend.COMPILED).run_exunet(times, plan, booked=booked)


def of_small_motion(case: BothCodes, times: Floats, part: float) -> Iterator[tuple[str, Trajectory]]:
    """Yield code and motion at `times`, with errors in proportion to the motion, however small that is.

    Exunet takes RK44 at a part of its stable step, the reference DOP853
    at a tolerance above the round-off of the stiffest mode.
    """
    plan = fixed_plan(case, float(np.diff(times).min()), part)
    yield CODES[0], case.run_exunet(times, plan)
    yield CODES[1], case.run_reference(times, rtol=1e-10, atol=1e-11)
