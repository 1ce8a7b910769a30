"""Explicit methods of fixed step: classical Runge-Kutta of order 4, velocity Verlet.

Whole steps are counted from the last stored time, so that none drifts; the last one before a stored time is
shorter where the step does not divide the interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from reference_impl.run import Run
from reference_impl.weave import Floats

Stepper = Callable[[float], Floats]  # takes the run to a time [s], returns the state then


def whole_steps(run: Run, step: float, end: float, take: Callable[[float], None]) -> Floats:
    """Calls take(arrival) for each step [s] from the present time to `end`."""
    begin = run.t
    whole = math.ceil((end - begin) / step * (1.0 - 1e-12))
    for k in range(1, whole + 1):
        take(end if k == whole else begin + k * step)
    return run.y


def classical(run: Run, step: float) -> Stepper:
    """Classical Runge-Kutta method of order 4 (RK4)."""

    def take(arrival: float) -> None:
        h, t, y = arrival - run.t, run.t, run.y
        k1 = run.rate(t, y)
        k2 = run.rate(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = run.rate(t + 0.5 * h, y + 0.5 * h * k2)
        k4 = run.rate(arrival, y + h * k3)
        run.arrive(arrival, y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))

    return lambda end: whole_steps(run, step, end, take)


def verlet(run: Run, step: float) -> Stepper:
    """Velocity Verlet: half a kick, a drift, half a kick; order 2, one right-hand side a step.

    Damping and Coriolis forces at the end of a step would need the velocity that they determine; they take
    v + h a(x, v) instead, which differs by O(h^2) and leaves the order.  Without them it is symplectic.
    """
    n3 = run.half
    rate = run.rate(run.t, run.y)

    def take(arrival: float) -> None:
        nonlocal rate
        h, y = arrival - run.t, run.y
        x, v, a = y[:n3], y[n3:-1], rate[n3:-1]
        half_kicked = v + 0.5 * h * a
        position = x + h * half_kicked
        after = run.rate(arrival, np.concatenate((position, v + h * a, (0.0,))))
        velocity = half_kicked + 0.5 * h * after[n3:-1]
        dissipated = y[-1] + 0.5 * h * (rate[-1] + after[-1])
        run.arrive(arrival, np.concatenate((position, velocity, (dissipated,))))
        rate = after

    return lambda end: whole_steps(run, step, end, take)
