"""Scenes and starts that several test files share, and the parametrisation over back ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy.optimize import brentq

import exunet
import reference_impl
from exunet.base.errors import CaseError
from exunet.bodies.distance import polyhedron
from exunet.bodies.rigid import RigidBody
from exunet.bodies.rotations import product, rotation_matrix
from exunet.bodies.shapes import Shape, Solid, TriangleMesh
from exunet.bodies.touched import surface_of
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.contact.law import ContactLaw
from exunet.forces.contact.thread_contact import SKIN, gauss_rules
from exunet.forces.cores import Surface
from exunet.forces.effects import Effects
from exunet.forces.estimate import EstimateBasis
from exunet.forces.terms import KernelTerm, copied
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.workspace import LARGEST, OUTLET, PEAKS, ObservedSteps
from exunet.integrators.exudyn.build import build
from exunet.integrators.exudyn.model import Model
from exunet.kernels import kernel
from exunet.kernels.kernel import ForceTable, Kernel, Takes
from exunet.net import AnyNetConfig, weave
from exunet.net.arrays import NO_TABLE
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
SHIPPED_CASES = sorted(path for path in CASES.rglob("*.toml") if path.parent != CASES / "studies")

# The override of each back end, and the parametrisation of a test over their names.
BACKENDS = {
    "compiled": "engine.backend=compiled",
    "exudyn": "engine.backend=exudyn",
}
every_backend = pytest.mark.parametrize("backend", BACKENDS)

# Bullets of planar_undamped.toml at 1 s and 1.5 s [m/s]: digits that Exudyn, the compiled loop and the
# reference share, and two tolerances of its DOP853 (reference_impl/README.md).
SPEED_AT_1S, SPEED_AT_1_5S = 2.2318743323, 1.621663

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


def with_any_effects(tables: dict[str, Any]) -> Scene:
    """Scene whose effects may contradict each other, which those of a case may not."""
    effects = Effects.model_validate(tables.get("effects", {}))
    return Scene.model_validate(tables | {"effects": {}}).model_copy(update={"effects": effects})


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
    "launch_force": {"kind": "gas", "force": 30.0, "stroke": 0.1, "spread_angle": 0.8, "body": "ball",
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


def without_events(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpret the text of compiled steps for forces without event functions."""
    monkeypatch.setattr(steps, "is_due", lambda *state: False, raising=False)
    monkeypatch.setattr(steps, "shortened", lambda step, *state: step, raising=False)


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
    numbers = (
        length,
        stiffness,
        twice_time,
        twice_time,
        np.zeros(len(ends)),
        np.where(twice_time > 0.0, 0.0, length**2),
    )
    numbers += np.ones(len(ends)), np.zeros(0, dtype=OUTLET), np.zeros(len(ends))
    numbers += np.zeros(len(ends), dtype=np.int64), NO_TABLE
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


# A few listed nodes, as texts of cases

HEAD = """
format = 1
title = "A few nodes"
initial.packing = 1.0
net.topology = "explicit"
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
"""
# Of a line of 10 kN that carries 1 kg: EA (s^3 - s) / 2 = 9.81 N.
STRETCH = brentq(lambda s: 5e3 * (s**3 - s) - 9.81, 1.0, 1.1)
HOIST = f"""
time = {{ end = 1.5, output_step = 0.05 }}
solver = {{ method = "RK44", step = 2e-4 }}
effects.gravity.acceleration = [0.0, 0.0, -9.81]
net.elements = [[0, 1]]  # between what is fixed
net.nodes = [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -2.0]]
net.node_masses = [1.0, 1.0, 1.0]
net.fixed = [0, 1]
[closing]
kind = "line"
nodes = [1]
start = {{ node = 0 }}
end = {{ node = 2 }}
length = {3.0 / STRETCH!r}
stiffness = 1e4
linear_density = 0.0
ring_diameter = 0.001
friction = %s
[closing.winch]
shortest = 0.5
damping = 20.0
"""


