"""Effects that act on rigid bodies: weight, the orbit's gradient and turning frame, damping by the mass."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import exunet
from exunet.bodies.rotations import rotation_matrix
from exunet.forces import on_bodies
from exunet.forces.blocks import Blocks
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate

# A net that nothing holds together, far from what the bodies do.
SCENE = """
format = 1
title = "Bodies under effects"
time = { end = 1.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-2 }
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 1.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = { diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }
"""
BACKENDS = ("engine.backend=exudyn", "engine.backend=compiled")
RATE = 1.1e-3  # rad/s
ORBIT = f"effects.orbit={{mean_motion={RATE}, radial=[1, 0, 0], along_track=[0, 1, 0], model='linear'}}"
MOMENTS = np.array([20.0, 50.0, 40.0])


def start(folder: Path, *overrides: str) -> Start:
    path = folder / "scene.toml"
    path.write_text(SCENE)
    return prepare_case(exunet.load(path, overrides))


def test_the_loops_sum_over_elements_of_mass() -> None:
    """Six masses at +-s_i on the axes have the moments of a body: force, torque, power, potential of each."""
    rng = np.random.default_rng(5)
    mass, arms = 3.0, np.array([0.4, 0.7, 0.2])
    places = np.concatenate([np.diag(arms), -np.diag(arms)])
    moments = mass / 3.0 * (arms @ arms - arms**2)
    gradient = rng.normal(size=(3, 3))
    gradient, turning = gradient + gradient.T, rng.normal(size=3)
    x, v = rng.normal(size=7), rng.normal(size=6)
    x[3:] /= np.linalg.norm(x[3:])
    index = (np.array([0], dtype=np.uint32), np.array([3], dtype=np.uint32), np.array([3], dtype=np.uint32))
    field = on_bodies.BodiesInField(*index, np.array([mass]), moments[None], gradient, 1.0, turning)
    force = np.zeros(6)
    on_bodies.add_field(0.0, x, v, field, force)
    turn = rotation_matrix(x[3:])
    rho = places @ turn.T
    speed = v[:3] + np.cross(turn @ v[3:], rho)
    each = mass / 6.0 * ((x[:3] + rho) @ gradient - np.cross(turning, speed))
    np.testing.assert_allclose(force[:3], each.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(force[3:], np.cross(rho, each).sum(axis=0) @ turn, rtol=1e-11, atol=1e-12)
    at = x[:3] + rho
    stored = -0.5 * mass / 6.0 * np.einsum("na,ab,nb->", at, gradient, at)
    assert on_bodies.field_potential(x, field) == pytest.approx(stored, rel=1e-12)
    # The same by alpha: -alpha v of each element.
    braked = on_bodies.BrakedBodies(index[0], index[2], np.array([0.3 * mass]), 0.3 * moments[None])
    force = np.zeros(6)
    on_bodies.add_braking(0.0, x, v, braked, force)
    each = -0.3 * mass / 6.0 * speed
    np.testing.assert_allclose(force[:3], each.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(force[3:], np.cross(rho, each).sum(axis=0) @ turn, rtol=1e-12)


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("loop", BACKENDS)
def test_a_body_falls_as_the_net(loop: str, tmp_path: Path) -> None:
    """-g t^2 / 2 for both; the engine and the loop integrate a parabola exactly, but for round-off."""
    body = "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4], angular_velocity=[0.1, 0.2, 0.3]}"
    result = simulate(start(tmp_path, body, loop, "effects.gravity.acceleration=[0.0, 0.5, -9.81]"))
    fallen = 0.5 * np.outer(result.time**2, [0.0, 0.5, -9.81])
    np.testing.assert_allclose(result.bodies["box"].position, fallen, atol=1e-12)
    np.testing.assert_allclose(result.position[:, 0] - [0.0, 0.0, 1.0], fallen, atol=1e-12)
    total = result.kinetic + result.potential
    assert np.abs(total - total[0]).max() < 1e-10


@pytest.mark.slow_for("engine.backend=compiled")
@pytest.mark.parametrize("loop", BACKENDS)
def test_a_tied_node_weighs_once(loop: str, tmp_path: Path) -> None:
    """A node on a body, off its centre: both fall, and the body does not turn."""
    body = (
        "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4]}",
        "bodies.box.attachments.a={node=0, point=[0.3, 0.2, 0.1]}",
    )
    result = simulate(start(tmp_path, *body, loop, "effects.gravity.acceleration=[0, 0, -9.81]"))
    box = result.bodies["box"]
    np.testing.assert_allclose(
        box.position[:, 2] - box.position[0, 2], -0.5 * 9.81 * result.time**2, atol=1e-11
    )
    assert np.abs(box.angular_velocity).max() < 1e-12


def libration(result: exunet.Result, of: np.ndarray) -> float:
    """Angular frequency from the first two passages of zero upwards, by cubic interpolation."""
    from scipy.interpolate import CubicSpline

    zeros = CubicSpline(result.time, of).roots(extrapolate=False)
    return 2.0 * math.pi / float(zeros[2] - zeros[0])


@pytest.mark.ci_for("engine.backend=exudyn")
@pytest.mark.slow
@pytest.mark.parametrize("loop", BACKENDS)
def test_libration_of_a_rigid_body(loop: str, tmp_path: Path) -> None:
    """Pitch: n sqrt(3 (I_along - I_radial) / I_normal), small angles (Wie, sec. 6.10): to 1e-4, as amplitudes
    of 1e-3 rad change it by 1e-7. Here radial x, along-track y, normal z. The body turns with the frame."""
    expected = RATE * math.sqrt(3.0 * (MOMENTS[1] - MOMENTS[0]) / MOMENTS[2])
    body = f"bodies.sat={{mass=100.0, inertia={MOMENTS.tolist()}, axis=[0, 0, 1], angle=1e-3}}"
    time = "time={end=9000.0, output_step=50.0}"
    result = simulate(start(tmp_path, body, loop, ORBIT, time, "solver.step=5.0"))
    angle = 2.0 * np.arcsin(result.bodies["sat"].attitude[:, 3])
    assert libration(result, angle) == pytest.approx(expected, rel=1e-4)
    total = result.kinetic + result.potential
    assert np.abs(total - total[0]).max() < 1e-9 * MOMENTS[2] * RATE**2


@pytest.mark.slow
@pytest.mark.parametrize("model", ["linear", "two_body"])
def test_a_body_in_orbit_moves_as_a_particle(model: str, tmp_path: Path) -> None:
    """The centre of a body beside a node of the net: the same orbit, whatever the body's attitude."""
    body = "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4], position=[0, 0, 1], angular_velocity=[1, 2, 3]}"
    time = "time={end=100.0, output_step=10.0}"
    result = simulate(start(tmp_path, body, ORBIT, f"effects.orbit.model={model}", time))
    np.testing.assert_allclose(result.bodies["box"].position, result.position[:, 0], rtol=1e-12, atol=1e-13)


