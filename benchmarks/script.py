"""What a script and a closing line add to a step of the compiled loop, in a net of 20 x 20 meshes.

    python benchmarks/script.py [--repeats 15]

A net thrown at a box that it does not reach, with RK44 steps of 0.1 ms; conditions that never hold are
looked at all the time. Each run is taken right before or after one without; processor time, so that other
programs disturb less. Writes benchmarks/script.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from pathlib import Path

from exunet.case.casefile import load
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.simulation import Simulation

HERE = Path(__file__).parent
CASES = HERE.parent / "cases" / "missions"
SCENE = (
    "engine.loop=compiled",
    'solver={method="RK44", step=1e-4}',
    "net.size=5.0",
    "net.mesh=0.25",
    "bodies.box.position=[0.0, 0.0, 50.0]",
)
LINE = ("closing.length=21.0", "closing.winch.shortest=2.0", "closing.winch.commands=[]")
BEGIN, END = 0.12, 0.42  # [s] between which steps are timed, once all rows have been used
OPEN = ("time > 99", "first_contact", "touching > 1000", "mouth_diameter < 0.1", "largest_area")
OPEN += ("range < 0.1", "relative_speed > 1e3")
CLOSED = ("closing_tension > 1e6",)
MISSION = ("first_contact", "mouth_diameter < 0.1", "closing_tension > 1e6")


def start(*conditions: str, line: bool) -> Start:
    """A scene with a closing line or without, and a script that waits for conditions."""
    tables = [f'{{name="e{k}", when="{one}", do="note"}}' for k, one in enumerate(conditions)]
    tables = [one.replace("do=", "fall=0.9, do=") if "largest_area" in one else one for one in tables]
    case = CASES / ("closed_box.toml" if line else "open_box.toml")
    overrides = [*SCENE, *(LINE if line else ()), f"script=[{', '.join(tables)}]"]
    return prepare(load(case, overrides).scene)


def of_step(begin: Start) -> float:
    """Processor time of a step [s]."""
    simulation = Simulation(begin)
    simulation.advance_to(BEGIN)
    before, began = simulation.counts.steps, time.process_time()
    simulation.advance_to(END)
    return (time.process_time() - began) / (simulation.counts.steps - before)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    asked = parser.parse_args()
    open_net, closed = start(line=False), start(line=True)
    rows = {f"`{one}`": (open_net, start(one, line=False)) for one in OPEN}
    rows |= {f"`{one}`, over a line": (closed, start(one, line=True)) for one in CLOSED}
    rows["a closing line"] = open_net, closed
    rows["a closing line, and a script of " + ", ".join(f"`{one}`" for one in MISSION)] = (
        open_net,
        start(*MISSION, line=True),
    )
    words = [
        "# What a script adds to a step",
        "",
        f"`python benchmarks/script.py --repeats {asked.repeats}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}. Processor time "
        "of RK44 steps of the compiled loop, in a net of 20 x 20 meshes with contact and material damping, "
        "with a script that waits for what never comes, and without one right before or after it. The share "
        "is the median of the ratios of neighbours, less 1; less than 15 % is meant for a script, a line and "
        "four controllers together, of which controllers are not measured here.",
        "",
        "| it has | without, median [us] | with, median [us] | share | quartiles |",
        "|---|---|---|---|---|",
    ]
    for name, (without, with_it) in rows.items():
        of_step(without), of_step(with_it)  # compiles, and fills the caches
        rounds = []
        for turn in range(asked.repeats):
            both = (of_step(one) for one in ((with_it, without) if turn % 2 else (without, with_it)))
            rounds.append(tuple(both)[:: -1 if turn % 2 else 1])
        bare, more = (1e6 * statistics.median(part) for part in zip(*rounds, strict=True))
        low, share, high = statistics.quantiles([one[1] / one[0] - 1.0 for one in rounds], n=4)
        words.append(f"| {name} | {bare:.1f} | {more:.1f} | {share:+.1%} | {low:+.1%} to {high:+.1%} |")
        sys.stdout.write(words[-1] + "\n")
        sys.stdout.flush()
    (HERE / "script.md").write_text("\n".join(words) + "\n")


if __name__ == "__main__":
    main()
