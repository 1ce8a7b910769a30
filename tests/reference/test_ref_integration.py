"""The integrators of reference_impl: order, convergence, known answers, breakdown."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from reference_impl import Diverged, Interrupted, acceleration, energy
from reference_impl.forces import strain, tension
from reference_impl.integration import integrate


@pytest.fixture(scope="module")
def cross(explicit, scene):
    """A mass held by four stretched soft cables, swinging slowly: smooth, always taut."""
    nodes = [[0.0, 0, 0], [1.0, 0, 0], [0.0, 1.0, 0], [-1.0, 0, 0], [0.0, -1.0, 0]]
    start = {
        "node_positions": [[0.05, 0.02, 0.1], *(np.array(nodes[1:]) * 1.3).tolist()],
        "node_velocities": [[0.3, -0.2, 0.5], *[[0.0, 0, 0]] * 4],
    }
    case = explicit(
        nodes,
        [[0, 1], [0, 2], [0, 3], [0, 4]],
        start,
        fixed=[1, 2, 3, 4],
        cable={"area": 1e-4, "density": 1000.0, "youngs_modulus": 1e5},
    )
    return scene(case, {"effects.rayleigh_damping": {"alpha": 0.1, "beta": 1e-4}})


@pytest.fixture(scope="module")
def exact(cross):
    run = cross.integrate([0.0, 1.0], rtol=1e-13, atol=1e-15)
    assert (strain(cross.system, run.x) > 0).all()
    return run


def error(run, exact):
    return float(np.abs(run.x[-1] - exact.x[-1]).max())


@pytest.mark.ci
@pytest.mark.slow
def test_rk4_is_of_order_4(cross, exact):
    errors = [error(cross.integrate([0.0, 1.0], method="RK4", step=h), exact) for h in (8e-3, 4e-3, 2e-3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.25)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.25)


def test_dissipated_energy_converges_with_the_motion(cross, exact):
    total = energy.kinetic(cross.system, exact.v) + energy.elastic(cross.system, exact.x) + exact.dissipated
    assert exact.dissipated[-1] > 1e-4
    assert total[1] == pytest.approx(total[0], rel=1e-12)


@pytest.mark.ci
@pytest.mark.slow
def test_tighter_tolerances_err_less(cross, exact):
    for method, bound in (("RK45", 1.0), ("DOP853", 1.0)):
        errors = [
            error(cross.integrate([0.0, 1.0], method=method, rtol=r, atol=r), exact)
            for r in (1e-4, 1e-7, 1e-10)
        ]
        assert errors[0] > 30 * errors[1] > 900 * errors[2]
        assert errors[2] < bound * 1e-8


@pytest.mark.ci_for("RK45")
@pytest.mark.slow_for("RK45")
@pytest.mark.parametrize("method", ["RK45", "DOP853"])
def test_agrees_with_scipy(cross, method):
    """One span without outputs in between: SciPy's own driver of the same pair comes to the same place."""
    n = len(cross.net.mass)

    def rate(t, y):
        x, v = y.reshape(2, n, 3)
        return np.concatenate((v.ravel(), acceleration(cross.system, t, x, v).ravel()))

    other = solve_ivp(
        rate,
        (0.0, 1.0),
        np.concatenate((cross.x0.ravel(), cross.v0.ravel())),
        method=method,
        rtol=1e-9,
        atol=1e-12,
    )
    own = cross.integrate([0.0, 1.0], method=method, rtol=1e-9, atol=1e-12)
    assert np.allclose(own.x[-1].ravel(), other.y[: 3 * n, -1], rtol=0, atol=1e-8)


@pytest.mark.ci_for("options1")
@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"method": "RK45"}, {"method": "RK4", "step": 3e-3}])
def test_output_times_are_hit_exactly(cross, options):
    times = [0.0, 0.1, 0.1000001, 0.7, 1.0]
    run = cross.integrate(times, **options)
    assert run.t.tolist() == times
    ends = [cross.integrate([0.0, t], rtol=1e-12, atol=1e-14).x[-1] for t in times[1:]]
    assert np.allclose(run.x[1:], ends, rtol=0, atol=1e-2 if options.get("method") == "RK45" else 1e-6)


def test_rk45_stores_without_changing_its_steps(cross):
    """As ode45 does: dense output.  The second stored time bounds the first step and is kept."""
    few, many = (
        cross.integrate([0.0, 0.01, *np.linspace(0.0, 1.0, n)[1:]], method="RK45", rtol=1e-6) for n in (2, 38)
    )
    assert np.array_equal(few.x[-1], many.x[-1])
    assert (few.n_rhs, few.n_steps) == (many.n_rhs, many.n_steps)
    fine = cross.integrate(many.t, rtol=1e-12, atol=1e-14)
    assert np.abs(many.x - fine.x).max() < 3 * np.abs(many.x[-1] - fine.x[-1]).max() < 1e-4


