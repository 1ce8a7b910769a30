"""Scenes and starts that several test files share, and the parametrisation over back ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter

import exunet
import reference_impl
from exunet.base.errors import CaseError
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.estimate import EstimateBasis
from exunet.forces.terms import KernelTerm
from exunet.integrators.compiled.workspace import LARGEST, PEAKS, ObservedSteps
from exunet.integrators.exudyn.build import build
from exunet.integrators.exudyn.model import Model
from exunet.kernels import kernel
from exunet.kernels.kernel import ForceTable, Kernel, Takes
from exunet.net import AnyNetConfig, weave
from exunet.results.result import Result
from exunet.scene.casefile import Case, load, parse_case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.simulation.run import run_into, simulate
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]
CASES = Path(__file__).parents[1] / "cases"
EFFECT_CASES = CASES / "effects"

# The override of each back end, and the parametrisation of a test over their names.
BACKENDS = {
    "compiled": "engine.backend=compiled",
    "exudyn": "engine.backend=exudyn",
}
every_backend = pytest.mark.parametrize("backend", BACKENDS)

# Nets as records

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 70e9}  # paper, Table 1


def thrown(solver: dict[str, Any], *, end: float = 0.5, **tables: Any) -> Scene:
    """A 2 x 2 net thrown open: snaps from 0.1 s on, the stable step of RK44 is 2.6e-4 s."""
    return Scene.model_validate(
        {
            "format": 1,
            "title": "small thrown net",
            "time": {"end": end, "output_step": 0.005},
            "solver": solver,
            "engine": {"backend": "exudyn"},
            "net": {
                "topology": "square",
                "size": 2.0,
                "mesh": 1.0,
                "cable": CABLE,
                "strings": {**CABLE, "diameter": 0.004, "length": 1.0},
                "bullets": {"mass": 0.5},
            },
            "initial": {"packing": 0.5},
            "launch": {"radial_speed": 5.0, "axial_speed": 0.0},
            **tables,
        }
    )


def pair_of_masses(**tables: Any) -> Scene:
    """Two masses of 0.5 kg on a cable of 1 m, at rest and just taut; EA = 10 N, as soft as rubber."""
    return Scene.model_validate(
        {
            "format": 1,
            "title": "two masses",
            "time": {"end": 0.5, "output_step": 0.05},
            "engine": {"backend": "exudyn"},
            "net": {
                "topology": "explicit",
                "nodes": [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]],
                "elements": [[0, 1]],
                "node_masses": [0.5, 0.5],
                "cable": {"area": 1e-4, "density": 10.0, "youngs_modulus": 1e5},
            },
            "initial": {"packing": 1.0},
            **tables,
        }
    )


# The paper's net, with effects by name, in states that try every branch

# Strong enough to show at once beside the elastic forces; together they use every kind of term.
_ORBIT = "mean_motion = 0.3, radial = [0.0, 0.6, 0.8], along_track = [1.0, 0.0, 0.0]"
EFFECTS = {
    "rayleigh_damping": "{alpha = 0.2, beta = 1e-6}",
    "mass_damping": "{alpha = 0.7}",
    "material_damping": "{relaxation_time = 1e-4}",
    "gravity": "{acceleration = [1.0, 2.0, -9.0]}",
    "linear orbit": f'{{{_ORBIT}, model = "linear"}}',
    "two-body orbit": f'{{{_ORBIT}, model = "two_body"}}',
    "thermal_strain": "{temperature_change = -100.0, expansion_coefficient = 5e-5}",
}


def effects(names: Iterable[str]) -> list[str]:
    """Overrides that switch these effects on."""
    keys = {name: "orbit" if "orbit" in name else name for name in names}
    return [f"effects.{key}={EFFECTS[name]}" for name, key in keys.items()]


def text_of(kernel: Kernel) -> str:
    """Of all that is compiled for a kernel."""
    return "\n".join((kernel.source, *kernel.sources))


def no_table(takes: Takes = Takes.NOTHING) -> ForceTable:
    """Of steps whose forces a test gives in another way."""
    return ForceTable((), takes, (), np.zeros(0), {})


def planar(*overrides: str, on: Iterable[str] = ()) -> Start:
    """The paper's net (40 nodes, 64 elements), undamped, with the effects `on`."""
    return prepare(load(CASES / "planar_undamped.toml", [*overrides, *effects(on)]).scene)


