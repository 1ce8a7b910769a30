"""Times at which the bullets of many runs separate: how they are counted, ordered and told."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau

from exunet.verification.separation_runs import NUDGE, Curve

Floats = NDArray[np.float64]

NEVER = 1e9  # [s], in place of infinity, which a rank statistic does not take
SIGNIFICANT = 0.05  # probability below which a rank correlation is not put down to chance


def shown(instant: float) -> str:
    """A time of separation in words: NaN for a run that stopped, infinite for one that does not separate."""
    if math.isnan(instant):
        return "stopped"
    return f"{instant:.3f} s" if math.isfinite(instant) else "-"


def instants(runs: Iterable[Curve], time: Floats, level: float) -> list[float]:
    """Times of separation of the runs that did not stop."""
    return [instant for run in runs if not math.isnan(instant := run.separates(time, level))]


def median(times: Sequence[float]) -> float:
    """A run that does not separate is later than all; NaN for no runs."""
    return float(np.median(times)) if times else math.nan


def span(runs: Sequence[Curve], time: Floats, level: float) -> str:
    """In words: how many runs separate, and when."""
    found = instants(runs, time, level)
    seen = [instant for instant in found if math.isfinite(instant)]
    stopped = f", {len(runs) - len(found)} stopped" if len(found) < len(runs) else ""
    if not seen:
        return f"none of {len(runs)} runs before {time[-1]:g} s{stopped}"
    between = f"{min(seen):.2f} s" if len(seen) == 1 else f"{min(seen):.2f} to {max(seen):.2f} s"
    return f"{len(seen)} of {len(runs)} runs, at {between}{stopped}"


def order(runs: Sequence[Curve], time: Floats, level: float) -> tuple[float, float] | None:
    """Kendall's tau of the times of separation with tighter tolerances, and its probability by chance.

    A run that does not separate is later than all; one that stopped does not count. None where all times are
    equal: they have no order.
    """
    kept = [run for run in runs if not run.stopped]
    found = np.minimum(instants(kept, time, level), NEVER)
    if len(np.unique(found)) < 2 or len({run.tolerance for run in kept}) < 2:
        return None
    tau, p = kendalltau([-run.tolerance for run in kept], found)
    return float(tau), float(p)


def by_tolerance(runs: Iterable[Curve]) -> dict[float, list[Curve]]:
    """The runs at each tolerance."""
    groups: dict[float, list[Curve]] = {}
    for run in runs:
        groups.setdefault(run.tolerance, []).append(run)
    return groups


def drawn_table(drawn: dict[str, list[Curve]], time: Floats, level: float) -> str:
    """Markdown: medians over many moved starts by net and tolerance; why there are none without Numba."""
    if not drawn:
        return "Medians over many moved starts are not measured here: that takes the compiled loop (Numba)."
    tolerances = list(by_tolerance(next(iter(drawn.values()))))
    rows = [f"| net | {' | '.join(f'{t:.0e}' for t in tolerances)} |", "|---" * (len(tolerances) + 1) + "|"]
    for name, runs in drawn.items():
        cells = []
        for group in by_tolerance(runs).values():
            found = instants(group, time, level)
            lost = len(group) - len(found)
            cells.append(shown(median(found)) + (f" ({lost} stopped)" if found and lost else ""))
        rows.append(f"| {name} | {' | '.join(cells)} |")
    count = len(next(iter(by_tolerance(next(iter(drawn.values()))).values())))
    return (
        f"Median of the same times over {count} starts at each tolerance, each moved by {NUDGE:.0e} m in its "
        "own way (compiled loop):\n\n" + "\n".join(rows)
    )


def drawn_orders(drawn: dict[str, list[Curve]], time: Floats, level: float) -> dict[str, list[str]]:
    """Nets by what many moved starts show: "sooner" or "later" with a looser tolerance, or "no order"."""
    found: dict[str, list[str]] = {"sooner": [], "later": [], "no order": []}
    for name, runs in drawn.items():
        ranks, groups = order(runs, time, level), list(by_tolerance(runs).items())
        ends = ", ".join(
            f"{shown(median(instants(group, time, level)))} at {tolerance:.0e}"
            for tolerance, group in (groups[0], groups[-1])
        )
        if ranks is None:
            found["no order"].append(f"{name} (all at the same time)")
            continue
        tau, p = ranks
        kind = "no order" if p >= SIGNIFICANT else "sooner" if tau > 0.0 else "later"
        found[kind].append(f"{name} (median {ends}; tau = {tau:+.2f}, p = {p:.2g})")
    return found
