"""Steps of the compiled loop as plain Python: orders, stage times, what it observes, keeps and adds up."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import no_table, observed, without_events
from scipy.integrate import solve_ivp

from exunet.forces import cable
from exunet.forces.cable import AxialLaw
from exunet.forces.law import STRETCH_BOUND, green_lagrange_strain
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.loop import least_energy_beyond
from exunet.integrators.compiled.workspace import (
    EqualSteps,
    Kept,
    Motion,
    ObservedSteps,
    StepInterval,
    StepLimits,
    WatchedRows,
    clock_at,
    motion_at,
    no_samples,
)
from exunet.kernels.kernel import Takes

START, H = 0.3, 0.7  # [s]
Force = Callable[[float, Any, Any], float]


def use(monkeypatch: pytest.MonkeyPatch, add_forces: Callable[..., tuple[float, float]]) -> None:
    """Let steps act on points alone with these forces, without discrete states."""
    monkeypatch.setattr(steps, "add_forces", add_forces, raising=False)
    monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
    for name in ("BODIES", "FIRST_ORDER"):
        monkeypatch.setattr(steps, name, False, raising=False)
    monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)
    without_events(monkeypatch)


@pytest.fixture
def under(monkeypatch: pytest.MonkeyPatch) -> Callable[[Force], None]:
    """under(force): let the steps act on one coordinate of 1 kg with this force of (t, x, v)."""

    def use_force(force: Force) -> None:
        def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
            out[0] += force(t, x[0], v[0])
            return 0.5 * float(x[0]) ** 2, 0.0  # an energy that depends on the state

        use(monkeypatch, add_forces)

    return use_force


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
        seen = observed(np.zeros((0, 2), dtype=int), half=0.5 * np.ones(1), look_above=np.inf)
        kept = Kept(np.zeros(50), np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(50))
        run = StepInterval(motion, clock, seen, kept, no_samples())
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
        # It moves away from the origin, so that the end has the largest energy.
        assert seen.peaks["elastic"][0] == pytest.approx(0.5 * motion.x[0] ** 2, rel=1e-12)
        assert steps.stages_of(motion.work).a1[0] == pytest.approx((START + H) ** p, rel=1e-12)


@pytest.mark.parametrize("method", ["verlet_step", "verlet_step_in_place"])
@pytest.mark.parametrize("takes", Takes)
def test_reported_power_is_taken_with_the_velocity_at_the_middle(
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
    reported = 0.7 * (13.0 * 1.0 + 17.0 * x1 + 19.0 * middle) if takes == Takes.REPORTED else 0.0
    assert motion.taken[0] == pytest.approx(0.25 + reported, rel=1e-13)
    assert held == pytest.approx(23.0 * x1, rel=1e-13)


def test_the_largest_error_is_by_size_and_infinite_where_one_is_not_finite() -> None:
    assert steps.largest(np.array([0.5, -2.0, 1.0])) == 2.0
    assert steps.largest(np.array([-0.5, 3.0, 1.0])) == 3.0
    assert steps.largest(np.array([0.5, np.nan, 9.0])) == np.inf
    assert steps.largest(np.zeros(0)) == 0.0
    rates = np.zeros((7, 4))
    rates[6] = [0.0, -40.0, 20.0, 0.0]  # of the last stage 1/40 counts
    assert steps.largest_of_first_order(0.5, rates) == pytest.approx(0.5, rel=1e-15)
    rates[2, 3] = np.nan
    assert steps.largest_of_first_order(0.5, rates) == np.inf


ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
LENGTH, STIFFNESS = np.array([0.7, 0.6, 0.9, 0.8]), np.array([30.0, 20.0, 50.0, 40.0])
TWICE_TAU = np.array([0.04, 0.1, 0.0, 0.06])
NET: Any = SimpleNamespace(element_nodes=ENDS)
FIRST, LAST = 1.5, 2.7  # [s]


def seen_so_far(
    look_above: float = 0.0,
    twice: np.ndarray | None = None,
    n_v: int = 12,
    bounds: tuple[int, ...] = (0, 4),
) -> ObservedSteps:
    half, times = np.linspace(0.2, 1.3, n_v), np.zeros(4) if twice is None else twice
    return observed(ENDS, LENGTH, STIFFNESS, times, half=half, look_above=look_above, bounds=bounds)


def states(number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(3)
    return [(random.normal(0.0, 0.5, (4, 3)), random.normal(0.0, 1.0, (4, 3))) for _ in range(number)]


@pytest.mark.parametrize("n_v", range(9, 14))
def test_the_kinetic_energy_is_summed_over_all_coordinates(n_v: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "BODIES", False, raising=False)
    v = np.random.default_rng(n_v).normal(size=n_v)
    seen = seen_so_far(np.inf, n_v=n_v)
    motion = motion_at(np.zeros(n_v), np.zeros(n_v), np.ones(n_v), no_table(), np.zeros((0, 3)), n_v)
    steps.stages_of(motion.work).v1[:] = v
    assert steps.accept(motion, seen.half) == pytest.approx((seen.half * v**2).sum(), rel=1e-14)
    assert (motion.v == v).all()


@pytest.mark.parametrize("viscous", [False, True])
def test_the_largest_tension_is_that_of_the_law(viscous: bool) -> None:
    law = AxialLaw(LENGTH, STIFFNESS, 0.5 * TWICE_TAU if viscous else None)
    seen = seen_so_far(twice=TWICE_TAU if viscous else None)
    largest, every = 0.0, []
    for time, (x, v) in enumerate(states(8)):
        steps.observe_tensions(float(time), x.ravel(), v.ravel(), seen)
        tension = cable.element_tension(NET, law, x, v)
        if tension.max() > largest:
            largest, when, where = tension.max(), time, int(np.argmax(tension))
        reported = seen.largest[0]
        assert reported["tension"] == pytest.approx(largest, rel=1e-13)
        assert (reported["time"], reported["element"]) == (when, where)
        every.append(np.maximum(tension, 0.0))
        assert seen.of_elements == pytest.approx(np.max(every, axis=0), rel=1e-13)
    assert largest > 0.0
    assert (seen.peaks["look_above"][0] == 0.0) == viscous


def test_no_tension_is_larger_below_the_energy_from_which_states_are_looked_at() -> None:
    """That of the strain e with EA e (1 + e) = N, in the element that needs least; near to it for small N."""
    for scale in (1.0, 1e-3):
        x = np.array(
            [[0.0, 0.0, 0.0], [0.7 * (1.0 + 0.05 * scale), 0.0, 0.0], [0.6, 0.1, 0.0], [0.1, 0.0, 0.0]]
        )
        seen = seen_so_far()
        steps.observe_tensions(0.0, x.ravel(), np.zeros(12), seen)
        tension = float(seen.largest["tension"][0])
        strain = np.array([np.roots([1.0, 1.0, -tension / ea]).max() for ea in STIFFNESS])
        least = 0.5 * STIFFNESS * LENGTH * strain**2
        assert seen.peaks["look_above"][0] == pytest.approx(least.min(), rel=1e-9)
        taut = 0.5 * 30.0 * 0.7 * green_lagrange_strain(0.7 * (1.0 + 0.05 * scale), 0.7) ** 2
        assert least[0] < taut < least[0] * (1.0 + 0.1 * scale)


@pytest.mark.parametrize("viscous", [False, True])
def test_each_group_has_the_largest_tension_of_its_own(viscous: bool) -> None:
    """The first two elements, and the last two; none may be missed below the energy that is looked for."""
    law = AxialLaw(LENGTH, STIFFNESS, 0.5 * TWICE_TAU if viscous else None)
    seen = seen_so_far(twice=TWICE_TAU if viscous else None, bounds=(0, 2, 4))
    every = []
    for time, (x, v) in enumerate(states(8)):
        elastic = float(cable.elastic_energy(law, cable.lengths(NET, x[None]))[0])
        steps.see(float(time), elastic, 1.0, x.ravel(), v.ravel(), np.zeros(0), seen)
        every.append(cable.element_tension(NET, law, x, v))
        for found, group in zip(seen.largest, (slice(0, 2), slice(2, 4)), strict=True):
            own = np.array(every)[:, group]
            when, where = np.unravel_index(own.argmax(), own.shape)
            assert found["tension"] == pytest.approx(own.max(), rel=1e-13)
            assert (found["time"], found["element"]) == (when, group.start + where)
    assert seen.largest["tension"][0] != seen.largest["tension"][1]


def test_the_largest_elastic_and_the_smallest_kinetic_energy_are_kept() -> None:
    seen, v = seen_so_far(np.inf), np.zeros(12)
    for elastic, kinetic in ((7.0, 3.0), (6.0, 4.0), (5.0, 2.0)):
        steps.see(0.5, elastic, kinetic, v, v, v, seen)
    assert (seen.peaks["elastic"][0], seen.peaks["kinetic"][0]) == (7.0, 2.0)


def test_what_is_watched_of_a_step_goes_into_its_row() -> None:
    """Some entries, the mean place and velocity of the first points, discrete states; until rows end."""
    random = np.random.default_rng(9)
    motion = motion_at(*random.normal(size=(2, 15)), np.ones(15), no_table(), np.zeros((0, 3)), 15)
    weights, discrete = random.uniform(size=4), random.normal(size=6)
    of_x, of_v, of_discrete = np.array([2, 7]), np.array([1, 14]), np.array([5, 0, 3])
    looks = WatchedRows(
        np.array([0, 2]), of_x, of_v, of_discrete, discrete, weights, np.zeros(3),
        *(np.full((15, 3), 7.0) for _ in "xv"), np.zeros((3, 3)), np.zeros((3, 6)),
    )  # fmt: skip
    assert [steps.look(time, motion, looks) for time in (0.5, 0.75)] == [False, True]
    assert looks.at.tolist() == [2, 2]
    assert looks.time.tolist() == [0.5, 0.75, 0.0]
    for found, entries, known in ((looks.x, of_x, motion.x), (looks.v, of_v, motion.v)):
        others = np.setdiff1d(np.arange(15), entries)
        np.testing.assert_array_equal(found[entries, :2], np.tile(known[entries, None], (1, 2)))
        assert (found[others] == 7.0).all()
        assert (found[:, 2] == 7.0).all()
    np.testing.assert_array_equal(looks.reported[:2], np.tile(discrete[of_discrete], (2, 1)))
    mean = [weights @ item[:12].reshape(4, 3) for item in (motion.x, motion.v)]
    np.testing.assert_allclose(looks.mean[:2], np.tile(np.concatenate(mean), (2, 1)), rtol=1e-13)


@pytest.fixture
def dissipating(monkeypatch: pytest.MonkeyPatch) -> None:
    """One coordinate of 1 kg under the force t, and a power 4 t^3 + x^2 + 3 v^2 that is taken out."""

    def add_forces(t: float, x: Any, v: Any, data: Any, out: Any) -> tuple[float, float]:
        out[0] += t
        return float(t), 0.0

    def power(t: float, x: Any, v: Any, data: Any, scratch: Any) -> float:
        return 4.0 * t**3 + float(x[0]) ** 2 + 3.0 * float(v[0]) ** 2

    use(monkeypatch, add_forces)
    monkeypatch.setattr(steps, "power", power, raising=False)
    monkeypatch.setattr(steps, "has_power", lambda rows: True, raising=False)
    monkeypatch.setattr(steps, "extra_work", lambda h, *state: 0.5 * h, raising=False)


def moving() -> tuple[Motion, np.ndarray, ObservedSteps, Kept]:
    """At FIRST where x = t^3 / 6, v = t^2 / 2, which the force t continues."""
    state = (np.array([FIRST**3 / 6.0]), np.array([FIRST**2 / 2.0]))
    motion = motion_at(*state, np.ones(1), no_table(Takes.INTEGRATED), np.zeros((0, 3)), 1)
    seen = observed(np.zeros((0, 2), dtype=int), half=np.ones(1), look_above=np.inf)
    steps.begin(FIRST, False, motion)
    kept = Kept(np.zeros(90), np.zeros((90, 1)), np.zeros((90, 1)), np.zeros(90))
    return motion, clock_at(FIRST, 0.01), seen, kept


def taken(t: float) -> float:
    """The integral from FIRST of 4 t^3 + (t^3 / 6)^2 + 3 (t^2 / 2)^2, and 1/2 for each second."""
    t, s = np.array(t), FIRST
    return float(t**4 - s**4 + (t**7 - s**7) / 252.0 + 0.15 * (t**5 - s**5) + 0.5 * (t - s))


@pytest.mark.usefixtures("dissipating")
@pytest.mark.parametrize("verlet", [False, True])
def test_equal_steps_add_up_work_wherever_they_are_interrupted(verlet: bool) -> None:
    """Simpson's rule over the Hermite polynomial, of order 4: exact for t^3 and nearly so for the rest."""
    found = []
    for parts in ((60,), (17, 43)):
        motion, clock, seen, kept = moving()
        row = done = 0
        for part in parts:
            equal = EqualSteps(FIRST, LAST, 60, done, part)
            row = steps.equal_steps(
                verlet, equal, row, 7, StepInterval(motion, clock, seen, kept, no_samples())
            )
            done += part
        times = FIRST + (LAST - FIRST) / 60.0 * np.array([7, 14, 21, 28, 35, 42, 49, 56, 60])
        assert row == 9
        np.testing.assert_allclose(kept.time[:row], times, rtol=1e-14)
        allowed = 1e-3 if verlet else 1e-8  # Verlet's own path is of order 2
        np.testing.assert_allclose(kept.taken[:row], [taken(t) for t in times], rtol=allowed)
        found.append((motion.x[0], motion.v[0], motion.taken[0], *kept.taken))
    assert found[0] == found[1]


