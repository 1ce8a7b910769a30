"""Single steps of the compiled loop as plain Python, on forces whose motion is known: orders, stage times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import no_table
from scipy.integrate import solve_ivp
from seen_elements import seen_of

from exunet.integrators.compiled import steps
from exunet.integrators.compiled.workspace import (
    EqualSteps,
    Kept,
    Motion,
    Run,
    StepLimits,
    clock_at,
    motion_at,
    no_samples,
)
from exunet.kernels.kernel import Takes

START, H = 0.3, 0.7  # [s]
Force = Callable[[float, Any, Any], float]


@pytest.fixture
def under(monkeypatch: pytest.MonkeyPatch) -> Callable[[Force], None]:
    """under(force): let the steps act on one coordinate of 1 kg with this force of (t, x, v)."""

    def use(force: Force) -> None:
        def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
            out[0] += force(t, x[0], v[0])
            return 0.5 * float(x[0]) ** 2, 0.0  # something that tells the state

        monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
        monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
        for name in ("BODIES", "FIRST_ORDER"):
            monkeypatch.setattr(steps, name, False, raising=False)
        monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)

    return use


def at_start(x: float = 0.0, v: float = 0.0) -> Motion:
    """One coordinate at START; the work space holds its acceleration, and nothing else that is known."""
    motion = motion_at(np.array([x]), np.array([v]), np.ones(1), no_table(), np.zeros((0, 3)), 1)
    motion.work[:] = np.nan
    steps.begin(START, False, motion)
    return motion


def power_of_time(p: int) -> tuple[Force, float, float]:
    """A force t^p, and position and velocity at the end of a step from rest at 0 m."""
    end, q = START + H, p + 1
    speed = (end**q - START**q) / q
    way = (end ** (q + 1) - START ** (q + 1)) / (q * (q + 1)) - START**q / q * H
    return (lambda t, x, v: t**p), way, speed


@pytest.mark.parametrize("p", range(5))
def test_a_dormand_prince_step_takes_the_forces_at_its_stages_own_times(
    under: Callable[[Force], None], p: int
) -> None:
    """Order 5: velocities under t^4 and positions under t^3 are exact. Catches any wrong time of a stage."""
    force, way, speed = power_of_time(p)
    under(force)
    motion = at_start()
    end = steps.stages_of(motion.work)
    error, held = steps.dormand_prince_step(START, H, motion)
    assert end.v1[0] == pytest.approx(speed, rel=1e-13)
    if p <= 3:
        assert end.x1[0] == pytest.approx(way, rel=1e-13)
    assert end.a7[0] == pytest.approx((START + H) ** p, rel=1e-13)  # the first stage of the next step
    assert held == pytest.approx(0.5 * end.x1[0] ** 2, rel=1e-13)
    # The embedded method is of order 4: it errs from t^3 on in the position, from t^4 on in the velocity.
    assert (error > 1e-6) == (p >= 3)


@pytest.mark.parametrize("p", range(4))
def test_a_runge_kutta_step_takes_the_forces_at_its_stages_own_times(
    under: Callable[[Force], None], p: int
) -> None:
    """Order 4: velocities under t^3 and positions under t^2 are exact."""
    force, way, speed = power_of_time(p)
    under(force)
    motion = at_start()
    steps.runge_kutta_4_step(START, H, motion)
    assert steps.stages_of(motion.work).v1[0] == pytest.approx(speed, rel=1e-13)
    if p <= 2:
        assert steps.stages_of(motion.work).x1[0] == pytest.approx(way, rel=1e-13)


@pytest.mark.parametrize(("method", "order"), [("runge_kutta_4_step", 4), ("dormand_prince_step", 5)])
def test_a_step_has_its_order_where_time_speed_and_place_all_matter(
    under: Callable[[Force], None], method: str, order: int
) -> None:
    """Half the step, 2^(order + 1) times less error. Catches a wrong time or place of any stage."""

    def force(t: float, x: Any, v: Any) -> float:
        return float(np.cos(3.0 * t) - 2.0 * v - 5.0 * x - x**3)

    under(force)
    errors = []
    for h in (0.04, 0.02, 0.01):
        motion = at_start(0.4, 1.0)
        getattr(steps, method)(START, h, motion)
        exact = solve_ivp(
            lambda t, y: (y[1], force(t, *y)), (START, START + h), (0.4, 1.0),
            method="DOP853", rtol=1e-13, atol=1e-15,
        ).y[:, -1]  # fmt: skip
        found = np.concatenate([steps.stages_of(motion.work).x1, steps.stages_of(motion.work).v1])
        errors.append(np.abs(found - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > order + 0.8, orders
    assert np.max(errors[0]) < 0.04**order  # a far too large coefficient may shrink its error as fast


def test_a_verlet_step_takes_the_force_at_its_end_with_the_velocity_of_its_middle(
    under: Callable[[Force], None],
) -> None:
    """By hand, from x = 2, v = 3 at t = 0.3: a0, then v + h a0 / 2, x + h (that), and a1 there at t = 1."""
    under(lambda t, x, v: 5.0 * t - 7.0 * x - 11.0 * v)
    motion = at_start(2.0, 3.0)
    held = steps.verlet_step(START, H, motion)
    a0 = 5.0 * 0.3 - 7.0 * 2.0 - 11.0 * 3.0
    middle = 3.0 + 0.35 * a0
    x1 = 2.0 + 0.7 * middle
    a1 = 5.0 * 1.0 - 7.0 * x1 - 11.0 * middle
    end = steps.stages_of(motion.work)
    assert [end.a1[0], end.x1[0], end.v1[0]] == pytest.approx([a1, x1, middle + 0.35 * a1], rel=1e-13)
    assert held == pytest.approx(0.5 * x1**2, rel=1e-13)


def test_a_verlet_step_in_place_has_the_bits_of_one_between_arrays(under: Callable[[Force], None]) -> None:
    """Three steps in a row: places, speeds, accelerations and stored energy."""
    under(lambda t, x, v: 5.0 * t - 7.0 * x - 11.0 * v)
    apart, in_place = at_start(2.0, 3.0), at_start(2.0, 3.0)
    for k in range(3):
        held = steps.verlet_step(START + k * H, H, apart)
        result = steps.stages_of(apart.work)
        apart.x[:], apart.v[:] = result.x1, result.v1
        assert steps.verlet_step_in_place(START + k * H, H, in_place) == held
        found = in_place.x, in_place.v, steps.stages_of(in_place.work).a1
        np.testing.assert_array_equal(found, (apart.x, apart.v, result.a1))


@pytest.mark.parametrize("p", range(3))
def test_steps_in_a_row_go_on_in_time(under: Callable[[Force], None], p: int) -> None:
    """Seven equal steps, and chosen ones, under t^p: as exact as one, if each begins where the last ended."""
    force, way, speed = power_of_time(p)
    under(force)
    for equal in (True, False):
        motion, clock = at_start(), clock_at(START, 0.05)
        seen = seen_of(np.zeros((0, 2), dtype=int), half=0.5 * np.ones(1), look_above=np.inf)
        kept = Kept(np.zeros(50), np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(50))
        run = Run(motion, clock, seen, kept, no_samples())
        if equal:
            rows = steps.equal_steps(False, EqualSteps(START, START + H, 7, 0, 7), 0, 1, run)
            assert clock["steps"][0] == 7
        else:
            limits = StepLimits(tolerance=1e-9, longest=0.2, least=1e-6)
            rows = steps.chosen_steps(limits, START + H, 100, 0, 1, run)
        assert clock["time"][0] == START + H
        assert kept.time[rows - 1] == START + H
        assert motion.v[0] == pytest.approx(speed, rel=1e-12)
        assert motion.x[0] == pytest.approx(way, rel=1e-12)
        # It moves away from the origin, so that the end has the largest of the energies told.
        assert seen.peaks["elastic"][0] == pytest.approx(0.5 * motion.x[0] ** 2, rel=1e-12)
        assert steps.stages_of(motion.work).a1[0] == pytest.approx((START + H) ** p, rel=1e-12)


@pytest.mark.parametrize("method", ["verlet_step", "verlet_step_in_place"])
@pytest.mark.parametrize("takes", Takes)
def test_power_that_forces_tell_is_taken_with_the_velocity_of_the_middle(
    method: str, takes: Takes, under: Callable[[Force], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By hand as above, with a power 13 t + 17 x + 19 v; 0.25 J had been taken before."""
    under(lambda t, x, v: 0.0)

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        out[0] += 5.0 * t - 7.0 * x[0] - 11.0 * v[0]
        return 23.0 * float(x[0]), float(13.0 * t + 17.0 * x[0] + 19.0 * v[0])

    monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
    motion = at_start(2.0, 3.0)._replace(takes=int(takes))
    motion.taken[0] = 0.25
    held = getattr(steps, method)(START, H, motion)
    middle = 3.0 + 0.35 * (5.0 * 0.3 - 7.0 * 2.0 - 11.0 * 3.0)
    x1 = 2.0 + 0.7 * middle
    told = 0.7 * (13.0 * 1.0 + 17.0 * x1 + 19.0 * middle) if takes == Takes.REPORTED else 0.0
    assert motion.taken[0] == pytest.approx(0.25 + told, rel=1e-13)
    assert held == pytest.approx(23.0 * x1, rel=1e-13)


def test_the_largest_of_errors_is_by_size_and_what_is_no_number_is_infinite() -> None:
    assert steps.largest(np.array([0.5, -2.0, 1.0])) == 2.0
    assert steps.largest(np.array([-0.5, 3.0, 1.0])) == 3.0
    assert steps.largest(np.array([0.5, np.nan, 9.0])) == np.inf
    assert steps.largest(np.zeros(0)) == 0.0
    rates = np.zeros((7, 4))
    rates[6] = [0.0, -40.0, 20.0, 0.0]  # of the last stage 1/40 counts
    assert steps.largest_of_first_order(0.5, rates) == pytest.approx(0.5, rel=1e-15)
    rates[2, 3] = np.nan
    assert steps.largest_of_first_order(0.5, rates) == np.inf