def hoist(friction: float, force: float | None = None) -> str:
    """Below `HEAD`: a winch at (-1, 0, 0) that lifts 1 kg over a ring at the origin, 2 m above it.

    The line turns by 90 degrees there, and has at first the weight as tension everywhere. The winch pulls by
    a force [N] from 0.1 s on and locks at 1.2 s; None: it has no commands.
    """
    pull = f'{{ at = 0.1, mode = "tension", force = {force} }}, {{ at = 1.2, mode = "lock" }}'
    return HOIST % friction + ("" if force is None else f"commands = [{pull}]\n")


# Solids, meshes and touched surfaces, and their distances by a second route

SOLID_NUMBERS: dict[str, tuple[float, float, float]] = {
    "box": (1.0, 2.0, 3.0),
    "sphere": (0.7, 0.0, 0.0),
    "capsule": (0.3, 1.5, 0.0),
    "cylinder": (0.5, 2.0, 0.0),
    "frustum": (0.6, 0.2, 1.0),
}
EDGE = 0.08  # edge radius of touched solids [m]
TOUCHED = {
    "box": Solid("box", (0.6, 1.0, 0.4)),
    "cylinder": Solid("cylinder", (0.4, 1.0, 0.0)),
    "sphere": Solid("sphere", (0.5, 0.0, 0.0)),
    "capsule": Solid("capsule", (0.3, 0.9, 0.0)),
    "frustum": Solid("frustum", (0.5, 0.3, 0.8)),
    "widening frustum": Solid("frustum", (0.2, 0.6, 0.7)),
    "cone": Solid("frustum", (0.5, 0.0, 0.9)),  # its core ends in a tip
    "cone upside down": Solid("frustum", (0.0, 0.5, 0.4)),
}
TWO_BOXES = "two boxes side by side"
COMPOUNDS = {
    TWO_BOXES: tuple(Solid("box", (0.6, 1.0, 0.4), (x, 0.0, 0.0)) for x in (-0.3, 0.3)),
    "box and lying cylinder": (
        Solid("box", (0.6, 1.0, 0.4)),
        Solid("cylinder", (0.3, 0.8, 0.0), (0.2, 0.1, 0.25), (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)),
    ),
    "sphere and cone": (
        Solid("sphere", (0.4, 0.0, 0.0), (0.1, 0.0, -0.3)),
        Solid("frustum", (0.5, 0.1, 0.8), (0.0, 0.1, 0.1), (0.8, 0.0, 0.6, 0.0)),
    ),
}
SHAPES = {name: (solid,) for name, solid in TOUCHED.items()} | COMPOUNDS
# An L with legs 0.2 m wide and 0.5 m long, anticlockwise from its inner corner.
OUTLINE = [(-0.05, -0.05), (-0.05, 0.25), (-0.25, 0.25), (-0.25, -0.25), (0.25, -0.25), (0.25, -0.05)]


def extruded(outline: list[tuple[float, float]], half: float) -> TriangleMesh:
    """A prism of an outline whose first corner sees all others; z = -half ... half [m]."""
    n = len(outline)
    vertices = np.array([(x, y, z) for z in (-half, half) for x, y in outline])
    found = [(n, n + k, n + k + 1) for k in range(1, n - 1)] + [(0, k + 1, k) for k in range(1, n - 1)]
    for k in range(n):
        m = (k + 1) % n
        found += [(k, m, n + m), (k, n + m, n + k)]
    return TriangleMesh(vertices, np.array(found))


