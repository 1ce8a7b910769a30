"""What `exunet check` says a run will take, beside what it took: time, memory, disk, and the rest of the way.

    python benchmarks/estimates.py [--only NAME]

Each run is a process of its own, so that its memory is its own. Writes benchmarks/estimates.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from exunet.case.casefile import load
from exunet.figures import save_figures
from exunet.interfaces.commands.estimates import estimated
from exunet.simulation.pace import Pace
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import run_into

HERE = Path(__file__).parent
CASES = HERE.parent / "cases"
RUNS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("planar_deployment", ()),
    ("planar_deployment", ("engine.loop=compiled",)),
    ("planar_deployment_006", ()),
    ("planar_undamped", ("engine.net=fused",)),
    ("planar_undamped", ("solver.method=auto", "solver.accuracy=1e-2")),
    ("planar_deployment", ("net.size=10", "time.end=1.0")),
    ("planar_deployment", ("time.output_step=1e-5", "engine.loop=compiled")),
    ("hard/divided_by_10", ()),
    ("hard/every_step", ()),
    ("hard/folded", ()),
    ("hard/heavy_bullets", ()),
    ("hard/launch_250", ()),
    ("hard/mesh_1x20", ()),
    ("hard/mesh_50x50", ()),
    ("hard/mesh_50x50", ("engine.loop=compiled",)),
    ("hard/odd_times", ()),
    ("hard/packed_001", ()),
    ("hard/soft_threads", ()),
    ("hard/long_undamped", ("engine.loop=compiled",)),
    ("verification/hanging", ()),
    ("verification/free_net", ()),
    ("effects/j2", ()),
    ("capture/box", ()),
    ("capture/free_sphere", ()),
    ("capture/rocket", ()),
    ("capture/l_shape", ()),
    ("missions/throw_close_tow", ()),
)
PARTS = (0.25, 0.5, 0.75)  # of the wall time, at which the rest is foretold


def measured(name: str, overrides: tuple[str, ...]) -> dict[str, object]:
    """One run, with its estimate."""
    start = prepare_case(load(CASES / f"{name}.toml", overrides))
    cost = estimated(start, thorough=True).run
    case = load(CASES / f"{name}.toml", overrides)
    looks: list[tuple[float, float, int]] = []
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()

        def look(now: float, right_hand_sides: int) -> None:
            looks.append((time.process_time() - began, now, right_hand_sides))

        result = run_into(folder, case, start, look, None, save_figures)
        seconds = time.process_time() - began
        kept = sum(path.stat().st_size for path in Path(folder).rglob("*"))
    return {
        "seconds": cost.seconds,
        "factor": cost.factor,
        "counted": cost.counted,
        "memory": cost.memory,
        "kept": cost.kept,
        "right_hand_sides": cost.right_hand_sides,
        "measured": {
            "seconds": seconds,
            "right_hand_sides": result.provenance["right_hand_sides"],
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
            "kept": kept,
        },
        "rest": [rest(looks, part, None if cost.known is None else cost.known) for part in PARTS],
        "learned": [rest(looks, part, None) for part in PARTS],
    }


def rest(looks: list[tuple[float, float, int]], part: float, expected: float | None) -> float | None:
    """What was foretold to be left over what was, at a part of the stepping's wall time."""
    if not looks or looks[-1][0] < 0.5:  # too short to foretell anything
        return None
    whole, pace = looks[-1][0], Pace(looks[-1][1], expected)
    seen = [look for look in looks if look[0] <= part * whole]
    for one in seen:
        pace.look(*one)
    left = pace.left()
    return left.likely / (whole - seen[-1][0]) if left and left.likely > 0.0 else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cases whose name begins so; the file is not written")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one is not None:
        print(json.dumps(measured(*RUNS[asked.one])))  # noqa: T201
        return
    lines, ratios = [], []
    for number, (name, overrides) in enumerate(RUNS):
        if not name.startswith(asked.only):
            continue
        command = [sys.executable, __file__, "--one", str(number)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{name}: {done.stderr}")
        found = json.loads(done.stdout.splitlines()[-1])
        lines.append(row(name, overrides, found))
        ratios.append(found["seconds"] / found["measured"]["seconds"])
        print(lines[-1], flush=True)  # noqa: T201
    if not asked.only:
        write(lines, ratios)


def row(name: str, overrides: tuple[str, ...], found: dict[str, object]) -> str:
    real = found["measured"]
    rests = [
        " ".join("-" if one is None else f"{one:.2g}" for one in found[key]) for key in ("rest", "learned")
    ]
    cells = (
        " ".join((name, *overrides)),
        found["counted"],
        f"{found['right_hand_sides']:.2g}",
        f"{real['right_hand_sides']:.2g}",
        f"{found['seconds']:.2g}",
        f"{real['seconds']:.2g}",
        f"{found['seconds'] / real['seconds']:.2g}",
        f"{found['factor']:.3g}",
        f"{found['memory'] / 1e6:.0f}",
        f"{real['memory'] / 1e6:.0f}",
        f"{found['kept'] / 1e6:.2g}",
        f"{real['kept'] / 1e6:.2g}",
        *rests,
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def write(lines: list[str], ratios: list[float]) -> None:
    heads = (
        "case", "counted", "RHS est.", "RHS", "s est.", "s", "ratio", "factor", "MB est.", "MB",
        "disk MB est.", "disk MB", "rest told", "rest learned",
    )  # fmt: skip
    text = [
        "# What a run takes: estimated and measured",
        "",
        f"`python benchmarks/estimates.py` on {platform.platform()}, {os.cpu_count()} shared cores.",
        "The estimate is that of `exunet check`. The measured time goes from the first step to the last",
        "figure; it is processor time, since other programs ran beside: wall time on an idle machine.",
        "*RHS* are right-hand sides; *factor* is the uncertainty that the estimate states; memory and",
        "disk are bounds. *rest*: the time foretold to be left over what was left, at a quarter, half",
        "and three quarters of the stepping; *told* with the number of right-hand sides that the",
        "estimate counted, *learned* from the pace alone (what is likely of the range that the run prints).",
        "",
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *lines,
        "",
        f"Estimated over measured time: {min(ratios):.2g} to {max(ratios):.2g}, median "
        f"{sorted(ratios)[len(ratios) // 2]:.2g}.",
    ]
    (HERE / "estimates.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