@pytest.mark.ci
@pytest.mark.slow
def test_turning_in_the_frame_of_an_orbit(tmp_path: Path) -> None:
    """Against Euler's equations in inertial axes with the torque 3 n^2 r x I r, carried into Hill's frame."""
    rate = 0.05
    orbit = ORBIT.replace(str(RATE), str(rate))
    spin = np.array([0.2, -0.1, 0.3])  # relative to the frame
    body = f"bodies.sat={{mass=100.0, inertia={MOMENTS.tolist()}, angular_velocity={spin.tolist()}}}"
    time = "time={end=40.0, output_step=4.0}"
    result = simulate(start(tmp_path, body, orbit, time, "solver.step=0.01"))

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        turn, momentum = y[:9].reshape(3, 3), y[9:]  # inertial axes; the frame turns about z
        radial = np.array([math.cos(rate * t), math.sin(rate * t), 0.0])
        inertia = turn @ np.diag(MOMENTS) @ turn.T
        omega = np.linalg.solve(inertia, momentum)
        torque = 3.0 * rate**2 * np.cross(radial, inertia @ radial)
        return np.concatenate([np.cross(omega, turn.T).T.ravel(), torque])

    begin = np.concatenate([np.eye(3).ravel(), MOMENTS * np.add(spin, [0.0, 0.0, rate])])
    found = solve_ivp(rates, (0.0, 40.0), begin, rtol=1e-11, atol=1e-12, t_eval=result.time)
    for k, t in enumerate(result.time):
        back = rotation_matrix(np.array([math.cos(0.5 * rate * t), 0.0, 0.0, -math.sin(0.5 * rate * t)]))
        expected = back @ found.y[:9, k].reshape(3, 3)
        ours = rotation_matrix(result.bodies["sat"].attitude[k])
        np.testing.assert_allclose(ours, expected, atol=1e-7)


@pytest.mark.parametrize("effect", ["mass_damping.alpha=0.5", "rayleigh_damping={alpha=0.5, beta=0.0}"])
def test_damping_by_the_mass(effect: str, tmp_path: Path) -> None:
    """Speed and spin of a sphere decay as exp(-alpha t), and the energy is booked."""
    body = "bodies.ball={mass=3.0, inertia=[0.2, 0.2, 0.2], velocity=[1, 2, 3], angular_velocity=[0, 0, 4]}"
    result = simulate(start(tmp_path, body, f"effects.{effect}"))
    decay = np.exp(-0.5 * result.time)[:, None]
    ball = result.bodies["ball"]
    np.testing.assert_allclose(ball.velocity, decay * [1.0, 2.0, 3.0], rtol=1e-9)
    np.testing.assert_allclose(ball.angular_velocity, decay * [0.0, 0.0, 4.0], rtol=1e-9, atol=1e-12)
    total = result.kinetic + result.dissipated
    assert np.abs(total / total[0] - 1.0).max() < 1e-8


def test_guided_bodies_feel_nothing(tmp_path: Path) -> None:
    """They go where they are told; what acts by the mass is no part of what they give."""
    begin = start(
        tmp_path,
        "bodies.wall={mass=3.0, inertia=[0.2, 0.3, 0.4], motion='fixed'}",
        "effects.gravity.acceleration=[0, 0, -9.81]",
    )
    assert begin.system.blocks.free_bodies == ()
    assert begin.system.forces.on_bodies == set()


def test_what_leaves_bodies_out_says_so(tmp_path: Path) -> None:
    sunlight = "effects.solar_pressure={flux=1361.0, direction=[0, 0, 1], pressure_coefficient=1.0}"
    words = "act on net and tethers, not on bodies: solar_pressure"
    assert words in start(tmp_path, sunlight, "bodies.a={mass=1, inertia=[1, 1, 1]}").plan.notes
    assert words not in start(tmp_path, sunlight).plan.notes


def test_a_scene_without_bodies_has_no_such_terms(tmp_path: Path) -> None:
    begin = start(tmp_path, ORBIT, "effects.mass_damping.alpha=0.1")
    assert begin.system.forces.kernels == ()
    assert isinstance(begin.system.blocks, Blocks)
    assert begin.system.blocks.own_mass is begin.system.blocks.mass
