"""Observed orders of all integrators of both codes, on smooth motion and across the kink of the force law."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.plan import make_plan
from exunet.solvers import METHODS, Plan, Solver
from exunet.verify.check import Check, Finding, Plate
from exunet.verify.figures import convergence
from exunet.verify.pair import Motion, Pair
from exunet.verify.tolerances import KINK, ORDER

Floats = NDArray[np.float64]

# Declared orders of the reference's methods (its README).
REFERENCE: dict[str, int] = {"RK4": 4, "Verlet": 2, "EM": 2, "RK45": 5, "DOP853": 8}
ADAPTIVE = ("RK45", "DOP853")
STEPS = (100, 141, 200, 283, 400, 566, 800)
TOLERANCES = tuple(10.0**-k for k in range(4, 12))
SMALLEST, LARGEST = 3e-13, 1e-2  # [m]: errors outside are round-off, or far from the limit of small steps
FITTED = 5  # the errors of that many smallest steps tell the order
KINK_ORDER = 2


@dataclass(frozen=True)
class Series:
    """Errors of one method: declared order, numbers of steps (k,), largest errors of a position (k,) [m]."""

    label: str
    order: int
    steps: Floats
    errors: Floats

    def observed(self, fitted: int = FITTED) -> float:
        """Slope of the error over the number of steps, over the last `fitted` of the usable errors."""
        good = np.flatnonzero((self.errors > SMALLEST) & (self.errors < LARGEST))[-fitted:]
        if len(good) < 2:
            return float("nan")
        return -float(np.polyfit(np.log(self.steps[good]), np.log(self.errors[good]), 1)[0])


def all_series(pair: Pair) -> list[Series]:
    """Every integrator of both codes over the whole case, against the reference's finest motion."""
    end = pair.start.scene.time.end
    times = np.array([0.0, end])
    exact = pair.march(times, rtol=3e-14, atol=1e-15)
    found = []
    for method, facts in METHODS.items():
        plans = _plans(pair, method, end)
        runs = [pair.engine(times, plan) for plan in plans]
        found.append(_series(f"Exudyn {method}", facts.order, runs, exact))
    for method, order in REFERENCE.items():
        settings: list[dict[str, Any]] = [{"step": end / n} for n in STEPS]
        if method in ADAPTIVE:
            settings = [{"rtol": t, "atol": t} for t in TOLERANCES]
        runs = [pair.march(times, method=method, **how) for how in settings]
        found.append(_series(f"reference {method}", order, runs, exact))
    return found


def _plans(pair: Pair, method: str, end: float) -> list[Plan]:
    if METHODS[method].kind != "adaptive":
        return [Plan(method, step=end / n) for n in STEPS]
    start = pair.start
    plans = []
    for tolerance in TOLERANCES:
        solver = Solver.model_validate({"method": method, "tolerance": tolerance})
        scene = start.scene.model_copy(update={"solver": solver})
        plans.append(make_plan(scene, start.net, start.terms, start.velocity))
    return plans


def _series(label: str, order: int, runs: list[Motion], exact: Motion) -> Series:
    errors = [float(np.abs(run.position[-1] - exact.position[-1]).max()) for run in runs]
    return Series(label, order, np.array([run.steps for run in runs], dtype=float), np.array(errors))


def smooth(pair: Pair) -> Iterator[Finding]:
    """Where no element ever goes slack, every method must show its declared order."""
    found = all_series(pair)
    for series in found:
        observed = series.observed()
        words = f"observed {observed:.2f}, declared {series.order}"
        yield Check(6, pair.name, f"order of {series.label}", abs(observed - series.order), ORDER, words)
    yield _plate(pair, found, "always taut", "Every method shows its declared order.")


def with_kink(pair: Pair) -> Iterator[Finding]:
    """Where a cable becomes taut and slack again: about second order is left of any higher one."""
    found = all_series(pair)
    for series in found:
        observed = series.observed(fitted=len(series.steps))
        words = f"observed {observed:.2f}, declared {series.order}"
        if series.order >= KINK_ORDER and np.ptp(series.steps) > 0 and series.label.split()[1] in FIXED:
            short = max(0.0, KINK_ORDER - observed)
            yield Check(6, pair.name, f"order below 2 of {series.label}", short, KINK, words)
        else:
            yield Check(6, pair.name, f"order of {series.label}", observed, None, words)
    caption = (
        "Fixed steps keep about second order, whatever their order on smooth motion, and scatter with the "
        "place of the kink in its step; adaptive methods find the kink and cut their steps there."
    )
    yield _plate(pair, found, "a snap inside the run", caption)


FIXED = {name for name, facts in METHODS.items() if facts.kind != "adaptive"} | (
    set(REFERENCE) - set(ADAPTIVE)
)


def _plate(pair: Pair, found: list[Series], what: str, caption: str) -> Plate:
    lines = {series.label: (series.steps, np.maximum(series.errors, 1e-17)) for series in found}
    ours = [label for label in lines if label.startswith("Exudyn")]
    panels = {
        "Exudyn, explicit": ours[:8],
        "Exudyn, implicit; reference": ours[8:] + [label for label in lines if label not in ours],
    }
    figure = convergence(f"Errors against the number of steps: {what}", "steps", lines, panels)
    return Plate(6, f"orders_{pair.name}", figure, f"{pair.name}: {what}. {caption}")
