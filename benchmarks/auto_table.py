"""Measures the table from which solver.method = "auto" chooses: python benchmarks/auto_table.py [--seconds]

Writes exunet/simulation/auto_table.toml and benchmarks/auto_table.md; with --seconds only the times of runs.
Errors are those of bullet speeds at the end of a run, relative to the launch speed, against the converged
solution of `exunet cost`.
tests/physics/test_methods.py checks the promise on other scenes than these.
"""

from __future__ import annotations

import os
import platform
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import exunet
from exunet.base.files import replacing
from exunet.methods.config import Solver
from exunet.methods.method import METHODS as FACTS
from exunet.methods.method import Backend, Method
from exunet.model.stability import largest_frequency
from exunet.scene.scene import Engine, Scene
from exunet.simulation.auto import NEARLY_DEPLOYED
from exunet.simulation.preparation import prepare
from exunet.studies.both_codes import both_of
from exunet.studies.cost.runs import Subject, run
from exunet.studies.cost.settings import Setting, setting_of
from exunet.studies.cost.study import Converged, converge

ROOT = Path(__file__).parent.parent
PLANAR = ROOT / "cases" / "planar_undamped.toml"
DAMPED = ROOT / "cases" / "planar_deployment.toml"
OUT_OF_PLANE = ("launch.axial_speed=4.0",)
Scenes = tuple[tuple[Path, tuple[str, ...], tuple[float, ...]], ...]
# (case, overrides, ends): before each scene's horizon of predictability
FOLDED: Scenes = (
    (PLANAR, (), (0.9, 1.2, 1.3, 1.5)),
    (DAMPED, (), (0.9, 1.3)),
    (PLANAR, ("initial.packing=0.2",), (0.5, 0.9)),
    (PLANAR, ("net.mesh=0.5",), (0.7,)),
    (PLANAR, (*OUT_OF_PLANE, "effects.gravity.acceleration=[0.5, 0.0, -1.0]"), (0.6, 0.9)),
    (PLANAR, ("launch.radial_speed=10.0",), (0.2, 0.3)),
    (PLANAR, ("launch.radial_speed=1.5",), (2.2,)),
    (PLANAR, ("net.divisions=2",), (0.6,)),
    (PLANAR, ("net.cable.youngs_modulus=1e9", "net.strings.youngs_modulus=1e9"), (0.6, 1.0)),
    (PLANAR, ("initial.packing=0.5",), (0.8,)),
    (PLANAR, ("initial.packing=0.7",), (0.5,)),
)
# From packing NEARLY_DEPLOYED on: all threads snap within a tenth of a second, and errors grow from then.
DEPLOYED: Scenes = (
    (PLANAR, ("initial.packing=0.9",), (0.15, 0.2, 0.25)),
    (PLANAR, ("initial.packing=0.95",), (0.2,)),
    (PLANAR, ("initial.packing=0.99",), (0.2, 0.24)),
)
TOLERANCES = tuple(10.0**-k for k in np.arange(4.0, 11.5, 0.5))
ACCURACIES = tuple(10.0**-k for k in range(1, 9))
METHODS = ("DOPRI5", "ODE23")  # adaptive; `exunet cost` found no fixed step cheaper
LEAST = {"DOPRI5": 1e-11, "ODE23": 9e-10}  # a method of order 3 is dear below
STORED = (1, 30, 111, 400)
MARGIN = 3.0  # the requested accuracy over the worst error measured
MESHES = (1, 2, 3, 5, 10, 20, 40)
# Uncertainty of the converged solution up to which a scene counts: not close to its horizon, from which a
# nearly deployed start is never far.
CERTAIN = {"folded": 5e-8, "nearly_deployed": 1e-6}
# An error counts if it is this many times the uncertainty of the converged solution; of nearly deployed
# starts, where few would, all count, as the uncertainty at least.
RESOLVED = {"folded": 10.0, "nearly_deployed": 0.0}
TITLES = {
    "folded": f"Folded starts, packing below {NEARLY_DEPLOYED:g}",
    "nearly_deployed": f"Nearly deployed starts, packing {NEARLY_DEPLOYED:g} and above",
}
ENOUGH, LONG = 10_000, 2.0  # right-hand sides, or seconds, over which one of a run is measured
STIFF = ("effects.rayleigh_damping.beta=1e-3", "time.end=0.8")
IMPLICIT_STEPS = (1e-2, 1e-3, 1e-4)


def say(words: str) -> None:
    """A line of progress."""
    sys.stdout.write(words + "\n")
    sys.stdout.flush()


