"""Random small scenes of every kind, and what is wrong with what comes of one."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from exunet.base.errors import CaseError, InputError, RunStopped
from exunet.results import measures as metrics
from exunet.results.io import load_result, save
from exunet.results.result import Result
from exunet.results.summary import summarise
from exunet.scene.casefile import load
from exunet.simulation.guards import ENERGY_BOUND
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate

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


def document(seed: int) -> dict[str, dict[str, Any]]:
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


def text(tables: dict[str, dict[str, Any]]) -> str:
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


def _clock(tables: dict[str, dict[str, Any]], random: Generator) -> None:
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


def judge(seed: int, folder: Path) -> tuple[str, str]:
    """Run a scene; how it ended ("sound", "stopped", "refused") and what is wrong with it ("": nothing)."""
    return judge_case(text(document(seed)), folder)


def judge_case(words: str, folder: Path) -> tuple[str, str]:
    """As `judge`, for the text of a case; any exception that is no typed refusal comes out."""
    end, fault, _ = judged(words, folder)
    return end, fault


def judged(words: str, folder: Path) -> tuple[str, str, Result | None]:
    """As `judge_case`, with what came of the run; None: nothing."""
    path = folder / "case.toml"
    path.write_text(words, encoding="utf-8")
    try:
        start = prepare(load(path).scene)
    except (CaseError, InputError) as refusal:
        return "refused", "" if str(refusal).strip() else "a refusal without a word", None
    try:
        result = simulate(start)
    except RunStopped as stop:
        if stop.result is None:
            return "stopped", "nothing of the run is kept", None
        return "stopped", _words(stop) or _faults(stop.result, start, folder), stop.result
    missing = "" if np.array_equal(result.time, start.scene.time.stored_times) else "stored times are missing"
    return "sound", missing or _faults(result, start, folder), result


def _words(stop: RunStopped) -> str:
    text = str(stop)
    if stop.result is not None and (stop.result.complete or stop.result.verdict != text):
        return "a stopped run is not marked as such"
    if re.search(r"\bnan\b|\binf\b", text):
        return f"the message has a number that is none: {text}"
    when = re.search(r"t = [\d.e+-]+ s", text)
    what = re.search(
        r"element is \d+ between nodes \d+ and \d+, stretch .*node is \d+|not started|"
        r"(element|bullet|node) \d+ (came to|is deeper than|near \w+ moves)",
        text,
    )
    return "" if when and what else f"the message lacks time or place: {text}"


def _faults(result: Result, start: Start, folder: Path) -> str:
    """The first thing that is wrong with a result, complete or not."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        summary = summarise(result)
    json.dumps(summary, allow_nan=False)
    save(result, folder / "result.h5")  # refuses what is not finite
    if not np.array_equal(load_result(folder / "result.h5").position, result.position):
        return "the file does not give the result back"
    balance = metrics.energy_balance(result)
    at_rest = (
        float(result.kinetic.max() + result.elastic.max()) < 1e-10
    )  # the guards' own least energy, 1e-12 J
    if balance > ENERGY_BOUND * (1 + 1e-9) and not at_rest:
        return f"the energy balance is off by {balance:.3g}"
    return _momentum_faults(result, start)


def _momentum_faults(result: Result, start: Start) -> str:
    on = set(result.provenance["effects"])
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