def mesh_keys(mesh: TriangleMesh, folder: Path, name: str) -> dict[str, str]:
    """Write a mesh into a file in a folder: the keys of a body that name it."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).export(folder / f"{name}.stl")
    return {"shape": "mesh", "file": f"{name}.stl", "unit": "m"}


def body_of(solids: tuple[Solid, ...], edge: float = EDGE) -> RigidBody:
    """A body whose centre of mass and principal axes are not those of its frame."""
    shape = Shape(solids, edge_radius=edge)
    return RigidBody("b", 2.0, (1.0, 2.0, 2.5), (0.05, -0.02, 0.1), (0.8, 0.0, 0.6, 0.0), shape)


@lru_cache
def surface(solids: tuple[Solid, ...], edge: float = EDGE) -> Surface:
    """The touched surface of `body_of`."""
    found = surface_of(body_of(solids, edge))
    assert found is not None
    return found


def contact_of(
    touched: Surface, stiffness: float = 3.0, damping: float = 0.0, thick: float = 0.01, pieces: int = 1
) -> Any:
    """The part of a `ThreadContact` that the loops over one thread, number 0, read."""
    number = len(touched.cores.kind)
    work = SimpleNamespace(
        lines=np.zeros((number, 6)), spans=np.zeros((number, 2)), splits=np.zeros(max(16 * number, pieces)),
        found=np.zeros((pieces, 8)), sums=np.zeros(12), rule=gauss_rules(2, 4, 8),
    )  # fmt: skip
    near = SimpleNamespace(
        clear=np.zeros(1), seen=np.zeros((1, 6)), listed_pieces=np.zeros(1, dtype=np.int64),
        pieces=np.zeros((1, pieces), dtype=np.int64), apart=np.zeros((1, pieces)),
        skin=SKIN * touched.cores.samples.cell,
    )  # fmt: skip
    threads = SimpleNamespace(thick=np.array([thick]), pieces=np.array([pieces]))
    law, body = ContactLaw(stiffness, damping, 1.0, 0.0, 0.0), SimpleNamespace(radius=1.0)
    return SimpleNamespace(
        cores=touched.cores, threads=threads, law=law, body=body, near=near, work=work, after=np.zeros((1, 5))
    )


def in_solid(solid: Solid, points: Floats) -> Floats:
    """Points (..., 3) in the principal axes of `body_of`, in the solid's own axes."""
    body = body_of((solid,))
    in_frame = points @ body.rotation.T + body.centre
    return (in_frame - solid.position) @ rotation_matrix(np.array(solid.attitude))


def to_principal(solid: Solid, vectors: Floats) -> Floats:
    """Vectors (..., 3) in the solid's axes, in the principal axes of `body_of`."""
    turn = rotation_matrix(np.array(solid.attitude))
    return np.asarray(vectors @ turn.T @ body_of((solid,)).rotation)


def in_principal(*point: float) -> Floats:
    """A point in the frame of `body_of`, in its principal axes."""
    return np.asarray(body_of(()).in_principal_axes(np.array(point)))


def rounding_of(solid: Solid, edge: float) -> float:
    """Distance [m] of the surface from the core."""
    return solid.numbers[0] if solid.kind in ("sphere", "capsule") else edge


def half_planes(solid: Solid, edge: float) -> tuple[Floats, Floats]:
    """G, h: the core of a solid of revolution is where G (r, z) <= h, with r from its axis.

    The faces of a cylinder or frustum, moved inwards by the edge radius.
    """
    a, b, c = solid.numbers
    ends = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    if solid.kind in ("sphere", "capsule"):
        return ends, np.array([0.0, 0.5 * b, 0.5 * b])
    if solid.kind == "cylinder":
        a, b, c = a, a, b
    ends[0] = np.array([c, a - b]) / np.hypot(c, a - b)
    return ends, np.array([ends[0] @ [a, -0.5 * c], 0.5 * c, 0.5 * c]) - edge


def from_core(solid: Solid, edge: float, points: Floats) -> tuple[Floats, Floats]:
    """(n,) distances of points (n, 3) from the core, 0 within, and directions (n, 3), in the solid's axes.

    From the outline in the plane through the axis, segment by segment; of a box by clipping.
    """
    if solid.kind == "box":
        limit = 0.5 * np.array(solid.numbers) - edge
        apart = points - np.clip(points, -limit, limit)
        distance = np.linalg.norm(apart, axis=1)
        return distance, apart / np.maximum(distance, 1e-300)[:, None]
    g, h = half_planes(solid, edge)
    (c, s), high, low = g[0], h[1], -h[2]
    if h[0] - s * low < 0.0:  # the side meets the axis above the end
        low = h[0] / s
    if h[0] - s * high < 0.0:
        high = h[0] / s
    outline = np.array([[0.0, low], [(h[0] - s * low) / c, low], [(h[0] - s * high) / c, high], [0.0, high]])
    across = np.hypot(points[:, 0], points[:, 1])
    at = np.stack([across, points[:, 2]], axis=1)
    distance, apart = np.full(len(points), np.inf), np.zeros_like(at)
    for begin, end in pairwise(outline):
        side = end - begin
        part = np.clip((at - begin) @ side / (side @ side), 0.0, 1.0) if side.any() else np.zeros(len(points))
        this = at - begin - part[:, None] * side
        nearer = np.linalg.norm(this, axis=1) < distance
        apart[nearer] = this[nearer]
        distance = np.linalg.norm(apart, axis=1)
    apart[(at @ g.T <= h).all(axis=1)] = 0.0
    distance = np.linalg.norm(apart, axis=1)
    around = points[:, :2] / np.maximum(across, 1e-300)[:, None]
    direction = np.column_stack([around * apart[:, :1], apart[:, 1]])
    return distance, direction / np.maximum(distance, 1e-300)[:, None]


