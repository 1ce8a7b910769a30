"""The momentum that the target of each shipped capture gets, over divisions of the meshes and steps.

    python benchmarks/divisions.py [--only NAME ...] [--runs 8]

Divisions 1, 2, 4 ... to twice those of the case, the step as long as the elements are, where it is stable; at
the case's divisions with half of the step too. All from the same number of perturbed runs, with perturbations
that show differences of medians (`perturbation_for_medians`), in the compiled loop on all cores.
The momentum is what the net has lost, as nothing else acts on it: soon after the main contact, and at the
end. Writes divisions.md, case by case, and what is there of other cases stays.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.base.files import markdown_table
from exunet.scene.casefile import Case, load
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.cost.settings import changed, stable_step_of
from exunet.studies.ensemble import perturbation_for_medians, perturbed_bodies_of, perturbed_positions

HERE = Path(__file__).parent
CAPTURES = HERE.parent / "cases" / "capture"
AFTER = {
    "box": 1.5,
    "cubesat": 2.6,
    "cylinder": 4.5,
    "fixed_sphere": 0.8,
    "free_sphere": 0.8,
    "rocket": 0.8,
    "satellite": 5.0,
}  # [s]: the net is around the target and pulls; a miss does not have a momentum
OF_STABLE = 0.6  # most of the stable step: damping bounds it by the square of an element's length
HEAD = (
    *("divisions", "threads", "step [s]", "after contact [N s]", "least to largest", "to the case"),
    *("at the end [N s]", "least to largest", "to the case", "right-hand sides"),
)
WORDS = (
    "Medians of perturbed runs, in the compiled loop. The row without a change is the case as it is shipped; "
    "divisions are those of each side of a mesh."
)


@dataclass(frozen=True)
class Found:
    """Of one setting: momenta (runs, 2) [N s] after the contact and at the end; right-hand sides of a run."""

    divisions: int
    step: float
    threads: int
    momenta: NDArray[np.float64]
    right_hand_sides: int

    @property
    def medians(self) -> NDArray[np.float64]:
        return np.asarray(np.median(self.momenta, axis=0))


def starts(case: Case) -> Iterator[Start]:
    """The case at divisions 1, 2, 4 ... and, from its own on, with half of the step too."""
    own = prepare_case(case)
    assert own.plan.step is not None
    most = 2 * case.scene.net.divisions
    for divisions in (2**k for k in range(most.bit_length()) if 2**k <= most):
        free = prepare_case(changed(case, f"net.divisions={divisions}", "solver.step="))
        as_long = own.plan.step * case.scene.net.divisions / divisions
        step = min(as_long, OF_STABLE * stable_step_of(free))
        for size in (as_long, as_long / 2.0) if divisions == case.scene.net.divisions else (step,):
            yield prepare_case(changed(case, f"net.divisions={divisions}", f"solver.step={size!r}"))


def lost(start: Start, times: tuple[float, float]) -> tuple[list[float], int]:
    """The momentum that the net has lost at some stored times [N s], and its right-hand sides."""
    result = simulate(start)
    n = len(start.net.mass)
    momentum = np.einsum("n,tnk->tk", start.net.mass, result.velocity[:, :n])
    at = [int(np.abs(result.time - time).argmin()) for time in times]
    sizes = [float(np.linalg.norm(momentum[k] - momentum[0])) for k in at]
    return sizes, int(result.run.cost.right_hand_sides)


def found(start: Start, times: tuple[float, float], runs: int) -> Found:
    """From all perturbed runs."""
    move, seed = perturbation_for_medians(start), start.scene.seed
    places = perturbed_positions(start, runs, move, seed)
    bodies = perturbed_bodies_of(start, runs, move, seed)

    def one(run: int) -> tuple[list[float], int]:
        return lost(start.moved(places[run], start.velocity, None if bodies is None else bodies[run]), times)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        momenta, counts = zip(*pool.map(one, range(runs)), strict=True)
    net, step = start.scene.net, start.plan.step
    assert step is not None
    return Found(net.divisions, step, start.net.n_elements, np.array(momenta), counts[0])


def rows(name: str, runs: int) -> list[str]:
    """The lines of a case."""
    case = load(CAPTURES / f"{name}.toml", ["engine.backend=compiled"])
    times, every = (AFTER[name], case.scene.time.end), list[Found]()
    for start in starts(case):
        every.append(found(start, times, runs))
        print(f"{name}: {every[-1]}", flush=True)  # noqa: T201
    net, solver = case.scene.net, case.scene.solver
    own = next(one for one in every if (one.divisions, one.step) == (net.divisions, solver.step))
    cells = []
    for one in every:
        numbers = []
        for k in range(2):
            median, values = one.medians[k], one.momenta[:, k]
            change = 100.0 * (median / own.medians[k] - 1.0)
            told = "" if one is own else f"{change:+.1f} %"
            numbers += [f"{median:.4g}", f"{values.min():.4g} to {values.max():.4g}", told]
        cells.append(
            [str(one.divisions), str(one.threads), f"{one.step:.3g}", *numbers, str(one.right_hand_sides)]
        )
    after = f"After contact: at {times[0]:g} s; the end: at {times[1]:g} s. {runs} perturbed runs."
    return [f"## {name}", "", after, "", *markdown_table(HEAD, cells)]


def kept(path: Path) -> dict[str, str]:
    """The sections that are there, by case."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    sections = text.split("\n## ")[1:]
    return {one.split("\n", maxsplit=1)[0]: "## " + one.strip() for one in sections}


def main() -> None:
    """Run the cases of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=AFTER, nargs="+", default=list(AFTER))
    parser.add_argument("--runs", type=int, default=8)
    options = parser.parse_args()
    path = HERE / "divisions.md"
    about = f"{platform.platform()}, {os.cpu_count()} cores, exunet {exunet.__version__}"
    for name in options.only:
        lines = rows(name, options.runs)  # first, as another process may write meanwhile
        sections = kept(path) | {name: "\n".join(lines).strip()}
        every = [sections[one] for one in AFTER if one in sections]
        head = [
            "# Momentum of the target over divisions and steps",
            "",
            f"`python benchmarks/divisions.py`, {about}",
        ]
        path.write_text("\n".join([*head, "", WORDS, "", "\n\n".join(every)]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