def model(start: Start) -> Model:
    """The engine's model of a start."""
    return build(start.system, start.state, start.plan)


def states(start: Start, seed: int = 3) -> dict[str, tuple[Floats, Floats]]:
    """Position and velocity (n_nodes, 3) of a net that is packed, mixed, overstretched, or a point."""
    random = np.random.default_rng(seed)
    reference, shape = start.net.reference_position, start.position.shape

    def moved(scale: float, noise: float) -> tuple[Floats, Floats]:
        return scale * reference + noise * random.normal(size=shape), random.normal(size=shape)

    return {
        "packed": moved(0.1, 0.0),
        "mixed": moved(1.0, 1e-2),
        "overstretched": moved(1.2, 1e-2),
        "coincident": moved(0.0, 0.0),
    }


# Case files with terms that a test defines

# Two nodes of 0.5 kg, 1.05 m apart on a cable of 1 m and 55 N, which move apart: it is taut for 0.2 s. Beside
# them a tumbling body of 2 kg with three different moments of inertia.
PAIR = """
format = 1
title = "Two nodes and a body"
time = { end = 0.15, output_step = 0.05 }
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, 0.0], [1.05, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.49945414827643875, 0.49945414827643875]  # and half the cable: 0.5 kg
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }
initial.node_velocities = [[-0.5, 0.0, 0.1], [0.5, 0.1, 0.0]]
"""
BODY = (
    "bodies.target={mass=2.0, inertia=[0.2, 0.3, 0.4], position=[-0.5, 0.2, 0.1], velocity=[0.1, 0.0, 0.2],"
    "attitude=[0.9, 0.1, 0.3, 0.2], angular_velocity=[1.0, 2.0, -1.5]}"
)


def case_file(folder: Path, text: str = PAIR) -> Path:
    """The scene as a file."""
    path = folder / "case.toml"
    path.write_text(text)
    return path


def start_of(
    path: Path,
    overrides: Sequence[str],
    make: Callable[[Blocks], Sequence[KernelTerm]],
    states: tuple[FirstOrder, ...] = (),
) -> Start:
    """A case with terms of a test beside its own; make(blocks) gives them."""
    return prepare_case(load(path, overrides)).with_forces(make, states)


def continue_alike(one: Simulation, other: Simulation, until: float, folder: Path) -> None:
    """Take `other` to where `one` is, through a file, and both on to a time [s], bitwise equal."""
    one.snapshot().save(folder / "here")
    other.restore(Snapshot.load(folder / "here"))
    for sim in (one, other):
        sim.advance_to(until)
    for name, values in one.state.arrays().items():
        np.testing.assert_array_equal(other.state.arrays()[name], values)
    assert one.energy == other.energy


# Cases of a folder that are run, and others that restart from their states


def case_in(folder: Path, text: str, *overrides: str) -> Case:
    """The case of a text in the folder."""
    return parse_case(text, folder / "first.toml", overrides)


def stored(folder: Path, case: Case) -> Result:
    """The result of a case, in folder/first."""
    (folder / "first").mkdir()
    return run_into(folder / "first", case)


def restarted(folder: Path, text: str, named: str, overrides: Sequence[str] = ()) -> Case:
    """The case of a text in the folder, started from a state."""
    changes = ["initial.packing=", f"initial.restart={named!r}", *overrides]
    return parse_case(text, folder / "second.toml", changes)


# Nets of a few listed nodes

THREAD = {"area": 1e-6, "density": 1000.0, "youngs_modulus": 1e9}  # EA = 1 kN, 1 g a metre
ORBIT = {"radial": [0.0, 0.6, 0.8], "along_track": [1.0, 0.0, 0.0]}


