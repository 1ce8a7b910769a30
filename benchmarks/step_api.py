"""What stepping from outside costs: `Simulation.advance` by 1 ms against `run` that stores every 1 ms.

    python benchmarks/step_api.py [--repeats 9]

The paper's net with 20 x 20 meshes, run and steps by turns in one process; processor time of all but the
preparation of the case, so that other programs disturb less. Writes benchmarks/step_api.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from pathlib import Path

from exunet.scene.casefile import load
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.simulation.simulation import Simulation

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_deployment.toml"
NET = ("net.size=20.0", "time.output_step=0.001")
# From the start, where the steps are longest: 1 ms holds so few of them that each call counts most.
RUNS = {
    "compiled loop, to 0.4 s": ("engine.backend=compiled", "time.end=0.4"),
    "compiled loop, to 2.5 s": ("engine.backend=compiled", "time.end=2.5"),
    "Exudyn, to 0.2 s": ("engine.backend=exudyn", "time.end=0.2"),
}


def of_run(start: Start) -> float:
    """Processor time [s]."""
    began = time.process_time()
    simulate(start)
    return time.process_time() - began


def of_steps(start: Start, *, read: bool = False) -> float:
    """Processor time of as many steps of 1 ms [s]; read: the energies and the net after each."""
    began = time.process_time()
    simulation = Simulation(start)
    for _ in range(round(start.scene.time.end / 1e-3)):
        simulation.advance(1e-3)
        if read:
            _ = simulation.energy, simulation.net
    return time.process_time() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--only", default="", help="runs whose name begins so; the file is not written")
    asked = parser.parse_args()
    words = [
        "# What stepping from outside costs",
        "",
        f"`python benchmarks/step_api.py --repeats {asked.repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}. Processor time "
        "of `Simulation.advance(0.001)` over and over, and of `exunet.run` with an output step of 1 ms, by "
        "turns, on the paper's net with 20 x 20 meshes. The share is the median of the ratios of neighbours, "
        "less 1; at most 10 % are meant. The last column is what reading `energy` and `net` after a step "
        "adds, the look of the guards at that state included.",
        "",
        "| form, stretch | run, median [s] | steps, median [s] | of one step [ms] | share | quartiles "
        "| reading adds [ms] |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, overrides in RUNS.items():
        if not name.startswith(asked.only):
            continue
        start = prepare(load(CASE, [*NET, *overrides]).scene)
        of_run(start), of_steps(start)  # compiles, and fills the caches
        rounds = []
        for turn in range(asked.repeats):
            if turn % 2:
                steps, run = of_steps(start), of_run(start)
            else:
                run, steps = of_run(start), of_steps(start)
            rounds.append((run, steps, of_steps(start, read=True)))
        run, steps, _ = (statistics.median(part) for part in zip(*rounds, strict=True))
        low, share, high = statistics.quantiles([one[1] / one[0] - 1.0 for one in rounds], n=4)
        number = round(start.scene.time.end / 1e-3)
        read_out = statistics.median(one[2] - one[1] for one in rounds) / number
        words.append(
            f"| {name} | {run:.3f} | {steps:.3f} | {1e3 * steps / number:.3f} | {share:+.1%} | "
            f"{low:+.1%} to {high:+.1%} | {1e3 * read_out:.3f} |"
        )
        sys.stdout.write(words[-1] + "\n")
        sys.stdout.flush()
    if not asked.only:
        (HERE / "step_api.md").write_text("\n".join(words) + "\n")


if __name__ == "__main__":
    main()
