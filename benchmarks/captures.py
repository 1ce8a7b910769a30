"""What a capture costs: a 20 x 20 net with contact of threads and friction on a free, tumbling box.

    python benchmarks/captures.py [--meshes 20] [--only mujoco|shipped|mesh|steps] [--before FOLDER]

Beside a bare loop in C of the same work (bare_capture.c: cable law with viscous stress, each thread tested
against the box, contact with damping and friction, nothing observed), window by window of one throw, by
turns; then what parts of the forces take once the net is wrapped, what a body out of reach costs,
and MuJoCo (tendons, knots as spheres; where it is not installed, what the page has of it
stays). One process, so one core. Takes some three minutes and writes captures.md.

At its end the shipped case of such a net, cases/capture/box.toml, as a user runs it but for the stored
states, and the same with 40 x 40 meshes; then a net of 10 m wrapped on a satellite from a mesh, beside the
version in `--before FOLDER` by turns, and mean steps of whole runs. `--only` renews one of the last parts.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mujoco_capture import HEAD as MUJOCO_HEAD
from mujoco_capture import mujoco
from numpy.typing import NDArray

import exunet
from exunet.forces.contact.status import status_of
from exunet.forces.contact.thread_contact import ThreadContact
from exunet.integrators.compiled.loop import CompiledStepper, loop_kernel
from exunet.kernels.kernel import Kernel

HERE = Path(__file__).parent
Floats = NDArray[np.float64]
WINDOW, WINDOWS = 0.05, 20  # s
ROUNDS = 9
HEAD = (
    "| until [s] | a right-hand side [µs] | a step of the bare loop [µs] | ratio | times real time | "
    "threads that touch | of the bare loop |\n|---|---|---|---|---|---|---|"
)

SHIPPED_CASE = HERE.parent / "cases" / "capture" / "box.toml"
SHIPPED = {"20 x 20": (), "40 x 40": ("net.mesh=0.125",)}  # what is set otherwise; the step stays stable
SHIPPED_WINDOW, SHIPPED_THROWS = 0.1, 5  # s, of each the least of so many throws
SHIPPED_HEAD = "## The shipped case"

SCENE = """
format = 1
title = "A net around a tumbling box"
[time]
end = 1.0
output_step = 0.05
[solver]
method = "VelocityVerlet"
step = {step}
[engine]
backend = "compiled"
[net]
topology = "square"
size = 5.0
mesh = {mesh}
[net.cable]
diameter = 0.001
density = 1390.0
youngs_modulus = 70e9
[net.bullets]
mass = 0.2
[initial]
packing = 0.98
velocity = [0.0, 0.0, 5.0]
[effects.material_damping]
relaxation_time = 1e-6
[bodies.box]
shape = "box"
size = [1.0, 1.0, 1.0]
edge_radius = 0.02
mass = 100.0
position = [0.1, 0.1, {ahead}]
velocity = [0.0, 0.0, 0.0]
angular_velocity = [0.3, 0.4, 0.2]
"""
CONTACT = """
[effects.contact]
threads = ["box"]
law = "linear"
stiffness = 2e4
restitution = 0.5
impact_speed = 2.0
friction = { law = "regularised", coefficient = 0.3, slip_speed = 0.01 }
"""


def scene_text(meshes: int, *, contact: bool = True, ahead: float = 1.0) -> str:
    """The scene; the step is 0.7 of sqrt(rho / E) times the mesh."""
    step = 0.7 * (5.0 / meshes) * (1390.0 / 70e9) ** 0.5
    return SCENE.format(step=f"{step:.3g}", mesh=5.0 / meshes, ahead=ahead) + (CONTACT if contact else "")


def simulation(meshes: int, *overrides: str, contact: bool = True, ahead: float = 1.0) -> exunet.Simulation:
    """Of the scene, at its start."""
    text = scene_text(meshes, contact=contact, ahead=ahead)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture.toml"
        path.write_text(text)
        return exunet.Simulation(path, list(overrides))


class Box(ctypes.Structure):
    _fields_ = [
        ("half", ctypes.c_double * 3), ("rounding", ctypes.c_double), ("radius", ctypes.c_double),
        ("mass", ctypes.c_double), ("inertia", ctypes.c_double * 3), ("stiffness", ctypes.c_double),
        ("damping", ctypes.c_double), ("friction", ctypes.c_double), ("slip", ctypes.c_double),
    ]  # fmt: skip


class Bare:
    """The bare loop, from the start of a simulation on."""

    def __init__(self, sim: exunet.Simulation, folder: Path) -> None:
        library = folder / "bare_capture.so"
        source = str(HERE / "bare_capture.c")
        command = ["gcc", "-O3", "-march=native", "-fPIC", "-shared", "-o", str(library), source, "-lm"]
        subprocess.run(command, check=True)
        self._march = ctypes.CDLL(str(library)).march
        self._march.restype = ctypes.c_long
        system, net, law = sim.start.system, sim.start.net, sim.start.system.forces.cable.law
        touched = next(d for d in loop_kernel(system).table().data if isinstance(d, ThreadContact))
        contact, cores = touched.law, touched.cores
        state, bodies = sim.state, sim.state.bodies
        self._step = sim.plan.step or 0.0
        self._sizes = net.n_nodes, net.n_elements
        mass, inertia = system.blocks.inertia.mass[0], system.blocks.inertia.moments[0]
        # The ends of ctypes take pointers; the arrays stay here.
        self._arrays = [
            net.element_nodes.astype(np.int32),
            law.natural_length.copy(),
            law.stiffness.copy(),
            2.0 * np.asarray(law.relaxation_time) * np.ones(net.n_elements),
            np.full(net.n_elements, float(touched.threads.thick.max())),
            1.0 / net.mass,
        ]
        self._box = Box(
            (ctypes.c_double * 3)(*cores.numbers[0]), cores.rounding[0], touched.body.radius, mass,
            (ctypes.c_double * 3)(*inertia), contact.stiffness, contact.damping, contact.friction,
            contact.slip_speed,
        )  # fmt: skip
        self.position, self.velocity = state.position.ravel().copy(), state.velocity.ravel().copy()
        turning = bodies.attitude[0], bodies.angular_velocity[0]
        self.body = np.concatenate([bodies.position[0], bodies.velocity[0], *turning])
        self._force = np.zeros_like(self.position)

    def advance(self, duration: float) -> tuple[int, int]:
        """Steps, and how many threads touch at the end."""
        steps = round(duration / self._step)
        n, m = self._sizes
        arrays = [a.ctypes.data_as(ctypes.c_void_p) for a in self._arrays]
        moving = [
            a.ctypes.data_as(ctypes.c_void_p) for a in (self.position, self.velocity, self.body, self._force)
        ]
        box, h = ctypes.byref(self._box), ctypes.c_double(self._step)
        return steps, self._march(n, m, *arrays, box, *moving, h, ctypes.c_long(steps))


def throw(meshes: int, folder: Path) -> tuple[list[str], float, exunet.Simulation]:
    """Rows of a table, the whole ratio, and the simulation wrapped around the box."""
    sim = simulation(meshes)
    bare = Bare(sim, folder)
    sim.advance(1e-3)  # what is compiled is compiled, or loaded
    sim.reset()
    rows, times = [], np.zeros((WINDOWS, 2))
    for k in range(WINDOWS):
        before = sim.counts.right_hand_sides
        began = time.perf_counter()
        sim.advance(WINDOW)
        middle = time.perf_counter()
        steps, touching = bare.advance(WINDOW)
        times[k] = middle - began, time.perf_counter() - middle
        count = sim.counts.right_hand_sides - before
        ours = int(status_of(sim.state.discrete["contact/threads/box"]).touching)
        rows.append(
            f"| {sim.time:.2f} | {1e6 * times[k, 0] / count:.1f} | {1e6 * times[k, 1] / steps:.1f} | "
            f"{times[k, 0] / times[k, 1]:.2f} | {WINDOW / times[k, 0]:.2f} | {ours} | {touching} |"
        )
    whole, steps = times.sum(axis=0), round(WINDOWS * WINDOW / (sim.plan.step or 1.0))
    ratios = times[:, 0] / times[:, 1]
    low, middle, high = statistics.quantiles(ratios.tolist(), n=4)
    rows.append(
        f"| whole | {1e6 * whole[0] / sim.counts.right_hand_sides:.1f} | "
        f"{1e6 * whole[1] / steps:.1f} | {whole[0] / whole[1]:.2f} "
        f"(windows: median {middle:.2f}, quartiles {low:.2f} to {high:.2f}) | "
        f"{WINDOWS * WINDOW / whole[0]:.2f} | | |"
    )
    return rows, float(whole[0] / whole[1]), sim


def shares(sim: exunet.Simulation) -> list[str]:
    """Microseconds of one evaluation of the forces, whole and by term, in the state of a simulation."""
    system, state = sim.start.system, sim.state
    kernel = Kernel(system.forces, bodies=True)
    table = kernel.table(state.discrete)
    x, v = (np.array(part) for part in system.layout.pack(state.moving))
    force = np.zeros(system.blocks.n_force)

    def each(rows: Any) -> float:
        kernel.module.forces(state.time, x, v, rows, force)
        found = []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            for _ in range(500):
                kernel.module.forces(state.time, x, v, rows, force)
            found.append((time.perf_counter() - began) / 500)
        return 1e6 * statistics.median(found)

    names = [type(data).__name__ for data in table.data]
    parts = {name: each(table.rows[k : k + 1].copy()) for k, name in enumerate(names)}
    touching = next(data for data in table.data if isinstance(data, ThreadContact))
    far = system.layout.pack(state.moving)[0].copy()
    far[system.blocks.centre("box")] += 1e3  # the broad phase alone, chosen anew
    held, x[:] = x.copy(), far
    touching.near.look[2] = -1.0
    row = names.index("ThreadContact")
    parts["broad phase, nothing in reach"] = each(table.rows[row : row + 1].copy())
    x[:] = held
    return [f"| {name} | {value:.2f} |" for name, value in parts.items()]


def out_of_reach(meshes: int) -> tuple[float, float, float]:
    """Median and quartiles of the ratio with contact, the body 1 km away, to the same without contact."""
    made = []
    for contact in (True, False):
        start = simulation(meshes, contact=contact, ahead=1000.0).start
        plan = simulation(meshes, contact=contact, ahead=1000.0).plan
        made.append(CompiledStepper(start.system, start.state, plan, loop_kernel(start.system), every=None))
    ratios = []
    at = 0.0
    for turn in range(2 * ROUNDS + 1):
        spent = {}
        for which in (0, 1) if turn % 2 else (1, 0):
            began = time.perf_counter()
            made[which].step([at + 0.02])
            spent[which] = time.perf_counter() - began
        at += 0.02
        if turn:
            ratios.append(spent[0] / spent[1])
    low, middle, high = statistics.quantiles(ratios, n=4)
    return middle, low, high


def shipped() -> list[str]:
    """The shipped case and that of more meshes: windows of the throw, each the fastest of several."""
    lines = [
        SHIPPED_HEAD,
        "",
        f"`cases/capture/box.toml` in the compiled loop: threads and bullets that touch, friction that "
        f"sticks, the script. Windows of {SHIPPED_WINDOW:g} s, each the fastest of {SHIPPED_THROWS} throws, "
        f"the same to the last bit; load of the machine before: {os.getloadavg()[0]:.1f}.",
        "",
        "| meshes | threads | step [s] | a right-hand side [µs] | times real time | whole |",
        "|---|---|---|---|---|---|",
    ]
    for name, settings in SHIPPED.items():
        sim = exunet.Simulation(SHIPPED_CASE, ["engine.backend=compiled", *settings])
        sim.advance(1e-3)  # what is compiled is compiled, or loaded
        end = sim.start.scene.time.end
        windows = round(end / SHIPPED_WINDOW)
        spent, counts = np.full(windows, np.inf), np.zeros(windows)
        for _ in range(SHIPPED_THROWS):
            sim.reset()
            for k in range(windows):
                before, began = sim.counts.right_hand_sides, time.perf_counter()
                sim.advance(SHIPPED_WINDOW)
                spent[k] = min(spent[k], time.perf_counter() - began)
                counts[k] = sim.counts.right_hand_sides - before
        each, pace = 1e6 * spent / counts, SHIPPED_WINDOW / spent
        lines.append(
            f"| {name} | {sim.start.net.n_elements} | {sim.plan.step:.3g} | "
            f"{each.min():.0f} to {each.max():.0f} | {pace.min():.2f} to {pace.max():.2f} | "
            f"{end / spent.sum():.2f} |"
        )
        sys.stderr.write(lines[-1] + "\n")
    return [*lines, ""]


def by_turns(script: str, *arguments: str, before: str | None, folder: str) -> dict[str, list[list[float]]]:
    """What a script prints as JSON with this version, and with an earlier one, ROUNDS_OF_RUNS times each."""
    versions = {"now": str(HERE.parent)} | ({"before": before} if before else {})
    found: dict[str, list[list[float]]] = {name: [] for name in versions}
    for turn in range(ROUNDS_OF_RUNS + 1):
        for name, root in versions.items():
            command = [sys.executable, "-c", script, *(argument.format(root=root) for argument in arguments)]
            environment = os.environ | {"PYTHONPATH": root, "COMPILE_ONLY": "" if turn else "1"}
            out = subprocess.run(
                command, env=environment, cwd=folder, check=True, capture_output=True, text=True
            )
            if turn:  # the first compiles
                found[name].append(json.loads(out.stdout))
    return found


ROUNDS_OF_RUNS = 3
STEPS_HEAD = "## Mean steps of whole runs"
TRIED = """What was tried, in microseconds of a step on a box (least of windows of one throw, by turns):

