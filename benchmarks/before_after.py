"""Two versions of exunet on the same runs: python benchmarks/before_after.py --before FOLDER [--rounds N]

FOLDER is a checkout of the earlier version. The runs are those of guards.py, the best settings of
work_precision.py, and stretched nets as in growth.py. Each round runs the versions by turns, each in a
process of its own. Writes before_after.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

import growth
from guards import RUNS

HERE = Path(__file__).parent
BOUND = 1.05
LEAST = 1.0  # [s]: shorter runs are repeated in a process until they have taken as long

ONE = """
import json, sys, time
import exunet
case, least, *overrides = sys.argv[1:]
case = exunet.load(case, overrides)
exunet.run(case)
told, began = [], time.perf_counter()
while not told or time.perf_counter() - began < float(least):
    start = time.perf_counter()
    done = exunet.run(case).provenance
    told.append((done["integration_seconds"], time.perf_counter() - start, done["right_hand_sides"]))
json.dump(sorted(told)[len(told) // 2], sys.stdout)
"""


def rows() -> dict[str, tuple[str, ...]]:
    """Case and overrides by name."""
    found: dict[str, tuple[str, ...]] = {f"guards: {name}": run for name, run in RUNS.items()}
    large = "guards: 50 x 50 meshes, DOPRI5, fused"
    found[large] = (*found[large], "time.end=0.004")
    damped, undamped = "planar_deployment.toml", "planar_undamped.toml"
    loop, connectors, fused = (
        ("engine.loop=compiled",),
        ("engine.net=connectors", "engine.loop=exudyn"),
        ("engine.net=fused", "engine.loop=exudyn"),
    )
    equal = "solver.accuracy=", "solver.method=RK44"
    found["damped, RK44, connectors"] = (damped, *connectors, *equal, "solver.step=1e-4")
    found["damped, RK44, compiled loop"] = (damped, *loop, *equal, "solver.step=2e-5")
    best = "time.end=1.5", "solver.accuracy="
    for name, form, method, tolerance in (
        ("connectors", connectors, "ODE23", "1e-6"),
        ("fused", fused, "ODE23", "3.2e-6"),
        ("compiled loop", loop, "DOPRI5", "1e-6"),
    ):
        setting = f"solver.method={method}", f"solver.tolerance={tolerance}"
        found[f"work and precision: {name}, {method}"] = (undamped, *best, *form, *setting)
    for meshes in (20, 70):
        elements = 2 * meshes * (meshes + 1) + 4
        steps = max(20, growth.WORK // elements)
        for name, form in (("connectors", connectors), ("fused", fused), ("compiled loop", loop)):
            # As `growth.CHANGES`, but the run ends after its steps.
            changes = [change for change in growth.CHANGES if not change.startswith("time.end")]
            taken = f"net.size={float(meshes)}", f"time.end={steps * growth.STEP}"
            setting = "solver.method=RK44", f"solver.step={growth.STEP}"
            words = f"growth: {meshes} x {meshes} meshes, RK44, {name}"
            found[words] = (undamped, *changes, *taken, "engine=", *form, *setting)
    return found


def one(folder: Path, case: str, overrides: tuple[str, ...]) -> tuple[float, float, int]:
    """Seconds of the integration and of the whole run, and its right-hand sides."""
    command = [sys.executable, "-c", ONE, f"cases/{case}", str(LEAST), *overrides]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{folder}: {case} {' '.join(overrides)}:\n{done.stderr[-2000:]}")
    integration, whole, right_hand_sides = json.loads(done.stdout)
    return integration, whole, right_hand_sides


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, required=True, help="checkout of the earlier version")
    parser.add_argument("--commit", default="ef793bf", help="of that checkout, for the report")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", help="rows whose names have this in them; writes nothing")
    asked = parser.parse_args()
    versions = {"before": asked.before.resolve(), "after": HERE.parent}
    lines = [
        "# Before and after the rebuilding",
        "",
        f"`python benchmarks/before_after.py --before CHECKOUT --rounds {asked.rounds}` with a checkout of "
        f"commit {asked.commit}, {time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}. Wall time, medians of processes by turns; the range is that of "
        "the rounds; ratio of the integrations' medians, after by before, with the range of the ratios of "
        f"neighbours. At most {BOUND} is meant.",
        "",
        "| run | before [s] | after [s] | ratio | ratio of whole runs | right-hand sides |",
        "|---|---|---|---|---|---|",
    ]
    for name, (case, *overrides) in rows().items():
        if asked.only not in name:
            continue
        times: dict[str, list[tuple[float, float, int]]] = {version: [] for version in versions}
        for _ in range(asked.rounds):
            for version, folder in versions.items():
                times[version].append(one(folder, case, tuple(overrides)))
        shown = []
        for version in versions:
            seconds = [integration for integration, _, _ in times[version]]
            spread = f"{min(seconds):.4g} to {max(seconds):.4g}"
            shown.append(f"{statistics.median(seconds):.4g} ({spread})")
        ratios = []
        for k in (0, 1):
            by_turns = [after[k] / before[k] for before, after in zip(*times.values(), strict=True)]
            before, after = (statistics.median(run[k] for run in runs) for runs in times.values())
            ratios.append(f"{after / before:.2f} ({min(by_turns):.2f} to {max(by_turns):.2f})")
        counts = sorted({run[2] for runs in times.values() for run in runs})
        numbers = " and ".join(map(str, counts))
        lines.append(f"| {name} | {shown[0]} | {shown[1]} | {ratios[0]} | {ratios[1]} | {numbers} |")
        sys.stdout.write(lines[-1] + "\n")
        sys.stdout.flush()
    if not asked.only:
        (HERE / "before_after.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
