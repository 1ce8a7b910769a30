"""Scenes of bodies that touch each other, for tests; the net is one thread far away."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.simulation.simulation import Simulation

Floats = NDArray[np.float64]

TWO = """
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
RUBBING = (
    "effects.contact.friction.coefficient=0.3",
    'effects.contact.friction.law="regularised"',
    "effects.contact.friction.slip_speed=1e-2",
)


def bounces(restitution: float) -> tuple[str, ...]:
    """Overrides with which an impact at 1 m/s has a restitution."""
    law = f"restitution={restitution},impact_speed=1.0"
    return (f'effects.contact={{bodies=[["one","other"]],law="linear",body_stiffness=1e4,{law}}}',)


def written(folder: Path) -> Path:
    """The scene without bodies."""
    path = folder / "two.toml"
    path.write_text(TWO)
    return path


def simulation(folder: Path, *changes: str) -> Simulation:
    """The scene with overrides, at its start."""
    return exunet.Simulation(str(written(folder)), list(changes))


def momenta(sim: Simulation) -> tuple[Floats, Floats]:
    """Momentum (3,) and angular momentum (3,) of the bodies, about the origin."""
    rigid, push, moment = sim.state.bodies, np.zeros(3), np.zeros(3)
    for k, body in enumerate(sim.start.system.bodies):
        own = body.mass * rigid.velocity[k]
        spin = np.array(body.inertia) * rigid.angular_velocity[k]
        push = push + own
        moment = moment + np.cross(rigid.position[k], own) + rotation_matrix(rigid.attitude[k]) @ spin
    return push, moment