| change | 20 x 20 | 40 x 40 |
|---|---|---|
| before | 25.4 | 115 |
| work of material damping from the forces of the step, not from the states at both ends | 18.1 | 70 |
| part of a thread near a box from quadratics, not by Newton's method (13 distances a thread) | 15.4 | 62 |
| slack elements, and those with less tension than before, not compared with the largest tension | 14.5 | 58 |
| distances at the ends of a piece used twice | no gain | |

With the work of the step's own forces the energy balance of `planar_deployment.toml` (velocity Verlet,
relaxation time 1e-5 s) is off by 4.5e-5, 17e-5 and 24e-5 of the energy with steps of 1e-5, 2e-5 and 4e-5 s;
before by 15e-5, 42e-5 and 173e-5. Of a step of 40 x 40 at 0.4 s contact takes 34 %, the cable law 30 %.

Wrapped on the satellite, the ends of a thread may move by a part of a cell before its pieces are listed anew.
0.012, 0.025 (chosen), 0.05, 0.1 (before), 0.2, 0.4 and 0.8 took 21.4, 21.0, 22.4, 25.8, 32, 37 and 42
microseconds; the numbers of a run do not depend on it.

`exunet ensemble cases/missions/capture_satellite.toml --runs 20` took 203.8 s on two idle cores: 100 captures
take 17 minutes."""
WHOLE_RUN = """
import json, os, sys, time
import exunet
case, end = sys.argv[1], float(sys.argv[2])
sim = exunet.Simulation(case, ["engine.backend=compiled"])
sim.advance(1e-3)
count, began = sim.counts.right_hand_sides, time.process_time()
while sim.time < end - 1e-9 and not os.environ["COMPILE_ONLY"]:
    sim.advance_to(min(sim.time + 0.05, end))
