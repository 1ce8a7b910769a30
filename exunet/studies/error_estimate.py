"""The error of a run, estimated from a second run with a finer setting and a third from a moved start."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exunet.case.scene import Scene
from exunet.methods.plan import Plan
from exunet.results.result import Result
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate

Floats = NDArray[np.float64]

LEAST_TOLERANCE = 1e-12  # [m, m/s]; below, steps are rejected for round-off and nothing is gained
FINER = 0.1  # of the tolerance; a fixed step is halved
PUSH = 1e-12  # [m], of each coordinate of the moved start
SEED = 20210616


@dataclass(frozen=True)
class ErrorEstimate:
    """Differences of speeds between runs, of the bullets (of all nodes if there are none), / launch speed.

    accuracy    : what was asked for
    at_end      : at the last stored time, to the run with the other setting
    largest     : the same, largest over the stored times (instants inside a snap included)
    sensitivity : at the last stored time, to the run whose start is moved by up to PUSH
    lost_from   : the first stored time [s] from which the difference stays above the accuracy; None: nowhere
    best        : the error at the last stored time before that
    other       : the other setting, in words
    """

    accuracy: float
    at_end: float
    largest: float
    sensitivity: float
    lost_from: float | None
    best: float
    other: str

    def rows(self) -> list[tuple[str, str]]:
        """Rows of the table at the end of a run."""
        words = f"{self.at_end:.1e} of the launch speed at the end, {self.largest:.1e} at most ({self.other})"
        found = [("estimated error", words)]
        if self.lost_from is not None:
            found.append(
                (
                    "accuracy not reached",
                    f"{self.accuracy:g} holds before t = {self.lost_from:.4g} s only, with {self.best:.1e} "
                    "there; if a smaller solver.accuracy does not mend it, the horizon of predictability "
                    "is passed, and what is left to compare are energy, area and mean speed",
                )
            )
        if self.sensitivity > max(self.accuracy, 10.0 * self.at_end):
            found.append(
                (
                    "sensitive start",
                    f"a start moved by {PUSH:.0e} m changes the speeds at the end by {self.sensitivity:.1e}: "
                    "they hold for exactly this start only",
                )
            )
        return found


def estimate_error(scene: Scene, result: Result) -> ErrorEstimate:
    """Run the scene again, twice, and compare with `result`; raises RunStopped if one of them stops."""
    start = prepare(scene)
    plan, other = _other(start.plan)
    scale = float(np.linalg.norm(start.velocity, axis=1).max(initial=0.0)) or 1.0
    ours = _speeds(result)
    difference = np.abs(ours - _speeds(simulate(replace(start, plan=plan)))).max(axis=1) / scale
    moved = np.abs(ours[-1] - _speeds(simulate(_moved(start)))[-1]).max() / scale
    accuracy = scene.solver.accuracy
    within = np.flatnonzero(difference <= accuracy)
    last = int(within[-1]) if len(within) else 0
    lost = last + 1 < len(difference)
    return ErrorEstimate(
        accuracy=accuracy,
        at_end=float(difference[-1]),
        largest=float(difference.max()),
        sensitivity=float(moved),
        lost_from=float(result.time[last + 1]) if lost else None,
        best=float(difference[last]),
        other=other,
    )


def _other(plan: Plan) -> tuple[Plan, str]:
    """A plan with a finer setting, or a coarser one where no finer one helps."""
    if plan.tolerance is None:
        assert plan.step is not None
        return replace(plan, step=0.5 * plan.step), f"against step {0.5 * plan.step:.3g} s"
    factor = FINER if FINER * plan.tolerance >= LEAST_TOLERANCE else 1.0 / FINER
    tolerance = factor * plan.tolerance
    return replace(plan, tolerance=tolerance), f"against tolerance {tolerance:.2g}"


def _moved(start: Start) -> Start:
    push = np.random.default_rng(SEED).uniform(-PUSH, PUSH, start.position.shape)
    push[start.net.fixed_nodes] = 0.0
    return replace(start, position=start.position + push)


def _speeds(result: Result) -> Floats:
    bullets = result.net.bullet_nodes
    velocity = result.velocity[:, bullets] if len(bullets) else result.velocity
    return np.asarray(np.linalg.norm(velocity, axis=-1))
