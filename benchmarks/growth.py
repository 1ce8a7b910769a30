"""How cost grows with the net: python benchmarks/growth.py

Square nets of 5 x 5 to 100 x 100 meshes on each backend: time to build, time of a right-hand side, memory;
medians of interleaved rounds, exponents fitted from 20 x 20 on. Writes growth.md, growth.csv and growth.png.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import peers

import exunet
from exunet.integrators.compiled.loop import CompiledStepper, loop_kernel
from exunet.integrators.exudyn.stepper import ExudynStepper
from exunet.methods.method import Method, Plan
from exunet.plots.style import BLACK, BLUE, RED, blank, drawing
from exunet.simulation.preparation import Start, prepare

HERE = Path(__file__).parent
CASE = HERE.parent / "cases" / "planar_undamped.toml"
MESHES = (5, 10, 20, 40, 70, 100)
FITTED = 20  # meshes on a side from which on the exponent is fitted: below, each call's own cost counts
BACKENDS = ("Exudyn", "compiled loop", "bare loop in C")
STEP = 1e-7  # s, of RK44
WORK = 200_000  # elements x steps of one timing
# A stretched net, so that the forces are computed in every element.
CHANGES = (
    "initial.packing=1.001",
    "launch=",
    "time.end=1.0",
    "time.output_step=",
    "time.output_times=[]",
    "solver=",
)


def start_of(meshes: int, backend: str) -> Any:
    engine = ["engine.backend=compiled"] if backend == "compiled loop" else ["engine.backend=exudyn"]
    engine = [] if backend.startswith("bare") else engine
    case = exunet.load(CASE, [*CHANGES, f"net.size={float(meshes)}", *engine, "solver.method=RK44"])
    return prepare(case.scene)


def measure(meshes: int, backend: str) -> tuple[int, float, float]:
    """Elements, seconds to build (weave, plan, fill the engine), seconds of a right-hand side."""
    began = time.perf_counter()
    start = start_of(meshes, backend)
    elements = start.net.n_elements
    steps = max(20, WORK // elements)
    if backend.startswith("bare"):
        return elements, time.perf_counter() - began, _bare(start, steps)
    advance = _advancing(start, backend, Plan(Method.RK44, step=STEP))
    advance(0.0, STEP)  # compiles, allocates
    built = time.perf_counter() - began
    began = time.perf_counter()
    advance(STEP, STEP * (1 + steps))
    return elements, built, (time.perf_counter() - began) / (4 * steps)


def _advancing(start: Start, backend: str, plan: Plan) -> Callable[[float, float], object]:
    """advance(a, b): take the steps from one time [s] to another, without guards."""
    if backend == "compiled loop":
        motion = CompiledStepper(start.system, start.state, plan, loop_kernel(start.system), every=None)
        return lambda _, b: motion.step([b])
    stepper = ExudynStepper(start.system, start.state, plan)
    return lambda _, b: stepper.step([b])


def _bare(start: Start, steps: int) -> float:
    net = start.net
    problem = peers.Problem(
        *net.element_nodes.T, net.mass, net.reference_length, net.axial_stiffness,
        start.position, start.velocity, net.bullet_nodes, STEP * steps, STEP,
    )  # fmt: skip
    peers.bare(problem, 1.0)  # compiles
    return peers.bare(problem, 1.0)[0] / (6 * steps)  # the first step is short, too


def peak_memory(meshes: int, backend: str) -> float:
    """Largest memory [MB] of a separate process that builds the net and takes a step."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return float(pool.apply(_peak, (meshes, backend)))


