"""Scenes with contact, for tests: few, so that few kernels are compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from solids import mesh_keys

import exunet
from exunet.bodies.overlap import polyhedron
from exunet.bodies.rotations import product, rotation_matrix
from exunet.bodies.shapes import Solid
from exunet.forces.terms import KernelTerm, copied
from exunet.simulation.preparation import Start

Floats = np.ndarray

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


class Placed:
    """A start whose nodes and bodies may be put somewhere else; the axes of bodies are the principal ones."""

    def __init__(self, start: Start) -> None:
        self.start, self.blocks = start, start.system.blocks
        self.x, self.v = start.system.layout.pack(start.state.moving)
        self.names = [body.name for body in start.system.bodies]
        self.nodes = slice(0, 3 * start.net.n_nodes)

    def terms(self) -> list[tuple[KernelTerm, Any]]:
        """The terms with memory, and their data."""
        return [(term, term.data) for term in self.start.system.forces.kernels if term.memory]

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
