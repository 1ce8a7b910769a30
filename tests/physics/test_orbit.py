"""Gravity, an orbit and the Earth's oblateness: on points, and on bodies that they turn."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scenes import (
    BACKENDS,
    EFFECT_CASES,
    ORBIT,
    bodies_alone,
    every_backend,
    gradient,
    listed,
    model,
    ran,
    random_states,
    reference_run,
)
from scipy.integrate import solve_ivp

from exunet.bodies.rotations import rotation_matrix
from exunet.forces import on_bodies
from exunet.forces.effects import j2, orbit
from exunet.forces.environment import EARTH_MU, EARTH_RADIUS
from exunet.integrators.exudyn.probe import Probe
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate


def test_gravity_is_free_fall() -> None:
    run = simulate(prepare(load(EFFECT_CASES / "parabolic_flight.toml", ["engine.backend=exudyn"]).scene))
    mass = run.net.mass / run.net.mass.sum()
    centre = np.einsum("n,tna->ta", mass, run.position)
    start = np.einsum("n,na->a", mass, run.velocity[0])
    fall = np.outer(0.5 * run.time**2, [0.0, 0.0, -0.49])
    np.testing.assert_allclose(centre, np.outer(run.time, start) + fall, rtol=0, atol=1e-12)


def hill(n: float, time: np.ndarray, x0: np.ndarray, v0: np.ndarray) -> np.ndarray:
    """Clohessy-Wiltshire state transition (radial, along, across): Vallado, sec. 6.8.1, eq. (6-66)."""
    x, y, z = x0
    u, v, w = v0
    s, c = np.sin(n * time), np.cos(n * time)
    return np.stack(
        [
            u / n * s - (3 * x + 2 * v / n) * c + 4 * x + 2 * v / n,
            (6 * x + 4 * v / n) * s + 2 * u / n * c - (6 * n * x + 3 * v) * time + y - 2 * u / n,
            z * c + w / n * s,
        ],
        axis=1,
    )


def two_in_orbit(model: str) -> dict[str, Any]:
    """Two slack nodes for one orbit, n = 1e-3 rad/s."""
    n = 1e-3
    return listed(
        [[0.0, 0.0, 0.0], [5000.0, 0.0, 0.0]],
        [[0, 1]],
        2 * math.pi / n,
        initial={
            "node_positions": [[3.0, -2.0, 4.0], [-10.0, 8.0, 5.0]],
            "node_velocities": [[0.004, 0.003, -0.002], [0.01, -0.02, 0.0]],
        },
        effects={"orbit": {"mean_motion": n, "model": model, **ORBIT}},
        solver={"method": "RK44", "step": 2 * math.pi / n / 4000},
    )


@pytest.mark.parametrize("code", ["exudyn", "reference"])
def test_hill_over_one_orbit(code: str) -> None:
    case = two_in_orbit("linear")
    if code == "reference":
        time, position = reference_run(case)
    else:
        run = ran(case, code)
        time, position = run.time, run.position
    radial, along = np.array(ORBIT["radial"]), np.array(ORBIT["along_track"])
    axes = np.stack([radial, along, np.cross(radial, along)])
    for node in range(2):
        x0 = axes @ np.array(case["initial"]["node_positions"][node])
        v0 = axes @ np.array(case["initial"]["node_velocities"][node])
        exact = hill(1e-3, time, x0, v0)
        assert np.abs(position[:, node] @ axes.T - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.slow_for("compiled")
@every_backend
def test_two_bodies_keep_energy_and_momentum_in_the_inertial_frame(backend: str) -> None:
    run = ran(two_in_orbit("two_body"), backend)
    n = 1e-3
    radius = (EARTH_MU / n**2) ** (1 / 3)
    radial = np.array(ORBIT["radial"])
    turn = n * np.cross(radial, ORBIT["along_track"])
    # In axes that are those of the scene at this moment; both quantities are scalars of the inertial motion.
    place = run.position + radius * radial
    speed = run.velocity + np.cross(turn, place)
    kepler = 0.5 * np.sum(speed**2, axis=-1) - EARTH_MU / np.linalg.norm(place, axis=-1)
    spin = np.linalg.norm(np.cross(place, speed), axis=-1)
    for conserved in (kepler, spin):
        assert np.abs(conserved / conserved[0] - 1.0).max() < 1e-12


# J2


def j2_keys(**more: float) -> j2.J2:
    return j2.J2.model_validate(
        {"altitude": 700e3, "inclination": 1.1, "argument_of_latitude": 0.7, **ORBIT} | more
    )


def test_the_j2_gradient_is_that_of_the_field() -> None:
    """Differences of the J2 acceleration in Cartesian form, Vallado, eq. (8-19 ff.), at points 1 km apart."""
    keys = j2_keys()
    radius = EARTH_RADIUS + 700e3
    # The scene's axes in the Earth's: place and direction of flight at this latitude argument, node along x.
    i, u = 1.1, 0.7
    up = np.array([math.cos(u), math.sin(u) * math.cos(i), math.sin(u) * math.sin(i)])
    forth = np.array([-math.sin(u), math.cos(u) * math.cos(i), math.cos(u) * math.sin(i)])
    scene = np.stack([keys.radial, keys.along_track, np.cross(keys.radial, keys.along_track)])
    turn = np.stack([up, forth, np.cross(up, forth)]).T @ scene  # from the scene's axes to the Earth's

    def field(place: np.ndarray) -> np.ndarray:
        r = float(np.linalg.norm(place))
        z2 = 5.0 * (place[2] / r) ** 2
        factor = -1.5 * j2.EARTH_J2 * EARTH_MU * EARTH_RADIUS**2 / r**5
        return factor * place * np.array([1.0 - z2, 1.0 - z2, 3.0 - z2])

    centre = radius * up
    step = 1e3
    numeric = np.stack(
        [
            turn.T @ (field(centre + step * turn[:, k]) - field(centre - step * turn[:, k])) / (2 * step)
            for k in range(3)
        ],
        axis=1,
    )
    found = keys.gradient()
    assert np.abs(found - numeric).max() < 1e-6 * np.abs(found).max()
    assert abs(np.trace(found)) < 1e-12 * np.abs(found).max()  # Laplace


def test_j2_pulls_nodes_apart_as_its_gradient_says() -> None:
    start = prepare(load(EFFECT_CASES / "j2.toml").scene)
    alone = prepare(load(EFFECT_CASES / "j2.toml", ["effects.j2="]).scene)
    place = start.net.reference_position
    still = np.zeros_like(place)
    change = Probe(model(start)).accelerations(place, still) - Probe(model(alone)).accelerations(place, still)
    keys = start.scene.effects.j2
    np.testing.assert_allclose(change, place @ keys.gradient(), rtol=0, atol=1e-15)


RANDOM = np.random.default_rng(20261121)


MASS, RADIUS, RATE = np.array([2.0, 3.0, 0.5, 1.0]), 5.0, 0.7  # an orbit so small that every term shows
RADIAL, NORMAL = np.array([0.36, 0.48, 0.8]), np.array([0.8, -0.6, 0.0])
CIRCLE = orbit.CircularOrbit(MASS, RATE, RADIUS, RADIAL, NORMAL)


def test_two_bodies_pull_with_the_inverse_square() -> None:
    """m [-mu (R r + x) / |R r + x|^3 + n^2 (R r + x, without its part along h)], mu = n^2 R^3."""
    for x, _ in random_states(5):
        place = RADIUS * RADIAL + x
        pull = -(RATE**2) * RADIUS**3 * place / np.linalg.norm(place, axis=1, keepdims=True) ** 3
        turned = RATE**2 * (place - np.outer(place @ NORMAL, NORMAL))
        force = np.zeros(12)
        orbit.add_two_body(0.0, x.ravel(), x.ravel(), CIRCLE, force)
        np.testing.assert_allclose(force.reshape(4, 3), MASS[:, None] * (pull + turned), atol=1e-13)

        def stored(y: np.ndarray) -> float:
            return orbit.two_body_potential(y, CIRCLE)

        np.testing.assert_allclose(gradient(stored, x.ravel(), 1e-3), -force, rtol=1e-9, atol=1e-10)
    assert stored(np.zeros(12)) == 0.0


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


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_body_falls_as_the_net(backend: str) -> None:
    """-g t^2 / 2 for both; the engine and the loop integrate a parabola exactly, but for round-off."""
    body = "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4], angular_velocity=[0.1, 0.2, 0.3]}"
    result = simulate(bodies_alone(body, BACKENDS[backend], "effects.gravity.acceleration=[0.0, 0.5, -9.81]"))
    fallen = 0.5 * np.outer(result.time**2, [0.0, 0.5, -9.81])
    np.testing.assert_allclose(result.bodies["box"].position, fallen, atol=1e-12)
    np.testing.assert_allclose(result.position[:, 0] - [0.0, 0.0, 1.0], fallen, atol=1e-12)
    total = result.kinetic + result.potential
    assert np.abs(total - total[0]).max() < 1e-10


@pytest.mark.slow_for("compiled")
@every_backend
def test_a_tied_node_weighs_once(backend: str) -> None:
    """A node on a body, off its centre: both fall, and the body does not turn."""
    body = (
        "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4]}",
        "bodies.box.attachments.a={node=0, point=[0.3, 0.2, 0.1]}",
    )
    result = simulate(bodies_alone(*body, BACKENDS[backend], "effects.gravity.acceleration=[0, 0, -9.81]"))
    box = result.bodies["box"]
    np.testing.assert_allclose(
        box.position[:, 2] - box.position[0, 2], -0.5 * 9.81 * result.time**2, atol=1e-11
    )
    assert np.abs(box.angular_velocity).max() < 1e-12


SLOW = 1.1e-3  # rad/s
IN_ORBIT = f"effects.orbit={{mean_motion={SLOW}, radial=[1, 0, 0], along_track=[0, 1, 0], model='linear'}}"
MOMENTS = np.array([20.0, 50.0, 40.0])


@pytest.mark.parametrize("model", ["linear", "two_body"])
def test_a_body_in_orbit_moves_as_a_particle(model: str) -> None:
    """The centre of a body beside a node of the net: the same orbit, whatever the body's attitude."""
    body = "bodies.box={mass=3.0, inertia=[0.2, 0.3, 0.4], position=[0, 0, 1], angular_velocity=[1, 2, 3]}"
    time = "time={end=2.0, output_step=0.5}"  # over which the gradient moves both by 2e-6 m
    result = simulate(bodies_alone(body, IN_ORBIT, f"effects.orbit.model={model}", time))
    np.testing.assert_allclose(result.bodies["box"].position, result.position[:, 0], rtol=1e-12, atol=1e-13)


@pytest.mark.ci
@pytest.mark.slow
def test_turning_in_the_frame_of_an_orbit() -> None:
    """Against Euler's equations in inertial axes with the torque 3 n^2 r x I r, carried into Hill's frame."""
    rate = 0.05
    orbit = IN_ORBIT.replace(str(SLOW), str(rate))
    spin = np.array([0.2, -0.1, 0.3])  # relative to the frame
    body = f"bodies.sat={{mass=100.0, inertia={MOMENTS.tolist()}, angular_velocity={spin.tolist()}}}"
    time = "time={end=40.0, output_step=4.0}"
    result = simulate(bodies_alone(body, orbit, time, "solver.step=0.01"))
    total = result.kinetic + result.potential
    assert np.abs(total - total[0]).max() < 1e-9 * MOMENTS[2] * rate**2

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