def listed(nodes: Any, elements: Any, end: float, **more: Any) -> dict[str, Any]:
    """A case of listed nodes over `end` [s], by DOPRI5 to 1e-11; more : tables and changes of tables."""
    net = {"topology": "explicit", "nodes": nodes, "elements": elements, "cable": THREAD}
    return {
        "format": 1,
        "title": "listed nodes",
        "time": {"end": end, "output_step": end / 20},
        "solver": {"method": "DOPRI5", "tolerance": 1e-11},
        "net": net | more.pop("net", {}),
        "initial": {"packing": 1.0} | more.pop("initial", {}),
    } | more


def one_thread(end: float, **more: Any) -> dict[str, Any]:
    """A thread of 1 m along x, of one element."""
    return listed([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0, 1]], end, **more)


def ran(case: dict[str, Any], backend: str = "exudyn") -> Result:
    """The result of a case of few nodes; the compiled loop runs as plain Python, which is sooner done."""
    with pytest.MonkeyPatch.context() as patch:
        if backend == "compiled":
            patch.setattr(kernel, "numba_installed", lambda: False)
        return simulate(prepare(Scene.model_validate(case | {"engine": {"backend": backend}})))


def reference_run(case: dict[str, Any]) -> tuple[Floats, Floats]:
    """Times and positions (k, n, 3) [m] of the reference, whose explicit nets keep the listed order."""
    scene = reference_impl.prepare(reference_impl.read_document(case))
    run = scene.integrate(rtol=1e-12, atol=1e-13)
    return run.t, run.x


# Strong enough that each turns over energy within the half second that a test follows.
STRONG: dict[str, dict[str, Any]] = {
    "gravity": {"acceleration": [1.0, -2.0, -9.0]},
    "mass_damping": {"alpha": 0.5},
    "material_damping": {"relaxation_time": 1e-3},
    "orbit": {"mean_motion": 0.5, "model": "two_body", **ORBIT},
    "rayleigh_damping": {"alpha": 0.2, "beta": 1e-5},
    "air_drag": {"density": 1.2, "drag_coefficient": 1.1, "bullet_drag_coefficient": 0.5,
                 "bullet_area": 0.01},
    "bending": {"modulus": 1e9},
    "breaking": {"strain": 0.02},
    "contact": {"threads": ["ball"], "law": "linear", "stiffness": 1e3, "damping": 0.1,
                "friction": {"law": "sticking", "coefficient": 0.3}},
    "j2": {"mean_motion": 0.5, "inclination": 1.0, "argument_of_latitude": 0.5, **ORBIT},
    "launch_force": {"kind": "gas", "force": 30.0, "stroke": 0.1, "spread_angle": 0.8, "chaser_mass": 3.0,
                     "dead_length": 0.2, "exponent": 1.4},
    "molecular_drag": {"density": 1e-4, "flow": [-300.0, 50.0, 0.0], "drag_coefficient": 2.2,
                       "bullet_area": 0.01},
    "self_contact": {"stiffness": 1e5, "radius": 0.002, "damping": 0.5},
    "solar_pressure": {"flux": 1e10, "direction": [0.0, 1.0, 0.0], "pressure_coefficient": 1.3,
                       "bullet_area": 0.01},
    "thermal_strain": {"temperature_change": -80.0, "expansion_coefficient": 1e-4},
    "thrust": {"bullets": [0, 3], "time": [0.05, 0.1, 0.22],
               "force": [[0.0, 0.0, 20.0], [5.0, 0.0, 10.0], [0.0, -8.0, 0.0]]},
}  # fmt: skip


BODIES_ALONE = """
format = 1
title = "Bodies under effects"
time = { end = 1.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-2 }
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 1.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
"""


def bodies_alone(*overrides: str) -> Start:
    """A start with a node that nothing holds, and with the bodies and effects of the overrides."""
    return prepare_case(parse_case(BODIES_ALONE, Path("scene.toml"), overrides))


# Four nodes for the loops of forces, and derivatives

EMPTY = np.zeros(0)
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [1, 3]])


