"""Estimates of contact before a run: impacts, and the step that damping and friction allow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import CASES, NET_ON_BOX, of_text
from scipy.integrate import solve_ivp

import exunet
from exunet.forces.contact.estimate import (
    damping_rate,
    friction_rate,
    speed_of_bodies,
    speed_of_net,
    speed_of_threads,
)
from exunet.forces.contact.law import Friction
from exunet.simulation.preparation import prepare_case

MASS, STIFFNESS = 0.02, 5e3  # kg, N/m^n


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("hit", [1e-3, 0.3, 2.0, 30.0, 1000.0])
def test_the_bound_is_that_of_an_impact(hit: float, exponent: float) -> None:
    """Of m p'' = -k p^n (1 + a p'), p' = 1 m/s at first: the most of a k p^n / m until it turns back."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        depth, speed = max(y[0], 0.0), y[1]
        return [speed, -STIFFNESS * depth**exponent * max(1.0 + hit * speed, 0.0) / MASS]

    def turns(t: float, y: np.ndarray) -> float:
        return float(y[1])

    turns.terminal, turns.direction = True, -1.0  # type: ignore[attr-defined]
    deepest = ((exponent + 1.0) / 2.0 * MASS / STIFFNESS) ** (1.0 / (exponent + 1.0))
    found = solve_ivp(rates, (0.0, 1.0), [0.0, 1.0], events=turns, rtol=1e-8, atol=1e-12, method="LSODA")
    depth = float(found.y[0].max())
    assert 0.0 < depth <= deepest * (1.0 + 1e-6)
    most = hit * STIFFNESS * depth**exponent / MASS
    slope = exponent * STIFFNESS * deepest ** (exponent - 1.0)
    bound = damping_rate(hit, slope / MASS, 1.0, exponent)
    assert most < bound
    assert bound < 3.0 * most


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
def test_the_slope_of_friction_is_at_most_that_of_an_impact(exponent: float) -> None:
    """Of N = k p^n where m v^2 / 2 = k p^(n + 1) / (n + 1): exactly so of a linear force."""
    speed, rubs = 2.0, Friction(0.3, 0.01)
    depth = (0.5 * (exponent + 1.0) * MASS * speed**2 / STIFFNESS) ** (1.0 / (exponent + 1.0))
    slope = exponent * STIFFNESS * depth ** (exponent - 1.0)
    steepest = 0.3 * STIFFNESS * depth**exponent / (MASS * 0.01)
    bound = friction_rate(rubs, slope / MASS, speed)
    assert steepest <= bound * (1.0 + 1e-12)
    assert bound < 1.3 * steepest
    assert (bound < steepest * (1.0 + 1e-12)) == (exponent == 1.0)
    assert friction_rate(Friction(0.3), slope / MASS, speed) == 0.0


def test_speeds_are_those_of_the_start() -> None:
    """A net at (0.1, 0, -1) m/s, a box at (0, 0.05, 0) m/s that turns at (0.3, -0.2, 0.5) rad/s."""
    blocks = prepare_case(of_text(NET_ON_BOX)).system.blocks
    against = math.sqrt(0.1**2 + 0.05**2 + 1.0)
    spin = math.sqrt(0.3**2 + 0.2**2 + 0.5**2)
    assert speed_of_net(blocks, "box", 0.0) == pytest.approx(against, rel=1e-12)
    assert speed_of_net(blocks, "box", 0.2) == pytest.approx(against + 0.2 * spin, rel=1e-12)
    assert speed_of_bodies(blocks, "box", "box", (0.1, 0.2)) == pytest.approx(0.3 * spin, rel=1e-12)
    assert speed_of_threads(blocks) == pytest.approx(against, rel=1e-12)


def test_a_throw_that_comes_later_counts() -> None:
    case = exunet.load(CASES / "missions" / "throw_close_tow.toml")
    start = prepare_case(case)
    nodes = slice(start.net.n_nodes)
    assert np.abs(start.velocity[nodes]).max() < 0.1
    assert 1.5 < speed_of_net(start.system.blocks, "box", 0.0) < 3.0
