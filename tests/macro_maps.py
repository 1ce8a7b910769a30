"""The linear map from macro step to macro step of a coupling of a mass m on a spring, the net.

The maps are written from what the coupling does, not from its code: states are the host's position and
velocity, the velocity one step before, the force of that step, and the last predicted position and velocity
of the port; of a net with a light node, its position and velocity too. m = H = 1, so that k is H^2 k / m;
times are in macro steps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm


def step(state: np.ndarray, mean_of: Callable[..., float], *, parallel: bool = False) -> np.ndarray:
    """One macro step; in parallel (Jacobi): with the force of the step before.

    mean_of : mean force of the net along a cubic by place and velocity at both ends
    """
    x, v, before, given, aim, speed = state
    acceleration = v - before
    place, fast = x + v + 0.5 * acceleration, v + acceleration
    mean = mean_of(aim, speed, place, fast)
    force = given if parallel else mean
    return np.array([x + v + 0.5 * force, v + force, v, mean, place, fast])


def growth(k: float, damping: float = 0.0, *, parallel: bool = False) -> float:
    """Of amplitudes in a macro step: the spectral radius less 1."""

    def mean_of(aim: float, speed: float, place: float, fast: float) -> float:
        return -k * (0.5 * (aim + place) + (speed - fast) / 12.0) - damping * k * (place - aim)

    columns = [step(unit, mean_of, parallel=parallel) for unit in np.eye(6)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max() - 1.0)


def along(aim: float, speed: float, place: float, fast: float) -> list[float]:
    """Place and its derivatives at the beginning of such a cubic."""
    way = place - aim
    return [aim, speed, 2.0 * (3.0 * way - 2.0 * speed - fast), 6.0 * (speed + fast - 2.0 * way)]


def growth_with_node(method: str, k: float, node: float, beyond: float, tau: float = 0.0) -> float:
    """As `growth`, for k between the mass and a node, and beyond * k between that and a fixed point.

    method : "once", or "repeats": until the host ends at the motion of the net
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
            end[:] = through @ [*state[6:], 0.0, *along(*path)]
            return float(end[2])

        host = step(state[:6], mean_of)
        return np.concatenate([host, end[:2]])

    one, size = (repeated, 4) if method == "repeats" else (once, 8)
    columns = [one(unit) for unit in np.eye(size)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max() - 1.0)
