"""Springs and gas that launch bullets, and a launch at an angle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import BACKENDS, EFFECT_CASES
from scipy.spatial.transform import Rotation

from exunet.bodies.rotations import rotation_matrix
from exunet.forces.effects import launch_force
from exunet.results.measures import centre_of_mass
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate

GUN = {"kind": "spring", "force": 64.0, "stroke": 0.05, "spread_angle": 0.2, "body": "chaser"}
GAS = GUN | {"kind": "gas", "dead_length": 0.1, "exponent": 1.4}


@pytest.mark.slow_for("compiled")
@pytest.mark.parametrize(
    ("backend", "keys"),
    [
        pytest.param(
            backend, keys, id=f"{backend}-{keys['kind']}", marks=[pytest.mark.slow] * (backend == "compiled")
        )
        for backend in BACKENDS
        for keys in (GUN, GAS)
    ],
)
def test_a_launch_by_force_keeps_momentum_and_does_its_work(keys: dict[str, Any], backend: str) -> None:
    changes = ["bodies.chaser.mass=5.0", "time.end=0.05", "solver.tolerance=1e-10"]
    case = load(EFFECT_CASES / "launch_force.toml", [*changes, f"engine.backend={backend}"])
    launch = TypeAdapter(launch_force.AnyLaunchForce).validate_python(keys)
    effects = case.scene.effects.model_copy(update={"launch_force": launch})
    run = simulate(prepare(case.scene.model_copy(update={"effects": effects})))
    assert np.abs(run.momentum).max() < 1e-12
    assert run.potential[0] == pytest.approx(4 * launch.work, rel=1e-12)
    assert run.potential[-1] == 0.0  # all have left their barrels
    assert run.kinetic[-1] + run.elastic[-1] == pytest.approx(run.potential[0], rel=1e-6)
    chaser = run.bodies["chaser"]
    assert chaser.velocity[-1, 2] < 0.0  # the recoil
    # The centre of the net alone, which goes off forwards; with the chaser's, weighed, it stays where it was.
    centre = centre_of_mass(run)
    assert centre[-1, 2] - centre[0, 2] > 0.01
    whole = run.net.mass.sum() * centre + chaser.mass * chaser.position
    assert np.abs(whole - whole[0]).max() < 1e-12


def test_the_work_of_gas_is_the_integral_of_its_force() -> None:
    keys = launch_force.GasLaunchForce.model_validate(GAS)
    s, weight = np.polynomial.legendre.leggauss(30)
    way = 0.025 * (s + 1.0)
    assert keys.work == pytest.approx(0.025 * weight @ (64.0 * (0.1 / (0.1 + way)) ** 1.4), rel=1e-13)


def test_a_spread_launch_is_its_two_components() -> None:
    spread = prepare(load(EFFECT_CASES / "spread_launch.toml").scene)
    plain = load(
        EFFECT_CASES / "spread_launch.toml",
        ["launch.speed=", "launch.spread_angle=", f"launch.radial_speed={4 * math.sin(0.2)!r}",
         f"launch.axial_speed={4 * math.cos(0.2)!r}"],
    )  # fmt: skip
    np.testing.assert_allclose(spread.velocity, prepare(plain.scene).velocity, rtol=0, atol=1e-15)


RANDOM = np.random.default_rng(20261121)
AXES = np.array([[0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [0.48, 0.64, 0.6]])


def test_gas_does_not_push_at_the_end_of_the_stroke() -> None:
    """There its force falls to zero, from F0 (V / (V + stroke))^gamma."""
    axes, bullets = np.array([[0.0, 0.0, 1.0]]), np.array([0])
    law = launch_force.LaunchLaw(60.0, 0.5, 0.5, 2.0)
    on_body = launch_force.Barrels(bullets, np.ones(1), axes, np.array([0.25]), 3, 6, 6, law)
    muzzles = launch_force.Muzzles(on_body)
    for way, push, left in ((0.5, 0.0, [0]), (0.5 - 2.0**-40, 15.0, [])):
        x, force = np.array([0, 0, way + 0.25, 0, 0, 0, 1.0, 0, 0, 0]), np.zeros(9)
        launch_force.add_launch_of_body(0.0, x, np.zeros(9), on_body, force)
        assert force[2] == pytest.approx(push, rel=1e-9)
        assert muzzles.crossed(0.0, x, np.zeros(9), np.ones(1)).tolist() == left
        assert (launch_force.beyond_muzzle(0.0, x, np.zeros(9), on_body) >= 0.0) == bool(left)
        assert muzzles.crossed(0.0, x, np.zeros(9), np.zeros(1)).tolist() == []


@pytest.mark.parametrize(
    "law", [launch_force.LaunchLaw(60.0, 0.4), launch_force.LaunchLaw(60.0, 0.4, 0.15, 1.4)]
)
def test_force_and_torque_do_the_virtual_work_of_the_potential(law: launch_force.LaunchLaw) -> None:
    """Moves of bullet and body, and turns of the body, against the change of U by central differences.

    Behind the start, in the barrel, out of it, and back in it after it had left.
    """
    axes = np.vstack([AXES, [0.0, 0.0, 1.0]])
    points = np.arange(0, 12, 3)
    inside, start = np.array([1.0, 1.0, 1.0, 0.0]), np.array([0.1, 0.2, -0.3, 0.0])
    # Four bullets, the centre, the attitude; velocities have their spin at 15.
    data = launch_force.Barrels(points, inside, axes, start, 12, 15, 15, law)
    x, force = np.concatenate([RANDOM.normal(0.0, 0.3, 15), RANDOM.normal(size=4)]), np.zeros(18)
    x[15:] /= np.linalg.norm(x[15:])
    turn, wanted = rotation_matrix(x[15:]), np.array([-0.05, 0.2, 0.5, 0.1])
    for b in range(4):
        arm = (x[3 * b : 3 * b + 3] - x[12:15]) @ turn
        arm += (wanted[b] + start[b] - arm @ axes[b]) * axes[b]
        x[3 * b : 3 * b + 3] = x[12:15] + turn @ arm
    launch_force.add_launch_of_body(0.0, x, np.zeros(18), data, force)
    assert [launch_force.way_in_barrel(x, b, data) for b in range(4)] == pytest.approx(wanted, abs=1e-14)
    pushes = np.linalg.norm(force[:12].reshape(4, 3), axis=1)
    if law.exponent:
        ratio = (0.15 / np.array([0.15, 0.35])) ** 1.4
        assert pushes == pytest.approx([*60.0 * ratio, 0.0, 0.0], rel=1e-12)
    else:
        assert pushes == pytest.approx([67.5, 30.0, 0.0, 0.0], rel=1e-12)
    step, slope = 1e-6, np.zeros(18)
    for k in range(18):
        ends = []
        for sign in (step, -step):
            moved = x.copy()
            if k < 15:
                moved[k] += sign
            else:
                axis = sign * np.eye(3)[k - 15]
                attitude = Rotation.from_quat(x[15:], scalar_first=True) * Rotation.from_rotvec(axis)
                moved[15:] = attitude.as_quat(scalar_first=True)
            ends.append(launch_force.launch_of_body_potential(moved, data))
        slope[k] = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(force, -slope, atol=1e-7)
    # One line: no net force, and no net torque about any point.
    assert np.abs(force[:15].reshape(5, 3).sum(axis=0)).max() < 1e-14 * 60.0
    about = np.cross(x[:15].reshape(5, 3), force[:15].reshape(5, 3)).sum(axis=0) + turn @ force[15:]
    assert np.abs(about).max() < 1e-13 * 60.0
