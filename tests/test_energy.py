"""Energy of terms, and the middle of steps by which work is summed: against cubics in time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from listed_scenes import HEAD
from test_quantities import NET
from test_script import case_of

from exunet.bodies.rotations import rotation_matrix
from exunet.model import energy
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import prepare_case


def test_the_middle_of_steps_of_a_cubic_motion() -> None:
    """Of points and centres it is exact; of a body that turns evenly to the fourth order of the angle.

    Steps of different lengths; the attitudes change their sign from state to state, as they may.
    """
    system = prepare_case(case_of("", scene=NET)).system
    x0, v0 = system.layout.pack(prepare_case(case_of("", scene=NET)).state.moving)
    rng, moved = np.random.default_rng(6), system.blocks.centres
    powers, time = rng.normal(size=(4, moved)), np.array([0.3, 0.7, 0.8, 1.4])
    spin = np.array([0.4, -0.2, 0.3])

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, v = np.tile(x0, (len(t), 1)), np.tile(v0, (len(t), 1))
        x[:, :moved] = sum(c * t[:, None] ** k for k, c in enumerate(powers))
        v[:, :moved] = sum(k * c * t[:, None] ** (k - 1) for k, c in enumerate(powers) if k)
        size = np.linalg.norm(spin)
        half = 0.5 * size * t[:, None]
        x[:, moved : moved + 4] = np.concatenate([np.cos(half), np.sin(half) * spin / size], axis=1)
        v[:, moved:] = spin
        return x, v

    x, v = at(time)
    x[1::2, moved : moved + 4] *= -1.0
    place, speed = energy._middle(system, time, x, v, None)
    known, rates = at(0.5 * (time[1:] + time[:-1]))
    np.testing.assert_allclose(place[:, :moved], known[:, :moved], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(speed[:, :moved], rates[:, :moved], rtol=1e-11, atol=1e-11)
    turns = rotation_matrix(place[:, moved : moved + 4])
    np.testing.assert_allclose(turns, rotation_matrix(known[:, moved : moved + 4]), atol=2e-4)
    np.testing.assert_allclose(speed[:, moved:], rates[:, moved:], atol=2e-3)


LINE = """
net.elements = []
net.nodes = [[0.2, 0.0, 0.0], [0.5, 0.9, 0.1], [-0.5, 0.8, 0.0]]
net.node_masses = [2.0, 0.1, 0.3]
time = { end = 0.5, output_step = 0.1 }
effects.gravity.acceleration = [0.1, -0.2, -9.81]
[closing]
kind = "line"
nodes = [0, 1, 2]
length = 2.0
stiffness = 200.0
linear_density = 0.0
ring_diameter = 0.001
friction = 0.0
"""


def test_the_potential_is_that_of_loads_and_of_kernel_terms() -> None:
    """m g h, and EA L (e^2 - 1)^2 / 8 of a closing line round three nodes, 2 m long."""
    system = prepare_case(parse_case(HEAD + LINE, Path("line.toml"))).system
    x = np.random.default_rng(1).normal(size=(3, system.blocks.n_x)) * 2.0
    at = x[:, :9].reshape(3, 3, 3)
    x[:, 9:] = 0.0  # nothing is wound up
    around = np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).sum(axis=1)
    known = 200.0 * 2.0 / 8.0 * ((around / 2.0) ** 2 - 1.0) ** 2
    known -= np.einsum("n,kna,a->k", [2.0, 0.1, 0.3], at, [0.1, -0.2, -9.81])
    found = energy.potential(system.forces, x, dict(system.memory))
    np.testing.assert_allclose(found, known, rtol=1e-3)