def distance_from_solid(solid: Solid, points: Floats) -> Floats:
    """(n,) distances of points (n, 3) in the solid's axes, 0 within."""
    return np.maximum(from_core(solid, 0.0, points)[0] - rounding_of(solid, 0.0), 0.0)


# Bodies that touch each other; the net is one thread far away

TWO_BODIES = """
format = 1
title = "Two bodies that meet"
time = { end = 100.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-4 }
engine.backend = "compiled"
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 5e3], [0.0, 1.0, 5e3]]
net.elements = [[0, 1]]
net.cable = { diameter = 0.002, density = 1000.0, youngs_modulus = 1e6 }
[effects.contact]
bodies = [["one", "other"]]
law = "linear"
body_stiffness = 1e4
damping = 0.0
"""
# A ball of 2 kg and one of 3 kg, which meet head-on after 0.1 s at 1 m/s.
BALLS = (
    'bodies.one={shape="sphere",radius=0.3,mass=2.0,position=[-0.5,0.0,0.0],velocity=[0.5,0.0,0.0]}',
    'bodies.other={shape="sphere",radius=0.2,mass=3.0,position=[0.1,0.0,0.0],velocity=[-0.5,0.0,0.0]}',
)
# A box, and a body of a box, a capsule and a ball, that turn and meet off their centres.
ODD = (
    'bodies.one={shape="box",size=[0.5,0.4,0.3],edge_radius=0.06,mass=2.0,position=[-0.6,0.1,0.05],'
    "velocity=[1.0,0.0,0.0],angular_velocity=[0.5,1.0,-2.0]}",
    "bodies.other={edge_radius=0.05,mass=3.0,position=[0.4,0.0,0.0],angular_velocity=[-1.0,0.3,0.5],parts={"
    'a={shape="box",size=[0.6,0.5,0.4]},b={shape="capsule",radius=0.08,length=0.3,position=[-0.2,0.3,0.1]},'
    'c={shape="sphere",radius=0.2,position=[-0.2,0.1,0.2]}}}',
)
FRICTION = (
    "effects.contact.friction.coefficient=0.3",
    'effects.contact.friction.law="regularised"',
    "effects.contact.friction.slip_speed=1e-2",
)


def bounces(restitution: float) -> tuple[str, ...]:
    """Overrides with which an impact at 1 m/s has a restitution."""
    law = f"restitution={restitution},impact_speed=1.0"
    return (f'effects.contact={{bodies=[["one","other"]],law="linear",body_stiffness=1e4,{law}}}',)


def momenta_of_bodies(sim: Simulation) -> tuple[Floats, Floats]:
    """Momentum (3,) and angular momentum (3,) of the bodies, about the origin."""
    rigid, push, moment = sim.state.bodies, np.zeros(3), np.zeros(3)
    for k, body in enumerate(sim.start.system.bodies):
        own = body.mass * rigid.velocity[k]
        spin = np.array(body.inertia) * rigid.angular_velocity[k]
        push = push + own
        moment = moment + np.cross(rigid.position[k], own) + rotation_matrix(rigid.attitude[k]) @ spin
    return push, moment


# Nets and threads in contact: few scenes, so that few kernels are compiled

