"""Two bodies on a cable that snaps taut, as one system, and as a net with a port and a host."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import exunet
from exunet import BodiesHost, NetSystem, Simulation

# A cable of two elements, 1 m and 55 N each, between two bodies; the first element is taut at the start, the
# second snaps taut at some 0.1 s.
CHAIN = """
format = 1
title = "Two bodies on a cable"
time = { end = 0.4, output_step = 0.05 }
solver = { method = "DOPRI5", tolerance = 1e-11 }
engine.backend = "compiled"
initial.packing = 1.0
initial.node_positions = [[0.0, 0.0, 0.0], [1.05, 0.0, 0.0], [2.0, 0.0, 0.0]]
initial.node_velocities = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [0.0, 0.0, 0.0]]
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
net.elements = [[0, 1], [1, 2]]
net.node_masses = [0.1, 0.5, 0.1]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }

[bodies.first]
mass = 2.0
inertia = [0.2, 0.3, 0.4]
position = [-0.5, 0.2, 0.1]
velocity = [-0.3, 0.0, 0.2]
angular_velocity = [1.0, 2.0, -1.5]
attachments.x = { point = [0.3, 0.1, -0.2], node = 0 }
"""
SECOND = """
[bodies.second]
mass = 3.0
inertia = [0.2, 0.3, 0.4]
products_of_inertia = [0.05, 0.02, 0.01]
centre_of_mass = [0.1, 0.2, 0.3]
position = [2.2, 0.1, 0.0]
velocity = [0.5, 0.0, 0.3]
attitude = [0.9, 0.1, 0.3, 0.2]
angular_velocity = [0.1, 2.0, 0.0]
attachments.x = { point = [-0.1, 0.1, 0.2], node = 2 }
"""
LUMP = 1390.0 * math.pi * 0.0005**2 / 2.0  # half an element [kg]


class Scene:
    """The files of the scene in a folder."""

    def __init__(self, folder: Path) -> None:
        self.whole = folder / "whole.toml"
        self.whole.write_text(CHAIN + SECOND)
        self.net = folder / "net.toml"
        self.net.write_text(CHAIN + SECOND.replace("mass = 3.0", 'mass = 3.0\nmotion = "port"'))

    def in_one(self, until: float) -> exunet.Simulation:
        """Both in one system, at a time [s]."""
        sim = Simulation(self.whole)
        sim.advance_to(until)
        return sim

    def both(self) -> tuple[NetSystem, BodiesHost]:
        """Net and host at the start."""
        net = NetSystem(self.net)
        return net, BodiesHost.of_ports(net)


def momenta(sim: Simulation) -> tuple[np.ndarray, np.ndarray, float]:
    """Momentum [N s], angular momentum about the origin [N m s] and energy [J] of what moves freely."""
    from exunet.model.states import States

    now = States.of(sim.start.system, sim.state)
    return now.momentum[0], now.angular_momentum[0], sim.energy.kinetic + sim.energy.elastic


def spring(folder: Path, stretch: float = 1.01) -> tuple[NetSystem, BodiesHost]:
    """A body of 0.05 kg in the middle of two stretched cables of 1 m, and its host."""
    body = (
        '[bodies.b]\nmotion = "port"\nmass = 0.05\ninertia = [1.0, 1.0, 1.0]\n'
        f"position = [{stretch}, 0.0, 0.0]\n"
    )
    body += "velocity = [0.01, 0.0, 0.0]\nattachments.x = { point = [0.0, 0.0, 0.0], node = 1 }\n"
    head = 'format = 1\ntitle = "A spring"\ntime = { end = 9.0, output_step = 1.0 }\n'
    head += 'solver = { method = "DOPRI5", tolerance = 1e-11 }\nengine.backend = "compiled"\n'
    head += 'initial.packing = 1.0\nnet.topology = "explicit"\n'
    head += "net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e6 }\n"
    file = folder / "spring.toml"
    ends = "net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]\nnet.fixed = [0, 2]\n"
    ends += "net.elements = [[0, 1], [1, 2]]\nnet.node_masses = [0.0, 1e-3, 0.0]\n"
    places = f"[[0.0, 0.0, 0.0], [{stretch}, 0.0, 0.0], [{2.0 * stretch}, 0.0, 0.0]]"
    start = f"initial.node_positions = {places}\n"
    file.write_text(head + ends + start + body)
    net = NetSystem(file)
    return net, BodiesHost.of_ports(net)


def stiffness(stretch: float = 1.01) -> float:
    """Of the spring [N/m]: of eq. (3), N = EA (s^3 - s) / 2, two tangents at a stretch s."""
    return 2.0 * 70e6 * math.pi * 0.0005**2 * (1.5 * stretch**2 - 0.5)


def energy_of(net: NetSystem, host: BodiesHost | None = None) -> float:
    """Of what moves freely, and of the net [J]."""
    return momenta(net.simulation)[2] + (momenta(host.simulation)[2] if host is not None else 0.0)
