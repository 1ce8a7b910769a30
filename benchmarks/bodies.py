"""What bodies cost: the paper's net with ten free bodies and without, taking turns.

    python benchmarks/bodies.py [--rounds 15]

Equal steps, so that both have the same right-hand sides, and the same stored states. Wall time of the
integration over its right-hand sides; the cost of the bodies is the difference of neighbours. It is meant to
be below 5 microseconds a right-hand side in the compiled loop. Takes some two minutes and writes bodies.md.
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
from exunet.simulation import run as timeloop
from exunet.simulation.preparation import Start, prepare

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_undamped.toml"
MEANT = 5.0  # microseconds a right-hand side, in the compiled loop
EQUAL = ("solver.accuracy=", "time.output_step=0.1", "solver.method=RK44")
LOOP, COARSE = ("engine.backend=compiled",), ("engine.backend=exudyn", "solver.step=1e-4", "time.end=1.0")
RUNS = {
    "compiled loop": (*EQUAL, *LOOP, "solver.step=2e-5", "time.end=1.5"),
    "Exudyn": (*EQUAL, *COARSE, "engine.backend=exudyn"),
}


def bodies(number: int) -> str:
    """Override: so many bodies of three moments of inertia, far from the net, each turning in its own way."""
    tables = (
        f"b{k}={{mass={k + 1}.0, inertia=[1.0, 1.5, 2.0], position=[{20 * k + 50}.0, 0.0, 0.0], "
        f"velocity=[0.0, {k}.0, 1.0], angular_velocity=[0.1, {k + 1}.0, 0.2]}}"
        for k in range(number)
    )
    return f"bodies={{{', '.join(tables)}}}"


def a_right_hand_side(start: Start) -> tuple[float, int]:
    """Microseconds of one, and how many there were."""
    cost = timeloop.simulate(start).run.cost
    count = cost.right_hand_sides
    return 1e6 * cost.integration_seconds / count, count


def measured(run: tuple[str, ...], number: int, rounds: int) -> tuple[list[float], list[float], int]:
    """Microseconds a right-hand side without bodies and with them, by turns, and how many there were."""
    starts = [prepare(load(CASE, [*run, *more]).scene) for more in ((), (bodies(number),))]
    counts = {a_right_hand_side(start)[1] for start in starts}  # compiles
    if len(counts) != 1:
        sys.exit(f"not the same right-hand sides: {counts}")
    times: tuple[list[float], list[float]] = ([], [])
    for turn in range(rounds):
        for k in (0, 1) if turn % 2 == 0 else (1, 0):  # which goes first changes too
            times[k].append(a_right_hand_side(starts[k])[0])
    return *times, counts.pop()


def quartiles(values: list[float]) -> str:
    low, middle, high = statistics.quantiles(values, n=4)
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--bodies", type=int, default=10)
    asked = parser.parse_args()
    lines = [
        "# What bodies cost",
        "",
        f"`python benchmarks/bodies.py --rounds {asked.rounds} --bodies {asked.bodies}`, "
        f"{time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}. The paper's net (64 elements, undamped) with and without "
        f"{asked.bodies} free bodies, RK44 with equal steps, by turns: microseconds a right-hand side, steps "
        "and guards included; medians and, in brackets, quartiles. The cost is the difference of neighbours.",
        "",
        "| form | right-hand sides | without [µs] | with [µs] | cost of the bodies [µs] | of one body [µs] |",
        "|---|---|---|---|---|---|",
    ]
    costs = {}
    for name, run in RUNS.items():
        without, having, count = measured(run, asked.bodies, asked.rounds)
        more = [b - a for a, b in zip(without, having, strict=True)]
        costs[name] = statistics.median(more)
        one = costs[name] / asked.bodies
        cells = (name, str(count), *map(quartiles, (without, having, more)), f"{one:.2f}")
        row = f"| {' | '.join(cells)} |"
        lines.append(row)
        sys.stdout.write(row + "\n")
        sys.stdout.flush()
    found = costs["compiled loop"]
    verdict = "holds" if found < MEANT else "does NOT hold"
    lines += [
        "",
        f"Meant for ten bodies in the compiled loop is less than {MEANT:g} µs a right-hand side: with "
        f"{asked.bodies} bodies and {found:.2f} µs it {verdict}.",
        "",
        "A scene without bodies has nothing of them in its kernel, its engine or its steps: "
        "`before_after.md` compares such scenes with a version before there were any.",
    ]
    sys.stdout.write("\n".join(lines[-3:]) + "\n")
    (HERE / "bodies.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
