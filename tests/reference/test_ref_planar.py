"""The planar net of the paper: numbers to hold, symmetry, sensitivity.  Each names its source."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from reference_impl import acceleration, energy

TIMES = [0.0, 1.0, 1.25, 1.5, 1.75, 2.0]


@pytest.fixture(scope="module")
def undamped(scene):
    made = scene("planar_undamped.toml")
    return made, made.march(TIMES)


@pytest.fixture(scope="module")
def damped(scene):
    made = scene("planar_deployment.toml", symmetric=True)
    return made, made.march(TIMES)


def total_energy(made, run):
    return energy.kinetic(made.system, run.v) + energy.elastic(made.system, run.x) + run.dissipated


def test_bullet_speeds(undamped):
    """field.md: 2.231874 m/s at 1.00 s and 1.621663 m/s at 1.50 s, all four alike."""
    made, run = undamped
    speeds = made.bullet_speeds(run)
    assert speeds[1] == pytest.approx([2.231874] * 4, abs=1e-6)
    assert speeds[3] == pytest.approx([1.621663] * 4, abs=1e-6)
    assert np.ptp(speeds[:4], axis=1).max() <= 1e-12


def test_energy_is_constant_without_damping(undamped):
    """Issue: E0 = 6.404390 J; constant to 1e-5 over 2 s."""
    total = total_energy(*undamped)
    assert total[0] == pytest.approx(6.404390, abs=1e-6)
    assert np.abs(total / total[0] - 1.0).max() <= 1e-5


def test_momenta_are_constant_without_damping(undamped):
    made, run = undamped
    assert np.abs(energy.momentum(made.system, run.v)).max() < 1e-9
    assert np.abs(energy.angular_momentum(made.system, run.x, run.v)).max() < 1e-9


def test_energy_with_damping_balances(damped):
    total = total_energy(*damped)
    assert damped[1].dissipated[-1] > 0.01
    assert np.abs(total / total[0] - 1.0).max() <= 1e-5


def test_symmetric_arithmetic_keeps_the_bullets_bitwise_alike(damped):
    made, run = damped
    speeds = made.bullet_speeds(run)
    assert np.all(speeds == speeds[:, :1])


def test_symmetric_arithmetic_keeps_every_mirror_bitwise(damped):
    made, run = damped
    row = {tuple(p): i for i, p in enumerate((made.net.reference_position + 0.0).tolist())}
    for mirror in (lambda p: p * [-1, 1, 1], lambda p: p * [1, -1, 1], lambda p: p[..., [1, 0, 2]]):
        image = [row[tuple(p)] for p in (mirror(made.net.reference_position) + 0.0).tolist()]
        assert np.array_equal(run.x[:, image], mirror(run.x))
        assert np.array_equal(run.v[:, image], mirror(run.v))


@pytest.mark.parametrize("topology", ["square", "radial"])
def test_symmetric_arithmetic_keeps_mirrors_of_fine_nets(document, scene, topology):
    made = scene(
        document(topology, divisions=2),
        {
            "launch.axial_speed": 1.0,
            "initial.packing": 0.7,
            "effects.rayleigh_damping": {"alpha": 1e-3, "beta": 1e-6},
        },
        symmetric=True,
    )
    run = made.march([0.0, 0.3], method="RK45", rtol=1e-5, atol=1e-7)
    row = {tuple(p): i for i, p in enumerate((made.net.reference_position + 0.0).tolist())}
    assert np.abs(run.v[-1] - run.v[0]).max() > 0.1
    for mirror in (lambda p: p * [-1, 1, 1], lambda p: p * [1, -1, 1], lambda p: p[..., [1, 0, 2]]):
        image = [row[tuple(p)] for p in (mirror(made.net.reference_position) + 0.0).tolist()]
        assert np.array_equal(run.x[:, image], mirror(run.x))


def test_default_arithmetic_lets_the_curves_separate(damped, scene):
    """field.md: with the paper's damping, round-off alone separates the four curves between 1.5 and 2.0 s."""
    made = scene("planar_deployment.toml")
    speeds = made.bullet_speeds(made.march([0.0, 1.5, 2.0], rtol=1e-8, atol=1e-10))
    assert np.ptp(speeds[1]) < 1e-6
    assert np.ptp(speeds[2]) > 1e-3


def test_curves_separate_at_the_defaults_of_ode45(scene):
    """Paper, Fig. 5: the four curves separate for t > 1.75 s."""
    made = scene("planar_deployment.toml")
    run = made.march(method="RK45")
    apart = np.ptp(made.bullet_speeds(run), axis=1) > 1e-2
    assert 1.6 < run.t[np.argmax(apart)] < 1.95
    assert np.ptp(made.bullet_speeds(run)[-1]) > 0.05
    total = total_energy(made, run)
    assert np.abs(total / total[0] - 1.0).max() > 0.01  # these tolerances do not keep the balance


def test_scipy_agrees(scene, undamped):
    """SciPy's own driver of DOP853 on the same right-hand side."""
    made, run = undamped
    n = len(made.net.mass)

    def rate(t, y):
        x, v = y.reshape(2, n, 3)
        return np.concatenate((y[3 * n :], acceleration(made.system, t, x, v).ravel()))

    with np.errstate(all="ignore"):  # SciPy tries steps that are far too long
        other = solve_ivp(
            rate,
            (0.0, 1.5),
            np.concatenate((made.x0.ravel(), made.v0.ravel())),
            method="DOP853",
            rtol=1e-10,
            atol=1e-12,
        )
    bullet = other.y[3 * n :, -1].reshape(n, 3)[made.net.bullet_nodes]
    assert np.linalg.norm(bullet, axis=1) == pytest.approx(made.bullet_speeds(run)[3], abs=1e-6)


def test_sensitivity_to_the_start(scene):
    """field.md: 1e-12 m at the start is about 4e-13 m/s at 1.0 s, but 0.1 m/s at 1.5 s."""
    made = scene("planar_undamped.toml")
    made.x0 = made.x0 + 1e-12 * np.random.default_rng(1).standard_normal(made.x0.shape)
    spread = np.ptp(made.bullet_speeds(made.march([0.0, 1.0, 1.5])), axis=1)
    assert spread[1] < 1e-11
    assert spread[2] > 1e-3


@pytest.mark.slow
def test_symmetric_runs_converge(scene):
    """Kept symmetric, the damped run converges to the end: reference values for the symmetric motion."""
    made = scene("planar_deployment.toml", symmetric=True)
    rough, fine = (made.bullet_speeds(made.march(TIMES, rtol=r, atol=r / 100))[:, 0] for r in (1e-10, 1e-12))
    assert np.abs(rough - fine).max() < 1e-6
    assert fine[1:] == pytest.approx(
        [2.2612965804, 2.2633471175, 2.0154888410, 1.8046988894, 0.54215856], abs=1e-8
    )
