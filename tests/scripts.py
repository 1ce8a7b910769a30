"""Scenes with a script for tests, and the times at which its conditions come true by hand calculation."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from scenes import HEAD, hoist
from scipy.optimize import brentq

import exunet
from exunet.scene.casefile import Case, parse_case

# A node that falls past a body that stays where it is, and two bodies far away with a reel between them.
SCENE = """
format = 1
title = "A script"
time = { end = 1.0, output_step = 0.05 }
solver = { method = "RK44", step = 1e-3 }
engine.backend = "compiled"
initial.packing = 1.0
initial.node_velocities = [[0.5, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 3.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
effects.gravity.acceleration = [0.0, 0.0, -9.81]

[bodies.target]
shape = "sphere"
radius = 0.1
mass = 1.0
motion = "fixed"
[bodies.left]
mass = 2.0
inertia = [0.3, 0.4, 0.5]
position = [0.0, 50.0, 0.0]
[bodies.right]
mass = 3.0
inertia = [0.3, 0.4, 0.5]
position = [3.0, 50.0, 0.0]

[tethers.tow]
diameter = 0.001
density = 1390.0
youngs_modulus = 1e9
length = 3.2
divisions = 2
start = { body = "left" }
end = { body = "right" }
[tethers.tow.reel]
damping = 100.0

[capture]
target = "target"
relative_speed = 1e3
duration = 0.0
"""
FALL = SCENE[: SCENE.index("[bodies.left]")] + SCENE[SCENE.index("[capture]") :]

# A hub and three corners, 2 m from it.
NET = """
format = 1
title = "Three corners and a body"
time = { end = 1.0, output_step = 0.05 }
solver = { method = "RK44", step = 5e-4 }
initial.packing = 1.0
net.topology = "radial"
net.radius = 2.0
net.spokes = 3
net.rings = 1
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
[bodies.target]
mass = 1.0
inertia = [0.3, 0.4, 0.5]
"""

# 1 kg falls from where a tether of 100 N and 1 m, on a fixed body, begins to hold it.
SECTION = math.pi * 0.0005**2
EA, G = 100.0, 9.81
HANGS = f"""{HEAD}
time = {{ end = 0.6, output_step = 0.02 }}
solver = {{ method = "RK44", step = 5e-4 }}
initial.node_positions = [[0.0, 0.0, -1.0]]
net.nodes = [[0.0, 0.0, -1.0]]
net.elements = []
net.node_masses = [1.0]
effects.gravity.acceleration = [0.0, 0.0, {-G}]
[bodies.roof]
mass = 1.0
inertia = [0.3, 0.4, 0.5]
motion = "fixed"
[tethers.tow]
diameter = 0.001
density = 1.0
youngs_modulus = {EA / SECTION!r}
length = 1.0
start = {{ body = "roof" }}
end = {{ node = 0 }}
"""
# A ball on a table.
SLIDES = f"""{HEAD}
time = {{ end = 0.3, output_step = 0.01 }}
solver = {{ method = "RK44", step = 1e-4 }}
initial.node_positions = [[0.0, 0.0, {0.51 - G / 1e4!r}]]
initial.node_velocities = [[1.0, 0.0, 0.0]]
net.nodes = [[0.0, 0.0, 0.0]]
net.elements = []
net.node_masses = [1.0]
effects.gravity.acceleration = [0.0, 0.0, {-G}]
effects.contact = {{ nodes = ["table"], node_radius = 0.01, law = "linear", node_stiffness = 1e4, damping = 0.0, friction = {{ law = "sticking", coefficient = 0.3 }} }}
[bodies.table]
shape = "box"
size = [4.0, 4.0, 1.0]
edge_radius = 0.1
mass = 1.0
motion = "fixed"
"""  # noqa: E501
LIFTS = HEAD + hoist(friction=0.3)


def case_of(script: str, *overrides: str, scene: str = SCENE) -> Case:
    return parse_case(scene + script, Path("script.toml"), overrides)


def entry(name: str, **keys: Any) -> str:
    """A table of the script; every value as TOML writes it."""
    lines = [
        f'{key} = "{item}"' if isinstance(item, str) else f"{key} = {item}" for key, item in keys.items()
    ]
    return "\n".join(["[[script]]", f'name = "{name}"', *lines, ""]).replace("True", "true")


def happened(result: exunet.Result) -> list[tuple[str, float]]:
    """Name and time of the entries that were done, in order."""
    return [(item.entry, item.time_s) for item in result.run.done]


def only(result: exunet.Result) -> float:
    """Time of the only entry that was done [s]."""
    assert len(happened(result)) == 1
    return happened(result)[0][1]


def range_at(t: float) -> float:
    """Of the node that is thrown at 0.5 m/s along x, from 3 m above, and falls [m]."""
    return math.hypot(0.5 * t, 3.0 - 0.5 * 9.81 * t * t)


def when_range_is(value: float) -> float:
    """On the way down [s]; the node passes the target at some 0.77 s."""
    return float(brentq(lambda t: range_at(t) - value, 0.0, 0.75, xtol=1e-14))


# A tether of 3.2 m in two elements becomes taut between bodies without weight that fly apart and turn.
FREE = SCENE.replace("effects.gravity.acceleration = [0.0, 0.0, -9.81]\n", "").replace(
    "initial.node_velocities = [[0.5, 0.0, 0.0]]\n", ""
)
TOWED = FREE.replace("[tethers.tow.reel]\ndamping = 100.0\n", "").replace(
    "position = [3.0, 50.0, 0.0]\n",
    "position = [3.0, 50.0, 0.0]\nvelocity = [2.0, 0.3, 0.0]\nangular_velocity = [0.4, 0.5, 1.0]\n",
)
TOWED = TOWED.replace(
    'end = { body = "right" }', 'end = { body = "right", point = [0.0, 0.2, 0.1] }'
).replace("youngs_modulus = 1e9\nlength", "youngs_modulus = 1e8\nlength")
END = entry("go", at=0.4, do="release", on="tethers.tow.end")