# A square net of four sides of 0.4 m with a bullet on a string of 1 m at each corner, over a fixed plate;
# its top is the plane z = -0.05. The cables are so soft that nodes move as if they were alone: a thread that
# falls flat gives each of its nodes a force in proportion to its mass.
SIDE, STRING = 0.4, 1.0  # m
DIAMETER, DENSITY = 1e-3, 1000.0  # m, kg/m3
PLATE = f"""
format = 1
title = "A net on a plate"
time = {{ end = 100.0, output_step = 1.0 }}
solver = {{ method = "RK44", step = 1e-5 }}
engine.backend = "compiled"
initial = {{ packing = 1.0, velocity = [0.0, 0.0, 0.0] }}
net.topology = "square"
net.size = {SIDE}
net.mesh = {SIDE}
net.cable = {{ diameter = {DIAMETER}, density = {DENSITY}, youngs_modulus = 1e-3 }}
net.strings = {{ diameter = {DIAMETER}, density = {DENSITY}, youngs_modulus = 1e-3, length = {STRING} }}
net.bullets.mass = 1e-12
effects.gravity.acceleration = [0.0, 0.0, 0.0]
effects.contact = {{ threads = ["plate"], bullets = ["plate"], bullet_radius = 0.02 }}
[bodies.plate]
shape = "box"
size = [20.0, 20.0, 0.4]
edge_radius = 0.05
position = [0.0, 0.0, -0.25]
mass = 10.0
motion = "fixed"
"""
# The same net, of threads of four elements, thrown at a free box that turns: threads and a bullet touch it
# off its centre from 20 ms on.
BOX = (0.25, 0.2, 0.1)  # m
NET_ON_BOX = f"""
format = 1
title = "A net on a free box"
time = {{ end = 1.0, output_step = 0.01 }}
solver = {{ method = "RK44", step = 1e-5 }}
engine.backend = "compiled"
initial = {{ packing = 1.0, velocity = [0.1, 0.0, -1.0] }}
net.topology = "square"
net.size = {SIDE}
net.mesh = {SIDE}
net.divisions = 4
net.cable = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e5 }}
net.strings = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e5, length = 0.1 }}
net.bullets.mass = 0.01
[effects.contact]
threads = ["box"]
bullets = ["box"]
bullet_radius = 0.01
law = "linear"
stiffness = 1e4
bullet_stiffness = 1e3
restitution = 0.5
impact_speed = 1.0
friction = {{ law = "sticking", coefficient = 0.3 }}
[bodies.box]
shape = "box"
size = {list(BOX)}
edge_radius = 0.02
position = [0.25, 0.2, -0.08]
velocity = [0.0, 0.05, 0.0]
angular_velocity = [0.3, -0.2, 0.5]
mass = 0.5
"""
RADIUS, STIFFNESS = 0.005, 4e4  # m, N/m2
REACH = 2 * RADIUS
# Two threads of two elements each, which cross 12 mm apart near a node of the second.
CROSSED = f"""
format = 1
title = "Two threads that cross"
time = {{ end = 0.1, output_step = 0.002 }}
solver = {{ method = "RK44", step = 1e-4 }}
engine.backend = "compiled"
initial = {{ packing = 1.0, node_velocities = [[0, 0, 0.4], [0, 0, 0.5], [0, 0, 0.4], [0, 0, 0], [0, 0, 0],
  [0, 0, 0]] }}
net.topology = "explicit"
net.nodes = [[-0.5, 0, 0], [0, 0, 0], [0.5, 0, 0], [0.05, -0.5, 0.012], [0.06, 0.001, 0.012],
  [0.2, 0.5, 0.012]]
net.elements = [[0, 1], [1, 2], [3, 4], [4, 5]]
net.node_masses = [0.01, 0.012, 0.014, 0.016, 0.018, 0.02]
net.cable = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e6 }}
effects.self_contact = {{ radius = {RADIUS}, stiffness = {STIFFNESS}, damping = 0.0 }}
"""
LINEAR: dict[str, Any] = {"law": "linear", "stiffness": 2e3, "bullet_stiffness": 1e-9}
HERTZ: dict[str, Any] = {"law": "hertz", "modulus": 2e3}


def overrides(group: str, keys: Mapping[str, Any]) -> list[str]:
    """Overrides of the keys of a table."""
    return [f"{group}.{key}={_as_toml(value)}" for key, value in keys.items()]


def contact(**keys: Any) -> list[str]:
    """Overrides of `[effects.contact]`."""
    return overrides("effects.contact", keys)


def _as_toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def simulation(folder: Path, text: str, *changes: str) -> exunet.Simulation:
    """The scene with overrides, at its start."""
    path = folder / "scene.toml"
    path.write_text(text)
    return exunet.Simulation(str(path), list(changes))


