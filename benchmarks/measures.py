"""Tests what "auto" does for metrics, without solver.accuracy: python benchmarks/measures.py [SCENE ...]

Writes benchmarks/measures.md (without arguments). For sixteen deployments whose end lies beyond the horizon
of predictability, the shift of the median of each deployment measure against tight runs, with its 90 %
bootstrap interval. The two one-sided tests at 5 % show equivalence where that lies within a third of the
tight runs' range. For ten scenes with contact and reels, the metrics whose medians differ significantly from
those with steps four times shorter, by what matters in `exunet cost`.
tests/unit/test_settings_of_measures.py repeats three of the scenes.
"""

from __future__ import annotations

import os
import platform
import sys
import time
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.scene.casefile import Case
from exunet.simulation.preparation import Start, prepare
from exunet.studies.ensemble import (
    OF_FIXED_STEPS,
    perturbation_for_medians,
    perturbed_bodies_of,
    perturbed_positions,
    run_ensemble,
    start_of_runs,
)
from exunet.studies.samples import CHANCE, PART, compare

Floats = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
UNDAMPED, DAMPED = "planar_undamped", "planar_deployment"
_THREAD = "density=1390.0, youngs_modulus=70e9"
_THREADS = f"cable={{diameter=0.002, {_THREAD}}}, strings={{length=1.0, diameter=0.004, {_THREAD}}}"
_RESAMPLES, _LEVEL, _SEED = 2000, 0.05, 0


@dataclass(frozen=True)
class Shift:
    """Of the median of a quantity, over the range of the finest runs; low, high: its 90 % interval."""

    shift: float
    low: float
    high: float

    @property
    def shown(self) -> bool:
        """Equivalence by two one-sided tests at 5 %: the interval lies within PART of the range."""
        return max(abs(self.low), abs(self.high)) < PART


def shift_of(finest: Floats, other: Floats, least: float) -> Shift | None:
    """How far the median is moved, by bootstrap; None if the finest runs differ by `least` only."""
    width = float(np.ptp(finest))
    if width <= least:
        return None
    draw = np.random.default_rng(_SEED)
    a, b = (
        np.median(values[draw.integers(0, len(values), (_RESAMPLES, len(values)))], axis=1)
        for values in (finest, other)
    )
    low, high = np.quantile((b - a) / width, (_LEVEL, 1.0 - _LEVEL))
    return Shift(float(np.median(other) - np.median(finest)) / width, float(low), float(high))


def _hexagonal(mesh: float, rings: int) -> str:
    return f'net={{topology="hexagonal", mesh={mesh}, rings={rings}, {_THREADS}, bullets={{mass=0.5}}}}'


def _radial(radius: float, spokes: int, rings: int) -> str:
    numbers = f"radius={radius}, spokes={spokes}, rings={rings}"
    return f'net={{topology="radial", {numbers}, {_THREADS}, bullets={{mass=0.3}}}}'


