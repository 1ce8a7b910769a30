"""Adaptive steps and thin bodies: a slack net in free flight has no error that would make steps shorter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet

SCENE = """
format = 1
title = "A slack net nears a thin plate fast"
time = { end = 0.075, output_step = 0.005 }
solver = { method = "DOPRI5", accuracy = 1e-3 }
engine = { backend = "compiled" }
[net]
topology = "square"
size = 2.0
mesh = 0.5
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e7 }
bullets = { mass = 0.1 }
[initial]
packing = 0.7
velocity = [0.0, 0.0, 40.0]
[effects.material_damping]
relaxation_time = 1e-4
[bodies.plate]
shape = "box"
size = [0.8, 0.8, 0.04]
edge_radius = 0.019
mass = 50.0
position = [0.03, 0.05, 1.0]
[effects.contact]
threads = ["plate"]
bullets = ["plate"]
bullet_radius = 0.02
law = "linear"
stiffness = 4e6
bullet_stiffness = 4e6
restitution = 0.5
impact_speed = 40.0
friction = { law = "regularised", coefficient = 0.3, slip_speed = 0.1 }
"""


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
def test_a_slack_net_meets_a_thin_plate_at_any_accuracy(tmp_path: Path, accuracy: float) -> None:
    """The plate gets the momentum that the net loses, p = m v of both, to round-off of the run."""
    path = tmp_path / "case.toml"
    path.write_text(SCENE)
    result = exunet.run(exunet.load(path, [f"solver.accuracy={accuracy}"]))
    assert result.time[-1] == 0.075
    plate = 50.0 * result.bodies["plate"].velocity[-1]
    net = result.net.mass @ (result.velocity[-1] - result.velocity[0])
    assert plate[2] > 1.0  # N s, of 40 m/s times 0.4 kg of bullets and a light net: it does not pass through
    np.testing.assert_allclose(plate, -net, rtol=0.0, atol=1e-9)