@pytest.mark.usefixtures("dissipating")
def test_steps_of_much_energy_are_all_kept() -> None:
    """The elastic energy here is the time; above 2 s each step is kept, below one in twenty."""
    motion, clock, seen, kept = moving()
    seen.peaks["keep_above"] = 2.0 + 1e-9
    run = StepInterval(motion, clock, seen, kept, no_samples())
    rows = steps.equal_steps(False, EqualSteps(FIRST, LAST, 60, 0, 60), 0, 20, run)
    numbers = np.rint((kept.time[:rows] - FIRST) / 0.02).astype(int)
    assert numbers.tolist() == [20, *range(26, 61)]


@pytest.mark.usefixtures("dissipating")
def test_chosen_and_equal_steps_pass_through_given_times() -> None:
    times = np.array([FIRST, 1.6, 2.05, LAST])
    for equal in (False, True):
        motion, clock, seen, kept = moving()
        rows = kept._replace(time=np.zeros(4))
        run = StepInterval(motion, clock, seen, rows, no_samples())
        if equal:
            reached = steps.through_equal(False, times, 0.02, run)
            assert clock["steps"][0] == 5 + 23 + 33  # no step longer than 0.02 s
        else:
            control = StepLimits(tolerance=1e-9, longest=0.05, least=1e-9)
            reached = steps.through_chosen(times, control, 10.0, 10**6, run)
            assert clock["time"][0] == LAST
        assert reached == 4
        np.testing.assert_array_equal(rows.time, times)
        np.testing.assert_allclose(rows.x[:4, 0], times**3 / 6.0, rtol=1e-12)
        np.testing.assert_allclose(rows.v[:4, 0], times**2 / 2.0, rtol=1e-12)
        np.testing.assert_allclose(rows.taken[:4], [taken(t) for t in times], rtol=1e-6, atol=1e-12)


def test_below_an_energy_no_element_is_stretched_too_far() -> None:
    """That of the element which has the least where it alone is as long as the law holds."""
    system: Any = SimpleNamespace(
        forces=SimpleNamespace(cable=SimpleNamespace(law=AxialLaw(LENGTH, STIFFNESS, None)))
    )
    each = []
    for e in range(4):
        long = LENGTH.copy()
        long[e] *= STRETCH_BOUND
        each.append(float(cable.elastic_energy(AxialLaw(LENGTH, STIFFNESS, None), long[None])[0]))
    assert least_energy_beyond(system) == pytest.approx(min(each), rel=1e-12)
    assert min(each) > 0.0
