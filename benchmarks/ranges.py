"""What the printed ranges hold of other runs: python benchmarks/ranges.py [--runs N] [SCENE ...]

Writes benchmarks/ranges.md (without scenes): five shipped cases, and five scenes drawn at random when this
is run, one a topology. For each, the spread as a run prints it (32 perturbed runs, seed of the case), and
fresh runs with other seeds, other output steps and both back ends. A headline that is printed as a
range is covered by the part of the fresh runs whose value lies in the range. One that is printed as a value
with an error is compared with that of a converged run, of the start as it is with a hundredth of the
tolerance, or a quarter of the step, at sixteen times as many instants: it is right, or not, within that error
and half a unit of the last printed digit.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

import exunet
from exunet.net.areas import achievable_area
from exunet.results.course import course_of
from exunet.results.headlines import headlines_of
from exunet.results.judged import Judged
from exunet.scene.casefile import Case
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.rollback import finer
from exunet.simulation.run import simulate
from exunet.studies.ensemble import perturbed_positions, run_ensemble
from exunet.studies.spread import MOVE, spread_of

ROOT = Path(__file__).parent.parent
CASES = ROOT / "cases"
SHIPPED = (
    "planar_deployment",
    "planar_deployment_006",
    "planar_undamped",
    "bodies/launch",
    "nets/cut",
)
_THREAD = "density=1390.0, youngs_modulus=70e9"
DRAWN = ("square", "rectangular", "hexagonal", "radial", "outline")
SEED = 20261122  # of the scenes, and of the fresh runs
INSTANTS = 6400  # of the converged run, sixteen times those of a course
STEPS = (0.0017, 0.005, 0.0093, 0.021)  # [s] of output
IN_EXUDYN = 0.1  # part of the fresh runs; the others are compiled


@dataclass(frozen=True)
class Covered:
    """Of one headline: its words, whether it is a range, and the part of the fresh runs that it covers.

    part : of a value 1 if the converged one lies within its error, else 0
    """

    key: str
    words: str
    is_range: bool
    part: float


def scenes() -> dict[str, Case]:
    """All ten by name."""
    found = {name: exunet.load(CASES / f"{name}.toml") for name in SHIPPED}
    random = np.random.default_rng(SEED)
    for name in DRAWN:
        found[f"drawn, {name}"] = exunet.load(CASES / "planar_deployment.toml", list(_drawn(name, random)))
    return found


def _drawn(name: str, random: np.random.Generator) -> Iterator[str]:
    threads = f"cable={{diameter={random.uniform(1e-3, 3e-3):.5f}, {_THREAD}}}"
    strings = f"strings={{length={random.uniform(0.7, 1.4):.3f}, diameter=0.004, {_THREAD}}}"
    size, meshes = random.uniform(3.0, 7.0), int(random.integers(4, 8))
    mesh = f"{size / meshes!r}"
    net = {
        "square": f'topology="square", size={size!r}, mesh={mesh}',
        "rectangular": f'topology="rectangular", size=[{size!r}, {1.5 * size!r}], mesh=[{mesh}, {mesh}]',
        "hexagonal": f'topology="hexagonal", mesh={size / 8.0:.4f}, rings=2',
        "radial": f'topology="radial", radius={0.5 * size:.4f}, spokes={2 * meshes}, rings={meshes - 1}',
        "outline": f'topology="cut", outline="octagon", size={size:.4f}, mesh_shape="square", '
        f"mesh={size / 5.3:.4f}, border={{diameter=0.003, {_THREAD}}}",
    }[name]
    yield f"net={{{net}, {threads}, {strings}, bullets={{mass={random.uniform(0.2, 0.6):.3f}}}}}"
    packing, speed = random.uniform(0.08, 0.3), random.uniform(1.5, 4.0)
    yield f"initial.packing={packing:.4f}"
    yield f"launch.radial_speed={speed:.4f}"
    yield f"launch.axial_speed={random.uniform(0.0, 3.0):.4f}"
    yield f"time.end={2.0 * size / speed * (1.0 - packing) * 0.5:.3f}"


def fresh(case: Case, runs: int) -> list[dict[str, float | None]]:
    """The headlines of each of so many runs from starts of other seeds."""
    of_engine = round(IN_EXUDYN * runs)
    compiled = runs - of_engine
    found: list[dict[str, float | None]] = []
    for k, step in enumerate(STEPS):
        start = _start(case, "compiled", step)
        count = len(range(k, compiled, len(STEPS)))
        moved = perturbed_positions(start, count, MOVE, SEED + k)
        many = run_ensemble(start, moved, retries=start.scene.solver.retry)
        size = achievable_area(start.net)
        found += [headlines_of(many.course(run, size)) for run in range(len(many))]
    asked = [(case, k) for k in range(of_engine)]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found += pool.map(_by_the_engine, asked)
    return found


def _start(case: Case, backend: str, step: float) -> Start:
    times = f"time={{end={case.scene.time.end!r}, output_step={step}}}"
    changed = exunet.load(case.path, [*case.overrides, f"engine.backend={backend}", times])
    return prepare_case(changed)


def _by_the_engine(asked: tuple[Case, int]) -> dict[str, float | None]:
    case, number = asked
    start = _start(case, "exudyn", STEPS[number % len(STEPS)])
    (moved,) = perturbed_positions(start, 1, MOVE, SEED + 100 + number)
    return headlines_of(course_of(simulate(start.moved(moved, start.velocity))))


def converged(case: Case) -> dict[str, float | None]:
    """The headlines of the start as it is with a much finer setting, at many more times."""
    start = _start(case, "compiled", case.scene.time.end / INSTANTS)
    for _ in range(2):
        plan = finer(start.plan)
        start = start if plan is None else replace(start, plan=plan)
    many = run_ensemble(start, start.position[None], retries=start.scene.solver.retry)
    return headlines_of(many.course(0, achievable_area(start.net)))


def covered(one: Judged, values: list[float]) -> float:
    """The part of the values that what is printed holds."""
    last = 0.5 * 10.0 ** -_decimals(one)
    low, high = one.least, one.largest
    if one.value is not None and one.error is not None:
        low, high = one.value - one.error, one.value + one.error
    return float(np.mean([low - last <= value <= high + last for value in values]))


def _decimals(one: Judged) -> int:
    """Of the numbers as printed."""
    number = one.words().replace("median ", "").split()[0].rstrip(",")
    return len(number.partition(".")[2]) if "e" not in number else 12


def study(name: str, case: Case, runs: int) -> list[Covered]:
    begun = time.perf_counter()
    spread = replace(spread_of(prepare_case(case)), run=course_of(exunet.run(case)))
    found, right = fresh(case, runs), converged(case)
    rows = []
    for key, one in spread.judged.items():
        compared = found if not one.predictable else [right]
        values = [value for each in compared if (value := each.get(key)) is not None]
        if values:
            rows.append(Covered(key, one.words(), not one.predictable, covered(one, values)))
    _say(f"{name}: {time.perf_counter() - begun:.0f} s")
    for row in rows:
        _say(f"    {row.key}: {row.words}: {row.part:.3f}")
    return rows


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def report(found: dict[str, list[Covered]], runs: int) -> str:
    machine = f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}"
    steps = ", ".join(map(str, STEPS))
    lines = [
        "# What the printed ranges hold",
        "",
        f"`python benchmarks/ranges.py --runs {runs}`, {time.strftime('%Y-%m-%d')}, {machine}.",
        f"{runs} fresh runs a scene (seeds of their own, output steps of {steps} s, one in ten in Exudyn)",
        "against the spread that a run prints; values with an error against a converged run. Drawn scenes",
        "come from the first draw; none was left out.",
        "",
        "| scene | ranges | least part held | mean part held | values with an error | of them right |",
        "|---|---|---|---|---|---|",
    ]
    every = []
    for name, rows in found.items():
        ranges = [row.part for row in rows if row.is_range]
        values = [row.part for row in rows if not row.is_range]
        every += ranges
        numbers = f"{min(ranges):.3f} | {np.mean(ranges):.3f}" if ranges else "- | -"
        right = f"{sum(values):.0f}" if values else "-"
        lines.append(f"| {name} | {len(ranges)} | {numbers} | {len(values)} | {right} |")
    lines += [
        "",
        f"Of all {len(every)} ranges the mean is {np.mean(every):.3f}, the least {min(every):.3f}.",
        "",
    ]
    for name, rows in found.items():
        lines += [
            "",
            f"## {name}",
            "",
            "| headline | printed | part of the fresh runs held; of a value: 1 is right |",
            "|---|---|---|",
        ]
        lines += [f"| {row.key} | {row.words} | {row.part:.3f} |" for row in rows]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("scene", nargs="*")
    asked = parser.parse_args()
    every = scenes()
    found = {name: study(name, every[name], asked.runs) for name in asked.scene or every}
    if not asked.scene:
        (ROOT / "benchmarks" / "ranges.md").write_text(report(found, asked.runs), encoding="utf-8")


if __name__ == "__main__":
    main()
