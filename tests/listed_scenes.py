"""Scenes of a few listed nodes that several test files run, as texts of cases."""

from __future__ import annotations

from scipy.optimize import brentq

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
