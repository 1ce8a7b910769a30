"""The linear map from macro step to macro step of a coupling of a mass m on a spring, the net.

The maps are written from what the methods do, not from the coupling's code: states are the host's position
and velocity, the velocity one step before, the last given force, the method's own acceleration, what is owed,
the mean force of the step before, and the last predicted position and velocity of the port; of a net with a
light node, its position and velocity too. m = H = 1, so that k is H^2 k / m; times are in macro steps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm


def step(state: np.ndarray, method: str, mean_of: Callable[..., float], *, lags: bool = False) -> np.ndarray:
    """One macro step; `lags`: methods that weigh get the mean force as it is.

    mean_of : mean force of the net along a cubic by place and velocity at both ends
    """
    x, v, before, given, own, owed, last, aim, speed = state
    own, owed = own * (method[0] not in "RV"), owed * (method[0] != "R")  # which they do not have
    acceleration = v - before
    place, fast = x + v + 0.5 * acceleration, v + acceleration
    mean = mean_of(aim, speed, place, fast)
    handed = mean
    if method[0] != "R" and not lags:
        expected = 1.5 * mean - 0.5 * last
        owed = owed + mean - 0.5 * (given + expected)
        handed = expected + owed
        owed = owed - 0.5 * (handed - expected)
    if method == "RK44":
        x, new = x + v + 0.5 * mean, v + mean
    elif method == "RK44 in parallel":
        x, new = x + v + 0.5 * given, v + given
    elif method == "VelocityVerlet":
        x, new = x + v + 0.5 * given, v + 0.5 * (given + handed)
    else:
        radius = 1.0 if method == "TrapezoidalIndex2" else float(method[16:])
        m, f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
        if method == "TrapezoidalIndex2":
            m = f = 0.0
        gamma = 0.5 + f - m
        beta = 0.25 * (gamma + 0.5) ** 2
        rate = ((1.0 - f) * handed + f * given - m * own) / (1.0 - m)
        x, new = x + v + (0.5 - beta) * own + beta * rate, v + (1.0 - gamma) * own + gamma * rate
        own = rate
    if method == "TrapezoidalIndex2":
        own = handed
    return np.array([x, new, v, handed, own, owed, mean, place, fast])


def growth(method: str, k: float, damping: float = 0.0, *, lags: bool = False) -> float:
    """Of amplitudes in a macro step: the spectral radius less 1."""

    def mean_of(aim: float, speed: float, place: float, fast: float) -> float:
        return -k * (0.5 * (aim + place) + (speed - fast) / 12.0) - damping * k * (place - aim)

    columns = [step(unit, method, mean_of, lags=lags) for unit in np.eye(9)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max() - 1.0)


def along(aim: float, speed: float, place: float, fast: float) -> list[float]:
    """Place and its derivatives at the beginning of such a cubic."""
    way = place - aim
    return [aim, speed, 2.0 * (3.0 * way - 2.0 * speed - fast), 6.0 * (speed + fast - 2.0 * way)]


def growth_with_node(method: str, k: float, node: float, beyond: float, tau: float = 0.0) -> float:
    """As `growth`, for k between the mass and a node, and beyond * k between that and a fixed point.

    method : or "repeats", until the host ends at the motion of the net
    """
    rate = np.zeros((7, 7))  # of the node's place and velocity, the impulse, and the port's four derivatives
    rate[0, 1] = 1.0
    rate[1, [0, 1, 3, 4]] = np.array([-(1.0 + beyond), -tau * (1.0 + beyond), 1.0, tau]) * k / node
    rate[2, [0, 1, 3, 4]] = np.array([1.0, tau, -1.0, -tau]) * k
    rate[[3, 4, 5], [4, 5, 6]] = 1.0
    through = expm(rate)

    def repeated(state: np.ndarray) -> np.ndarray:
        x, v, y, w = state
        free = through @ [y, w, 0.0, *along(x, v, x + v, v)]
        by_force = through @ [0.0, 0.0, 0.0, *along(0.0, 0.0, 0.5, 1.0)]
        force = free[2] / (1.0 - by_force[2])
        end = free + force * by_force
        return np.array([x + v + 0.5 * force, v + force, end[0], end[1]])

    def once(state: np.ndarray) -> np.ndarray:
        end = np.zeros(7)

        def mean_of(*path: float) -> float:
            end[:] = through @ [*state[9:], 0.0, *along(*path)]
            return float(end[2])

        host = step(state[:9], method, mean_of)
        return np.concatenate([host, end[:2]])

    one, size = (repeated, 4) if method == "repeats" else (once, 11)
    columns = [one(unit) for unit in np.eye(size)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max() - 1.0)
