"""Jumps of the force where viscous elements become taut: both forms against the roots of a polynomial."""

from __future__ import annotations

import math
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import no_table
from seen_elements import seen_of

from exunet.forces import cable_term
from exunet.forces.cable import Law
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.workspace import motion_at

ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
LENGTH, STIFFNESS = np.array([1.0, 1.2, 0.9, 1.1]), np.array([30.0, 20.0, 50.0, 40.0])
TAU, MASS = np.array([0.02, 0.05, 0.01, 0.03]), np.array([0.5, 2.0, 1.0, 0.7])
WITHIN = 0.4  # [s]
ROUND_OFF = 64.0 * 2.0**-52


def motions(number: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Positions, velocities, accelerations (4, 3) at which most elements are slack."""
    random = np.random.default_rng(7)
    return [
        (random.normal(0.0, 0.3, (4, 3)), random.normal(0.0, 1.0, (4, 3)), random.normal(0.0, 0.7, (4, 3)))
        for _ in range(number)
    ]


def over(e: int, state: Any, t: float) -> tuple[float, float]:
    """Length of an element less its natural one [m] and its rate [m/s] on the parabola, at a time t [s]."""
    (i, j), (x, v, a) = ENDS[e], state
    d = (x[j] - x[i]) + t * (v[j] - v[i]) + 0.5 * t * t * (a[j] - a[i])
    u = (v[j] - v[i]) + t * (a[j] - a[i])
    return float(np.linalg.norm(d) - LENGTH[e]), float(d @ u / np.linalg.norm(d))


def first_crossing(e: int, state: Any) -> float:
    """When an element that is slack becomes taut, from the roots of its squared length; infinite if never."""
    (i, j), (x, v, a) = ENDS[e], state
    d, u, b = x[j] - x[i], v[j] - v[i], a[j] - a[i]
    if np.linalg.norm(d) > LENGTH[e]:
        return math.inf
    roots = np.roots([b @ b / 4.0, u @ b, u @ u + d @ b, 2.0 * d @ u, d @ d - LENGTH[e] ** 2])
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real <= WITHIN)]
    return float(real.min(initial=math.inf))


def by_hand(state: Any, tolerance: float, time: float) -> tuple[float, float, float] | None:
    """Time until the first jump that matters [s], the step across it [s], and the jumps within that step."""
    found = []
    for e in range(4):
        after = first_crossing(e, state)
        if math.isfinite(after):
            rate = over(e, state, after)[1]
            size = STIFFNESS[e] * TAU[e] / LENGTH[e] * rate / min(MASS[ENDS[e]])
            if size * WITHIN > tolerance:
                place = np.abs(state[0][ENDS[e]]).max() + LENGTH[e]
                step = min(WITHIN, max(tolerance / size, ROUND_OFF * max(time, place / rate)))
                found.append((after, step, size))
    if not found:
        return None
    after, step, _ = min(found)
    return after, step, sum(size for when, _, size in found if when <= after + step)


def compiled(state: Any, tolerance: float, time: float, **changed: Any) -> tuple[float, float]:
    x, v, a = (part.ravel().copy() for part in state)
    inverse = np.repeat(1.0 / MASS, 3)
    motion = motion_at(x, v, inverse, no_table(), np.zeros((0, 3)), 12)
    motion.work[0] = a
    seen = seen_of(ENDS, LENGTH, STIFFNESS, 2.0 * TAU)._replace(**changed)
    return steps.jump_ahead(WITHIN, tolerance, time, motion, seen)


def of_arrays(
    state: Any, tolerance: float, time: float, fixed: tuple[int, ...] = ()
) -> cable_term.Jump | None:
    blocks: Any = SimpleNamespace(
        mass=MASS, net=SimpleNamespace(element_nodes=ENDS, fixed_nodes=np.array(fixed, dtype=int))
    )
    return cable_term.jump_ahead(blocks, Law(LENGTH, STIFFNESS, TAU), WITHIN, tolerance, time, state)


@pytest.mark.parametrize(("tolerance", "time"), [(1e-3, 0.0), (0.3, 1.0), (1e-13, 0.0), (1e-13, 5.0)])
def test_both_forms_find_the_first_jump_that_matters(tolerance: float, time: float) -> None:
    met = 0
    for state in motions(120):
        wanted = by_hand(state, tolerance, time)
        found, (after, across) = of_arrays(state, tolerance, time), compiled(state, tolerance, time)
        if wanted is None:
            assert found is None
            assert after == across == math.inf
            continue
        assert found is not None
        assert [found.after, found.step] == pytest.approx(wanted[:2], rel=1e-9)
        assert [after, across] == pytest.approx(wanted[:2], rel=1e-9)
        assert found.size == pytest.approx(wanted[2], rel=1e-9)
        assert found.to_it == pytest.approx(after - max(0.5 * across, 0.01 * after), rel=1e-9)
        met += 1
    assert met > 30


def test_elements_that_do_not_count_have_no_jump() -> None:
    """Without viscosity, broken, or between nodes that are held still."""
    state = next(s for s in motions(50) if by_hand(s, 1e-3, 0.0) is not None)
    assert compiled(state, 1e-3, 0.0)[0] < math.inf
    assert compiled(state, 1e-3, 0.0, jumps=np.zeros(4)) == (math.inf, math.inf)
    assert compiled(state, 1e-3, 0.0, stiffness=np.zeros(4)) == (math.inf, math.inf)
    assert of_arrays(state, 1e-3, 0.0, fixed=(0, 1, 2, 3)) is None


def test_a_state_beyond_floats_is_no_warning() -> None:
    """As that of a body that turns at 1e9 rad/s may become; the guards tell what is wrong with it."""
    x, v, a = next(s for s in motions(50) if by_hand(s, 1e-3, 0.0) is not None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for huge in (1e200, math.inf):
            of_arrays((x, v, np.full_like(a, huge)), 1e-3, 0.0)
            of_arrays((x, v * 1e200, a * huge), 1e-3, 0.0)


# Exact in binary: two threads of 1 m along x from a fixed point, whose ends of 1 kg move outward.
THREADS = np.array([[0, 1], [0, 2]])


def on_threads(
    place: tuple[float, float],
    speed: tuple[float, float],
    bend: tuple[float, float] = (0.0, 0.0),
    within: float = 0.5,
    tolerance: float = 1.0,
) -> tuple[cable_term.Jump | None, tuple[float, float]]:
    """What both forms find; a jump is 8 m/s2 for each m/s at which a thread becomes taut."""
    x, v, a = (
        np.array([[0.0, 0.0, 0.0], [one, 0.0, 0.0], [0.0, two, 0.0]]) for one, two in (place, speed, bend)
    )
    mass, ones = np.ones(3), np.ones(2)
    blocks: Any = SimpleNamespace(
        mass=mass, net=SimpleNamespace(element_nodes=THREADS, fixed_nodes=np.array([0]))
    )
    law = Law(ones, 16.0 * ones, 0.5 * ones)
    found = cable_term.jump_ahead(blocks, law, within, tolerance, 0.0, (x, v, a))
    inverse = np.repeat([0.0, 1.0, 1.0], 3)
    motion = motion_at(x.ravel(), v.ravel(), inverse, no_table(), np.zeros((0, 3)), 9)
    motion.work[0] = a.ravel()
    seen = seen_of(THREADS, ones, 16.0 * ones, ones)
    return found, steps.jump_ahead(within, tolerance, 0.0, motion, seen)


def test_jumps_within_one_step_across_are_crossed_together() -> None:
    """At 1/4 s and 3/8 s, where the step across the first is 1/8 s; a little later, it is alone."""
    found, (after, across) = on_threads((0.75, 0.625), (1.0, 1.0))
    assert found == cable_term.Jump(0.25, 16.0, 0.125)
    assert (after, across) == (0.25, 0.125)
    found, _ = on_threads((0.75, 0.624), (1.0, 1.0))
    assert found == cable_term.Jump(0.25, 8.0, 0.125)


def test_a_jump_at_the_end_of_the_time_counts() -> None:
    """1/2 + 5/4 t - t^2 / 2 = 1 at t = 1/2; a little slower, it is too late."""
    found, compiled_found = on_threads((0.5, 0.1), (1.25, 0.0), (-1.0, 0.0))
    assert found is not None
    assert found.after == compiled_found[0] == 0.5
    found, compiled_found = on_threads((0.5, 0.1), (1.2499, 0.0), (-1.0, 0.0))
    assert found is None
    assert compiled_found == (math.inf, math.inf)


def test_a_thread_at_its_length_that_parts_jumps_at_once() -> None:
    found, compiled_found = on_threads((1.0, 0.1), (1.0, 0.0))
    assert found == cable_term.Jump(0.0, 8.0, 0.125)
    assert compiled_found == (0.0, 0.125)
    found, compiled_found = on_threads((1.0 + 1e-12, 0.1), (1.0, 0.0))  # taut already
    assert found is None
    assert compiled_found == (math.inf, math.inf)


@pytest.mark.parametrize("within", [4.0, 1.0, 0.25])
def test_a_thread_that_its_acceleration_makes_taut_in_time_is_found(within: float) -> None:
    """From 1/8 m; the speed alone would need 2.25 times as long as there is."""
    after = 0.9 * within
    speed = 0.875 / (2.5 * after)
    bend = 2.0 * (0.875 - speed * after) / after**2
    found, compiled_found = on_threads((0.125, 0.1), (speed, 0.0), (bend, 0.0), within, 1e-3)
    assert found is not None
    assert found.after == pytest.approx(after, rel=1e-7)
    assert compiled_found[0] == pytest.approx(after, rel=1e-7)


def test_a_jump_that_costs_the_tolerance_and_no_more_is_none() -> None:
    """8 m/s2 over 1/2 s."""
    found, compiled_found = on_threads((0.75, 0.1), (1.0, 0.0), tolerance=4.0)
    assert found is None
    assert compiled_found == (math.inf, math.inf)
    found, compiled_found = on_threads((0.75, 0.1), (1.0, 0.0), tolerance=3.999)
    assert found is not None
    assert compiled_found[0] == 0.25