def test_rk4_stores_after_exactly_one_step(cross):
    """Against eq. (16) and the tableau by hand."""
    h, system = 1e-3, cross.system
    run = cross.integrate([0.0, h], method="RK4", step=h)

    def rate(x, v):
        return np.array([v, acceleration(system, 0.0, x, v)])

    y = np.array([cross.x0, cross.v0])
    k1 = rate(*y)
    k2 = rate(*(y + h / 2 * k1))
    k3 = rate(*(y + h / 2 * k2))
    k4 = rate(*(y + h * k3))
    expected = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert (run.n_steps, run.n_rhs) == (1, 4)
    assert np.allclose(run.x[1], expected[0], rtol=0, atol=1e-15)
    assert np.allclose(run.v[1], expected[1], rtol=0, atol=1e-14)


def test_starts_from_any_state(cross, exact):
    half = cross.integrate([0.0, 0.4], rtol=1e-13, atol=1e-15)
    rest = integrate(cross.system, half.x[-1], half.v[-1], [0.4, 1.0], rtol=1e-13, atol=1e-15)
    assert error(rest, exact) < 1e-11


@pytest.mark.slow
def test_snap_of_two_masses(explicit, scene):
    """field.md: E11_max = 5.331090e-3, N_peak = 294.65036 N, contact 6.67665e-3 s, rebound at 2.5 m/s."""
    light = 0.5 * 1390.0 * np.pi / 4 * 1e-6
    start = {"node_velocities": [[-1.25, 0.0, 0.0], [1.25, 0.0, 0.0]]}
    case = explicit(
        [[0.0, 0, 0], [1.0, 0, 0]],
        [[0, 1]],
        start,
        node_masses=[0.5 - light] * 2,
        cable={"diameter": 1e-3, "density": 1390.0, "youngs_modulus": 70e9},
    )
    snap = scene(case)
    run = snap.integrate(np.linspace(0.0, 8e-3, 4001))
    e11 = strain(snap.system, run.x)[:, 0]
    gap = 1.0 - (run.x[-1, 1, 0] - run.x[-1, 0, 0])
    assert e11.max() == pytest.approx(5.331090e-3, abs=1e-9)
    assert tension(snap.system, run.x).max() == pytest.approx(294.65036, abs=5e-5)
    assert run.v[-1, 0, 0] - run.v[-1, 1, 0] == pytest.approx(2.5, rel=1e-9)
    assert run.t[-1] - gap / 2.5 == pytest.approx(6.67665e-3, abs=5e-9)


def test_free_flight_under_gravity(document, scene):
    net = scene(
        document(),
        {
            "effects.gravity.acceleration": [0.0, 0.0, -9.81],
            "launch.radial_speed": 0.0,
            "initial.velocity": [1.0, 0.0, 2.0],
        },
    )
    run = net.integrate([0.0, 0.5])
    moved = np.array([0.5, 0.0, 2.0 * 0.5 - 0.5 * 9.81 * 0.25])
    assert np.allclose(run.x[-1] - run.x[0], moved, atol=1e-12)
    total = energy.kinetic(net.system, run.v) + energy.potential(net.system, run.x)
    assert total[1] == pytest.approx(total[0], rel=1e-12)


def test_net_at_rest_stays(document, scene):
    net = scene(document(), {"launch.radial_speed": 0.0, "initial.packing": 1.0})
    run = net.integrate([0.0, 1.0])
    assert np.abs(run.x[1] - run.x[0]).max() < 1e-14


def test_too_long_a_step_is_reported_with_time_and_element(document, scene):
    net = scene(document())
    with pytest.raises(Diverged) as diverged:
        net.integrate(method="RK4", step=5e-3)
    assert 0.0 < diverged.value.time < 1.0
    assert 0 <= diverged.value.element < 64
    assert np.isfinite(diverged.value.trajectory.x).all()
    assert diverged.value.trajectory.t[-1] <= diverged.value.time


@pytest.mark.parametrize("method", ["RK45", "DOP853"])
def test_infinite_forces_are_reported(document, scene, method):
    net = scene(document(), {"initial.packing": 1e120})
    with pytest.raises(Diverged) as diverged:
        net.integrate(method=method)
    assert len(diverged.value.trajectory.t) == 1


def test_interruption_keeps_what_was_done(cross):
    def stop(time, end):
        if time >= 0.3:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as interrupted:
        cross.integrate([0.0, 0.1, 0.2, 0.3, 1.0], progress=stop)
    assert interrupted.value.trajectory.t.tolist() == [0.0, 0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    "options",
    [
        {"method": "Euler"},
        {"method": "RK4"},
        {"step": 1e-3},
        {"rtol": 0.0},
        {"atol": float("nan")},
        {"method": "RK4", "step": 1e-3, "rtol": 1e-3},
        {"times": [0.0, 0.0]},
        {"times": []},
    ],
)
def test_refuses_arguments_that_cannot_be_meant(cross, options):
    with pytest.raises(ValueError, match=r"must|RK4"):
        cross.integrate(**options)


def test_refuses_moving_fixed_nodes(cross):
    with pytest.raises(ValueError, match="fixed"):
        integrate(cross.system, cross.x0, np.ones_like(cross.v0), [0.0, 1.0])


def test_how_to_integrate_is_named(cross):
    """Nothing of it can be taken for something else by its place."""
    with pytest.raises(TypeError):
        integrate(cross.system, cross.x0, cross.v0, [0.0, 1.0], "RK4")
