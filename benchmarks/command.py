"""The command beside the integration: python benchmarks/command.py [--before FOLDER] [--rounds N]

FOLDER is a checkout of an earlier version, which runs by turns with this one. Kernels are cached: a first run
of each version is not counted. Processor time does not depend on what else runs, wall time does. Writes
command.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent

# Command, and goal [s] beside the integration.
ROWS = {
    "planar case, compiled": (("run", "cases/planar_deployment.toml", "--backend", "compiled"), 2.0),
    "capture/box": (("run", "cases/capture/box.toml"), 2.5),
    "missions/throw_close_tow": (("run", "cases/missions/throw_close_tow.toml"), 3.0),
    "exunet.load": ((), 0.4),
    "import exunet": ((), 0.02),
    "exunet --help": (("--help",), 0.1),
}
SCRIPTS = {
    "exunet.load": "import exunet; exunet.load('cases/planar_deployment.toml')",
    "import exunet": "import exunet",
}
# Parts of a run: label, module, and the function (or class and method) whose time counts.
PARTS = (
    ("imports of the command", "", ""),
    ("integration", "exunet.simulation.run", "drive"),
    ("model, plan of steps", "exunet.cli.run", "prepare_case"),
    ("kernels, guards", "exunet.simulation.simulation", "Simulation.__init__"),
    ("metrics", "exunet.cli.run", "summary_of"),
    ("report.html", "exunet.plots.view", "write_page"),
    ("figures", "exunet.plots.registry", "save_run_figures"),
)

CHILD = """
import functools, importlib, json, os, sys, time
started = time.process_time(), time.perf_counter()
parts, out, arguments = json.loads(sys.argv[1]), sys.argv[2], sys.argv[3:]
spent = {label: [0.0, 0.0] for label, _, _ in parts}

def timed(label, function):
    @functools.wraps(function)
    def call(*args, **keys):
        start = time.process_time(), time.perf_counter()
        try:
            return function(*args, **keys)
        finally:
            spent[label][0] += time.process_time() - start[0]
            spent[label][1] += time.perf_counter() - start[1]
    return call

import exunet.cli.main
def load():
    import exunet.cli.run
    import matplotlib.figure
timed("imports of the command", load)()
for label, module, name in parts:
    if module:
        owner = importlib.import_module(module)
        *classes, last = name.split(".")
        for part in classes:
            owner = getattr(owner, part)
        setattr(owner, last, timed(label, getattr(owner, last)))
sys.argv = ["exunet", *arguments]
try:
    exunet.cli.main.main()
except SystemExit:
    pass
spent["whole"] = [time.process_time(), time.perf_counter() - started[1]]
with open(out, "w") as file:
    json.dump(spent, file)
"""


def measure(folder: Path, name: str) -> dict[str, list[float]]:
    """Return processor and wall time [s] of the parts and of the whole of a row, in a process of its own."""
    (arguments, _), environment = ROWS[name], {**os.environ, "PYTHONPATH": str(folder)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "spent.json"
        if "run" in arguments:
            every = (*arguments, "--ensemble", "0", "--out", f"{place}/run")
            command = [sys.executable, "-c", CHILD, json.dumps(PARTS), str(out), *every]
        else:
            command = [
                sys.executable,
                *(("-m", "exunet", *arguments) if arguments else ("-c", SCRIPTS[name])),
            ]
        before, start = os.times(), time.perf_counter()
        subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        after, wall = os.times(), time.perf_counter() - start
        if out.is_file():
            return dict(json.loads(out.read_text()))
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return {"whole": [used, wall]}


def beside(spent: dict[str, list[float]], k: int) -> float:
    """Return the time beside the integration; k : 0 of the processor, 1 of the wall."""
    return spent["whole"][k] - spent.get("integration", [0.0, 0.0])[k]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, help="checkout of an earlier version")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", help="rows whose names contain this; writes nothing")
    asked = parser.parse_args()
    versions = {"before": asked.before.resolve()} if asked.before else {}
    versions["now"] = HERE.parent
    lines = [
        "# The command beside the integration",
        "",
        f"`python benchmarks/command.py --rounds {asked.rounds}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}. "
        "`--ensemble 0`, kernels cached, figures and report.html included. Least and median processor time, "
        "least wall time.",
        "",
        "| work | goal [s] | version | processor, least [s] | median [s] | wall, least [s] |",
        "|---|---|---|---|---|---|",
    ]
    parts = ["", "Parts, least processor time [s]; what is left is Python itself, and writing result.h5:", ""]
    header = " | ".join(label for label, _, _ in PARTS)
    parts += [f"| work | version | {header} |", f"|---|---|{'---|' * len(PARTS)}"]
    for name in [name for name in ROWS if asked.only in name]:
        found: dict[str, list[dict[str, list[float]]]] = {version: [] for version in versions}
        for turn in range(asked.rounds + 1):
            for version, folder in versions.items():
                spent = measure(folder, name)
                if turn:  # the first one fills the caches
                    found[version].append(spent)
        for version, runs in found.items():
            used, wall = ([beside(run, k) for run in runs] for k in (0, 1))
            row = f"{min(used):.2f} | {statistics.median(used):.2f} | {min(wall):.2f}"
            lines.append(f"| {name} | {ROWS[name][1]:g} | {version} | {row} |")
            if len(runs[0]) > 1:
                least = (min(run[label][0] for run in runs) for label, _, _ in PARTS)
                parts.append(f"| {name} | {version} | {' | '.join(f'{value:.2f}' for value in least)} |")
            sys.stdout.write(lines[-1] + "\n")
            sys.stdout.flush()
    sys.stdout.write("\n".join(parts) + "\n")
    if not asked.only:
        (HERE / "command.md").write_text("\n".join(lines + parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
