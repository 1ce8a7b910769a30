"""Convergence of metrics: error of a run from a finer one, and runs with a finer step or finer threads.

The lumps of an undamped thread collide, so that tensions depend on how many there are, and a step for metrics
resolves some snaps only in part. A refinement by a factor of 2 shows both: a metric whose median moves out of
its range, by more than `PART` or `PART_OF_STEP` of itself, is not converged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exunet.methods.config import ACCURACY
from exunet.methods.method import Plan
from exunet.model.limits import relative_speed
from exunet.results.ensemble import INTERVALS, MANY, Ensemble
from exunet.results.measures import speeds_of
from exunet.results.metrics import Metric, printed
from exunet.results.result import Result
from exunet.scene.casefile import Case, parse_case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.ensemble import (
    FEW_RUNS,
    RUNS,
    SMALL_MOVE,
    default_runs,
    nearby_start,
    of_much_other_accuracy,
    perturbed_runs,
    tracked_speeds,
)

FACTOR = 2  # of the number of elements on each thread from one division to the next, and of steps
PART = 0.05  # of a median, below which a change by the division is not reported
PART_OF_STEP = 0.01  # of a median, or of its vector, below which a change by the step is not reported
OF_ENERGY = 1e-3  # the same of an energy, as a part of the energy scale
STARTS = 4  # perturbed starts that go again with half of the step; of a long run one


@dataclass(frozen=True)
class Refinement:
    """Medians of a metric over perturbed runs of a case and over those of a finer one.

    low, high : of its range in the case
    part      : change that is not reported, relative to the larger median
    size      : what the change is relative to where that is more [unit]
    """

    metric: Metric
    median: float
    finer: float
    low: float
    high: float
    part: float = PART
    size: float = 0.0

    @property
    def change(self) -> float:
        """Change relative to the larger median, or to `size`; 0 where all are 0."""
        scale = max(abs(self.median), abs(self.finer), self.size)
        return abs(self.finer - self.median) / scale if scale else 0.0

    @property
    def converged(self) -> bool:
        """False if the finer case moves the median out of the range, by more than `part`."""
        last = self.metric.last_digit(self.median)
        return self.low - last <= self.finer <= self.high + last or self.change <= self.part

    def __str__(self) -> str:
        last = self.metric.last_digit(max(abs(self.median), abs(self.finer)))
        last = max(last, 10.0 ** np.floor(np.log10(max(abs(self.median), abs(self.finer)))) / 100.0)
        values = f"{printed(self.median, last)} → {printed(self.finer, last)} {self.metric.unit}"
        return f"{self.metric.words} {values}".rstrip()


def divided(case: Case, factor: int) -> Case:
    """Return the case with `factor` times the elements on each mesh side and string; a fixed step follows."""
    net, solver = case.scene.net, case.scene.solver
    changes = [f"net.divisions={factor * net.divisions}"]
    if (strings := getattr(net, "strings", None)) is not None:
        changes.append(f"net.strings.divisions={factor * strings.divisions}")
    if solver.step is not None:
        changes.append(f"solver.step={solver.step / factor!r}")
    return parse_case(case.text, case.path, (*case.overrides, *changes))


def refine(
    case: Case, coarse: Ensemble, *, progress: Callable[[int], None] | None = None
) -> dict[str, Refinement]:
    """Compare the metrics of perturbed runs of a case with those of `FEW_RUNS` runs with the next division.

    Parameters
    ----------
    case : Case
        Of the runs.
    coarse : Ensemble
        Perturbed runs of the case.
    progress : callable, optional
        Called with the number of completed runs.

    Returns
    -------
    dict of str to Refinement
        By key of the metric; of metrics that both have, no details and no entries of balances.

    Raises
    ------
    CaseError, RunStopped
        If the finer scene is refused, or one of its runs stops.
    """
    fine = perturbed_runs(prepare_case(divided(case, FACTOR)), FEW_RUNS, progress=progress)
    found = refinements(coarse, fine)
    return {key: item for key, item in found.items() if not (item.metric.detail or item.metric.balance)}


def refinements(coarse: Ensemble, fine: Ensemble, part: float = PART) -> dict[str, Refinement]:
    """Return the metrics of both ensembles; changes of a component are relative to its vector."""
    every = {key: (coarse.range(key), fine.range(key)) for key in coarse.about}
    pairs = {key: (one, other) for key, (one, other) in every.items() if one and other}
    larger = {key: max(abs(one.median), abs(other.median)) for key, (one, other) in pairs.items()}
    found = {}
    for key, (one, other) in pairs.items():
        axes, name = [key], one.metric.name
        if name[-2:] in ("_x", "_y", "_z"):
            axes = [replace(one.metric, name=name[:-1] + axis).key for axis in "xyz"]
        size = math.hypot(*(larger.get(axis, 0.0) for axis in axes))
        found[key] = Refinement(one.metric, one.median, other.median, one.low, one.high, part, size)
    return found


def has_step_for_metrics(start: Start) -> bool:
    """Return True for a fixed step that the case leaves to the program."""
    return start.scene.solver.for_metrics and start.plan.step is not None


def runs_of_half_step(start: Start, coarse: Ensemble) -> int:
    """Return how many of the perturbed starts of a case go again with half of the step."""
    return min(coarse.runs, STARTS if default_runs(start) == RUNS else 1)


def halve_step(
    start: Start, coarse: Ensemble, energy: float, *, progress: Callable[[int], None] | None = None
) -> dict[str, Refinement]:
    """Compare the metrics of perturbed runs with those of some of their starts with half of the step.

    Beyond the horizon two runs from one start differ as two starts do, whatever the step. So the median of
    the repeats is compared with the range of all runs. By chance alone the median of four is outside 5 % to
    95 % of 32 runs in 2 of 100 metrics. A single run is outside the range of eight in 2 of 9. Ranges of few
    runs are therefore widened by half of their width at each end, which leaves 1 to 6 of 100.

    Parameters
    ----------
    start : Start
        Of the case, with a step for metrics.
    coarse : Ensemble
        Perturbed runs of the case.
    energy : float
        Scale of energies [J].
    progress : callable, optional
        Called with the number of completed runs.

    Returns
    -------
    dict of str to Refinement
        By key of the metric; of all metrics that both have.

    Raises
    ------
    RunStopped
        If one of the runs stops.
    """
    plan, interval = coarse.run.plan, start.scene.time.end / INTERVALS  # which the loop divides equally
    assert plan is not None
    assert plan.step is not None
    step = interval / (FACTOR * math.ceil(interval / plan.step - 1e-9))
    solver = start.scene.solver.model_copy(update={"method": plan.method, "step": step})
    halved = replace(start, scene=start.scene.model_copy(update={"solver": solver}))
    fine = perturbed_runs(halved, runs_of_half_step(start, coarse), progress=progress)
    found = refinements(coarse, fine, PART_OF_STEP)
    for key, item in found.items():
        size = max(item.size, OF_ENERGY / PART_OF_STEP * energy if item.metric.unit == "J" else 0.0)
        wider = 0.0 if coarse.runs >= MANY else 0.5 * (item.high - item.low)
        found[key] = replace(item, low=item.low - wider, high=item.high + wider, size=size)
    return found


def is_checked(start: Start, *, requested: bool | None) -> bool:
    """Return True if runs with the next division follow a run; by default where 32 perturbed runs do."""
    if requested is not None:
        return requested
    return default_runs(start) == RUNS


def summary_of(found: Mapping[str, Refinement]) -> dict[str, Any]:
    """Return the medians of both cases, and the metrics that are not converged, in words, headlines first."""
    moved = [item for item in found.values() if not item.converged]
    moved.sort(key=lambda item: (item.metric.detail, item.metric.balance, -item.change))
    return {
        "moved": [str(item) for item in moved],
        "metrics": {key: [item.median, item.finer] for key, item in found.items()},
    }


@dataclass(frozen=True)
class ErrorEstimate:
    """Differences of speeds between runs over the launch speed; fields are named as in summary.json.

    of          : "bullets", or "nodes" without bullets
    accuracy    : requested one
    at_end      : at the last stored time, to the run with the other setting
    largest     : the same, largest over the stored times (instants inside a snap included)
    time_of_largest_s : its stored time
    nodes_at_end, nodes_largest : errors at the end and largest of the node that is off most
    sensitivity : largest difference to the run whose start is perturbed by up to `move_m`
    lost_from_s : first stored time at which one of both is above the accuracy; None: nowhere
    other       : the other setting, in words
    """

    of: str
    accuracy: float
    at_end: float
    largest: float
    time_of_largest_s: float
    nodes_at_end: float
    nodes_largest: float
    lost_from_s: float | None
    sensitivity: float
    move_m: float
    other: str


def estimate_error(scene: Scene, result: Result) -> ErrorEstimate:
    """Run the scene twice more and compare with `result`; raises RunStopped if a run stops."""
    start = prepare(scene)
    plan = of_much_other_accuracy(start.plan)
    scale = relative_speed(start.system, start.state)
    ours = tracked_speeds(result.net, result.velocity)
    other = simulate(replace(start, plan=plan))
    nearby = tracked_speeds(start.net, simulate(nearby_start(start)).velocity)
    again = tracked_speeds(start.net, other.velocity)
    difference = np.abs(ours - again).max(axis=1) / scale
    every = np.arange(start.net.n_nodes)
    of_nodes = np.abs(speeds_of(every, result.velocity[:]) - speeds_of(every, other.velocity[:]))
    of_nodes = of_nodes.max(axis=1) / scale
    accuracy = scene.solver.accuracy or ACCURACY
    sensitive = np.abs(ours - nearby).max(axis=1) / scale
    above = np.flatnonzero(np.maximum(difference, sensitive) > accuracy)
    return ErrorEstimate(
        of="bullets" if len(start.net.bullet_nodes) else "nodes",
        accuracy=accuracy,
        at_end=float(difference[-1]),
        largest=float(difference.max()),
        time_of_largest_s=float(result.time[difference.argmax()]),
        nodes_at_end=float(of_nodes[-1]),
        nodes_largest=float(of_nodes.max()),
        lost_from_s=float(result.time[above[0]]) if len(above) else None,
        sensitivity=float(sensitive.max()),
        move_m=SMALL_MOVE * start.net.size,
        other=_words(plan),
    )


def _words(plan: Plan) -> str:
    return (
        f"against tolerance {plan.tolerance:.2g}" if plan.step is None else f"against step {plan.step:.3g} s"
    )
