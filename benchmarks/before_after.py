"""Two versions of exunet on the same runs: python benchmarks/before_after.py --before FOLDER [--rounds N]

FOLDER is a checkout of the earlier version. The runs are ten (`ROWS`): the paper's net, stretched nets as in
growth.py, and a capture. Each round runs the versions by turns, each in a
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
BOUND = 1.10
LEAST = 1.0  # [s]: shorter runs are repeated in a process until they have taken as long

ONE = """
import json, sys, time
import exunet
case, least, *overrides = sys.argv[1:]
case = exunet.load(case, overrides)
exunet.run(case)
runs, began = [], time.perf_counter()
while not runs or time.perf_counter() - began < float(least):
    start, used = time.perf_counter(), time.process_time()
    done = exunet.run(case).run.cost
    used = time.process_time() - used
    runs.append((done.integration_seconds, time.perf_counter() - start, used, done.right_hand_sides))
integration, whole, _, evaluations = sorted(runs)[len(runs) // 2]
json.dump((integration, whole, min(run[2] for run in runs), evaluations), sys.stdout)
"""


ROWS = (
    "undamped, DOPRI5, Exudyn",
    "damped, DOPRI5, Exudyn",
    "undamped, DOPRI5, compiled loop",
    "undamped, VelocityVerlet, compiled loop",
    "damped, DOPRI5, compiled loop",
    "damped, RK44, Exudyn",
    "damped, RK44, compiled loop",
    "20 x 20 meshes, RK44, Exudyn",
    "70 x 70 meshes, RK44, compiled loop",
    "box captured, compiled loop",
)


def rows() -> dict[str, tuple[str, ...]]:
    """Case and overrides of `ROWS`, by name."""
    found: dict[str, tuple[str, ...]] = dict(RUNS)
    damped, exudyn, loop = "planar_deployment.toml", "engine.backend=exudyn", "engine.backend=compiled"
    equal = "solver.accuracy=", "solver.method=RK44"
    found["damped, RK44, Exudyn"] = (damped, exudyn, *equal, "solver.step=1e-4")
    found["damped, RK44, compiled loop"] = (damped, loop, *equal, "solver.step=2e-5")
    for meshes, name, backend in ((20, "Exudyn", exudyn), (70, "compiled loop", loop)):
        steps = max(20, growth.WORK // (2 * meshes * (meshes + 1) + 4))
        # As `growth.CHANGES`, but the run ends after its steps.
        changes = [change for change in growth.CHANGES if not change.startswith("time.end")]
        taken = f"net.size={float(meshes)}", f"time.end={steps * growth.STEP}"
        setting = "solver.method=RK44", f"solver.step={growth.STEP}"
        words = f"{meshes} x {meshes} meshes, RK44, {name}"
        found[words] = ("planar_undamped.toml", *changes, *taken, backend, *setting)
    found["box captured, compiled loop"] = ("capture/box.toml", loop, "time.end=0.5")
    return {name: found[name] for name in ROWS}


def of_version(folder: Path, overrides: tuple[str, ...]) -> list[str]:
    """Overrides as a checkout names them: before `engine.backend` there were two keys."""
    if "backend" in (folder / "cases" / "nets" / "star.toml").read_text(encoding="utf-8"):
        return list(overrides)
    former = {
        "engine.backend=compiled": "engine={loop='compiled'}",
        "engine.backend=exudyn": "engine={net='connectors'}",
    }
    return [former.get(change, change) for change in overrides]


Told = tuple[float, float, float, int]


def one(folder: Path, case: str, overrides: tuple[str, ...]) -> Told:
    """Medians of the seconds of the integration and of the whole run, the least processor time of the latter,
    and its right-hand sides.
    """
    command = [sys.executable, "-c", ONE, f"cases/{case}", str(LEAST), *of_version(folder, overrides)]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{folder}: {case} {' '.join(overrides)}:\n{done.stderr[-2000:]}")
    integration, whole, used, right_hand_sides = json.loads(done.stdout)
    return integration, whole, used, right_hand_sides


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, required=True, help="checkout of the earlier version")
    parser.add_argument("--commit", default="0bcc5363", help="of that checkout, for the report")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", help="rows whose names have this in them; writes nothing")
    asked = parser.parse_args()
    versions = {"before": asked.before.resolve(), "after": HERE.parent}
    lines = [
        "# Before and after the rebuilding",
        "",
        f"`python benchmarks/before_after.py --before CHECKOUT --rounds {asked.rounds}` with a checkout of "
        f"commit {asked.commit}, {time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}. Processes by turns. Of whole runs, which hold the same work in "
        "both versions, the least processor time, and its ratio, after by before: at most "
        f"{BOUND} is meant. Beside it ratios of wall time, medians with the range of the ratios of "
        "neighbours, of whole runs and of their integrations, in which the later version looks at states "
        "that the earlier one looked at afterwards.",
        "",
        "| run | before [s] | after [s] | ratio | ratio of wall time | of integrations | right-hand sides |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (case, *overrides) in rows().items():
        if asked.only not in name:
            continue
        times: dict[str, list[Told]] = {version: [] for version in versions}
        for _ in range(asked.rounds):
            for version, folder in versions.items():
                times[version].append(one(folder, case, tuple(overrides)))
        before, after = (min(run[2] for run in runs) for runs in times.values())
        ratios = [f"{after / before:.2f}"]
        for k in (1, 0):
            by_turns = [late[k] / early[k] for early, late in zip(*times.values(), strict=True)]
            early, late = (statistics.median(run[k] for run in runs) for runs in times.values())
            ratios.append(f"{late / early:.2f} ({min(by_turns):.2f} to {max(by_turns):.2f})")
        counts = sorted({run[3] for runs in times.values() for run in runs})
        numbers = " and ".join(map(str, counts))
        lines.append(f"| {name} | {before:.4g} | {after:.4g} | {' | '.join(ratios)} | {numbers} |")
        sys.stdout.write(lines[-1] + "\n")
        sys.stdout.flush()
    if not asked.only:
        (HERE / "before_after.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