@dataclass
class Found:
    """Of one method, by tolerance: errors over scenes and numbers of stored states, all right-hand sides."""

    errors: dict[float, list[float]]
    work: dict[float, int]

    @classmethod
    def of(cls, method: str) -> Found:
        """Nothing yet, for the tolerances of a method."""
        tolerances = [t for t in TOLERANCES if t > 0.9 * LEAST[method]]
        return cls({t: [] for t in tolerances}, dict.fromkeys(tolerances, 0))

    def tolerance(self, accuracy: float) -> float | None:
        """The largest tolerance at and below which MARGIN x the worst error is within the accuracy."""
        good = None
        for tolerance in sorted(self.errors):
            if MARGIN * max(self.errors[tolerance], default=0.0) > accuracy:
                break
            good = tolerance
        return good


def errors(words: list[str], kind: str, scenes: Scenes) -> dict[str, Found]:
    """What the methods did on all scenes of a kind."""
    found = {method: Found.of(method) for method in METHODS}
    head = " | ".join(f"{tolerance:.0e}" for tolerance in TOLERANCES)
    words += ["", f"## {TITLES[kind]}", ""]
    words += [f"| scene | to [s] | uncertainty | method | {head} |", "|---" * (len(TOLERANCES) + 4) + "|"]
    for path, overrides, ends in scenes:
        case = exunet.load(path, overrides)
        for end in ends:
            subject = Subject.of(case, (0.0, end), both_of(case))
            converged = converge(subject)
            scene = f"| `{' '.join((path.stem, *overrides))}` | {end:g} | {converged.uncertainty:.0e} "
            for method, kept in found.items():
                counts = converged.uncertainty < CERTAIN[kind]
                least = RESOLVED[kind] * converged.uncertainty if counts else np.inf
                row = [_worst(subject, converged, method, t, kept, least) for t in kept.work]
                words.append(f"{scene}| {method} | {' | '.join(f'{worst:.0e}' for worst in row)} |")
                say(words[-1])
    words += [
        "",
        "Right-hand sides over all scenes:",
        "",
        f"| | {head} |",
        "|---" * (len(TOLERANCES) + 1) + "|",
    ]
    for method, kept in found.items():
        words.append(f"| {method} | {' | '.join(map(str, kept.work.values()))} |")
    return found


def _worst(
    subject: Subject, converged: Converged, method: str, tolerance: float, kept: Found, least: float
) -> float:
    offs = []
    for stored in STORED:
        off, work = _error(
            subject,
            converged,
            setting_of(Backend.EXUDYN, Method(method), tolerance=tolerance * subject.speed),
            stored,
        )
        offs.append(off)
        kept.work[tolerance] += work
    kept.errors[tolerance] += [max(off, converged.uncertainty) for off in offs if off > least]
    return max(offs)


def _error(subject: Subject, converged: Converged, setting: Setting, stored: int) -> tuple[float, int]:
    """Speed error at the end of a run that stores so many states (they shorten steps), right-hand sides."""
    times = tuple(np.linspace(0.0, subject.end, stored + 1).tolist())
    try:
        found = run(subject.at(times), setting)
    except exunet.RunStopped:  # by a guard: far too loose
        return float("inf"), 0
    off = float(np.abs(found.tracked[-1] - converged.speeds).max()) / subject.speed
    return off, found.work.right_hand_sides


def stiff(words: list[str]) -> None:
    """An explicit and the implicit methods under stiff damping."""
    case = exunet.load(DAMPED, STIFF)
    subject = Subject.of(case, (0.0, case.scene.time.end))
    settings = [setting_of(Backend.EXUDYN, Method.DOPRI5, tolerance=1e-6 * subject.speed)]
    for method in (Method.TRAPEZOIDAL_INDEX2, Method.GENERALIZED_ALPHA):
        settings += [setting_of(Backend.EXUDYN, method, step=step) for step in IMPLICIT_STEPS]
    words += ["", "## Stiff damping", "", f"`{DAMPED.stem} {' '.join(STIFF)}`:", ""]
    words += ["| | s | |", "|---|---|---|"]
    for setting in settings:
        began, outcome = time.perf_counter(), "ran"
        try:
            seconds = run(subject, setting).seconds
        except exunet.RunStopped as stop:
            seconds, outcome = time.perf_counter() - began, str(stop).partition(";")[0]
        words.append(f"| {setting} | {seconds:.2f} | {outcome} |")
        say(words[-1])