_SOFT = ("net.cable.youngs_modulus=1e9", "net.strings.youngs_modulus=1e9")
_RECTANGLE = ('net.topology="rectangular"', "net.size=[4.0, 6.0]", "net.mesh=[1.0, 1.0]")
# name: (case, changes)
SCENES: dict[str, tuple[str, tuple[str, ...]]] = {
    "paper's net": (DAMPED, ()),
    "paper's net, packing 0.06": ("planar_deployment_006", ()),
    "undamped": (UNDAMPED, ()),
    "thrown forward, 52 deg": (UNDAMPED, ("launch.axial_speed=2.0",)),
    "thrown forward, 32 deg": (DAMPED, ("launch.axial_speed=4.0", "time.end=2.5")),
    "gravity": (UNDAMPED, ("launch.axial_speed=4.0", "effects.gravity.acceleration=[0.5, 0.0, -1.0]")),
    "rectangular": (UNDAMPED, (*_RECTANGLE, "launch.axial_speed=1.0", "time.end=2.5")),
    "hexagonal, 84": (DAMPED, (_hexagonal(0.7, 2), "time.end=2.5")),
    "radial": (UNDAMPED, (_radial(3.0, 8, 4), "launch.axial_speed=1.5")),
    "divided threads": (UNDAMPED, ("net.mesh=1.25", "net.divisions=2", "launch.axial_speed=1.0")),
    "small and fast": (
        UNDAMPED,
        ("net.size=2.5", "net.mesh=0.5", "net.strings.length=0.7", "launch.radial_speed=5.0", "time.end=0.8"),
    ),
    "soft threads": (UNDAMPED, (*_SOFT, "launch.axial_speed=1.0")),
    "damped": (
        DAMPED,
        (
            "effects.rayleigh_damping.alpha=0.1",
            "effects.rayleigh_damping.beta=1e-6",
            "launch.axial_speed=1.0",
        ),
    ),
    "viscous threads": (
        UNDAMPED,
        ("effects.material_damping.relaxation_time=1e-6", "launch.axial_speed=1.0"),
    ),
    "square, 368": (DAMPED, (f"net.mesh={5 / 13!r}", "launch.radial_speed=8.0", "time.end=0.7")),
    "hexagonal, 318": (DAMPED, (_hexagonal(0.4, 5), "launch.radial_speed=8.0", "time.end=0.8")),
}
# (case, changes) of scenes with contact, reels, closing lines and scripts
CAPTURES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("capture/miss", ()),
    ("capture/l_shape", ()),
    ("capture/free_sphere", ("time.end=0.6",)),
    ("capture/fixed_sphere", ("time.end=0.6",)),
    ("capture/box", ("time.end=0.6",)),
    ("missions/cut_tether", ()),
    ("missions/closed_box", ()),
    ("missions/open_box", ()),
    ("missions/throw_close_tow", ()),
    ("bodies/tow", ("time.end=4.0",)),
)
FINER, CAPTURE_RUNS = 4.0, 8
RUNS, RUNS_OF_LARGE, LARGE = 256, 48, 300  # elements from which a net is large
MEASURES = ("largest_area", "time_of_largest_area", "distance", "time_above_80_percent")
SEED = 0  # of the moves
REPEATS = 3  # of runs that are timed


@dataclass(frozen=True)
class Found:
    """Of one scene; shifts: None where the tight runs do not differ, as before the horizon.

    tight, cheap : processor time of a run to accuracy 1e-2 of the trajectory, and for measures [s]
    """

    elements: int
    runs: int
    method: str
    setting: str
    tight: float
    cheap: float
    shifts: dict[str, Shift | None]

    @property
    def ratio(self) -> float:
        """How many times less a run for measures takes."""
        return self.tight / self.cheap

    @property
    def shown(self) -> bool:
        """No measure is shifted."""
        return all(one is None or one.shown for one in self.shifts.values())


def case_of(name: str, solver: str) -> Case:
    """The case of a scene with the keys of [solver]."""
    case, changes = SCENES[name]
    instants = ("time.output_step=", "time.output_times=[]")
    return exunet.load(ROOT / "cases" / f"{case}.toml", [f"solver={solver}", *changes, *instants])


def starts_of(name: str) -> tuple[Start, Start]:
    """The starts of runs to accuracy 1e-2 of the trajectory, and for measures."""
    tight, cheap = (
        start_of_runs(prepare(case_of(name, solver).scene)) for solver in ("{accuracy=1e-2}", "{}")
    )
    return tight, cheap


def measures_of(start: Start, runs: int, move: float, *, first: int = 0) -> dict[str, Floats]:
    """(runs,) of each measure, from runs that are perturbed by up to a distance [m]."""
    position = perturbed_positions(start, runs, move, SEED, first=first)
    found = run_ensemble(start, position, retries=start.scene.solver.retry)
    return {metric.name: found.metrics[key] for key, metric in found.about.items() if metric.name in MEASURES}


def seconds(start: Start, repeats: int) -> float:
    """Least processor time of a run [s], which others on the machine hardly change; all is compiled."""
    found = []
    for _ in range(repeats):
        began = time.process_time()
        run_ensemble(start, start.position[None], workers=1)
        found.append(time.process_time() - began)
    return min(found)


def study(name: str, runs: int | None = None) -> Found:
    """Run a scene in both ways; the cheap runs are moved otherwise than the tight ones."""
    tight, cheap = starts_of(name)
    large = tight.net.n_elements >= LARGE
    number = runs or (RUNS_OF_LARGE if large else RUNS)
    move = perturbation_for_medians(cheap)
    ours, theirs = measures_of(tight, number, move), measures_of(cheap, max(number, RUNS), move, first=number)
    shifts = {key: shift_of(ours[key], theirs[key], 1e-8) for key in MEASURES}
    plan = cheap.plan
    setting = f"{plan.step:.3g} s" if plan.step else f"tolerance {plan.tolerance:.2g}"
    return Found(
        elements=tight.net.n_elements,
        runs=number,
        method=plan.method.value,
        setting=setting,
        tight=seconds(tight, 1 if large else REPEATS),
        cheap=seconds(cheap, REPEATS),
        shifts=shifts,
    )


