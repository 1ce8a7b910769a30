"""What a script, a closing line and four controllers add to a step of the compiled loop, 20 x 20 meshes.

    python benchmarks/script.py [--repeats 9]

The shipped capture of a net of 20 x 20 meshes, cases/capture/box.toml, from its start until it is wrapped,
window by window: flight, first contact, wrapped. Conditions that never hold are looked at all the time, and
lines and thrusters pull so little that the same threads are taut and touch with them and without. Runs go
through the same windows again and again, from one output time to the next as `exunet run` goes, with and
without by turns; processor time, of each window the least.
Writes benchmarks/script.md.
"""

from __future__ import annotations

import argparse
import gc
import os
import platform
import sys
import time
from itertools import pairwise
from pathlib import Path

from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "capture" / "box.toml"
WINDOWS = (0.05, 0.15, 0.4, 0.8, 1.2)  # [s], the first of flight; the net is around the box from 0.4 s on
OUTPUT = 0.02  # [s] output step of the shipped case
LINE = (
    'kind="line"',
    'rings="edge"',
    "stiffness=1e-8",
    "linear_density=1e-9",
    "ring_diameter=0.01",
    "friction=0.0",
    "winch={shortest=2.0, damping=0.5, largest_rate=6.0, commands=[]}",
)
SLACK, TAUT = 21.0, 14.0  # [m] of a line whose way is between 19.6 m and 20.1 m; at most twice its length
THRUSTERS = (
    "bullets=[0, 1, 2, 3]",
    'kind="point"',
    'body="box"',
    "offset=[0.0, 0.0, 0.45]",
    "stiffness=1.0",
    "damping=0.3",
    "largest_thrust=1e-10",
    "minimum_impulse=1e-14",
    "specific_impulse=60.0",
    "noise={position=0.005, velocity=0.005, seed=7}",
)
PERIODS = (0.1, 0.02)  # [s]; the second that of cases/missions/drift_controlled.toml
OPEN = ("time > 99", "first_contact", "touching > 9999", "mouth_diameter < 0.01", "largest_area")
OPEN += ("range < 1e-6", "relative_speed > 1e3")
MISSION = ("touching > 9999", "mouth_diameter < 0.01", "closing_tension > 1e6")

Ready = tuple[Simulation, Snapshot]


def ready(*conditions: str, line: float | None = None, period: float | None = None) -> Ready:
    """The scene at the beginning of the first window.

    conditions : that a script waits for; line : length of a closing line [m]; period : of controllers [s]
    """
    tables = [f'{{name="e{k}", when="{one}", do="note"}}' for k, one in enumerate(conditions)]
    tables = [one.replace("do=", "fall=0.99, do=") if "largest_area" in one else one for one in tables]
    overrides = ["engine.backend=compiled", f"script=[{', '.join(tables)}]"]
    if line is not None:
        overrides.append(f"closing={{{', '.join(LINE)}, length={line}}}")
    if period is not None:
        overrides.append(f"control={{{', '.join(THRUSTERS)}, period={period}}}")
    simulation = Simulation(prepare(load(CASE, overrides).scene))
    simulation.advance_to(WINDOWS[0])
    return simulation, simulation.snapshot()


def of_steps(scene: Ready) -> list[float]:
    """Processor time of a step in each window [us]."""
    simulation, begin = scene
    simulation.restore(begin)
    told = []
    gc.collect()
    gc.disable()  # with so many scenes at once it would take milliseconds, in the same window of each round
    for end in WINDOWS[1:]:
        before, began = simulation.counts.steps, time.process_time()
        while simulation.time < end:
            simulation.advance_to(min(simulation.time + OUTPUT, end))
        told.append(1e6 * (time.process_time() - began) / (simulation.counts.steps - before))
    gc.enable()
    return told


def rows() -> dict[str, Ready]:
    """What is measured."""
    found = {f"`{one}`": ready(one) for one in OPEN}
    found |= {f"four controllers, every {period:g} s": ready(period=period) for period in PERIODS}
    found["a line that is slack"] = ready(line=SLACK)
    found["a line that is taut"] = ready(line=TAUT)
    words = "taut line, a script of " + ", ".join(f"`{one}`" for one in MISSION)
    for period in PERIODS:
        name = f"{words}, four controllers every {period:g} s: together"
        found[name] = ready(*MISSION, line=TAUT, period=period)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=9)
    asked = parser.parse_args()
    bare, scenes, load_before = ready(), rows(), os.getloadavg()[0]
    steps = [round((b - a) / (bare[0].plan.step or 1.0)) for a, b in pairwise(WINDOWS)]
    table = []
    for name, scene in scenes.items():
        of_steps(bare), of_steps(scene)  # compiles, and fills the caches
        rounds = [(of_steps(bare), of_steps(scene)) for _ in range(asked.repeats)]
        without, with_it = (
            [min(times) for times in zip(*part, strict=True)] for part in zip(*rounds, strict=True)
        )
        shares = [more / less - 1.0 for less, more in zip(without, with_it, strict=True)]
        whole = sum(n * t for n, t in zip(steps, with_it, strict=True))
        whole /= sum(n * t for n, t in zip(steps, without, strict=True))
        cells = [f"{less:.1f} {share:+.0%}" for less, share in zip(without, shares, strict=True)]
        table.append(f"| {name} | {' | '.join(cells)} | {whole - 1.0:+.1%} |")
        sys.stdout.write(table[-1] + "\n")
        sys.stdout.flush()
    heads = [f"{a:g} to {b:g} s" for a, b in pairwise(WINDOWS)]
    words = (
        "# What a script, a closing line and controllers add to a step",
        "",
        f"`python benchmarks/script.py --repeats {asked.repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}, load average "
        f"{load_before:.1f} before and {os.getloadavg()[0]:.1f} after. Processor time of steps of the "
        f"compiled loop in `cases/capture/box.toml` (20 x 20 meshes, {bare[0].start.net.n_elements} "
        f"threads, velocity Verlet, steps of {bare[0].plan.step:g} s) without its script, with something and "
        "without it by turns; scripts wait for what never comes. In each window the least time of a step "
        "without [us], and what the least with it is more; then of all windows together, where less than "
        "15 % is meant for a script, a line and four controllers together.",
        "",
        f"| it has | {' | '.join(heads)} | all |",
        f"|---|{'---|' * len(heads)}---|",
        *table,
    )
    (HERE / "script.md").write_text("\n".join(words) + "\n")


if __name__ == "__main__":
    main()
