"""Observed orders of all integrators of exunet and of the reference on smooth motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from exunet.kernels.compile import numba_installed
from exunet.methods.method import COMPILED_METHODS, METHODS, Backend, Kind, Plan
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification.check import Check, Finding
from exunet.verification.figures import convergence, picture
from exunet.verification.horizon import with_tolerance
from exunet.verification.tolerances import ADAPTIVE_ORDER, ORDER

# Declared orders of the reference's methods (its README).
REFERENCE_ORDERS: dict[str, int] = {"EM": 2, "RK45": 5, "DOP853": 8}
ADAPTIVE = ("RK45", "DOP853")
STEPS = (100, 141, 200, 283, 400, 566, 800)
TOLERANCES = tuple(10.0**-k for k in range(4, 12))
SMALLEST, LARGEST = 3e-13, 1e-2  # [m]: errors outside are round-off, or far from the limit of small steps
FITTED = 4  # the errors of that many smallest steps give the order


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of one method: its declared order, and (k,) numbers of steps and largest position errors [m]."""

    label: str
    order: int
    adaptive: bool
    steps: Floats
    errors: Floats

    @property
    def observed(self) -> float:
        """Slope of the error over the number of steps, over the last usable errors."""
        good = np.flatnonzero((self.errors > SMALLEST) & (self.errors < LARGEST))[-FITTED:]
        if len(good) < 2:
            return float("nan")
        return -float(np.polyfit(np.log(self.steps[good]), np.log(self.errors[good]), 1)[0])


def orders(case: BothCodes) -> Iterator[Finding]:
    """Compare observed with declared orders where no element ever goes slack."""
    found = all_series(case)
    for series in found:
        observed, errors = (
            series.observed,
            (f"{series.errors[k]:.3g} m with {series.steps[k]:.0f}" for k in (0, -1)),
        )
        tolerance = ADAPTIVE_ORDER if series.adaptive else ORDER
        where = f"errors {' and '.join(errors)} steps"
        gap = abs(observed - series.order)
        yield Check(f"order of {series.label}", gap, tolerance, where, observed, float(series.order))
    lines = {series.label: (series.steps, series.errors) for series in found}
    panels = {
        panel: [label for label in lines if label.startswith(panel)]
        for panel in ("Exudyn", "compiled", "reference")
    }
    figure = convergence(f"{case.name}: errors against the number of steps", lines, panels)
    yield picture(
        "orders", figure, "Every method shows its declared order on a motion without slack elements."
    )


def all_series(case: BothCodes) -> list[ErrorSeries]:
    """Run every integrator over the whole case; errors are against the finest motion of the reference."""
    end = case.start.scene.time.end
    times = np.array([0.0, end])
    exact = case.run_reference(times, rtol=3e-14, atol=1e-15)
    backends = {"Exudyn": (case, tuple(METHODS))}
    if numba_installed():
        backends["compiled"] = (case.on_backend(Backend.COMPILED), COMPILED_METHODS)
    found = []
    for backend, (form, methods) in backends.items():
        for method in methods:
            adaptive = METHODS[method].kind == Kind.ADAPTIVE
            plans = [Plan(method, step=end / n) for n in STEPS]
            if adaptive:
                plans = [with_tolerance(case, method, tolerance) for tolerance in TOLERANCES]
            runs = [form.run_exunet(times, plan) for plan in plans]
            found.append(_series(f"{backend} {method}", METHODS[method].order, adaptive, runs, exact))
    for theirs, order in REFERENCE_ORDERS.items():
        settings: list[dict[str, Any]] = [{"step": end / n} for n in STEPS]
        if theirs in ADAPTIVE:
            settings = [{"rtol": t, "atol": t} for t in TOLERANCES]
        runs = [case.run_reference(times, method=theirs, **how) for how in settings]
        found.append(_series(f"reference {theirs}", order, theirs in ADAPTIVE, runs, exact))
    return found


def _series(label: str, order: int, adaptive: bool, runs: list[Trajectory], exact: Trajectory) -> ErrorSeries:
    errors = [float(np.abs(run.position[-1] - exact.position[-1]).max()) for run in runs]
    return ErrorSeries(label, order, adaptive, np.array([run.steps for run in runs]), np.array(errors))
