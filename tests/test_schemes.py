"""Single steps of the compiled loop as plain Python, on forces whose motion is known: orders, stage times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from exunet.backends.compiled import many_steps, schemes

NO_DATA = ()
START, H = 0.3, 0.7  # [s]
Force = Callable[[float, Any, Any], float]


@pytest.fixture
def under(monkeypatch: pytest.MonkeyPatch) -> Callable[[Force], None]:
    """under(force): let the steps act on one coordinate of 1 kg with this force of (t, x, v)."""

    def use(force: Force) -> None:
        def forces(t: float, x: Any, v: Any, data: Any, out: Any) -> float:
            out[0] = force(t, x[0], v[0])
            return 0.5 * float(x[0]) ** 2  # something that tells the state

        monkeypatch.setattr(schemes, "forces", forces, raising=False)
        monkeypatch.setattr(many_steps, "TAKES_ENERGY", False, raising=False)

    return use


def at_start(x: float = 0.0, v: float = 0.0) -> tuple[Any, ...]:
    """x, v, 1 / mass, data and work space whose row 0 is the acceleration at START."""
    state = (np.array([x]), np.array([v]), np.ones(1), NO_DATA)
    work = np.full((16, 1), np.nan)
    schemes.accelerate(START, *state, work[0])
    return *state, work


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
    *state, work = at_start()
    error, held = schemes.dormand_prince_step(START, H, *state, work)
    assert work[2, 0] == pytest.approx(speed, rel=1e-13)
    if p <= 3:
        assert work[1, 0] == pytest.approx(way, rel=1e-13)
    assert work[9, 0] == pytest.approx((START + H) ** p, rel=1e-13)  # the first stage of the next step
    assert held == pytest.approx(0.5 * work[1, 0] ** 2, rel=1e-13)
    # The embedded method is of order 4: it errs from t^3 on in the position, from t^4 on in the velocity.
    assert (error > 1e-6) == (p >= 3)


@pytest.mark.parametrize("p", range(4))
def test_a_runge_kutta_step_takes_the_forces_at_its_stages_own_times(
    under: Callable[[Force], None], p: int
) -> None:
    """Order 4: velocities under t^3 and positions under t^2 are exact."""
    force, way, speed = power_of_time(p)
    under(force)
    *state, work = at_start()
    schemes.runge_kutta_4_step(START, H, *state, work)
    assert work[2, 0] == pytest.approx(speed, rel=1e-13)
    if p <= 2:
        assert work[1, 0] == pytest.approx(way, rel=1e-13)


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
        *state, work = at_start(0.4, 1.0)
        getattr(schemes, method)(START, h, *state, work)
        exact = solve_ivp(
            lambda t, y: (y[1], force(t, *y)), (START, START + h), (0.4, 1.0),
            method="DOP853", rtol=1e-13, atol=1e-15,
        ).y[:, -1]  # fmt: skip
        errors.append(np.abs(work[1:3, 0] - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > order + 0.8, orders


def test_a_verlet_step_takes_the_force_at_its_end_with_the_velocity_of_its_middle(
    under: Callable[[Force], None],
) -> None:
    """By hand, from x = 2, v = 3 at t = 0.3: a0, then v + h a0 / 2, x + h (that), and a1 there at t = 1."""
    under(lambda t, x, v: 5.0 * t - 7.0 * x - 11.0 * v)
    *state, work = at_start(2.0, 3.0)
    held = schemes.verlet_step(START, H, *state, work)
    a0 = 5.0 * 0.3 - 7.0 * 2.0 - 11.0 * 3.0
    middle = 3.0 + 0.35 * a0
    x1 = 2.0 + 0.7 * middle
    a1 = 5.0 * 1.0 - 7.0 * x1 - 11.0 * middle
    assert work[:3, 0] == pytest.approx([a1, x1, middle + 0.35 * a1], rel=1e-13)
    assert held == pytest.approx(0.5 * x1**2, rel=1e-13)


@pytest.mark.parametrize("p", range(3))
def test_steps_in_a_row_go_on_in_time(under: Callable[[Force], None], p: int) -> None:
    """Seven equal steps, and chosen ones, under t^p: as exact as one, if each begins where the last ended."""
    force, way, speed = power_of_time(p)
    under(force)
    none = np.zeros(0)
    for equal in (True, False):
        x, v, inverse, data, work = at_start()
        taken, counts = np.zeros(1), np.zeros(2, dtype=np.int64)
        extremes = np.array([0.0, np.inf, np.inf, np.inf, 0.0, 0.0, -1.0])
        seen = (0.5 * np.ones(1), extremes, np.zeros((0, 2), dtype=int), none, none, none)
        kept = (np.zeros(50), np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(50))
        last = (x, v, inverse, data, work, taken, counts, seen, 1, kept)
        if equal:
            rows = many_steps.equal_steps(False, START, START + H, 7, 0, 7, 0, *last)
            assert counts.tolist() == [7, 0]
        else:
            clock = np.array([START, 0.05, 0.0, 0.0])
            rows = many_steps.chosen_steps(clock, START + H, 1e-9, 0.2, 1e-6, 100, 0, *last)
            assert clock[0] == START + H
        assert kept[0][rows - 1] == START + H
        assert v[0] == pytest.approx(speed, rel=1e-12)
        assert x[0] == pytest.approx(way, rel=1e-12)
        # Where the first step begins has the least kinetic energy, the end the largest elastic one.
        assert extremes[0] == pytest.approx(0.5 * x[0] ** 2, rel=1e-12)
        assert work[0, 0] == pytest.approx((START + H) ** p, rel=1e-12)