def random_states(number: int, seed: int = 20261121) -> list[tuple[Floats, Floats]]:
    """Positions and velocities (4, 3): elements slack and taut, becoming longer and shorter."""
    random = np.random.default_rng(seed)
    return [(random.normal(0.0, 0.6, (4, 3)), random.normal(0.0, 1.5, (4, 3))) for _ in range(number)]


def gradient(function: Callable[[Floats], Any], x: Floats, h: float = 1e-5) -> Floats:
    """Derivatives of a function of a flat array by central differences of order 4."""
    columns = []
    for k in range(x.size):
        e = np.zeros(x.size)
        e[k] = h
        near, far = function(x + e) - function(x - e), function(x + 2.0 * e) - function(x - 2.0 * e)
        columns.append((8.0 * np.asarray(near) - far) / (12.0 * h))
    return np.array(columns)


def observed(
    ends: np.ndarray,
    length: Floats = EMPTY,
    stiffness: Floats = EMPTY,
    twice_time: Floats = EMPTY,
    *,
    half: Floats = EMPTY,
    look_above: float = 0.0,
    bounds: tuple[int, ...] | None = None,
) -> ObservedSteps:
    """Nothing observed yet of a compiled run; without bounds all elements are one group."""
    bounds = (0, len(ends)) if bounds is None else bounds
    peaks = np.array([(0.0, np.inf, np.inf, look_above)], dtype=PEAKS)
    largest = np.array([(0.0, 0.0, -1)] * (len(bounds) - 1), dtype=LARGEST)
    first, second = 3 * np.reshape(ends, (-1, 2)).T
    numbers = length, stiffness, twice_time, twice_time, np.zeros(len(ends)), length**2
    return ObservedSteps(peaks, largest, np.array(bounds), half, first, second, *numbers)


# Nets with a state to estimate effects from, which are known by hand

SOFT_CABLE = {"area": 1e-3, "density": 1000.0, "youngs_modulus": 1e6}  # 1 kg a metre, EA = 1 kN


def basis_of(net: dict[str, Any], position: Any, velocity: Any, duration: float = 0.5) -> EstimateBasis:
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": SOFT_CABLE} | net))
    return EstimateBasis(woven, duration, np.array(position, dtype=float), np.array(velocity, dtype=float))


def chain(**more: Any) -> EstimateBasis:
    """Three nodes on a line, elements of 0.5 m and 2 m: masses of 0.25, 1.25 and 1 kg."""
    net = {
        "topology": "explicit",
        "nodes": [[0, 0, 0], [0.5, 0, 0], [2.5, 0, 0]],
        "elements": [[0, 1], [1, 2]],
    }
    place, speed = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], [[0, 0, 0], [3, 0, 0], [3, 4, 0]]
    return basis_of(net | more, place, speed)


def opening(duration: float) -> EstimateBasis:
    """2 x 2 meshes of 1 m at a tenth, bullets of 3 kg at the corners fly out at 2, up at 1 m/s."""
    net = {"topology": "square", "size": 2.0, "mesh": 1.0, "bullets": {"mass": 3.0}}
    woven = weave(TypeAdapter(AnyNetConfig).validate_python({"cable": SOFT_CABLE} | net))
    velocity = np.zeros((9, 3))
    corners = woven.reference_position[woven.bullet_nodes]
    velocity[woven.bullet_nodes] = math.sqrt(2.0) * corners + [0.0, 0.0, 1.0]
    return basis_of(net, 0.1 * woven.reference_position, velocity, duration)


# Faults


def refused(case: str | Path, *changes: str) -> list[str]:
    """Keys of the faults of a case, a text or a file, with overrides."""
    with pytest.raises(CaseError) as caught:
        prepare_case(load(case, changes) if isinstance(case, Path) else of_text(case, *changes))
    return [fault.key for fault in caught.value.faults]


def values_of(result: exunet.Result) -> dict[str, float]:
    """Metrics of a result by key, without units."""
    return {key: metric.value for key, metric in exunet.metrics(result).items()}


def of_text(text: str, *changes: str) -> Case:
    """A case that no file has, with overrides."""
    return parse_case(text, Path("scene.toml"), changes)
