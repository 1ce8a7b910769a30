"""Convergence of metrics: error of a run from a finer one, and runs with more elements on each thread.

The lumps of an undamped thread collide, so that tensions depend on how many there are. A grid refinement by a
factor of 2 shows it: a metric whose median moves out of its range, by more than `PART` of itself, is not
converged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exunet.methods.config import ACCURACY
from exunet.methods.method import Plan
from exunet.model.limits import relative_speed
from exunet.results.ensemble import Ensemble
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

FACTOR = 2  # of the number of elements on each thread from one division to the next
PART = 0.05  # of a median, below which a change by the division is not reported


@dataclass(frozen=True)
class Refinement:
    """Medians of a metric over perturbed runs with a division and with the next.

    low, high : of its range with the division
    """

    metric: Metric
    median: float
    finer: float
    low: float
    high: float

    @property
    def change(self) -> float:
        """Change by the next division relative to the larger median; 0 where both are 0."""
        scale = max(abs(self.median), abs(self.finer))
        return abs(self.finer - self.median) / scale if scale else 0.0

    @property
    def converged(self) -> bool:
        """False if the next division moves the median out of the range, by more than `PART`."""
        last = self.metric.last_digit(self.median)
        return self.low - last <= self.finer <= self.high + last or self.change <= PART

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
    return refinements(coarse, fine)


def refinements(coarse: Ensemble, fine: Ensemble) -> dict[str, Refinement]:
    """Return the metrics of both ensembles, with the division of the first and the next."""
    found = {}
    for key, metric in coarse.about.items():
        one, other = coarse.range(key), fine.range(key)
        if one is None or other is None or metric.detail or metric.balance:
            continue
        found[key] = Refinement(metric, one.median, other.median, one.low, one.high)
    return found


def is_checked(start: Start, *, requested: bool | None) -> bool:
    """Return True if runs with the next division follow a run; by default where 32 perturbed runs do."""
    if requested is not None:
        return requested
    return default_runs(start) == RUNS


def summary_of(found: Mapping[str, Refinement]) -> dict[str, Any]:
    """Return the medians with both divisions, and the metrics that are not converged, in words."""
    moved = sorted((item for item in found.values() if not item.converged), key=lambda item: -item.change)
    return {
        "moved": [str(item) for item in moved],
        "metrics": {key: [item.median, item.finer] for key, item in found.items()},
    }


FAR = 10.0  # times the accuracy, above which the error of a single node is reported


@dataclass(frozen=True)
class ErrorEstimate:
    """Differences of speeds between runs over the launch speed, of the bullets, or of all nodes.

    of          : "bullets", or "nodes" without bullets
    accuracy    : requested one
    at_end      : at the last stored time, to the run with the other setting
    largest     : the same, largest over the stored times (instants inside a snap included)
    nodes_at_end, nodes_largest : the same two of the node that is off most
    sensitivity : at the last stored time, to the run whose start is perturbed by up to `move` [m]
    lost_from   : the first stored time [s] from which the difference stays above the accuracy; None: nowhere
    best        : the error at the last stored time before that
    other       : the other setting, in words
    """

    of: str
    accuracy: float
    at_end: float
    largest: float
    nodes_at_end: float
    nodes_largest: float
    sensitivity: float
    lost_from: float | None
    best: float
    move: float
    other: str

    def numbers(self) -> dict[str, float | str | None]:
        """For summary.json: names with units."""
        return {
            "of": self.of,
            "accuracy": self.accuracy,
            "at_end": self.at_end,
            "largest": self.largest,
            "nodes_at_end": self.nodes_at_end,
            "nodes_largest": self.nodes_largest,
            "lost_from_s": self.lost_from,
            "best": self.best,
            "sensitivity": self.sensitivity,
            "move_m": self.move,
            "other": self.other,
        }


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
    within = np.flatnonzero(difference <= accuracy)
    last = int(within[-1]) if len(within) else 0
    lost = last + 1 < len(difference)
    return ErrorEstimate(
        of="bullets" if len(start.net.bullet_nodes) else "nodes",
        accuracy=accuracy,
        at_end=float(difference[-1]),
        largest=float(difference.max()),
        nodes_at_end=float(of_nodes[-1]),
        nodes_largest=float(of_nodes.max()),
        sensitivity=float(np.abs(ours[-1] - nearby[-1]).max() / scale),
        lost_from=float(result.time[last + 1]) if lost else None,
        best=float(difference[last]),
        move=SMALL_MOVE * start.net.size,
        other=_words(plan),
    )


def _words(plan: Plan) -> str:
    return (
        f"against tolerance {plan.tolerance:.2g}" if plan.step is None else f"against step {plan.step:.3g} s"
    )
