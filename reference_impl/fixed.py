"""Explicit methods of fixed step: classical Runge-Kutta of order 4, velocity Verlet.

Whole steps are counted from the last stored time, so that none drifts; the last one before a stored time is
shorter where the step does not divide the interval.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.bodies import turning
from reference_impl.mode import Mode
from reference_impl.run import Run
from reference_impl.turns import turned


class Fixed(ABC):
    """Steps of one length [s]; a subclass takes one of them.  What breaks does so at the end of a step."""

    def __init__(self, run: Run, step: float) -> None:
        self.run, self.step = run, step

    def advance(self, end: float) -> tuple[Floats, Mode]:
        """Takes the run to t = end [s]; the state and mode then."""
        run = self.run
        begin = run.t
        whole = math.ceil((end - begin) / self.step * (1.0 - 1e-12))
        for k in range(1, whole + 1):
            self.take(end if k == whole else begin + k * self.step)
            if any((run.break_exceeded(), run.reels_exceeded(), run.bullets_gone(), run.remember())):
                self.renew(end)
        return run.y, run.mode

    @abstractmethod
    def take(self, arrival: float) -> None:
        """One step, to `arrival` [s]."""

    def renew(self, until: float) -> None:  # noqa: B027 - most methods keep nothing
        """The forces changed at t; they are smooth `until` [s]."""


class Classical(Fixed):
    """Classical Runge-Kutta method of order 4 (RK4)."""

    def take(self, arrival: float) -> None:
        run = self.run
        h, t, y = arrival - run.t, run.t, run.y
        k1 = run.rate(t, y)
        k2 = run.rate(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = run.rate(t + 0.5 * h, y + 0.5 * h * k2)
        k4 = run.rate(arrival, y + h * k3)
        run.arrive(arrival, y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))


class Verlet(Fixed):
    """Velocity Verlet: half a kick, a drift, half a kick; order 2, one right-hand side a step.

    Drag, damping and Coriolis forces at the end of a step would need the velocity that they determine; they
    take v + h a(x, v) instead, which differs by O(h^2) and leaves the order.  Without them it is symplectic.
    Rigid bodies turn by the exponential of the angular velocity at half the step, which half a turn gives;
    torques kick their angular momenta as forces kick momenta.
    """

    def __init__(self, run: Run, step: float) -> None:
        super().__init__(run, step)
        self.rate = run.rate(run.t, run.y)

    def renew(self, until: float) -> None:
        self.rate = self.run.rate(self.run.t, self.run.y)

    def take(self, arrival: float) -> None:
        run, rate, where = self.run, self.rate, self.run.layout
        n3, books = where.half, where.moved
        h, y = arrival - run.t, run.y
        x, v, a = y[:n3], y[n3 : 2 * n3], rate[n3 : 2 * n3]
        half_kicked = v + 0.5 * h * a
        position = x + h * half_kicked
        attitude, torque = self._turn(h), rate[where.turned : books]
        spin = y[where.turned : books]
        guessed = (position, v + h * a, attitude, spin + h * torque, y[books:] + h * rate[books:])
        after = run.rate(arrival, np.concatenate(guessed))
        velocity = half_kicked + 0.5 * h * after[n3 : 2 * n3]
        kicked = spin + 0.5 * h * (torque + after[where.turned : books])
        booked = y[books:] + 0.5 * h * (rate[books:] + after[books:])
        run.arrive(arrival, np.concatenate((position, velocity, attitude, kicked, booked)))
        self.rate = after

    def _turn(self, h: float) -> Floats:
        """R (9 r,) of the rigid bodies after h [s], with their angular momenta at half the step."""
        run, mobility = self.run, self.run.system.bodies.mobility
        if not len(mobility):
            return np.empty(0)
        now = run.layout.held(run.y)
        spin = now.spin + 0.5 * h * run.layout.held(self.rate).spin
        middle = turned(now.attitude, 0.5 * h * turning(now.attitude, spin, mobility))
        return turned(now.attitude, h * turning(middle, spin, mobility)).ravel()
