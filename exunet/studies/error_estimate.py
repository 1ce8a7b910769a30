"""Error of a run, estimated from a much finer run and from a perturbed one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exunet.methods.config import ACCURACY
from exunet.methods.method import Plan
from exunet.model.stability import relative_speed
from exunet.results.measures import speeds_of
from exunet.results.result import Result
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.perturbation import (
    MOVE,
    nearby_start,
    of_much_other_accuracy,
    tracked_speeds,
)

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
        move=MOVE * start.net.size,
        other=_words(plan),
    )


def _words(plan: Plan) -> str:
    return (
        f"against tolerance {plan.tolerance:.2g}" if plan.step is None else f"against step {plan.step:.3g} s"
    )
