"""The step of a run that gives neither method nor accuracy, and what half of it is reported to change."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exunet.results.measures import energy_divisor
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import simulate
from exunet.studies.divisions import halve_step
from exunet.studies.ensemble import perturbed_runs

KINDS = ("square", "hexagonal", "radial", "rectangular", "cut")


def document(seed: int) -> str:
    """A net of any kind in flight, a third with a tether to a body and a third before a body it touches."""
    random = np.random.default_rng([seed, 7])
    mesh, meshes = float(random.uniform(0.3, 0.8)), int(random.integers(2, 5))
    material = {"density": 1390.0, "youngs_modulus": float(10.0 ** random.uniform(7.5, 9.0))}
    thick = float(random.uniform(8e-4, 2e-3))
    cable, string = ({"diameter": factor * thick} | material for factor in (1.0, 1.5))
    size = mesh * meshes
    net: dict[str, Any] = {
        "square": {"size": size, "mesh": mesh},
        "hexagonal": {"mesh": mesh, "rings": meshes // 3},
        "radial": {"radius": 0.6 * size, "spokes": meshes + 2, "rings": meshes - 1},
        "rectangular": {"size": [size, 0.5 * size], "mesh": [mesh, 0.5 * mesh]},
        "cut": {"outline": "square", "mesh_shape": "square", "mesh": mesh, "size": 3.5 * mesh, "border": string},
    }[KINDS[seed % 5]]
    net |= {"topology": KINDS[seed % 5], "divisions": int(random.choice([1, 1, 2])), "cable": cable}
    net |= {"bullets": {"mass": float(random.uniform(0.03, 0.3))}}
    length, packing, radial = random.uniform((0.5, 0.3, 1.0), (1.2, 0.5, 4.0)).tolist()
    end = (0.7 * size + length) * (1.0 - packing) / radial * float(random.uniform(1.5, 3.0))
    tables: dict[str, Any] = {
        "time": {"end": end, "output_step": end / 200},
        "engine": {"backend": "compiled"},
        "net": net | {"strings": string | {"length": length}},
        "initial": {"packing": packing},
        "launch": {"radial_speed": radial, "axial_speed": float(random.uniform(1.0, 4.0))},
    }
    time = 10.0 ** random.uniform(-5.0, -3.5)  # of damping [s]
    tables["effects"] = [
        {},
        {"mass_damping": {"alpha": 0.05}},
        {"material_damping": {"relaxation_time": time}},
        {"rayleigh_damping": {"alpha": 1e-3, "beta": 0.1 * time}, "gravity": {"acceleration": [0.0, 0.0, -9.81]}},
    ][int(random.integers(4))]
    box = {"shape": "box", "size": [0.3, 0.3, 0.3], "edge_radius": 0.05, "mass": float(10.0 ** random.uniform(0.0, 2.0))}
    match seed % 3:
        case 1:
            tables["bodies"] = {"b": box | {"position": [0.0, 0.0, -0.5]}}
            ends = {"start": {"body": "b", "point": [0.0, 0.0, 0.15]}, "end": {"bullet": 0}}
            tables["tethers"] = {"tow": cable | ends | {"length": 0.6 + length, "divisions": 4}}
        case 2:
            tables["bodies"] = {"b": box | {"position": [0.05, 0.02, 0.4 + 0.3 * size]}}
            law = {"law": "linear", "stiffness": float(10.0 ** random.uniform(3.0, 4.5)), "damping": 0.2}
            friction = {"law": "sticking", "coefficient": 0.3}
            tables["effects"] = {"material_damping": {"relaxation_time": time}}
            tables["effects"] |= {"contact": {"threads": ["b"], "friction": friction} | law}
    lines = [f"{name} = {_toml(keys)}" for name, keys in tables.items()]
    return "\n".join(["format = 1", f'title = "scene {seed}"', *lines])


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    return json.dumps(value)


def case_of(seed: int, *overrides: str) -> Case:
    return parse_case(document(seed), Path("scene.toml"), overrides)


TETHERED = """
format = 1
title = "scene"
time = { end = 0.606790980438014, output_step = 0.00303395490219007 }
engine.backend = "compiled"
net.topology = "hexagonal"
net.mesh = 0.3540381068085237
net.rings = 0
net.cable = { diameter = 0.0017710664024623332, density = 1390.0, youngs_modulus = 55950758.61076144 }
net.bullets.mass = 0.051833194593718206
[net.strings]
length = 0.8496914563404568
diameter = 0.0026565996036934996
density = 1390.0
youngs_modulus = 55950758.61076144
[initial]
packing = 0.3074139842100948
[launch]
radial_speed = 4.0272225145636895
axial_speed = 1.749486128332418
[effects]
mass_damping.alpha = 0.05
[bodies.c]
shape = "box"
size = [0.3, 0.3, 0.3]
mass = 20.0
position = [0.0, 0.0, -0.5]
[tethers.tow]
length = 1.4369434418441198
divisions = 4
diameter = 0.0017710664024623332
density = 1390.0
youngs_modulus = 55950758.61076144
start = { body = "c", point = [0.0, 0.0, 0.15] }
end.bullet = 0
"""
FALLING = """
format = 1
title = "scene"
time = { end = 3.4839680182335315, output_step = 0.01741984009116766 }
engine.backend = "compiled"
net.topology = "square"
net.divisions = 2
net.size = 3.61105647660276
net.meshes = 4
net.cable = { diameter = 0.0008476540339495809, density = 1390.0, youngs_modulus = 934274482.6199611 }
net.bullets.mass = 0.04062164032695653
[net.strings]
length = 1.083316942980828
diameter = 0.0012714810509243714
density = 1390.0
youngs_modulus = 934274482.6199611
[initial]
packing = 0.47947080817423066
[launch]
radial_speed = 1.3554684497612364
axial_speed = 1.1524501355248873
[effects]
rayleigh_damping = { alpha = 0.001, beta = 7.293681449620629e-06 }
gravity.acceleration = [0.0, 0.0, -9.81]
"""
