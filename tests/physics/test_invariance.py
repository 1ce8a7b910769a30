"""Invariance: a scene turned as a whole, or at another common velocity, moves alike.

Orbit and J2 are not among the effects: their axes are those of the orbit, so that turning the scene means
another case.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES
from scipy.spatial.transform import Rotation

import exunet
import reference_impl
from exunet.net.arrays import Floats
from reference_impl.forces import acceleration

TURN = Rotation.from_rotvec([0.9, -1.4, 0.6])  # arbitrary, about no symmetry axis of the net

# A packed net that a turning chaser throws. Directions in the scene's axes come as {placeholders}.
SCENE = """
format = 1
title = "Turned as a whole"
time = {{ end = 0.15, output_step = 0.05 }}
solver = {{ method = "DOPRI5", tolerance = 1e-11 }}
engine.backend = "exudyn"
net.topology = "square"
net.size = 2.0
net.mesh = 1.0
net.divisions = 2
net.cable = {{ diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }}
net.bullets = {{ mass = 0.2 }}
initial.packing = 0.3
initial.frame = {{ body = "chaser", position = [0.0, 0.0, 0.8] }}
launch = {{ speed = 4.0, spread_angle = 0.8 }}
[bodies.chaser]
shape = "box"
size = [1.0, 1.2, 1.4]
mass = 80.0
axis = {axis}
angle = {angle}
velocity = {velocity}
angular_velocity = [0.3, 0.2, 0.1]
"""

BULLETS = "bullet_drag_coefficient = 0.47\nbullet_area = 4e-3\n"
EFFECTS = {
    "damping": "[effects.rayleigh_damping]\nalpha = 0.1\nbeta = 1e-5\n"
    "[effects.bending]\nmodulus = 1e10\n[effects.mass_damping]\nalpha = 0.2\n",
    "air": f"[effects.air_drag]\ndensity = 1.2\ndrag_coefficient = 1.1\n{BULLETS}"
    "[effects.material_damping]\nrelaxation_time = 1e-4\n"
    "[effects.gravity]\nacceleration = {gravity}\n",
    "space": "[effects.molecular_drag]\ndensity = 1e-6\nflow = {flow}\ndrag_coefficient = 2.2\n"
    "bullet_area = 4e-3\n"
    "[effects.solar_pressure]\nflux = 1e7\ndirection = {sunlight}\npressure_coefficient = 1.3\n"
    "bullet_area = 4e-3\n"
    "[effects.thermal_strain]\ntemperature_change = -80.0\nexpansion_coefficient = 1e-4\n"
    "[effects.thrust]\nbullets = [1]\ntime = [0.0, 1.0]\nforce = [{thrust}, {thrust}]\n",
    "contact": """
[effects.material_damping]
relaxation_time = 1e-4
[effects.self_contact]
stiffness = 2e4
radius = 0.01
restitution = 0.5
impact_speed = 2.0
[effects.contact]
threads = ["target"]
bullets = ["target"]
bullet_radius = 0.03
law = "linear"
stiffness = 1e4
bullet_stiffness = 1e4
restitution = 0.5
impact_speed = 2.0
friction = {{ law = "sticking", coefficient = 0.3 }}
[bodies.target]
shape = "box"
size = [0.3, 0.4, 0.2]
edge_radius = 0.05
mass = 10.0
position = {target}
axis = {axis}
angle = {angle}
""",
}


def scene(tmp_path: Path, effects: str, turn: Rotation) -> Path:
    """Write the case turned by `turn`."""
    vectors = {
        "velocity": [0.5, -0.2, 0.3],
        "gravity": [0.0, 0.0, -9.81],
        "flow": [-7500.0, 0.0, 0.0],
        "sunlight": [0.6, 0.8, 0.0],
        "target": [0.1, -0.15, 0.98],
        "thrust": [3.0, 0.0, 1.0],
    }
    keys: dict[str, Any] = {name: turn.apply(vector).tolist() for name, vector in vectors.items()}
    attitude = (turn * Rotation.from_rotvec([0.3, 0.0, 0.0])).as_rotvec()
    angle = float(np.linalg.norm(attitude))
    path = tmp_path / f"{turn.magnitude():.3f}.toml"
    path.write_text((SCENE + effects).format(axis=(attitude / angle).tolist(), angle=angle, **keys))
    return path


@pytest.mark.parametrize("effects", EFFECTS)
def test_a_turned_scene_moves_as_the_scene(tmp_path: Path, effects: str) -> None:
    """To 1e-8 m before the predictability horizon; round-off and tolerance 1e-11 are below."""
    first, turned = (
        exunet.run(scene(tmp_path, EFFECTS[effects], turn)).position for turn in (Rotation.identity(), TURN)
    )
    expected = TURN.apply(first.reshape(-1, 3)).reshape(first.shape)
    np.testing.assert_allclose(turned, expected, rtol=0.0, atol=1e-8)


def reference_acceleration(path: Path) -> Floats:
    """(n, 3) at the start [m/s2]."""
    scene = reference_impl.load(path)
    return acceleration(scene.system, 0.0, scene.x0, scene.v0, scene.bodies0)


@pytest.mark.parametrize("effects", EFFECTS)
def test_accelerations_of_the_reference_turn_with_the_scene(tmp_path: Path, effects: str) -> None:
    """At the start, to round-off."""
    first, turned = (
        reference_acceleration(scene(tmp_path, EFFECTS[effects], turn))
        for turn in (Rotation.identity(), TURN)
    )
    np.testing.assert_allclose(turned, TURN.apply(first), rtol=0.0, atol=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("speed", [100.0, 7500.0])
def test_a_common_velocity_does_not_change_the_plan(speed: float) -> None:
    """Galilean invariance of what "auto" chooses: method, and tolerance to round-off of the velocities."""
    case, boosted = CASES / "planar_deployment.toml", [f"initial.velocity=[0.0, 0.6, {speed}]"]
    first, moving = (exunet.prepare(exunet.load(case, changes)).plan for changes in ([], boosted))
    assert moving.method == first.method
    assert moving.step == first.step
    assert moving.tolerance == pytest.approx(first.tolerance, rel=1e-11)
