"""What the guards cost: runs with and without them, taking turns.

    python benchmarks/guards.py [--repeats 9]

Without: no state is looked at. The ledger of dissipated energy and the largest tension, which are results,
stay, and with them the gathering of states. Processor time, so that other programs disturb less. Writes
benchmarks/guards.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

from exunet.model.states import States
from exunet.scene.casefile import load
from exunet.simulation import observers
from exunet.simulation import run as timeloop
from exunet.simulation.guards import Floats, Guards, GuardValues
from exunet.simulation.preparation import prepare

HERE = Path(__file__).parent
CASES = HERE.parent / "cases"
RUNS = {
    "undamped, DOPRI5, Exudyn": ("planar_undamped.toml",),
    "undamped, DOPRI5, compiled loop": ("planar_undamped.toml", "engine.backend=compiled", "time.end=10"),
    "undamped, VelocityVerlet, compiled loop": (
        "planar_undamped.toml", "engine.backend=compiled",
        "solver.method=VelocityVerlet", "solver.step=1e-5", "time.output_step=0.01", "time.end=10",
    ),
    "damped, DOPRI5, Exudyn": ("planar_deployment.toml",),
    "damped, DOPRI5, compiled loop": ("planar_deployment.toml", "engine.backend=compiled", "time.end=10"),
    "50 x 50 meshes, DOPRI5, compiled loop": ("hard/mesh_50x50.toml", "engine.backend=compiled"),
}  # fmt: skip


class Blind(Guards):
    """Guards that look at one state at the start, and never again."""

    seen: GuardValues | None = None

    def look(self, states: States, dissipated: Floats) -> GuardValues:
        if self.seen is None:
            self.seen = super().look(states[:1], dissipated[:1])
        return GuardValues(*(np.repeat(part, len(states), axis=-1) for part in vars(self.seen).values()))


@contextmanager
def without_guards() -> Iterator[None]:
    with mock.patch.object(observers, "Guards", Blind):
        yield


def seconds(case: str, *overrides: str) -> float:
    """Processor time of a run."""
    start = prepare(load(CASES / case, overrides).scene)
    began = time.process_time()
    timeloop.simulate(start)
    return time.process_time() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=9)
    repeats = parser.parse_args().repeats
    lines = [
        "# What the guards cost",
        "",
        f"`python benchmarks/guards.py --repeats {repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}. Processor time "
        "of runs with and without guards, by turns; the share is the median of the ratios of neighbours, "
        "less 1. At most 3 % are meant.",
        "",
        "| run | without, median [s] | share of the guards | quartiles |",
        "|---|---|---|---|",
    ]
    for name, run in RUNS.items():
        seconds(*run)  # compiles
        bare, ratios = [], []
        for _ in range(3 * repeats if "compiled" in name else repeats):  # which are short, and scatter more
            with without_guards():
                bare.append(seconds(*run))
            ratios.append(seconds(*run) / bare[-1] - 1.0)
        low, middle, high = statistics.quantiles(ratios, n=4)
        median = statistics.median(bare)
        lines.append(f"| {name} | {median:.3f} | {middle:+.1%} | {low:+.1%} to {high:+.1%} |")
        sys.stdout.write(lines[-1] + "\n")
    (HERE / "guards.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