def row_of(name: str, found: Found) -> str:
    """A line of the table."""
    cells = [
        "not spread" if one is None else f"{one.shift:+.2f} ({one.low:+.2f} to {one.high:+.2f})"
        for one in found.shifts.values()
    ]
    front = f"{name} | {found.elements} | {found.runs} | {found.method}, {found.setting}"
    times = f"{found.tight:.3g} | {found.cheap:.3g} | {found.ratio:.1f}"
    return f"| {front} | {times} | {' | '.join(cells)} | {'yes' if found.shown else 'no'} |"


def capture_row(name: str, changes: tuple[str, ...]) -> str:
    """A line of the table of captures: metrics whose medians are shifted."""
    table = tomllib.loads((ROOT / "cases" / f"{name}.toml").read_text(encoding="utf-8"))
    removed = ["solver="] if "solver" in table else []
    start = start_of_runs(prepare(exunet.load(ROOT / "cases" / f"{name}.toml", [*removed, *changes]).scene))
    assert start.plan.step is not None
    fine = replace(start, plan=replace(start.plan, step=start.plan.step / FINER))
    move, found = perturbation_for_medians(start), []
    for number, one in enumerate((start, fine)):
        first = number * CAPTURE_RUNS
        position = perturbed_positions(one, CAPTURE_RUNS, move, SEED, first=first)
        bodies = perturbed_bodies_of(one, CAPTURE_RUNS, move, SEED, first=first)
        found.append(run_ensemble(one, position, bodies=bodies, retries=one.scene.solver.retry))
    ours, theirs = found
    shared = [key for key in theirs.about if key in ours.about]
    level, shifted = CHANCE / max(1, len(shared)), []
    for key in shared:
        shift = compare(theirs.about[key], ours.metrics[key], theirs.metrics[key], level=level)
        if shift.significant and shift.matters:
            shifted.append(theirs.about[key].name)
    cells = (name, " ".join(changes), str(start.net.n_elements), f"{start.plan.step:.3g} s", str(len(shared)))
    return f"| {' | '.join(cells)} | {', '.join(shifted) or 'none'} |"


def main(names: list[str]) -> None:
    stamp = (
        f"{time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, exunet {exunet.__version__}"
    )
    lines = [
        "# What the setting for measures does",
        "",
        f"`python benchmarks/measures.py`, {stamp}",
        "",
        "Runs without `solver.accuracy` beside runs with `solver.accuracy = 1e-2`, in the compiled loop, "
        f"both from starts perturbed by up to {OF_FIXED_STEPS:g} of the net's size: more "
        "than the errors that runs of one method share. Shift of the median over the range of the tight "
        f"runs, with its 90 % bootstrap interval; {RUNS} runs at least for measures. Shown: all intervals "
        "lie within a third of the range (two one-sided tests at 5 %). Not spread: the tight runs agree. "
        "Seconds of processor time of one run, from the start as it is.",
        "",
        "| scene | elements | tight runs | for measures | s, tight | s | ratio | largest area | its time "
        "| distance | above 80 % | shown |",
        "|" + "---|" * 12,
    ]
    for name in names or SCENES:
        lines.append(row_of(name, study(name)))
        sys.stdout.write(lines[-1] + "\n")
        sys.stdout.flush()
    lines += [
        "",
        f"Scenes with contact and reels: {CAPTURE_RUNS} runs, beside {CAPTURE_RUNS} with steps "
        f"{FINER:g} times shorter.",
        "",
        "| case | changes | elements | step | metrics | shifted medians |",
        "|" + "---|" * 6,
    ]
    for name, changes in CAPTURES:
        lines.append(capture_row(name, changes))
        sys.stdout.write(lines[-1] + "\n")
        sys.stdout.flush()
    lines += ["", "The scenes:", ""]
    lines += [f"- {name}: `{' '.join((case, *changes))}`" for name, (case, changes) in SCENES.items()]
    if not names:
        (ROOT / "benchmarks" / "measures.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
