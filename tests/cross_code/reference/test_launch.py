"""Launches of reference_impl: speeds from work, forces at the start, balances."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reference_impl import acceleration, energy
from reference_impl.effects.launch_force import LaunchForce
from reference_impl.forces import Whole, response

SPRING = {"kind": "spring", "force": 64.0, "stroke": 0.05, "spread_angle": 0.4, "body": "chief"}
GAS = {**SPRING, "kind": "gas", "dead_length": 0.02, "exponent": 1.4}
WORK = {
    "spring": 0.5 * 64.0 * 0.05,
    "gas": 64.0 * 0.02 / 0.4 * (1.0 - (0.02 / 0.07) ** 0.4),  # F0 V/(gamma - 1) (1 - (V/(V + s))^(gamma - 1))
}
LAUNCHES = pytest.mark.parametrize("launch", [SPRING, GAS], ids=["spring", "gas"])
BALL = {"mass": 5.0, "inertia": [1.0, 1.0, 1.0]}
OUTWARDS = np.array([[-1.0, -1.0, 0], [1.0, -1.0, 0], [1.0, 1.0, 0], [-1.0, 1.0, 0]]) / math.sqrt(2.0)


@pytest.fixture(scope="module")
def launched(loose):
    """launched(launch, body, frame): the loose net and a body that throws its bullets."""

    def make(launch, body, frame=None):
        case = loose(launch_force=launch)
        carried = {} if frame is None else {"frame": frame}
        return {**case, "initial": {**case["initial"], **carried}, "bodies": {"chief": body}}

    return make


@LAUNCHES
@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2.0])
def test_speed_from_work_and_recoil(launched, scene, launch, angle):
    """Four bullets m and a chaser M: 1/mu = 1/m + 4 cos^2/M along a barrel, mu s'^2/2 = W at the muzzle.

    Each bullet has the impulse mu s' along its barrel, sin outwards and cos along +z; the chaser the opposite
    of their sum.
    """
    made = scene(launched({**launch, "spread_angle": angle}, BALL))
    run = made.integrate([0.0, 0.1])
    m = made.net.mass[made.net.bullet_nodes[0]]
    reduced = 1.0 / (1.0 / m + 4.0 * math.cos(angle) ** 2 / 5.0)
    impulse = math.sqrt(2.0 * WORK[launch["kind"]] * reduced)
    expected = impulse / m * (math.sin(angle) * OUTWARDS + math.cos(angle) * np.array([0.0, 0.0, 1.0]))
    assert run.v[-1, made.net.bullet_nodes] == pytest.approx(expected, rel=1e-9, abs=1e-11)
    recoil = [0.0, 0.0, -4.0 * impulse * math.cos(angle) / 5.0]
    assert run.bodies.velocity[-1, 0] == pytest.approx(recoil, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ["spring", "gas"])
def test_law_by_hand(kind):
    """F0 (1 - s/stroke) and F0 (V/(V + s))^gamma; F0 behind the start for gas, more than F0 for a spring."""
    gas = (0.02, 1.4) if kind == "gas" else (None, None)
    law = LaunchForce(64.0, 0.05, 0.0, "chief", *gas)
    s = np.array([-0.01, 0.0, 0.02, 0.0499999, 0.0500001, 0.3])
    expected = {
        "spring": [76.8, 64.0, 38.4, 1.28e-4, 0.0, 0.0],
        "gas": [64.0, 64.0, 64.0 * 0.5**1.4, 64.0 * (0.02 / 0.0699999) ** 1.4, 0.0, 0.0],
    }
    assert law.push(s) == pytest.approx(expected[kind], rel=1e-9)
    assert law.held(np.array([0.0])) == pytest.approx([WORK[kind]], rel=1e-14)
    assert law.held(np.array([0.05, 0.2])).tolist() == [0.0, 0.0]
    h = 1e-6
    inside = np.array([-0.01, 0.001, 0.02, 0.049])
    slope = (law.held(inside - h) - law.held(inside + h)) / (2.0 * h)
    assert slope == pytest.approx(law.push(inside), rel=1e-7)


UNEVEN = {
    "mass": 5.0,
    "inertia": [1.5, 2.0, 2.5],
    "products_of_inertia": [0.2, -0.3, 0.25],
    "centre_of_mass": [0.1, -0.2, 0.05],
    "position": [0.3, -0.1, -0.4],
    "velocity": [0.3, -0.2, 0.1],
    "attitude": [1.0, 0.3, -0.2, 0.4],
}
OMEGA = [4.0, -3.0, 5.0]  # 7.07 rad/s
FRAME = {"body": "chief", "position": [0.2, 0.1, 0.5], "axis": [1.0, 2.0, 0.5], "angle": 0.7}


def axes_of(frame, body):
    """Rotation from the net's axes to the scene's."""

    def turn(axis, angle):
        x, y, z = np.array(axis) / np.linalg.norm(axis)
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k

    own = turn(body["axis"], body["angle"]) if "axis" in body else np.eye(3)
    return own if frame is None else own @ turn(frame["axis"], frame["angle"])


FROM_BODY = [
    ({}, 1e-10, 1e-12),
    ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-7, 1e-9),
]
METHOD_NAMES = ["DOP853", "RK45"]


@pytest.mark.ci_for("RK45-still-carried-spring")
@pytest.mark.slow
@LAUNCHES
@pytest.mark.parametrize("carried", [False, True], ids=["apart", "carried"])
@pytest.mark.parametrize("spin", [0.0, 1.0], ids=["still", "spinning"])
@pytest.mark.parametrize(("options", "bound", "angular"), FROM_BODY, ids=METHOD_NAMES)
def test_books_close(launched, scene, unbalanced, launch, carried, spin, options, bound, angular):
    """Energy, momentum and angular momentum of net and body, whether the body turns fast or not at all."""
    body = {**UNEVEN, "angular_velocity": [spin * w for w in OMEGA]}
    made = scene(launched(launch, body, FRAME if carried else None))
    run = made.integrate([0.0, 0.005, 0.03, 0.1], **options)
    books = energy.books(made.system, run)
    assert books.potential[0] == pytest.approx(4.0 * WORK[launch["kind"]])
    assert books.potential[-1] == 0.0
    assert run.gone[-1].all()
    assert unbalanced(made, run) < bound
    assert np.abs(books.momentum - books.momentum[0]).max() < 1e-12
    drift = np.abs(books.angular_momentum - books.angular_momentum[0]).max()
    assert drift < angular * max(1.0, np.abs(books.angular_momentum).max())
    turned = np.abs(
        np.einsum(
            "tij,jk,tk->ti",
            run.bodies.attitude[:, 0],
            made.system.bodies.inertia[0],
            run.bodies.angular_velocity[:, 0],
        )
    )
    assert np.ptp(turned, axis=0).max() > 1e-3  # the pushes turn the body


def test_forces_at_the_start(launched, scene):
    """F0 n on each bullet, R a = n, the opposite on the body at the bullet's place; by hand."""
    made = scene(launched(SPRING, {**UNEVEN, "angular_velocity": OMEGA}, FRAME))
    bodies, bullets = made.bodies0, made.net.bullet_nodes
    (body,) = made.case.bodies
    axes = body.attitude @ axes_of(FRAME, {})
    n = (math.sin(0.4) * OUTWARDS + math.cos(0.4) * np.array([0.0, 0.0, 1.0])) @ axes.T
    h = bodies.attitude[0] @ made.system.bodies.inertia[0] @ bodies.angular_velocity[0]
    x, v = (np.concatenate(pair) for pair in ((made.x0, bodies.position), (made.v0, bodies.velocity)))
    found = response(made.system, 0.0, Whole(x, v, bodies.attitude, h[None]))
    mass = made.net.mass[bullets, None]
    assert mass * found.acceleration[bullets] == pytest.approx(64.0 * n, abs=1e-10)
    assert 5.0 * found.acceleration[-1] == pytest.approx(-64.0 * n.sum(axis=0), abs=1e-10)
    lever = made.x0[bullets] - bodies.position[0]
    assert found.torque[0] == pytest.approx(np.cross(lever, -64.0 * n).sum(axis=0), abs=1e-10)
    gone = np.array([True, False, False, True])
    a = acceleration(made.system, 0.0, made.x0, made.v0, bodies, gone=gone)
    assert mass * a[bullets] == pytest.approx(np.where(gone[:, None], 0.0, 64.0 * n), abs=1e-10)