def as_mesh(folder: Path, text: str, size: tuple[float, float, float], more: str = "") -> str:
    """A scene with a mesh of a box of this size [m], in a file, in the place of its box; more : keys."""
    keys = mesh_keys(polyhedron(Solid("box", size)), folder, "box")
    lines = "\n".join(f"{key} = {_as_toml(value)}" for key, value in keys.items())
    begin, _, rest = text.partition('shape = "box"\n')
    _, _, after = rest.partition("\n")
    return "\n".join([begin + lines, more, after])


def net_on_box(folder: Path, shape: str, *changes: str) -> exunet.Simulation:
    """`NET_ON_BOX` with its box as a "solid", or as a "mesh"."""
    text = as_mesh(folder, NET_ON_BOX, BOX) if shape == "mesh" else NET_ON_BOX
    return simulation(folder, text, *changes)


def taken_by_contact(sim: exunet.Simulation) -> tuple[float, float]:
    """Energy [J] that its damping and its friction have taken."""
    blocks, values = sim.start.system.blocks, sim.view.first_order
    first = blocks.n_x - blocks.n_states
    damping, friction = (values[blocks.state(f"contact/{name}") - first] for name in ("damping", "friction"))
    return float(damping), float(friction)


def crossing(apart: float, angle: float) -> float:
    """Force [N] of long threads that cross: the integral over the ellipse in which they are near, by hand."""
    return 2 * STIFFNESS / (3 * REACH**2) * apart * (REACH**2 - apart**2) ** 1.5 / math.sin(angle)


class Placed:
    """A start whose nodes and bodies may be put somewhere else; the axes of bodies are the principal ones."""

    def __init__(self, start: Start) -> None:
        self.start, self.blocks = start, start.system.blocks
        self.x, self.v = start.system.layout.pack(start.state.moving)
        self.names = [body.name for body in start.system.bodies]
        self.nodes = slice(0, 3 * start.net.n_nodes)

    def terms(self) -> list[tuple[KernelTerm, Any]]:
        """The terms with discrete state, and their data."""
        return [(term, term.data) for term in self.start.system.forces.kernels if term.discrete]

    def centre(self, name: str = "target") -> Floats:
        return self.x[self.blocks.centre(name) :][:3]

    def attitude(self, name: str = "target") -> Floats:
        return self.x[self.blocks.attitude(name) :][:4]

    def turn(self, name: str = "target") -> Floats:
        """Rotation from a body's axes to the scene's."""
        return rotation_matrix(self.attitude(name))

    def spin(self, name: str = "target") -> Floats:
        """Angular velocity (3,) [rad/s] in the scene's axes."""
        return np.asarray(self.turn(name) @ self.v[self.blocks.spin(name) :][:3])

    def in_body(self, place: Any, name: str = "target") -> Floats:
        """A place (3,) of the scene in a body's axes, from its centre."""
        return np.asarray((place - self.centre(name)) @ self.turn(name))

    def in_scene(self, place: Any, name: str = "target") -> Floats:
        """Where in the scene a place of a body is."""
        return np.asarray(self.turn(name) @ place + self.centre(name))

    def velocity(self, place: Any, name: str = "target") -> Floats:
        """Velocity (3,) [m/s] of a body's point at a place of the scene."""
        of_centre = self.v[self.blocks.centre(name) :][:3]
        return np.asarray(of_centre + np.cross(self.spin(name), place - self.centre(name)))

    def move_on(self, time: float) -> None:
        """All go on as they move for a time [s]."""
        self.x[self.nodes] += time * self.v[self.nodes]
        for name in self.names:
            spin = self.v[self.blocks.spin(name) :][:3]
            angle = 0.5 * time * float(np.linalg.norm(spin))
            turned = [math.cos(angle), *(0.5 * time * np.sinc(angle / math.pi) * spin)]
            self.centre(name)[:] += time * self.v[self.blocks.centre(name) :][:3]
            self.attitude(name)[:] = product(self.attitude(name).copy(), np.array(turned))

    def stored(self) -> float:
        """Energy of contact [J]."""
        return sum(float(term.potential(self.x, copied(data))) for term, data in self.terms())  # type: ignore[misc]

    def rate_of_energy(self) -> float:
        """Its rate [W] as all goes on, by central differences."""
        here, energies = self.x.copy(), []
        for time in (1e-6, -1e-6):
            self.move_on(time)
            energies.append(self.stored())
            self.x[:] = here
        return (energies[0] - energies[1]) / 2e-6

    def gained(self, force: Floats) -> tuple[float, float]:
        """Largest components [N, N m] of all forces, and of their moments about the origin, in sum."""
        on_nodes, places = (values[self.nodes].reshape(-1, 3) for values in (force, self.x))
        total, moment = on_nodes.sum(axis=0), np.cross(places, on_nodes).sum(axis=0)
        for name in self.names:
            on_body, torque = (force[of(name) :][:3] for of in (self.blocks.centre, self.blocks.spin))
            total = total + on_body
            moment = moment + np.cross(self.centre(name), on_body) + self.turn(name) @ torque
        return float(np.abs(total).max()), float(np.abs(moment).max())


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