def _peak(meshes: int, backend: str) -> float:
    measure(meshes, backend)
    status = Path("/proc/self/status").read_text(encoding="ascii")  # Linux; getrusage includes the parent's
    return float(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def exponent(elements: list[int], values: list[float]) -> float:
    """Slope in the logarithms from FITTED meshes on."""
    keep = [k for k, meshes in enumerate(MESHES) if meshes >= FITTED]
    return float(np.polyfit(np.log([elements[k] for k in keep]), np.log([values[k] for k in keep]), 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    elements: list[int] = []
    built: dict[str, list[float]] = {backend: [] for backend in BACKENDS}
    rates: dict[str, list[float]] = {backend: [] for backend in BACKENDS}
    memory: dict[str, list[float]] = {backend: [] for backend in BACKENDS}
    for meshes in MESHES:
        found: dict[str, list[tuple[int, float, float]]] = {backend: [] for backend in BACKENDS}
        for _ in range(rounds):
            for backend in BACKENDS:
                found[backend].append(measure(meshes, backend))
        elements.append(found["Exudyn"][0][0])
        for backend in BACKENDS:
            built[backend].append(statistics.median(one[1] for one in found[backend]))
            rates[backend].append(statistics.median(one[2] for one in found[backend]))
            memory[backend].append(peak_memory(meshes, backend))
        rates_of = ", ".join(
            f"{backend} {1e9 * rates[backend][-1] / elements[-1]:.3g} ns" for backend in BACKENDS
        )
        sys.stdout.write(f"{meshes} x {meshes}: {rates_of} an element\n")
        sys.stdout.flush()
    _write(rounds, elements, built, rates, memory)


def _write(
    rounds: int,
    elements: list[int],
    built: dict[str, list[float]],
    rates: dict[str, list[float]],
    memory: dict[str, list[float]],
) -> None:
    lines = [
        "# Growth with the size of the net",
        "",
        f"`python benchmarks/growth.py --rounds {rounds}`, {time.strftime('%Y-%m-%d')}, "
        f"{platform.platform()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, exunet {exunet.__version__}, "
        f"load average {os.getloadavg()[0]:.1f}. "
        "Medians of interleaved rounds; all elements taut; exponents over the elements from "
        f"{FITTED} x {FITTED} meshes on.",
        "",
        f"| meshes | elements | {' | '.join(f'{backend} [ns]' for backend in BACKENDS)} | "
        f"{' | '.join(f'{backend}: build [s]' for backend in BACKENDS[:2])} | "
        f"{' | '.join(f'{backend} [MB]' for backend in BACKENDS[:2])} |",
        "|---" * 9 + "|",
    ]
    rows = []
    for k, meshes in enumerate(MESHES):
        each = [1e9 * rates[backend][k] / elements[k] for backend in BACKENDS]
        more = [built[backend][k] for backend in BACKENDS[:2]]
        space = [memory[backend][k] for backend in BACKENDS[:2]]
        cells = [f"{v:.3g}" for v in (*each, *more)] + [f"{v:.0f}" for v in space]
        lines.append(f"| {meshes} x {meshes} | {elements[k]} | {' | '.join(cells)} |")
        rows.append([meshes, elements[k], *each, *more, *space])
    slopes = [f"{exponent(elements, rates[backend]):.2f}" for backend in BACKENDS]
    slopes += [f"{exponent(elements, built[backend]):.2f}" for backend in BACKENDS[:2]]
    lines.append(f"| exponent | | {' | '.join(slopes)} | | | |")
    lines += [
        "",
        "The columns in ns are the time of one right-hand side for each element.",
        "",
        "![growth](growth.png)",
    ]
    text = "\n".join(lines) + "\n"
    (HERE / "growth.md").write_text(text, encoding="utf-8")
    with (HERE / "growth.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        head = [f"{backend}_ns" for backend in BACKENDS] + [f"{backend}_build_s" for backend in BACKENDS[:2]]
        writer.writerow(["meshes", "elements", *head, *(f"{backend}_MB" for backend in BACKENDS[:2])])
        writer.writerows(rows)
    _draw(elements, built, rates)
    sys.stdout.write(text)


def _draw(elements: list[int], built: dict[str, list[float]], rates: dict[str, list[float]]) -> None:
    styles = dict(zip(BACKENDS, ((BLUE, "o"), (RED, "s"), (BLACK, "^")), strict=True))
    with drawing():
        figure = blank(9.0, 4.2)
        left, right = figure.subplots(1, 2)
        for backend, (colour, marker) in styles.items():
            slope = exponent(elements, rates[backend])
            label = f"{backend}: {slope:.2f}"
            left.loglog(elements, rates[backend], color=colour, marker=marker, markersize=4, label=label)
            if not backend.startswith("bare"):
                label = f"{backend}: {exponent(elements, built[backend]):.2f}"
                right.loglog(elements, built[backend], color=colour, marker=marker, markersize=4, label=label)
        left.set_ylabel("time of one right-hand side [s]")
        right.set_ylabel("time to build [s]")
        for axes in (left, right):
            axes.set_xlabel("elements")
            axes.grid(visible=True, color="0.9", linewidth=0.6)
            axes.legend(title="backend: fitted exponent", frameon=False)
        figure.tight_layout()
        figure.savefig(HERE / "growth.png")


if __name__ == "__main__":
    main()
