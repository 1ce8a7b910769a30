"""Scenes with contact, for tests: few, so that few kernels are compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from solids import mesh_keys

import exunet
from exunet.bodies.overlap import polyhedron
from exunet.bodies.shapes import Solid

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
THROWN = f"""
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


def thrown(folder: Path, shape: str, *changes: str) -> exunet.Simulation:
    """`THROWN` with its box as a "solid", or as a "mesh"."""
    text = as_mesh(folder, THROWN, BOX) if shape == "mesh" else THROWN
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
