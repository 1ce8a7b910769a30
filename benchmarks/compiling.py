"""Compile the forces of a scene on an empty kernel cache: python benchmarks/compiling.py [--before FOLDER]

    [--rounds 3]

FOLDER is a checkout of an earlier version, measured by turns with this one. In each round `exunet run` is
called on an empty cache, once more on the same cache, and the planar case on the cache of the mission: the
first and the third less the second is what compiling takes. Processor time of the whole command. Then one run
of each version counts functions and divides the time among Numba's stages. Writes compiling.md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent
SCENES = {
    "throw_close_tow": ("missions/throw_close_tow.toml",),
    "planar case, compiled": ("planar_deployment.toml", "--backend", "compiled"),
}
STAGES = {
    "inference": "types",
    "lowering": "lowering to LLVM",
    "run": "LLVM's optimisation",
    "_finalize_final_module": "machine code",
    "add_ir_module": "LLVM's text read",
}
REST = "bytecode, names, cache"


def run(folder: Path, cache: Path, scene: str, script: tuple[str, ...] = ("-m", "exunet")) -> float:
    """Processor time [s] of a run of a scene."""
    case, *options = SCENES[scene]
    with tempfile.TemporaryDirectory() as out:
        place = str(folder / "cases" / case), *options, "--ensemble", "0", "--out", f"{out}/result"
        before = os.times()
        subprocess.run(
            [sys.executable, *script, "run", *place],
            cwd=folder,  # which comes before PYTHONPATH
            env={**os.environ, "PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(cache)},
            check=True,
            capture_output=script[0] == "-m",
        )
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def compiling(folder: Path) -> dict[str, float]:
    """Processor time [s] that compiling takes, by scene."""
    found = {}
    mission, planar = SCENES
    for scene in SCENES:
        with tempfile.TemporaryDirectory() as cache:
            empty, filled = (run(folder, Path(cache), scene) for _ in range(2))
            found[scene] = empty - filled
            if scene == mission:
                after_mission = run(folder, Path(cache), planar)
    found[f"{planar}, after {mission}"] = after_mission - filled
    return found


def listen() -> None:
    """Run `exunet` with the remaining arguments; print functions and processor time by stage."""
    from llvmlite.binding import newpassmanagers
    from numba.core import codegen, event

    used: Counter[str] = Counter()
    functions = 0
    open_stages: list[list[float]] = []

    def begin() -> None:
        open_stages.append([time.process_time(), 0.0])

    def end(name: str) -> None:
        began, inside = open_stages.pop()
        whole = time.process_time() - began
        used[next((stage for part, stage in STAGES.items() if part in name), REST)] += whole - inside
        if open_stages:
            open_stages[-1][1] += whole

    class Listener(event.Listener):
        def on_start(self, event: event.Event) -> None:
            begin()

        def on_end(self, event: event.Event) -> None:
            nonlocal functions
            functions += "name" not in event.data
            end(event.data["name"].split()[0] if "name" in event.data else "")

    for kind in ("numba:compile", "numba:run_pass"):
        event.register(kind, Listener())

    def timed(owner: type, name: str) -> None:
        method = getattr(owner, name)

        def measured(library: object, *given: object) -> object:
            begin()
            try:
                return method(library, *given)
            finally:
                end(name)

        setattr(owner, name, measured)

    for owner, name in (
        (newpassmanagers.FunctionPassManager, "run"),
        (newpassmanagers.ModulePassManager, "run"),
        (codegen.CPUCodeLibrary, "_finalize_final_module"),
        (codegen.CPUCodeLibrary, "add_ir_module"),
    ):
        timed(owner, name)
    from exunet.__main__ import main as command

    sys.argv[:] = ["exunet", *sys.argv[2:]]
    output, sys.stdout = sys.stdout, sys.stderr
    with contextlib.suppress(SystemExit):
        command()
    json.dump({"functions": functions, **used}, output)


def stages(folder: Path, scene: str) -> dict[str, float]:
    """Functions compiled for a scene, and processor time by stage [s]."""
    case, *options = SCENES[scene]
    with tempfile.TemporaryDirectory() as work:
        place = str(folder / "cases" / case), *options, "--ensemble", "0", "--out", f"{work}/result"
        done = subprocess.run(
            [sys.executable, __file__, "--listen", "run", *place],
            env={**os.environ, "PYTHONPATH": str(folder), "XDG_CACHE_HOME": work},
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
    return dict(json.loads(done.stdout))


def main() -> None:
    if sys.argv[1:2] == ["--listen"]:
        listen()
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    folders = [folder for folder in (given.before, HERE.parent) if folder is not None]
    names, load = ["before", "after"][-len(folders) :], os.getloadavg()[0]
    rounds = [[compiling(folder) for folder in folders] for _ in range(given.rounds)]
    head = f" {' | '.join(f'{name} [s]' for name in names)} |", "---|" * len(folders)
    lines = [f"| scene |{head[0]}", f"|---|{head[1]}"]
    for scene in rounds[0][0]:
        cells = []
        for number in range(len(folders)):
            times = [each[number][scene] for each in rounds]
            cells.append(f"{statistics.median(times):.1f} ({min(times):.1f} to {max(times):.1f})")
        lines.append(f"| {scene} | {' | '.join(cells)} |")
    for scene in SCENES:
        parts = [stages(folder, scene) for folder in folders]
        lines += ["", f"| {scene} |{head[0]}", f"|---|{head[1]}"]
        for name in ("functions", *dict.fromkeys(STAGES.values()), REST):
            form = ".0f" if name == "functions" else ".1f"
            lines.append(f"| {name} | {' | '.join(format(part[name], form) for part in parts)} |")
    page = HERE / "compiling.md"
    notes = page.read_text().partition("## Tried")[2] if page.exists() else "\n"
    command = f"`python benchmarks/compiling.py --rounds {given.rounds}`"
    version = subprocess.run(
        ["git", "-C", folders[0], "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    page.write_text(
        f"# Compiling on an empty kernel cache\n\n{command}"
        f"{f', before: a checkout of commit {version}' if given.before else ''}, "
        f"{time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, load average {load:.1f} before and {os.getloadavg()[0]:.1f} after. "
        "Processor time of `exunet run --ensemble 0` on an empty cache less that on the filled one: median "
        "and range. Below, one run by stage; `functions`: of kernels and those of Numba that they call.\n\n"
        + "\n".join(lines)
        + f"\n\n## Tried{notes}"
    )


if __name__ == "__main__":
    main()
