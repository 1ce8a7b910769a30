"""Observed orders of all integrators of both codes, on smooth motion and across the kink of the force law."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from exunet.methods.method import METHODS, Kind, Plan
from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification.check import Check, Evidence, Plate
from exunet.verification.figures import convergence
from exunet.verification.horizon import with_tolerance
from exunet.verification.tolerances import ADAPTIVE_ORDER, KINK, ORDER

# Declared orders of the reference's methods (its README).
REFERENCE_ORDERS: dict[str, int] = {"EM": 2, "RK45": 5, "DOP853": 8}
ADAPTIVE = ("RK45", "DOP853")
STEPS = (100, 141, 200, 283, 400, 566, 800)
TOLERANCES = tuple(10.0**-k for k in range(4, 12))
SMALLEST, LARGEST = 3e-13, 1e-2  # [m]: errors outside are round-off, or far from the limit of small steps
FITTED = 4  # the errors of that many smallest steps tell the order
KINK_ORDER = 2
STARTS = 8
SEED = 20210619


@dataclass(frozen=True)
class ErrorSeries:
    """Errors of one method.

    order  : declared
    steps  : (k,) how many
    errors : (k,) largest error of a position at the end [m]
    nodes  : (k,) the node that errs most
    """

    label: str
    order: int
    adaptive: bool
    steps: Floats
    errors: Floats
    nodes: list[int]

    def observed(self, fitted: int) -> float:
        """Slope of the error over the number of steps, over the last `fitted` of the usable errors."""
        good = np.flatnonzero((self.errors > SMALLEST) & (self.errors < LARGEST))[-fitted:]
        if len(good) < 2:
            return float("nan")
        return -float(np.polyfit(np.log(self.steps[good]), np.log(self.errors[good]), 1)[0])

    def words(self, observed: float) -> str:
        """The observed order beside the declared one, and the errors with the fewest and the most steps."""
        ends = (
            f"{self.errors[k]:.3g} m at node {self.nodes[k]} with {self.steps[k]:.0f} steps" for k in (0, -1)
        )
        return f"observed {observed:.2f}, declared {self.order}; {' and '.join(ends)}"


def all_series(cases: Sequence[BothCodes]) -> list[ErrorSeries]:
    """Every integrator of both codes over the whole case, against the reference's finest motion.

    The error is the root mean square over `cases`: the same case with different starts.
    """
    end = cases[0].start.scene.time.end
    times = np.array([0.0, end])
    exact = [case.run_reference(times, rtol=3e-14, atol=1e-15) for case in cases]
    found = []
    for method, facts in METHODS.items():
        adaptive = facts.kind == Kind.ADAPTIVE
        plans = [Plan(method, step=end / n) for n in STEPS]
        if adaptive:
            plans = [with_tolerance(cases[0], method, tolerance) for tolerance in TOLERANCES]
        runs = [[case.run_exunet(times, plan) for case in cases] for plan in plans]
        found.append(_series(f"Exudyn {method}", facts.order, adaptive, runs, exact))
    for theirs, order in REFERENCE_ORDERS.items():
        settings: list[dict[str, Any]] = [{"step": end / n} for n in STEPS]
        if theirs in ADAPTIVE:
            settings = [{"rtol": t, "atol": t} for t in TOLERANCES]
        runs = [[case.run_reference(times, method=theirs, **how) for case in cases] for how in settings]
        found.append(_series(f"reference {theirs}", order, theirs in ADAPTIVE, runs, exact))
    return found


def _series(
    label: str, order: int, adaptive: bool, runs: Sequence[Sequence[Trajectory]], exact: Sequence[Trajectory]
) -> ErrorSeries:
    ends, known = ([[run.position[-1] for run in row] for row in rows] for rows in (runs, [exact]))
    apart = np.abs(np.array(ends) - np.array(known)).max(axis=3)  # (settings, starts, nodes)
    steps = np.array([np.mean([run.steps for run in row]) for row in runs])
    errors = np.sqrt(np.mean(apart.max(axis=2) ** 2, axis=1))
    return ErrorSeries(label, order, adaptive, steps, errors, apart.max(axis=1).argmax(axis=1).tolist())


def smooth(case: BothCodes) -> Iterator[Evidence]:
    """Where no element ever goes slack, every method must show its declared order."""
    found = all_series([case])
    for series in found:
        observed = series.observed(FITTED)
        words = series.words(observed)
        allowed = ADAPTIVE_ORDER if series.adaptive else ORDER
        yield Check(f"order of {series.label}: off by", abs(observed - series.order), allowed, words)
    yield _plate(case, found, "always taut", "Every method shows its declared order.")


def with_kink(case: BothCodes) -> Iterator[Evidence]:
    """Where a cable becomes taut and slack again: second order is left of any higher one with equal steps."""
    found = all_series(_shifted(case))
    for series in found:
        observed = series.observed(len(series.steps))
        words = series.words(observed)
        if series.adaptive or series.order < KINK_ORDER:
            yield Check(f"order of {series.label}: observed", observed, None, words)
        else:
            gap = abs(observed - KINK_ORDER)
            yield Check(f"order of {series.label}: off 2 by", gap, KINK, words)
    caption = (
        "Equal steps keep second order, whatever the order of the method on smooth motion, because the kink "
        "lies somewhere inside a step (root mean square over eight starts); adaptive methods cut their steps "
        "at the kink and keep their advantage."
    )
    yield _plate(case, found, "a snap inside the run", caption)


def _shifted(case: BothCodes) -> list[BothCodes]:
    """The case with its nodes moved apart by up to what they travel in the longest step."""
    start, shares = case.start, np.random.default_rng(SEED).random(STARTS)
    step = start.scene.time.end / STEPS[0]
    places = [start.position + share * step * start.velocity for share in shares]
    return [case.from_state(place, start.velocity) for place in places]


def _plate(case: BothCodes, found: list[ErrorSeries], what: str, caption: str) -> Plate:
    lines = {series.label: (series.steps, series.errors) for series in found}
    ours = [label for label in lines if label.startswith("Exudyn")]
    panels = {
        "Exudyn, explicit": ours[:8],
        "Exudyn, implicit; reference": ours[8:] + [label for label in lines if label not in ours],
    }
    figure = convergence(f"Errors against the number of steps: {what}", lines, panels)
    return Plate(f"orders_{case.name}", figure, f"{case.name}: {what}. {caption}")
