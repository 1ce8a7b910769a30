"""Throws of the paper's net a second: eight side by side in compiled code against one by one.

    python benchmarks/ensemble.py [--repeats 7] [--runs 256]

VelocityVerlet with steps of 5e-5 s to 1.75 s, both by turns in one process, in a separate cache, so
that compilation is measured too, apart. The same throws by the case's own method show whether the metrics
have the same distribution. Writes benchmarks/ensemble.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from exunet.results.ensemble import Ensemble, ensemble_of, member_of
from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare_case
from exunet.studies.ensemble import perturbed_positions, run_members, start_of_runs

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_deployment.toml"
STEPS = "solver={method='VelocityVerlet', step=5e-5}"
WAYS = {"side by side": True, "one by one": False}
FEWER = 8  # times fewer throws one by one
MOVES = {  # [m] of the throws whose distributions are compared
    1e-4: "More than the errors of either method, which all its throws share: the distributions agree.",
    1e-9: "Less than the errors of either method: at 1.75 s the throws of one method are still near to one "
    "another, and equal steps shift metrics. Such ensembles are for the case's own method.",
}


def start_with(*overrides: str) -> Start:
    return start_of_runs(prepare_case(load(CASE, ["time.end=1.75", *overrides])))


def timed(start: Start, runs: int, *, together: bool, move: float = 1e-9) -> tuple[float, float, Ensemble]:
    """Wall and processor time [s], and what was found."""
    places = perturbed_positions(start, runs, move, 0)
    began, used = time.perf_counter(), time.process_time()
    found = run_members(start, places, member_of, together=together)
    seconds = time.perf_counter() - began, time.process_time() - used
    return *seconds, ensemble_of(found)


def quartiles(values: list[float]) -> str:
    low, middle, high = statistics.quantiles(values, n=4)
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def metrics(found: Ensemble) -> dict[str, np.ndarray]:
    """Those that each throw has."""
    return {found.about[key].words: of for key, of in found.metrics.items() if not np.isnan(of).any()}


def same_distribution(runs: int, move: float, words: str) -> list[str]:
    """Medians by the case's own method and by equal steps; Kolmogorov and Smirnov's test of both samples."""
    own, steps = start_with("engine.backend=compiled"), start_with(STEPS)
    accurate = metrics(timed(own, runs, together=False, move=move)[2])
    quick = metrics(timed(steps, runs, together=True, move=move)[2])
    rows = [
        "",
        f"Medians of {runs} throws from starts moved by up to {move:g} m, by the case's own method "
        f"({own.plan.method}, tolerance {own.plan.tolerance:.2g}) and by equal steps, and the probability of "
        f"a larger difference of the samples if they had one distribution. {words}",
        "",
        "| metric | own method | equal steps | p |",
        "|---|---|---|---|",
    ]
    for name, values in accurate.items():
        if name in quick and np.ptp(values) > 0.0:
            p = ks_2samp(values, quick[name]).pvalue
            rows.append(f"| {name} | {np.median(values):.5g} | {np.median(quick[name]):.5g} | {p:.2g} |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--runs", type=int, default=256, help="throws side by side; one by one: an eighth")
    asked = parser.parse_args()
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as cache:
        os.environ["XDG_CACHE_HOME"] = cache
        start = start_with(STEPS)
        compiled = {way: timed(start, 1, together=together)[1] for way, together in WAYS.items()}
        wall: dict[str, list[float]] = {way: [] for way in WAYS}
        used: dict[str, list[float]] = {way: [] for way in WAYS}
        load_before = os.getloadavg()[0]
        for _ in range(asked.repeats):
            last = {}
            for way, together in WAYS.items():
                runs = asked.runs if together else max(1, asked.runs // FEWER)
                seconds, processor, last[way] = timed(start, runs, together=together)
                wall[way].append(runs / seconds)
                used[way].append(runs / processor)
        one, many = last["one by one"], last["side by side"]
        key = "largest_tension_N"
        assert np.array_equal(one.metrics[key], many.metrics[key][: one.runs])
        rest = [line for pair in MOVES.items() for line in same_distribution(asked.runs // 2, *pair)]
    words = [
        "# Throws a second",
        "",
        f"`python benchmarks/ensemble.py --repeats {asked.repeats} --runs {asked.runs}`, "
        f"{time.strftime('%Y-%m-%d')}, {platform.platform()}, {cores} cores, Python "
        f"{platform.python_version()}; mean load before {load_before:.1f} (above 0.5, others had part "
        "of the cores: processor time is then the better measure, but shares its caches with them). The "
        "paper's net, VelocityVerlet with steps of 5e-5 s to 1.75 s, 401 instants, guards and measures "
        "included. Medians and quartiles.",
        "",
        f"| way | throws a second, {cores} cores | throws a second of processor time | compiling [s] |",
        "|---|---|---|---|",
        *(f"| {w} | {quartiles(wall[w])} | {quartiles(used[w])} | {compiled[w]:.1f} |" for w in WAYS),
        "",
        "The throws agree to the last bit.",
        *rest,
    ]
    (HERE / "ensemble.md").write_text("\n".join(words) + "\n")
    sys.stdout.write("\n".join(words) + "\n")


if __name__ == "__main__":
    main()
