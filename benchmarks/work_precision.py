"""Time to a speed error of 1e-4 m/s at t = 1.5 s: python benchmarks/work_precision.py [--rounds N]

The undamped planar case in exunet's forms, in the reference, and in the other programs that are installed,
each with its best setting: the loosest of a ladder at which, and at all tighter ones, the error is within the
bound; of several methods the fastest. Then all in turn, N rounds, short ones several times in each; medians.
Writes work_precision.md and work_precision.csv beside it.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import peers

import exunet
from exunet.methods.method import Backend
from exunet.simulation.preparation import prepare
from exunet.studies.both_codes import both_of
from exunet.studies.cost.runs import Subject, run
from exunet.studies.cost.settings import Setting, setting_of
from exunet.studies.ensemble import perturbed_positions, run_ensemble

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_undamped.toml"
END = 1.5
SPEED = 1.621663435  # m/s at END: reference_impl/README.md, digits that its two tightest tolerances share
BOUND = 1e-4  # m/s
LAUNCH = 2.5  # m/s
DECADES = tuple(10.0**-k for k in np.arange(4.0, 9.5, 0.5))
ENSEMBLE = 64
SHORT, MOST = 0.5, 10  # [s]: runs shorter than this are repeated in a round, up to so many times

Runner = Callable[[Any], peers.Outcome]


@dataclass
class Contestant:
    """A program with the ladders of its methods (loosest first)."""

    name: str
    run: Runner
    ladders: Sequence[Sequence[Any]]
    best: Any = None
    seconds: list[float] = field(default_factory=list)
    error: float = float("inf")
    note: str = ""

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)


def say(words: str) -> None:
    """A line of progress."""
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


def contestants() -> list[Contestant]:
    """All programs; those that are not installed refuse when they run."""
    case = exunet.load(CASE, [f"time.end={END}", "time.output_step=", "time.output_times=[]"])
    start = prepare(case.scene)
    subject = Subject.of(case, (0.0, END), both_of(case))
    net = start.net
    problem = peers.Problem(
        *net.element_nodes.T, net.mass, net.reference_length, net.axial_stiffness,
        start.position, start.velocity, net.bullet_nodes, END, start.plan.longest_step,
    )  # fmt: skip

    def ours(setting: Setting) -> peers.Outcome:
        began = time.perf_counter()
        try:
            found = run(subject, setting)
        except exunet.RunStopped:
            return time.perf_counter() - began, np.array([np.inf])
        return found.seconds, found.tracked[-1]

    def auto(form: str) -> peers.Outcome:
        changes = ["solver=", f"solver.accuracy={BOUND / LAUNCH}", form]
        chosen = exunet.load(CASE, [f"time.end={END}", "time.output_step=", "time.output_times=[]", *changes])
        result = exunet.run(chosen)
        speeds = np.linalg.norm(result.velocity[-1, result.net.bullet_nodes], axis=-1)
        return result.run.cost.integration_seconds, speeds

    def adaptive(backend: Backend | None, *methods: str) -> list[list[Setting]]:
        return [[setting_of(backend, method, tolerance=t) for t in DECADES] for method in methods]

    return [
        Contestant("exunet, auto", auto, [["engine.backend=exudyn"]]),
        Contestant("exunet, auto, also of the loop", auto, [["engine.backend=auto"]]),
        Contestant("exunet, Exudyn", ours, adaptive(Backend.EXUDYN, "DOPRI5", "ODE23")),
        Contestant("exunet, compiled loop", ours, adaptive(Backend.COMPILED, "DOPRI5")),
        Contestant("reference_impl", ours, adaptive(None, "RK45", "DOP853")),
        Contestant(
            "SciPy solve_ivp over NumPy",
            lambda setting: peers.scipy(problem, setting),
            [[(method, t) for t in DECADES] for method in ("RK45", "DOP853", "RK23")],
        ),
        Contestant(
            "GNU Octave ode45", lambda setting: peers.octave(problem, setting), [[1e-6, 1e-7, 1e-8, 1e-9]]
        ),
        Contestant(
            "MuJoCo",
            lambda setting: peers.mujoco(problem, setting),
            [[("RK4", h) for h in (4e-5, 2e-5, 1e-5)], [("Euler", h) for h in (1e-5, 5e-6)]],
        ),
        Contestant("bare loop in C", lambda setting: peers.bare(problem, setting), [DECADES]),
    ]


def find_best(contestant: Contestant) -> None:
    """Set the best setting, or a note with the reason if no setting qualifies."""
    found: list[tuple[float, Any, float]] = []
    least = (float("inf"), None)
    try:
        for ladder in contestant.ladders:
            runs = [(setting, *_outcome(contestant, setting)) for setting in ladder]
            able = []
            for setting, seconds, error in reversed(runs):  # from the tightest on
                least = min(least, (error, setting), key=lambda one: one[0])
                if not error <= BOUND:
                    break
                able.append((seconds, setting, error))
            if able:
                found.append(min(able[-1:], key=lambda one: one[0]))
    except peers.Missing as missing:
        contestant.note = str(missing)
        return
    if not found:
        contestant.note = f"not reached: {least[0]:.1e} m/s at best, with {least[1]}"
        return
    _, contestant.best, contestant.error = min(found, key=lambda one: one[0])
    say(f"{contestant.name}: {contestant.best}, error {contestant.error:.1e} m/s")


def _outcome(contestant: Contestant, setting: Any) -> tuple[float, float]:
    contestant.run(setting) if contestant.name.startswith("exunet") else None  # compiles
    seconds, speeds = contestant.run(setting)
    error = float(np.abs(speeds - SPEED).max())
    return seconds, error if np.isfinite(error) else float("inf")


def ensemble_rate() -> tuple[float, float]:
    """Perturbed runs a second to t = 1.75 s at accuracy 1e-4 on all cores, and the load before."""
    changes = [
        "time.end=1.75",
        "time.output_step=",
        "time.output_times=[]",
        "solver=",
        "solver.accuracy=1e-4",
    ]
    start = prepare(exunet.load(CASE, [*changes, "engine.backend=compiled"]).scene)
    moved = perturbed_positions(start, ENSEMBLE, 1e-10, seed=1)
    run_ensemble(start, moved[:2])
    began, worked = time.perf_counter(), time.process_time()
    run_ensemble(start, moved)
    return ENSEMBLE / (time.perf_counter() - began), (time.process_time() - worked) / ENSEMBLE


def words_of(setting: Any) -> str:
    if isinstance(setting, Setting):
        return f"{setting.method}, tolerance {setting.size:.1e}"
    if isinstance(setting, tuple):
        return f"{setting[0]}, {setting[1]:.1e}"
    return f"{setting:.1e}" if isinstance(setting, float) else str(setting)


def _versions() -> str:
    found = [f"exunet {exunet.__version__}"]
    for name in ("exudyn", "numpy", "scipy", "numba", "mujoco"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    everyone = contestants()
    for contestant in everyone:
        find_best(contestant)
    able = [one for one in everyone if one.best is not None]
    load = [os.getloadavg()[0]]
    rates = []
    for _ in range(rounds):
        for one in able:
            first = one.run(one.best)[0]
            one.seconds.append(first)
            again = range(min(MOST, int(SHORT / first)))
            one.seconds += [one.run(one.best)[0] for _ in again]
        rates.append(ensemble_rate())
        load.append(os.getloadavg()[0])
    limit = next((one.median for one in able if one.name.startswith("bare")), float("nan"))
    auto = next(one.median for one in able if one.name == "exunet, auto")
    lines = [
        f"# Time to |speed error| <= {BOUND:g} m/s at t = {END} s, undamped planar case",
        "",
        f"`python benchmarks/work_precision.py --rounds {rounds}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}, {_versions()}; "
        f"load average {min(load):.1f} to {max(load):.1f}. "
        "Time of the stepping alone, median and range of the rounds, all programs in turn.",
        "",
        "| | best setting | error [m/s] | time [s] | range [s] | times the bare loop | times exunet auto |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = []
    for one in everyone:
        if one.best is None:
            lines.append(f"| {one.name} | {one.note} | | | | | |")
            rows.append([one.name, one.note, "", "", "", ""])
            continue
        span = (min(one.seconds), max(one.seconds))
        lines.append(
            f"| {one.name} | {words_of(one.best)} | {one.error:.1e} | {one.median:.4g} "
            f"| {span[0]:.3g} to {span[1]:.3g} | {one.median / limit:.3g} | {one.median / auto:.3g} |"
        )
        rows.append([one.name, words_of(one.best), f"{one.error:.3e}", one.median, *span])
    lines += [
        "",
        f"Perturbed runs (`exunet.studies.ensemble`, compiled loop, to t = 1.75 s, accuracy 1e-4) on "
        f"{os.cpu_count()} cores: {statistics.median(each[0] for each in rates):.0f} a second "
        f"({min(each[0] for each in rates):.0f} to {max(each[0] for each in rates):.0f}), "
        f"{1e3 * statistics.median(each[1] for each in rates):.1f} ms of processor time a run.",
    ]
    text = "\n".join(lines) + "\n"
    (HERE / "work_precision.md").write_text(text, encoding="utf-8")
    with (HERE / "work_precision.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["program", "setting", "error_m_s", "median_s", "least_s", "most_s"])
        writer.writerows(rows)
    say(text)


if __name__ == "__main__":
    main()
