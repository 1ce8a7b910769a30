"""Whole runs: the paper's net up to its first snap, scenes with an empty set, random scenes and captures."""

from __future__ import annotations

import json
import math
import re
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pytest
from commands import command
from numpy.random import Generator
from scenes import BACKENDS, CASES, OUTLINE, every_backend, extruded, mesh_keys

import exunet
from exunet.base.errors import CaseError, InputError, RunStopped
from exunet.bodies.distance import polyhedron
from exunet.bodies.shapes import Solid
from exunet.integrators.exudyn.build import expected_items
from exunet.model.system import State, System
from exunet.results.ensemble import load_ensemble
from exunet.results.io import load_result, save
from exunet.results.measures import bullet_speeds, energy_balance, momentum_books
from exunet.results.result import Result
from exunet.results.summary import summarise
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.simulation.guards import ENERGY_BOUND
from exunet.simulation.observers import Observer
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import run_into, simulate
from exunet.simulation.simulation import OBSERVERS

# The paper's net


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_case_flies_until_its_strings_snap(path):
    """Bullets leave at 2.5 m/s along the diagonals; the strings of sqrt(2) m, packed to a part p of that, are
    taut when they have gone sqrt(2) (1 - p) m. Without damping they fly freely, and the net lies still.

    Eq. (13) damps with alpha, and along the slack strings too, with up to beta EA / (L m) = 0.0124 / s: it
    slows the bullets and drags the light corners after them, so the strings snap later. It stops a launch, a
    packing, a damping or stored times that are not those of the case.
    """
    case = exunet.load(path, ["time.end=0.6", "time.output_step=0.05"])
    run = exunet.run(case)
    assert run.complete
    assert run.time == pytest.approx(0.05 * np.arange(13), abs=1e-12)
    snap = math.sqrt(2.0) * (1.0 - case.scene.initial.packing) / 2.5
    before = run.time < snap
    assert before.sum() == 11  # 0.50912 s and 0.53174 s, by packing
    assert not run.tension[before].any()

    damping = case.scene.effects.rayleigh_damping
    alpha, beta = (damping.alpha, damping.beta) if damping else (0.0, 0.0)
    rate = beta * 70e9 * math.pi / 4 * 0.004**2 / math.sqrt(2.0) / 0.5
    speeds = bullet_speeds(run)[before].T
    assert np.all(speeds <= 2.5 * np.exp(-alpha * run.time[before]) + 1e-9)
    assert np.all(speeds >= 2.5 * np.exp(-(alpha + rate) * run.time[before]) - 1e-9)
    knots = np.setdiff1d(np.arange(run.net.n_nodes), run.net.bullet_nodes)
    if not damping:
        assert np.abs(run.position[before][:, knots] - run.position[0, knots]).max() < 1e-12
    else:
        assert speeds[0, -1] < 2.5 * np.exp(-alpha * 0.5) - 1e-4

    peak = run.run.largest_tension
    assert run.net.is_string[peak.element]
    assert snap < peak.time < (0.6 if damping else snap + 5e-4)  # the snap lasts half a millisecond
    assert np.abs(run.velocity[-1, knots]).max() > 1.0  # 6 g a knot take much of a snap of 0.5 kg at 2.5 m/s
    assert energy_balance(run) < 1e-5
    assert np.abs(run.momentum).max() < 1e-9  # four bullets that mirror each other


# Scenes with an empty set: no element, no free node


FAULTS = Path(__file__).parents[1] / "data" / "faults"
ONE_ELEMENT = (
    "net.nodes=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
    "net.elements=[[0, 1]]",
    "net.node_masses=[0.1, 0.1]",
)
NO_ELEMENT = "no_elements.toml"


@every_backend
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        (NO_ELEMENT, ()),
        (NO_ELEMENT, ONE_ELEMENT),
        ("all_fixed.toml", ()),
        ("tether_between_prescribed.toml", ()),
        ("thread_between_prescribed.toml", ()),
        ("slack_or_taut.toml", ()),
        ("self_contact_no_elements.toml", ()),
    ],
    ids=["no element", "one element", "all fixed", "tether", "thread", "slack or taut", "self-contact"],
)
def test_a_scene_with_an_empty_set_runs_with_checkpoints(
    tmp_path: Path, name: str, changes: tuple[str, ...], backend: str
) -> None:
    """No number of its result is NaN; a summary is made of it."""
    changes = ("time.end=0.2", "time.output_step=0.1", BACKENDS[backend], *changes)
    run_into(tmp_path, exunet.load(FAULTS / name, changes), checkpoint_every=0.1)
    result = load_result(tmp_path)
    assert np.isfinite(result.position).all()
    assert np.isfinite(result.kinetic + result.potential).all()
    assert summarise(result)["verdict"] == "ok"


