"""Tests the setting of solver.accuracy_of = "measures": python benchmarks/measures.py [SCENE ...]

Writes benchmarks/measures.md (without arguments): for sixteen scenes whose end lies beyond the horizon of
predictability, the shift of the median of each deployment measure against tight runs, with its 90 %
bootstrap interval. The two one-sided tests at 5 % show equivalence where that lies within a third of the
tight runs' range.
tests/unit/test_settings_of_measures.py repeats three of the scenes.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.scene.casefile import Case
from exunet.simulation.auto import measure_settings, perturbation
from exunet.simulation.preparation import Start, prepare
from exunet.studies.ensemble import run_ensemble, start_of_runs
from exunet.studies.perturbation import perturbed_positions
from exunet.studies.samples import Shift, shift_of

Floats = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
UNDAMPED, DAMPED = "planar_undamped", "planar_deployment"
_THREAD = "density=1390.0, youngs_modulus=70e9"
_THREADS = f"cable={{diameter=0.002, {_THREAD}}}, strings={{length=1.0, diameter=0.004, {_THREAD}}}"


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
RUNS, RUNS_OF_LARGE, LARGE = 256, 48, 300  # elements from which a net is large
MEASURES = ("largest_area", "time_of_largest_area", "distance", "time_above_80_percent")
SEED = 0  # of the moves
REPEATS = 3  # of runs that are timed


@dataclass(frozen=True)
class Found:
    """Of one scene; shifts: None where the tight runs do not differ, as before the horizon.

    tight, cheap : processor time of a run to accuracy 1e-4 of the trajectory, and for measures [s]
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


def case_of(name: str) -> Case:
    """The case of a scene, at accuracy 1e-4 of the trajectory."""
    case, changes = SCENES[name]
    instants = ("time.output_step=", "time.output_times=[]")
    return exunet.load(ROOT / "cases" / f"{case}.toml", ["solver=", *changes, *instants])


def starts_of(name: str) -> tuple[Start, Start]:
    """The starts of runs to accuracy 1e-4 of the trajectory, and for measures."""
    scene = case_of(name).scene
    solver = scene.solver.model_copy(update={"accuracy_of": "measures"})
    both = (scene, scene.model_copy(update={"solver": solver}))
    tight, cheap = (start_of_runs(prepare(one)) for one in both)
    return tight, cheap


def measures_of(start: Start, runs: int, *, first: int = 0) -> dict[str, Floats]:
    """(runs,) of each measure, from perturbed runs."""
    position = perturbed_positions(start, runs, perturbation(start.net), SEED, first=first)
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
    ours, theirs = measures_of(tight, number), measures_of(cheap, max(number, RUNS), first=number)
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
        'Runs with `solver.accuracy_of = "measures"` beside runs to accuracy 1e-4 of the trajectory, in the '
        f"compiled loop, both from starts moved by up to {measure_settings().move:g} of the net's size: more "
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
    lines += ["", "The scenes:", ""]
    lines += [f"- {name}: `{' '.join((case, *changes))}`" for name, (case, changes) in SCENES.items()]
    if not names:
        (ROOT / "benchmarks" / "measures.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
