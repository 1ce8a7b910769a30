"""Thrust of reference_impl: impulses by hand, stage times, knots."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from reference_impl import energy
from reference_impl.effects.thrust import Thrust

TIME = [0.013, 0.05, 0.09]
FORCE = [[1.0, 0.0, 5.0], [0.0, -3.0, 2.0], [0.5, 2.0, 1.0]]  # jumps at the first and the last knot
THRUST = {"bullets": [1, 2], "time": TIME, "force": FORCE}


def integral(t, order):
    """Velocity (order 1) and way (order 2) per mass of the force at time t, by hand: polynomials a knot."""
    total, slope_sum = np.zeros(3), np.zeros(3)  # way and velocity so far
    now = 0.0
    for (a, b), (f, g) in zip(pairwise(TIME), pairwise(FORCE), strict=True):
        f, g = np.array(f), np.array(g)
        if t <= a:
            break
        total, now = total + slope_sum * (a - now), a
        h = min(t, b) - a
        rate = (g - f) / (b - a)
        total = total + slope_sum * h + f * h**2 / 2.0 + rate * h**3 / 6.0
        slope_sum = slope_sum + f * h + rate * h**2 / 2.0
        now = a + h
    total = total + slope_sum * (t - now)
    return (slope_sum, total)[order - 1]


@pytest.mark.slow_for("Verlet")
@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-13),
        ({"method": "RK4", "step": 0.02}, 1e-14),  # linear in t: order 4 is exact
        ({"method": "RK4", "step": 0.0017}, 1e-13),
        ({"method": "RK45"}, 1e-13),
        ({"method": "Verlet", "step": 1e-5}, 1e-9),
    ],
    ids=["DOP853", "RK4 coarse", "RK4", "RK45", "Verlet"],
)
def test_free_bullets_follow_the_integrals(loose, scene, options, bound):
    """Slack net: x = int int F/m, on bullets 1 and 2 only; steps end at the knots, where the force jumps."""
    made = scene(loose(thrust=THRUST))
    times = np.array([0.0, 0.01, 0.013, 0.03, 0.05, 0.07, 0.09, 0.12])
    run = made.integrate(times, **options)
    pushed, others = made.net.bullet_nodes[[1, 2]], made.net.bullet_nodes[[0, 3]]
    m = made.net.mass[pushed[0]]
    for k, t in enumerate(times.tolist()):
        for node in pushed:
            assert run.v[k, node] == pytest.approx(integral(t, 1) / m, abs=max(bound, 1e-14))
            assert run.x[k, node] - run.x[0, node] == pytest.approx(integral(t, 2) / m, abs=bound)
    assert not run.v[:, others].any()
    assert not energy.elastic(made.system, run.x).any()


@pytest.mark.slow
def test_impulse_of_the_whole(document, scene):
    """Momentum of a snapping net = twice the trapezoids of the force, whatever the net does."""
    made = scene(document("square", size=2.0), {"effects.thrust": THRUST, "initial.packing": 0.9})
    run = made.integrate([0.0, 0.1, 0.12])
    p = energy.momentum(made.system, run.v)
    force = np.array(FORCE)
    impulse = 2.0 * sum(
        (b - a) * (f + g) / 2.0 for (a, b), (f, g) in zip(pairwise(TIME), pairwise(force), strict=True)
    )
    assert p[1] - p[0] == pytest.approx(impulse, rel=1e-10)
    assert p[2] - p[0] == pytest.approx(impulse, rel=1e-10)


@pytest.mark.ci_for("Verlet")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 1e-8),
        ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-5),
        ({"method": "RK4", "step": 2e-5}, 1e-3),
        ({"method": "Verlet", "step": 2e-5}, 5e-3),
    ],
    ids=["DOP853", "RK45", "RK4", "Verlet"],
)
def test_work_put_in_is_negative_dissipation(document, scene, unbalanced, options, bound):
    made = scene(
        document("square", size=2.0),
        {"effects.thrust": {**THRUST, "force": (10.0 * np.array(FORCE)).tolist()}, "initial.packing": 0.9},
    )
    run = made.integrate([0.0, 0.05, 0.1, 0.11], **options)
    assert run.dissipated[-1] < -1.0
    assert run.dissipated[-1] == pytest.approx(run.dissipated[-2], abs=1e-12)  # none after the last knot
    assert unbalanced(made, run) < bound


def test_force_at_and_around_knots():
    thrust = Thrust((0,), (1.0, 2.0, 4.0), ((1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (-1.0, 0.0, 0.0)))
    x = [thrust.at(t)[0] for t in (0.999, 1.0, 1.5, 2.0, 3.0, 4.0, 4.001)]
    assert x == pytest.approx([0.0, 1.0, 2.0, 3.0, 1.0, -1.0, 0.0])
    assert thrust.at(4.0, segment=3)[0] == 0.0  # after the last knot
    assert thrust.at(1.0, segment=0)[0] == 0.0  # before the first
    assert [thrust.segment(t) for t in (0.0, 1.0, 2.0, 4.0, 5.0)] == [0, 1, 2, 3, 3]


def test_numbers_of_bullets(document, scene):
    """docs/theory.md: bullet k of a honeycomb lies at 60 k degrees, spoke k at 2 pi k/spokes."""
    thrust = {"bullets": [1], "time": [0.0, 1.0], "force": [[1.0, 0.0, 0.0]] * 2}
    for topology, angle in (("hexagonal", 60.0), ("radial", 45.0), ("square", -45.0)):
        made = scene(document(topology), {"effects.thrust": thrust})
        x, y, _ = made.net.reference_position[made.system.thrusters[0]]
        assert np.degrees(np.arctan2(y, x)) == pytest.approx(angle)


@pytest.mark.parametrize("method", ["DOP853", "RK45"])
def test_knots_next_to_stored_times(loose, scene, method):
    """A knot one rounding away from a stored time, as 0.3 is from 3 x 0.1: no step is left between them."""
    made = scene(loose(thrust={**THRUST, "time": [0.1, 0.2, 0.3]}))
    times = [0.0, 0.1, 0.2, 3 * 0.1, 0.4]
    assert times[3] > 0.3
    run = made.integrate(times, method=method)
    assert run.t.tolist() == times


def test_start_between_knots(loose, scene):
    """A run that starts in the middle goes on as the whole one did."""
    made = scene(loose(thrust=THRUST))
    whole = made.integrate([0.0, 0.05, 0.07, 0.12])
    for k in (1, 2):
        rest = made.integrate([whole.t[k], 0.12], x0=whole.x[k], v0=whole.v[k])
        assert rest.x[-1] == pytest.approx(whole.x[-1], abs=1e-12)


def test_energy_momentum_refuses_thrust(loose, scene):
    made = scene(loose(thrust=THRUST))
    with pytest.raises(ValueError, match=r"effects\.thrust, which puts energy in"):
        made.integrate(method="EM", step=1e-3)