class Reporting(Observer):
    """Reports numbers, and what is no finite number."""

    def __init__(self, _system: System, _state: State) -> None:
        pass

    def report(self) -> dict[str, Any]:
        numbers = {"float": np.float64(1.5), "whole": np.int64(3)}
        return {**numbers, "nan": math.nan, "array": np.array([1.0]), "text": "text", "none": None}


def test_a_report_without_a_finite_number_costs_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(OBSERVERS, "own", f"{__name__}:Reporting")
    case = exunet.load(FAULTS / NO_ELEMENT, ["time.end=0.2", "time.output_step=0.1"])
    run_into(tmp_path, case)
    expected = {"float": 1.5, "whole": 3.0, **dict.fromkeys(("nan", "array", "text", "none"))}
    assert load_result(tmp_path).run.observed == expected


def test_the_command_describes_a_scene_without_elements(tmp_path: Path) -> None:
    settings = ("--set", "time.end=0.2", "--set", "time.output_step=0.1", "--out", "out")
    ended = command("run", FAULTS / NO_ELEMENT, *settings, folder=tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.ci
@pytest.mark.slow
def test_a_metric_may_be_absent_in_some_of_the_perturbed_runs(tmp_path: Path) -> None:
    """A net at the edge of slackness is taut in some runs only; a range of a tension does not go below 0."""
    ended = command("run", FAULTS / "slack_or_taut.toml", "--ensemble", 8, "--out", "out", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    ranges = load_ensemble(tmp_path / "out" / "ensemble.h5")
    tension = ranges.range("net_largest_tension_N")
    assert tension is not None
    assert 0 < tension.runs < tension.of_runs
    assert tension.low >= 0.0


@pytest.mark.slow
def test_a_long_fall_is_not_taken_for_a_divergence(tmp_path: Path) -> None:
    """The balance of free fall is off by round-off of the kinetic energy, 1e-10 of it after 4e6 steps."""
    case = exunet.load(FAULTS / "long_fall.toml", ["time.end=36.0", "solver.method=VelocityVerlet"])
    result = exunet.run(case)
    assert result.time[-1] == 36.0


# Against hand calculations, by Exudyn

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e9}
SPHERE = {"shape": "sphere", "radius": 0.1, "mass": 1.0}
PRESCRIBED = {
    "a": SPHERE | {"motion": "prescribed", "velocity": [0.0, 0.0, 0.1]},
    "b": SPHERE | {"motion": "prescribed", "position": [1.0, 0.0, 0.0], "velocity": [0.1, 0.0, 0.0]},
}
THREAD = {"nodes": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "elements": [[0, 1]]}


def run(net: dict[str, object], **tables: object) -> exunet.Result:
    """Run a scene; the items that Exudyn makes are those that `exunet check` reports."""
    document = {
        "format": 1,
        "title": "nothing is free",
        "time": {"end": 0.02, "output_step": 0.01},
        "engine": {"backend": "exudyn"},
        "net": {"topology": "explicit", "cable": CABLE, **net},
        "initial": {"packing": 1.0},
        "effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
        **tables,
    }
    scene = Scene.model_validate(document)
    result = exunet.run(scene)
    assert result.run.items == expected_items(prepare(scene).system)
    return result


@pytest.mark.parametrize("between", ["thread", "tether"])
def test_an_element_between_prescribed_bodies(between: str) -> None:
    """From (0, 0, 0.1 t) to (1 + 0.1 t, 0, 0): by EA and the Green-Lagrange strain."""
    if between == "thread":
        ties = [{"attachments": {"x": {"point": [0.0, 0.0, 0.0], "node": node}}} for node in (0, 1)]
        tied = {name: PRESCRIBED[name] | tie for name, tie in zip("ab", ties, strict=True)}
        result = run(THREAD, bodies=tied)
    else:
        far = {"nodes": [[0.0, 30.0, 0.0]], "elements": [], "node_masses": [0.1], "fixed": [0]}
        tether = CABLE | {"length": 1.0, "start": {"body": "a"}, "end": {"body": "b"}}
        result = run(far, bodies=PRESCRIBED, tethers={"t": tether})
    squared = (1.0 + 0.1 * result.time) ** 2 + (0.1 * result.time) ** 2
    tension = 1e9 * np.pi * 1e-6 * 0.5 * (squared - 1.0) * np.sqrt(squared)
    assert result.tension[:, -1] == pytest.approx(tension, rel=1e-12)


def test_a_free_body_beside_a_net_of_fixed_nodes() -> None:
    result = run(THREAD | {"fixed": [0, 1]}, bodies={"a": SPHERE | {"position": [0.0, 3.0, 0.0]}})
    assert result.bodies["a"].position[:, 2] == pytest.approx(-0.5 * 9.81 * result.time**2, abs=1e-12)
    assert np.array_equal(result.position, np.broadcast_to(THREAD["nodes"], (3, 2, 3)))
    assert not result.tension.any()


# Random scenes: each ends in a sound result or a typed refusal; what failed once is in cases/hard/found

Tables = dict[str, dict[str, Any]]
MAX_TIME = 60.0  # [s] of processor time a scene; the slowest takes 15
TOPOLOGIES = ("square", "rectangular", "hexagonal", "radial", "cut", "explicit")
EXPLICIT_METHODS = ("VelocityVerlet", "RK44", "RK33", "RK67", "ExplicitEuler", "ExplicitMidpoint")
IMPLICIT_METHODS = ("GeneralizedAlpha", "TrapezoidalIndex2")
PACKINGS = (0.0, 1e-6, 0.01, 0.1, 0.5, 0.9, 0.999, 1.0, 1.001, 1.05, 1.4, 3.0)
_HILL = {"radial": [0.0, 0.6, 0.8], "along_track": [1.0, 0.0, 0.0]}
# Sets of effects, not any subset: each set is one compiled kernel.
EFFECTS: tuple[dict[str, dict[str, Any]], ...] = (
    {},
    {},
    {},
    {"rayleigh_damping": {"alpha": 1e-3, "beta": 1e-8}},
    {"rayleigh_damping": {"alpha": 0.0, "beta": 1e-4}},
    {"mass_damping": {"alpha": 5.0}},
    {"material_damping": {"relaxation_time": 1e-4}},
    {"gravity": {"acceleration": [0.0, 0.5, -9.81]}},
    {"orbit": {**_HILL, "mean_motion": 0.3, "model": "linear"}},
    {"orbit": {**_HILL, "altitude": 7e5, "model": "two_body"}},
    {"thermal_strain": {"temperature_change": -100.0, "expansion_coefficient": 5e-5}},
    {"bending": {"modulus": 1e6}},
    {"breaking": {"strain": 0.01}},
    {"air_drag": {"density": 1.2, "drag_coefficient": 1.1}},
    {
        "rayleigh_damping": {"alpha": 1.0, "beta": 0.0},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "material_damping": {"relaxation_time": 1e-5},
    },
)
# Effects that act between nodes only, so that the linear momentum stays.
INTERNAL = {"material_damping", "thermal_strain", "bending", "breaking"}
MOMENTUM = 1e-9  # of sum m |v|: round-off of some thousand steps
ANGULAR = 0.05  # of sum m |x| |v|: as the energy, for the same coarse steps
TARGET = "target"
MESH = 0.25  # [m] of the nets of captures
# Of the size of the balance of momentum: what round-off of some ten thousand steps leaves. These steps may be
# the largest that are stable.
LINEAR = 1e-10
SHAPES = ("sphere", "box", "cylinder", "capsule", "frustum", "parts", "mesh")


def document(seed: int) -> Tables:
    """The tables of a random case; the same seed gives the same case."""
    random = np.random.default_rng(seed)
    kind = str(random.choice(TOPOLOGIES))
    tables = {"": {"format": 1, "title": f"fuzz {seed}"}, "time": {}, "solver": {}, "engine": _engine(random)}
    tables["net"] = _net(kind, random)
    tables["net.cable"] = _cable(random)
    thrown = kind != "explicit"
    if thrown and random.random() < 0.8:
        strings = _cable(random) if random.random() < 0.5 else dict(tables["net.cable"])
        length, divisions = float(random.uniform(0.8, 2.0)), int(random.integers(1, 3))
        tables["net.strings"] = strings | {"length": length, "divisions": divisions}
        tables["net.bullets"] = {"mass": float(10.0 ** random.uniform(-4.0, 4.0))}
    tables["initial"] = {"packing": float(random.choice(PACKINGS))}
    for name, keys in EFFECTS[int(random.integers(len(EFFECTS)))].items():
        tables[f"effects.{name}"] = dict(keys)
        if name == "air_drag" and "net.bullets" in tables:
            tables[f"effects.{name}"] |= {"bullet_drag_coefficient": 0.5, "bullet_area": 1e-3}
    _clock(tables, random)
    return {name: keys for name, keys in tables.items() if keys}


def text(tables: Tables) -> str:
    """A case file; JSON writes strings, numbers, lists and true as TOML does."""
    parts = []
    for name, keys in tables.items():
        lines = [f"{key} = {_value(value)}" for key, value in keys.items()]
        parts.append("\n".join([f"[{name}]", *lines] if name else lines))
    return "\n\n".join(parts) + "\n"


def _value(value: Any) -> str:
    """Return the TOML of a value; a dictionary becomes an inline table."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)


def _engine(random: Generator) -> dict[str, Any]:
    return {"backend": "compiled" if random.random() < 0.35 else "exudyn"}


def _net(kind: str, random: Generator) -> dict[str, Any]:
    net: dict[str, Any] = {"topology": kind, "divisions": int(random.choice([1, 1, 1, 2, 4]))}
    a, b = (int(n) for n in random.integers(1, 4, size=2))
    match kind:
        case "square":
            return net | {"mesh": 1.0, "size": float(a)}
        case "rectangular":
            return net | {"mesh": [1.0, 0.5], "size": [float(a), 0.5 * b]}
        case "hexagonal":
            return net | {"mesh": 0.7, "rings": int(random.integers(0, 2))}
        case "radial":
            return net | {"radius": float(b), "spokes": a + 2, "rings": b}
        case "cut":
            outline = str(random.choice(["square", "hexagon", "octagon"]))
            shape = str(random.choice(["square", "triangle"]))
            net |= {"outline": outline, "mesh_shape": shape, "border": _cable(random)}
            return net | {"mesh": 0.7, "size": 0.5 * a + 2.0}
    count = int(random.integers(2, 8))
    nodes = random.uniform(-1.5, 1.5, size=(count, 3)).round(6)
    pairs = {(k, k + 1) for k in range(count - 1)}
    for _ in range(int(random.integers(0, count))):
        pairs.add(tuple(sorted(random.choice(count, size=2, replace=False).tolist())))
    masses = np.where(random.random(count) < 0.4, 10.0 ** random.uniform(-4, 4, size=count), 0.0)
    net |= {"nodes": nodes.tolist(), "elements": sorted(pairs), "node_masses": masses.tolist()}
    if random.random() < 0.4:
        net["fixed"] = sorted(
            random.choice(count, size=int(random.integers(1, count)), replace=False).tolist()
        )
    return net


def _cable(random: Generator) -> dict[str, float]:
    return {
        "diameter": float(10.0 ** random.uniform(-5.0, -1.0)),
        "density": float(10.0 ** random.uniform(1.0, 5.0)),
        "youngs_modulus": float(10.0 ** random.uniform(3.0, 13.0)),
    }


def _clock(tables: Tables, random: Generator) -> None:
    """Duration, speeds and steps that go with the fastest frequency: things happen, in bounded time."""
    cable = tables["net.cable"]
    wave = float(np.sqrt(cable["youngs_modulus"] / cable["density"]))
    frequency = 2.0 * wave / 0.5 * tables["net"]["divisions"]
    if "net.strings" in tables:
        strings = tables["net.strings"]
        frequency = max(frequency, 2.0 * np.sqrt(strings["youngs_modulus"] / strings["density"]))
    end = float(10.0 ** random.uniform(0.5, 3.2) / frequency)
    tables["time"]["end"] = end
    if random.random() < 0.7:
        tables["time"]["output_step"] = end / float(10.0 ** random.uniform(0.0, 2.0))
    else:
        tables["time"]["output_times"] = np.unique(random.uniform(0.0, end, size=5)).tolist()
    speed = min(float(random.uniform(0.1, 3.0)) / end, wave * 10.0 ** float(random.uniform(-3.0, 0.5)))
    initial = tables["initial"]
    if random.random() < 0.5:
        initial["velocity"] = (speed * random.normal(size=3)).tolist()
    if random.random() < 0.6:
        initial["spin"] = (speed * random.normal(size=3)).tolist()
    if "net.bullets" in tables and random.random() < 0.9:
        tables["launch"] = {"radial_speed": speed, "axial_speed": speed * float(random.normal())}
    if tables["net"]["topology"] == "explicit" and random.random() < 0.7:
        count = len(tables["net"]["nodes"])
        initial["node_velocities"] = (speed * random.normal(size=(count, 3))).tolist()
    tables["solver"] = _solver(frequency, end, random)


def _solver(frequency: float, end: float, random: Generator) -> dict[str, Any]:
    solver: dict[str, Any] = {"retry": int(random.integers(0, 3))}
    choice = random.random()
    if choice < 0.3:
        return solver | {"accuracy": float(10.0 ** random.uniform(-8.0, 0.0))}
    if choice < 0.45:
        method, least = ("DOPRI5", -9.0) if random.random() < 0.5 else ("ODE23", -5.0)
        return solver | {"method": method, "tolerance": float(10.0 ** random.uniform(least, 0.0))}
    method = str(random.choice(EXPLICIT_METHODS if choice < 0.85 else IMPLICIT_METHODS))
    step = float(10.0 ** random.uniform(-1.5, 1.0)) / frequency
    most = 10_000 if method in EXPLICIT_METHODS else 500
    solver |= {"method": method, "step": max(step, end / most)}
    if random.random() < 0.5:
        solver["force"] = True
    return solver


# Captures


def capture(seed: int, folder: Path) -> Tables:
    """The tables of a random capture; the same seed gives the same case. A mesh goes into the folder."""
    random = np.random.default_rng([seed, 14])
    speed = float(10.0 ** random.uniform(-0.5, 1.0))
    shape, half = _shape(random, folder)
    gap = float(random.uniform(0.01, 0.1))
    end = (gap + float(random.uniform(0.1, 1.0)) * half) / speed
    tables: Tables = {"": {"format": 1, "title": f"capture {seed}"}}
    tables["time"] = {"end": end, "output_step": end / 20.0}
    tables["solver"] = _capture_solver(random)
    tables["engine"] = {"backend": "compiled" if random.random() < 0.9 else "exudyn"}
    tables["net"] = _capture_net(random)
    tables["net.cable"] = {
        "diameter": 1e-3,
        "density": 1390.0,
        "youngs_modulus": float(10.0 ** random.uniform(6.5, 8.5)),
    }
    if bullets := random.random() < 0.7:
        tables["net.bullets"] = {"mass": float(10.0 ** random.uniform(-3.0, 0.0))}
        if tables["net"]["topology"] == "hexagonal":  # whose bullets hang on bridles
            tables["net.strings"] = tables["net.cable"] | {"length": 0.3}
    tables["initial"] = {
        "packing": float(random.uniform(0.7, 1.0)),
        "velocity": [*(0.2 * speed * random.normal(size=2)).tolist(), speed],
    }
    if random.random() < 0.3:
        tables["effects.material_damping"] = {"relaxation_time": 1e-5}
    free = random.random() < 0.7
    tables[f"bodies.{TARGET}"] = shape | {
        "mass": float(10.0 ** random.uniform(-1.5, 3.0)),
        "position": [*random.uniform(-0.2, 0.2, size=2).tolist(), half + gap],
        "attitude": random.normal(size=4).tolist(),
        **({} if free else {"motion": "fixed"}),
    }
    if free:
        tables[f"bodies.{TARGET}"]["angular_velocity"] = (2.0 * random.normal(size=3)).tolist()
    tables |= {f"bodies.{TARGET}.parts.{name}": keys for name, keys in _parts(shape).items()}
    tables["effects.contact"] = _contact(random, speed, bullets=bullets)
    return tables


def _capture_net(random: Generator) -> dict[str, Any]:
    meshes = int(random.integers(2, 5))
    match str(random.choice(["square", "square", "rectangular", "hexagonal", "radial"])):
        case "square":
            return {"topology": "square", "mesh": MESH, "size": MESH * meshes}
        case "rectangular":
            return {"topology": "rectangular", "mesh": [MESH, 0.2], "size": [MESH * meshes, 0.6]}
        case "hexagonal":
            return {"topology": "hexagonal", "mesh": 0.2, "rings": int(random.integers(1, 3))}
        case _:
            return {"topology": "radial", "radius": 0.2 * meshes, "spokes": 6, "rings": meshes}


def _shape(random: Generator, folder: Path) -> tuple[dict[str, Any], float]:
    """Keys of a body without parts, or "parts"; the radius of a ball about its origin that holds it [m]."""
    kind = str(random.choice(SHAPES))
    a, b, c = (float(size) for size in random.uniform(0.15, 0.5, size=3))
    rounded = {"edge_radius": float(random.uniform(0.1, 0.4)) * min(a, b, c)}
    match kind:
        case "sphere":
            return {"shape": kind, "radius": a}, a
        case "capsule":
            return {"shape": kind, "radius": a, "length": b}, a + b
        case "box":
            return {"shape": kind, "size": [a, b, c]} | rounded, float(np.hypot(np.hypot(a, b), c)) / 2.0
        case "cylinder":
            return {"shape": kind, "radius": a, "length": b} | rounded, float(np.hypot(a, b))
        case "frustum":
            return {"shape": kind, "radii": [a, b], "length": c} | rounded, max(a, b) + c
        case "mesh":
            return _mesh(random, (a, b, c), rounded, folder)
    return {"edge_radius": 0.03}, 0.7


def _mesh(
    random: Generator, size: tuple[float, float, float], edge: dict[str, float], folder: Path
) -> tuple[dict[str, Any], float]:
    """As `_shape`, of an L, which has an inner edge, or of the polyhedron of a solid of this size."""
    if random.random() < 0.5:
        legs = 5.0 * min(size)  # of the outline, so that they are as wide as this
        mesh = extruded([(legs * x, legs * y) for x, y in OUTLINE], 0.5 * max(size))
    else:
        mesh = polyhedron(Solid(str(random.choice(SHAPES[:5])), size))
    if random.random() < 0.5:
        edge = edge | {"grid_spacing": 0.5 * edge["edge_radius"]}
    keys = mesh_keys(mesh, folder, TARGET)
    return keys | edge, float(np.linalg.norm(mesh.vertices, axis=1).max())


def _parts(shape: dict[str, Any]) -> Tables:
    """A box with an arm across it, if the body has no shape of its own."""
    if "shape" in shape:
        return {}
    return {
        "bus": {"shape": "box", "size": [0.4, 0.3, 0.3]},
        "arm": {"shape": "box", "size": [0.1, 0.9, 0.1], "position": [0.1, 0.0, 0.1]},
    }


def _contact(random: Generator, speed: float, *, bullets: bool) -> dict[str, Any]:
    stiffness = float(10.0 ** random.uniform(2.5, 5.0))
    keys: dict[str, Any] = {"threads": [TARGET]}
    if bullets:
        keys |= {"bullets": [TARGET], "bullet_radius": float(random.uniform(0.002, 0.03))}
    if random.random() < 0.7:
        keys |= {"law": "linear", "stiffness": stiffness}
        keys |= {"bullet_stiffness": stiffness} if bullets else {}
    else:
        keys |= {"law": "hertz", "modulus": stiffness}
    if random.random() < 0.5:
        keys |= {"restitution": float(random.uniform(0.2, 1.0)), "impact_speed": speed}
    else:
        keys |= {"damping": float(random.uniform(0.0, 1.0))}
    law = str(random.choice(["none", "sticking", "regularised"], p=[0.3, 0.4, 0.3]))
    if law != "none":
        keys["friction"] = {"law": law, "coefficient": float(random.uniform(0.05, 1.0))}
    if law == "regularised":
        keys["friction"]["slip_speed"] = 0.05 * speed
    return keys


def _capture_solver(random: Generator) -> dict[str, Any]:
    choice = random.random()
    if choice < 0.5:
        return {"method": "DOPRI5", "accuracy": float(10.0 ** random.uniform(-5.0, -2.0))}
    if choice < 0.6:
        return {"accuracy": 1e-3}
    return {"method": "RK44" if choice < 0.8 else "VelocityVerlet"}


# Scenes with empty sets


def bare(seed: int) -> Tables:
    """The tables of a random case with hardly a net: no thread, nodes that are fixed, tethers alone.

    Bodies are free, fixed or prescribed, often all of one kind.
    """
    random = np.random.default_rng([seed, 36])
    section = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e7}
    tables: Tables = {"": {"format": 1, "title": f"bare {seed}"}}
    tables["time"] = {"end": 0.1, "output_step": float(random.choice([0.001, 0.02, 0.1]))}
    tables["solver"] = {"method": str(random.choice(["auto", "DOPRI5", "RK44", "VelocityVerlet"]))}
    tables["net"] = {"topology": "explicit"} | _bare_net(random)
    tables["net.cable"] = section
    tables["initial"] = {"packing": 1.0}
    effects = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}, "material_damping": {"relaxation_time": 1e-5}}
    tables |= {f"effects.{name}": keys for name, keys in effects.items() if random.random() < 0.5}
    motions = ["free", "fixed", "prescribed"] if random.random() < 0.5 else [str(random.choice(MOTIONS))]
    names = "abc"[: int(random.integers(0, 4))]
    places = np.arange(3)[:, None] * np.array([1.0, 0.0, 0.0]) + 0.1 * random.normal(size=(3, 3))
    for name, place in zip(names, places, strict=False):
        motion = str(random.choice(motions))
        keys = {"shape": "box", "size": [0.1, 0.2, 0.3], "mass": 1.0, "position": place.tolist()}
        tables[f"bodies.{name}"] = keys | {"motion": motion}
        if motion != "fixed":
            tables[f"bodies.{name}"] |= {"velocity": random.normal(size=3).tolist()}
            tables[f"bodies.{name}"] |= {"angular_velocity": random.normal(size=3).tolist()}
        if random.random() < 0.3:
            node = int(random.integers(len(tables["net"]["nodes"])))
            if not any("attachments" in keys for keys in tables.values()):
                point = (np.array(tables["net"]["nodes"][node]) - place).tolist()
                tables[f"bodies.{name}"]["attachments"] = {"x": {"node": node, "point": point}}
    for first, second in pairwise(names):
        if random.random() < 0.7:
            divisions, length = int(random.integers(1, 4)), float(random.uniform(0.8, 1.6))
            keys = section | {"length": length, "divisions": divisions}
            tables[f"tethers.{first}{second}"] = keys | {"start": {"body": first}, "end": {"body": second}}
    return tables


MOTIONS = ("free", "fixed", "prescribed")


def _bare_net(random: Generator) -> dict[str, Any]:
    """A node without threads, or two or three on a thread, of which none, some or all are fixed."""
    count = int(random.integers(1, 4))
    net = {
        "nodes": [[float(k), 3.0, 0.0] for k in range(count)],
        "elements": [[k, k + 1] for k in range(count - 1)] if random.random() < 0.5 else [],
        "node_masses": [0.1] * count,
    }
    fixed = int(random.choice([0, 1, count, count]))
    return net | ({"fixed": list(range(fixed))} if fixed else {})


# What is wrong with a scene


class Ended(NamedTuple):
    """How a scene ended, and what is wrong with it ("": nothing).

    end : "sound", "stopped", "refused", "hang" or "raised"
    touched, rubbed : whether anything touched the target of a capture, and with friction
    """

    end: str
    fault: str = ""
    touched: bool = False
    rubbed: bool = False


class TooLongError(BaseException):
    """A scene that does not end; no `except Exception` of the program swallows it."""


def within_time(judge: Callable[[int, Path], Ended], seed: int) -> Ended:
    """Judge a scene within bounded time, whatever is raised."""

    def give_up(*_: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, MAX_TIME)  # whatever else the machine has to do
    try:
        with TemporaryDirectory() as folder:
            return judge(seed, Path(folder))
    except TooLongError:
        return Ended("hang", f"does not end within {MAX_TIME:g} s")
    except Exception:  # noqa: BLE001 - anything that is raised here is a finding
        return Ended("raised", traceback.format_exc())
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def judge_scene(seed: int, folder: Path) -> Ended:
    """Run a random scene."""
    return judge(text(document(seed)), folder)[0]


def judge_bare(seed: int, folder: Path) -> Ended:
    """Run a random scene with empty sets in both back ends; their tensions must agree."""
    tables, ended, found = bare(seed), [], []
    for backend in BACKENDS:
        tables["engine"] = {"backend": backend}
        end, result = judge(text(tables), folder)
        ended.append(end)
        found.append(result)
    first, second = found
    if ended[0].fault or ended[1].fault or first is None or second is None:
        same = [end.end for end in ended]
        differs = "" if same[0] == same[1] else f"the back ends end in {same[0]} and {same[1]}"
        return ended[0] if ended[0].fault else ended[1]._replace(fault=ended[1].fault or differs)
    if first.complete and second.complete:
        force = max(1.0, float(first.tension.max(initial=0.0)))
        apart = float(np.abs(first.tension - second.tension).max(initial=0.0)) / force
        if apart > 1e-2:  # of some periods of a stiff tether, at the accuracy of the run
            return ended[0]._replace(fault=f"tensions of the back ends differ by {apart:.3g}")
    return ended[0]


def judge_capture(seed: int, folder: Path) -> Ended:
    """Run a random capture."""
    tables = capture(seed, folder)
    ended, result = judge(text(tables), folder)
    if result is None:
        return ended
    touched = any(
        states.values[-1, 0] >= 0.0
        for key, states in result.contacts.items()
        if (key.body, key.quantity) == (TARGET, "first")
    )
    ended = ended._replace(touched=touched, rubbed=touched and "friction" in tables["effects.contact"])
    summed = tables["engine"]["backend"] == "exudyn" and result.run.plan.method == "VelocityVerlet"
    if ended.fault or (summed and "motion" in tables[f"bodies.{TARGET}"]):
        return ended  # the impulse of a fixed body is known to first order in the step there
    off = momentum_books(result)["linear"]
    if off.residual > LINEAR * off.size + 1e-15:
        return ended._replace(fault=f"the balance of momentum is off by {off.residual / off.size:.3g}")
    return ended


def judge(case: str, folder: Path) -> tuple[Ended, Result | None]:
    """Run the text of a case; any exception that is not a typed refusal comes out."""
    path = folder / "case.toml"
    path.write_text(case, encoding="utf-8")
    try:
        start = prepare(load(path).scene)
    except (CaseError, InputError) as refusal:
        return Ended("refused", "" if str(refusal).strip() else "a refusal without a message"), None
    try:
        result = simulate(start)
    except RunStopped as stop:
        return Ended("stopped", _faults_of_stop(stop, start, folder)), stop.result
    missing = "" if np.array_equal(result.time, start.scene.time.stored_times) else "stored times are missing"
    return Ended("sound", missing or _faults(result, start, folder)), result


def _faults_of_stop(stop: RunStopped, start: Start, folder: Path) -> str:
    if stop.result is None:
        return "nothing of the run is kept"
    if stop.result.complete or stop.result.verdict != str(stop):
        return "a stopped run is not marked as such"
    if re.search(r"\bnan\b|\binf\b", str(stop)):
        return f"the message has a number that is not finite: {stop}"
    if not re.search(r"t = [\d.e+-]+ s|not started", str(stop)):
        return f"the message lacks the time: {stop}"
    return _faults(stop.result, start, folder)


def _faults(result: Result, start: Start, folder: Path) -> str:
    """The first fault of a result, complete or not."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        summary = summarise(result)
    json.dumps(summary, allow_nan=False)
    save(result, folder / "result.h5", overwrite=True)  # refuses what is not finite
    if not np.array_equal(load_result(folder / "result.h5").position, result.position):
        return "the file does not give the result back"
    balance = energy_balance(result)
    at_rest = (
        float(result.kinetic.max() + result.elastic.max()) < 1e-10
    )  # the guards' own least energy, 1e-12 J
    if balance > ENERGY_BOUND * (1 + 1e-9) and not at_rest:
        return f"the energy balance is off by {balance:.3g}"
    return _momentum_faults(result, start)


def _momentum_faults(result: Result, start: Start) -> str:
    on = set(result.run.effects)
    rayleigh = start.scene.effects.model_dump(exclude_none=True).get("rayleigh_damping")
    along = rayleigh is not None and rayleigh["alpha"] == 0.0
    if len(result.net.fixed_nodes) or not on <= INTERNAL | ({"rayleigh_damping"} if along else set()):
        return ""
    each = result.net.mass * np.linalg.norm(result.velocity, axis=-1)
    energy = float(result.kinetic[0] + result.elastic[0])  # which may have been motion between stored states
    size = max(float(each.sum(axis=1).max()), float(np.sqrt(2.0 * result.net.mass.sum() * energy)))
    change = float(np.linalg.norm(result.momentum - result.momentum[0], axis=-1).max())
    if change > MOMENTUM * size + 1e-15:
        return f"the linear momentum changes by {change / size:.3g}"
    if along or "bending" in on:
        return ""
    arms = max(float((each * np.linalg.norm(result.position, axis=-1)).sum(axis=1).max()), 1e-9 * size)
    turned = float(np.linalg.norm(result.angular_momentum - result.angular_momentum[0], axis=-1).max())
    return f"the angular momentum changes by {turned / arms:.3g}" if turned > ANGULAR * arms + 1e-15 else ""


FOUND = CASES / "hard" / "found"
# Sets of effects whose kernels other tests compile too.
COMMON_EFFECTS: tuple[set[str], ...] = (set(), {"effects.rayleigh_damping"}, {"effects.gravity"})


def checked(ended: dict[int, Ended]) -> Counter[str]:
    """Fail for scenes that are wrong; how many ended in which way."""
    assert {seed: item for seed, item in ended.items() if item.fault} == {}
    return Counter(item.end for item in ended.values())


@pytest.mark.slow
def test_forty_random_scenes():
    seeds = [s for s in range(150) if {n for n in document(s) if "effects" in n} in COMMON_EFFECTS][:40]
    ends = checked({seed: within_time(judge_scene, seed) for seed in seeds})
    assert ends.total() == 40
    assert ends["sound"] >= 15  # else the scenes try nothing
    assert ends["stopped"] >= 3


@pytest.mark.slow
@pytest.mark.parametrize("first", range(150, 650, 100))
def test_random_scenes(first: int) -> None:
    """Some half of a hundred are sound, others stop or are refused: else an end is hardly tried."""
    ends = checked({seed: within_time(judge_scene, seed) for seed in range(first, first + 100)})
    assert ends["sound"] >= 40
    assert min(ends["stopped"], ends["refused"]) >= 1


@pytest.mark.ci_for("0")
@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 100, 20))
def test_random_scenes_with_empty_sets(first: int) -> None:
    ends = checked({seed: within_time(judge_bare, seed) for seed in range(first, first + 20)})
    assert ends["sound"] >= 5


@pytest.mark.ci_for("2000")
@pytest.mark.slow
@pytest.mark.parametrize("first", [*range(0, 400, 100), 2000])
def test_random_captures(first: int) -> None:
    """In half of a hundred something touches, in a third of them with friction."""
    pytest.importorskip("trimesh")  # for targets that are meshes
    ended = {seed: within_time(judge_capture, seed) for seed in range(first, first + 100)}
    assert checked(ended)["sound"] >= 80
    assert sum(item.touched for item in ended.values()) >= 50
    assert sum(item.rubbed for item in ended.values()) >= 33


@pytest.mark.slow_for("all_dissipated", "jump_far_ahead", "at_rest_in_orbit")
@pytest.mark.parametrize("path", sorted(FOUND.glob("*.toml")), ids=lambda path: path.stem)
def test_what_failed_once(path, tmp_path):
    ended, _ = judge(path.read_text(encoding="utf-8"), tmp_path)
    assert ended == Ended("sound")


def test_the_round_off_of_a_potential_is_no_energy_error():
    assert energy_balance(exunet.run(exunet.load(FOUND / "at_rest_in_orbit.toml"))) == 0.0