# A net of 0.6 m is thrown at a ball of 0.16 m, and reaches it after 0.11 s.
SMALL_NET_AT_BALL = """
format = 1
title = "A net is thrown at a ball"
[time]
end = 0.3
output_step = 0.01
[solver]
method = "RK44"
step = 1.4e-4
[engine]
backend = "compiled"
[net]
topology = "square"
size = 0.6
mesh = 0.15
[net.cable]
diameter = 0.001
density = 1390.0
youngs_modulus = 1e8
[net.bullets]
mass = 0.01
[initial]
packing = 0.98
velocity = [0.0, 0.0, 2.0]
[effects.material_damping]
relaxation_time = 1e-4
[effects.contact]
threads = ["ball_1"]
bullets = ["ball_1"]
bullet_radius = 0.01
law = "linear"
stiffness = 3e3
bullet_stiffness = 3e3
restitution = 0.3
impact_speed = 2.0
[bodies.ball_1]
shape = "sphere"
radius = 0.08
mass = 0.5
position = [0.02, 0.03, 0.3]
[capture]
target = "ball_1"
enclosed = 0.8
duration = 0.1
"""

# A net of 1 m is thrown at a ball of 0.3 m: a line round its edge closes it, and a reel pays out a tether.
NET_AT_BALL = """
format = 1
title = "A net is thrown at a ball"
[time]
end = 2.0
output_step = 0.01
[solver]
method = "RK44"
step = 2e-4
[engine]
backend = "compiled"
[net]
topology = "square"
size = 1.0
mesh = 0.25
[net.cable]
diameter = 0.001
density = 1390.0
youngs_modulus = 1e8
[net.bullets]
mass = 0.02
[initial]
packing = 0.98
velocity = [0.0, 0.0, 2.0]
[effects.material_damping]
relaxation_time = 1e-4
[bodies.ball]
shape = "sphere"
radius = 0.15
mass = 1.0
position = [0.02, 0.03, 0.5]
[bodies.chaser]
shape = "box"
size = [0.4, 0.4, 0.4]
motion = "fixed"
mass = 1.0
position = [0.0, 0.0, -0.3]
[tethers.tow]
length = 3.0
divisions = 3
diameter = 0.001
density = 1390.0
youngs_modulus = 1e8
start = { body = "chaser", point = [0.0, 0.0, 0.2] }
end = { node = 12 }
[tethers.tow.reel]
damping = 5.0
largest_rate = 5.0
paid_out = 0.3
commands = [{ at = 0.0, mode = "brake", force = 0.0 }]
[effects.contact]
threads = ["ball"]
bullets = ["ball"]
bullet_radius = 0.01
law = "linear"
stiffness = 3e3
bullet_stiffness = 3e3
restitution = 0.3
impact_speed = 2.0
friction = { law = "sticking", coefficient = 0.4 }
[closing]
kind = "line"
rings = "edge"
length = 4.0
stiffness = 100.0
linear_density = 1e-3
ring_diameter = 0.01
friction = 0.0
[closing.winch]
shortest = 0.4
damping = 0.5
largest_rate = 6.0
commands = [{ at = 0.2, mode = "tension", force = 2.5 }, { at = 1.2, mode = "lock" }]
[capture]
target = "ball"
enclosed = 0.8
mouth = 0.28
duration = 0.3
"""
