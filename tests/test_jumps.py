"""Jumps of the force where viscous elements become taut: both forms against the roots of a polynomial."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exunet.backends.compiled import many_steps
from exunet.backends.compiled.arrays import PEAKS, Motion, Seen, Stages
from exunet.forces import jumps
from exunet.forces.cable import Law

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
    work = np.zeros((len(Stages._fields), 12))
    work[0] = a
    none = np.zeros(0)
    inverse = np.repeat(1.0 / MASS, 3)
    motion = Motion(x, v, none, inverse, np.zeros((0, 3)), np.zeros(12), (), work, none, none, np.zeros(1))
    seen = Seen(np.zeros(1, dtype=PEAKS), none, ENDS, LENGTH, STIFFNESS, 2.0 * TAU)._replace(**changed)
    return many_steps.jump_ahead(WITHIN, tolerance, time, motion, seen)


def of_arrays(state: Any, tolerance: float, time: float, fixed: tuple[int, ...] = ()) -> jumps.Jump | None:
    points: Any = SimpleNamespace(
        mass=MASS, net=SimpleNamespace(element_nodes=ENDS, fixed_nodes=np.array(fixed, dtype=int))
    )
    return jumps.jump_ahead(points, Law(LENGTH, STIFFNESS, TAU), WITHIN, tolerance, time, state)


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
    assert compiled(state, 1e-3, 0.0, twice_time=np.zeros(4)) == (math.inf, math.inf)
    assert compiled(state, 1e-3, 0.0, stiffness=np.zeros(4)) == (math.inf, math.inf)
    assert of_arrays(state, 1e-3, 0.0, fixed=(0, 1, 2, 3)) is None