used = time.process_time() - began
json.dump((used, 1e6 * used / max(1, sim.counts.right_hand_sides - count)), sys.stdout)
"""


def mean_steps(before: str | None) -> list[str]:
    """Processor time of whole runs in the compiled loop, of each version by turns."""
    lines = [
        STEPS_HEAD,
        "",
        f"The scenes of the first two tables, and `cases/missions/capture_satellite.toml` with the step that "
        f"`auto` chooses. Processor time, medians of {ROUNDS_OF_RUNS} runs with the range, by turns; load of "
        f"the machine: {os.getloadavg()[0]:.1f}.",
        "",
        "| run | version | in total [s] | a right-hand side [µs] |",
        "|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        runs = {"capture_satellite": ("{root}/cases/missions/capture_satellite.toml", "7.0")}
        for meshes in (40, 20):
            case = Path(folder) / f"{meshes}.toml"
            case.write_text(scene_text(meshes))
            runs = {f"{meshes} x {meshes} on a box": (str(case), "1.0")} | runs
        for run, arguments in runs.items():
            for name, rows in by_turns(WHOLE_RUN, *arguments, before=before, folder=folder).items():
                used, step = np.array(rows).T
                cells = [
                    f"{np.median(part):.3g} ({part.min():.3g} to {part.max():.3g})" for part in (used, step)
                ]
                lines.append(f"| {run} | {name} | {' | '.join(cells)} |")
                sys.stdout.write(lines[-1] + "\n")
    return [*lines, "", *TRIED.splitlines(), ""]


MESH_HEAD = "## Wrapped on a mesh"
ON_MESH = """
import json, sys, time
import exunet
began = time.process_time()
sim = exunet.Simulation(sys.argv[1])
prepared = time.process_time() - began
sim.advance(1e-3)
steps = []
while sim.time < 1.95:
    count, began = sim.counts.right_hand_sides, time.process_time()
    sim.advance(0.1)
    steps.append(1e6 * (time.process_time() - began) / (sim.counts.right_hand_sides - count))
