"""A step of the compiled loop in flight, with what may happen in it: python benchmarks/steps_in_flight.py

    [--before FOLDER] [--rounds 9]

FOLDER is a checkout of an earlier version, which is measured by turns with this one, each in a process of its
own. Rows are variants of cases/missions/capture_satellite.toml (470 nodes, 869 elements) before it touches,
and a net of 20 x 20 meshes that may break. In each round the same window of flight is repeated from a
snapshot; processor time over steps. Writes steps_in_flight.md.
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
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).parent
SATELLITE = "missions/capture_satellite.toml"
VERLET = "solver.method=VelocityVerlet", "solver.step=1e-5"
WITHOUT_REEL = 'tethers.tow={length=25.0, divisions=25, diameter=0.002, density=970.0, youngs_modulus=70e9, \
start={body="chaser", point=[0,0,0.5]}, end={node=224}}'
WAITING = 'script=[{name="touch", when="first_contact", do="note"}]'
MESHES = "capture/box.toml", "solver.method=RK44", "solver.step=1.5e-4", "time.end=0.1"
ROWS: Mapping[str, tuple[str, ...]] = {
    "no reel, no script": (SATELLITE, *VERLET, WITHOUT_REEL, "script=[]"),
    "no reel, script waits": (SATELLITE, *VERLET, WITHOUT_REEL, WAITING),
    "reel locked, script waits": (SATELLITE, *VERLET, WAITING),
    "reel pays out at 6.5 m/s, script waits": (SATELLITE, *VERLET),
    "20 x 20 meshes, RK44": MESHES,
    "20 x 20 meshes, RK44, elements may break": (*MESHES, "effects.breaking.strain=0.5"),
}
WINDOWS = {SATELLITE: (0.2, 0.5, 0.05), MESHES[0]: (0.01, 0.07, 0.02)}  # begin, end, output step [s]


def measure(case: str, overrides: list[str]) -> None:
    """Print the processor time of a step [us] for each line of the input."""
    import exunet
    from exunet.simulation.preparation import prepare
    from exunet.simulation.simulation import Simulation

    scene = exunet.load(HERE.parent / "cases" / case, ["engine.backend=compiled", *overrides]).scene
    simulation, (begin, end, output) = Simulation(prepare(scene)), WINDOWS[case]
    simulation.advance_to(begin)
    start = simulation.snapshot()
    for _ in sys.stdin:
        simulation.restore(start)
        before, began = simulation.counts.steps, time.process_time()
        while simulation.time < end:
            simulation.advance_to(min(simulation.time + output, end))
        used = time.process_time() - began
        sys.stdout.write(json.dumps(1e6 * used / (simulation.counts.steps - before)) + "\n")
        sys.stdout.flush()


def process(folder: Path, row: str) -> subprocess.Popen[str]:
    """A process of a version, which measures when it gets a line."""
    case, *overrides = ROWS[row]
    return subprocess.Popen(
        [sys.executable, __file__, "--measure", case, *overrides],
        env={**os.environ, "PYTHONPATH": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def once(version: subprocess.Popen[str]) -> float:
    """Processor time of a step [us] in the next round."""
    assert version.stdin is not None
    assert version.stdout is not None
    version.stdin.write("\n")
    version.stdin.flush()
    return float(json.loads(version.stdout.readline()))


def words(times: list[float]) -> str:
    """Median and range."""
    return f"{statistics.median(times):.1f} ({min(times):.1f} to {max(times):.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--measure", nargs="+")
    given = parser.parse_args()
    if given.measure:
        measure(given.measure[0], given.measure[1:])
        return
    folders, load = [HERE.parent], os.getloadavg()[0]
    if given.before is not None:
        folders.insert(0, given.before)
    table = []
    for row in ROWS:
        versions = [process(folder, row) for folder in folders]
        for version in versions:
            once(version)  # fills the caches
        rounds = [[once(version) for version in versions] for _ in range(given.rounds)]
        for version in versions:
            version.communicate()
        table.append(f"| {row} | {' | '.join(words(list(times)) for times in zip(*rounds, strict=True))} |")
        sys.stdout.write(table[-1] + "\n")
        sys.stdout.flush()
    names = [name for name, _ in zip(("after", "before"), folders, strict=False)][::-1]
    page = (
        "# A step in flight",
        "",
        f"`python benchmarks/steps_in_flight.py --rounds {given.rounds}`"
        f"{', before: a checkout of commit 358f934e' if given.before else ''}, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}, load average "
        f"{load:.1f} before and {os.getloadavg()[0]:.1f} after. Processor time of a step [us], median and "
        "range of the rounds; versions by turns. `capture_satellite.toml` by velocity Verlet with 1e-5 s "
        "from 0.2 to 0.5 s, with two nodes that come off the drum where the reel pays out; the net of "
        "`capture/box.toml` by RK44 with 1.5e-4 s from 0.01 to 0.07 s.",
        "",
        f"| in flight | {' | '.join(f'{name} [us]' for name in names)} |",
        f"|---|{'---|' * len(names)}",
        *table,
    )
    (HERE / "steps_in_flight.md").write_text("\n".join(page) + "\n")


if __name__ == "__main__":
    main()