def rows_of(kind: str, found: dict[str, Found]) -> Iterator[str]:
    """Lines of the table for each method on scenes of a kind, and which is the cheapest at each accuracy."""
    yield from ("", f"# {TITLES[kind]}.", f"[{kind}]")
    for method, kept in found.items():
        yield from ("", f"[{kind}.{method}]")
        yield "# Accuracy -> tolerance per step / launch speed; at and below it,"
        yield from (f"# {MARGIN:g} x the worst error of all scenes is within the accuracy.", "tolerance = [")
        chosen = ((accuracy, kept.tolerance(accuracy)) for accuracy in ACCURACIES)
        yield from (f"  [{accuracy:.0e}, {tolerance:.2e}]," for accuracy, tolerance in chosen if tolerance)
        yield from ("]", "# Tolerance -> error over the scenes, median and worst.", "expected_error = [")
        for tolerance, offs in sorted(kept.errors.items()):
            if offs and max(offs) < float("inf"):
                yield f"  [{tolerance:.2e}, {statistics.median(offs):.2e}, {max(offs):.2e}],"
        yield from ("]", "# Tolerance -> right-hand sides over all scenes.", "work = [")
        yield from (f"  [{tolerance:.2e}, {kept.work[tolerance]}]," for tolerance in sorted(kept.work))
        yield "]"


def seconds_of_runs() -> dict[str, list[tuple[float, ...]]]:
    """By method: (elements, Exudyn, compiled loop) seconds of a right-hand side in such runs."""
    rows: dict[str, list[tuple[float, ...]]] = {method: [] for method in METHODS}
    for meshes in MESHES[:-2]:  # beyond, the ratios of methods stay
        scene = exunet.load(PLANAR, [f"net.mesh={5.0 / meshes!r}", "initial.packing=0.99"]).scene
        least = dict.fromkeys(((method, backend) for method in METHODS for backend in Backend), float("inf"))
        for _ in range(3):
            for method, backend in least:
                if backend != Backend.COMPILED or FACTS[Method(method)].compiled:
                    seconds = _seconds_in_run(scene, method, backend)
                    least[method, backend] = min(least[method, backend], seconds)
        for method, found in rows.items():
            elements = prepare(scene).net.n_elements
            found.append((elements, *(least[method, backend] for backend in Backend)))
            say(f"{method} {found[-1]}")
    return rows


def _seconds_in_run(scene: Scene, method: str, backend: Backend) -> float:
    """Processor time of a right-hand side [s], guards and record included: others hardly change it."""
    solver = Solver.model_validate({"method": method, "tolerance": 1e-8})
    engine = Engine.model_validate({"backend": backend})
    simulation = exunet.Simulation(prepare(scene.model_copy(update={"solver": solver, "engine": engine})))
    simulation.advance(0.006)  # compiles, and comes to where the first threads are taut
    stretch = 200.0 / largest_frequency(prepare(scene).system)
    before, began = simulation.counts.right_hand_sides, time.process_time()
    done, spent = 0, 0.0
    while done < ENOUGH and spent < LONG:
        simulation.advance(stretch)
        done, spent = simulation.counts.right_hand_sides - before, time.process_time() - began
    return spent / done


def seconds_in_lines() -> Iterator[str]:
    """Lines of the table with the times of runs."""
    yield "# Number of elements -> seconds of a right-hand side in a run, with what a step costs beside:"
    yield from ("# Exudyn, compiled loop.", "[run_seconds]")
    for method, rows in seconds_of_runs().items():
        yield f"{method} = ["
        yield from (f"  [{row[0]}, {', '.join(f'{one:.3g}' for one in row[1:])}]," for row in rows)
        yield "]"


STAMP = (
    f"{time.strftime('%Y-%m-%d')}, {platform.platform()}, {os.cpu_count()} cores, "
    f"Python {platform.python_version()}, exunet {exunet.__version__}"
)


def only_seconds() -> None:
    """Measure the times of runs anew, and leave all else as it is."""
    path = ROOT / "exunet" / "simulation" / "auto_table.toml"
    text = path.read_text(encoding="utf-8")
    head, rest = text[: text.index("# Number of elements -> seconds of a right-hand side in a run")], text
    rest = rest[rest.index("# Folded starts") :]
    times = "\n".join(seconds_in_lines())
    with replacing(path) as part:
        part.write_text(f"{head}{times}\n\n{rest}", encoding="utf-8")


def main() -> None:
    words = ["# What the table of `auto` was made from", "", STAMP, ""]
    words += [
        "Speed errors in Exudyn relative to the launch speed, by tolerance / launch speed; "
        f"worst of runs that store {', '.join(map(str, STORED))} states."
    ]
    folded = errors(words, "folded", FOLDED)
    deployed = errors(words, "nearly_deployed", DEPLOYED)
    stiff(words)
    lines = [
        "# Measured by benchmarks/auto_table.py, read by exunet/simulation/auto.py.",
        f"# {STAMP}",
        "",
        *seconds_in_lines(),
        *rows_of("folded", folded),
        *rows_of("nearly_deployed", deployed),
    ]
    with replacing(ROOT / "exunet" / "simulation" / "auto_table.toml") as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (ROOT / "benchmarks" / "auto_table.md").write_text("\n".join(words) + "\n", encoding="utf-8")


if __name__ == "__main__":
    only_seconds() if sys.argv[1:] == ["--seconds"] else main()