json.dump((prepared, *steps), sys.stdout)
"""


def on_mesh(before: str | None) -> list[str]:
    """Processor time of the preparation and of a right-hand side, of each version by turns."""
    text = SCENE.format(step="1e-5", mesh=0.5, ahead=1.6).replace("size = 5.0", "size = 10.0")
    solid = 'shape = "box"\nsize = [1.0, 1.0, 1.0]\nedge_radius = 0.02\nmass = 100.0'
    mesh = 'shape = "mesh"\nfile = "sat.stl"\nunit = "m"\nedge_radius = 0.05\nmass = 500.0'
    text = text.replace(solid, mesh).replace("velocity = [0.0, 0.0, 5.0]", "velocity = [0.0, 0.0, 8.0]", 1)
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "mesh.toml"
        case.write_text(text.replace("end = 1.0", "end = 2.0") + CONTACT)
        shutil.copy(HERE.parent / "cases" / "missions" / "sat.stl", folder)
        found = by_turns(ON_MESH, str(case), before=before, folder=folder)
    lines = [
        MESH_HEAD,
        "",
        f"A net of 10 m, 0.5 m meshes, thrown at 8 m/s at `cases/missions/sat.stl` of 500 kg; step 1e-5 s. "
        f"Processor time, medians of {ROUNDS_OF_RUNS} runs with the range, by turns; load of the machine: "
        f"{os.getloadavg()[0]:.1f}.",
        "",
        "| version | preparation [s] | a right-hand side until 0.5 s [µs] | until 1.4 s | from 1.5 s on |",
        "|---|---|---|---|---|",
    ]
    for name, runs in found.items():
        rows = np.array(runs)
        parts = rows[:, 0], rows[:, 1:6].mean(axis=1), rows[:, 6:15].mean(axis=1), rows[:, 16:].mean(axis=1)
        cells = [f"{np.median(part):.3g} ({part.min():.3g} to {part.max():.3g})" for part in parts]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return [*lines, ""]


def section(text: str, head: str) -> tuple[str, str, str]:
    """What of a page stands before a heading, under it, and from the next heading on."""
    before, _, rest = text.partition(head)
    under, mark, after = rest.partition("\n## ")
    return before, head + under, mark[1:] + after


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--meshes", type=int, default=20)
    parser.add_argument("--only", choices=("mujoco", "shipped", "mesh", "steps"), help="renew this part")
    parser.add_argument("--before", help="checkout of an earlier version, for the last two parts")
    arguments = parser.parse_args()
    page, meshes = HERE / "captures.md", arguments.meshes
    parts: dict[str, tuple[str, Callable[[], list[str]]]] = {
        "mujoco": (MUJOCO_HEAD, lambda: mujoco(simulation(meshes))),
        "shipped": (SHIPPED_HEAD, shipped),
        "mesh": (MESH_HEAD, lambda: on_mesh(arguments.before)),
        "steps": (STEPS_HEAD, lambda: mean_steps(arguments.before)),
    }
    if arguments.only:
        head, found = parts[arguments.only]
        before, _, after = section(page.read_text(), head)
        page.write_text("\n".join([before.rstrip(), "", *found(), after]).rstrip() + "\n")
        return
    lines = ["# What a capture costs", "", __doc__.split("\n\n")[2].replace("\n", " "), ""]
    machine = f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    lines += [f"exunet {exunet.__version__}, {machine}. Ratios matter.", ""]
    with tempfile.TemporaryDirectory() as folder:
        for size in dict.fromkeys((meshes, 40)):
            rows, ratio, sim = throw(size, Path(folder))
            sys.stderr.write(f"{size} x {size}: {ratio:.2f} times the bare loop\n")
            threads, step = sim.start.net.n_elements, f"{sim.plan.step:.3g}"
            lines += [f"## {size} x {size}, {threads} threads, step {step} s", "", HEAD, *rows, ""]
            if size == meshes:
                lines += ["One evaluation of the forces, wrapped:", "", "| part | µs |", "|---|---|"]
                lines += [*shares(sim), ""]
    middle, low, high = out_of_reach(meshes)
    lines += [
        f"A body out of reach: {100 * (middle - 1):+.1f} % of a step (quartiles {100 * (low - 1):+.1f} to "
        f"{100 * (high - 1):+.1f} %), beside the same scene without contact.", "",
    ]  # fmt: skip
    installed = importlib.util.find_spec("mujoco") is not None
    lines += (
        mujoco(simulation(meshes)) if installed else [section(page.read_text(), MUJOCO_HEAD)[1].rstrip(), ""]
    )
    page.write_text(
        "\n".join([*lines, *shipped(), *on_mesh(arguments.before), *mean_steps(arguments.before)]).rstrip()
        + "\n"
    )


if __name__ == "__main__":
    main()
