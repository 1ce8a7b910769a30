"""Where bodies and points are between instants at which their states are known.

Places are cubics through places and velocities at both ends (Hermite's); attitudes the same of quaternions,
whose rates angular velocities tell, brought to length 1. Of a body that makes less than half a turn from one
instant to the next both are exact to the fourth order of the time between.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import rotation_matrix, turning

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_SHORTEST = 0.9  # length of a quaternion between two of length 1, less than half a turn apart: 0.98 and more


def cubic(values: Floats, rates: Floats, step: Floats, part: Floats) -> Floats:
    """(n, m) values at parts (n,) of steps (n,) [s], of values and rates (2, n, m) at both ends of each."""
    s, h = part[:, None], step[:, None]
    a, b = values
    v, w = h * rates
    return np.asarray(a + s * (v + s * (3.0 * (b - a) - 2.0 * v - w + s * (2.0 * (a - b) + v + w))))


def rates_around(values: Floats, rates: Floats, step: Floats) -> Floats:
    """(3, n, ..., m) rates of which those of such a cubic are weighted means: points of control (Bezier's).

    values, rates : (n + 1, ..., m) at the ends of the steps (n,) [s]
    """
    h = step.reshape(-1, *(1,) * (values.ndim - 1))
    middle = 3.0 * np.diff(values, axis=0) / h - rates[:-1] - rates[1:]
    return np.stack([rates[:-1], middle, rates[1:]])


@dataclass(frozen=True, eq=False)
class Path:
    """The motion of a body through instants.

    time     : (t,) [s], increasing
    place    : (t, 3) of the centre of mass [m]
    velocity : (t, 3) [m/s]
    attitude : (t, 4) unit quaternions (w, x, y, z); signs are brought to the shorter way
    spin     : (t, 3) angular velocities in the body's axes [rad/s]
    """

    time: Floats
    place: Floats
    velocity: Floats
    attitude: Floats
    spin: Floats

    @cached_property
    def step(self) -> Floats:
        """(t - 1,) between instants [s]."""
        return np.diff(self.time)

    @cached_property
    def quaternions(self) -> tuple[Floats, Floats]:
        """(t, 4) each: attitudes whose signs do not change from one to the next, and their rates."""
        turned = np.einsum("tq,tq->t", self.attitude[1:], self.attitude[:-1]) < 0.0
        sign = np.concatenate([[1.0], np.cumprod(np.where(turned, -1.0, 1.0))])[: len(self.time)]
        attitude = sign[:, None] * self.attitude
        return attitude, turning(attitude, self.spin)

    @cached_property
    def poses(self) -> Floats:
        """(t, 7) places and attitudes at the instants."""
        return np.concatenate([self.place, self.attitude], axis=1)

    def at(self, row: Ints, part: Floats) -> Floats:
        """(n, 7) places [m] and attitudes at parts (n,) of the steps of these numbers (n,)."""
        ends, step = np.stack([row, row + 1]), self.step[row]
        attitude, rate = self.quaternions
        place = cubic(self.place[ends], self.velocity[ends], step, part)
        turned = cubic(attitude[ends], rate[ends], step, part)
        return np.concatenate([place, turned / np.linalg.norm(turned, axis=1, keepdims=True)], axis=1)

    @cached_property
    def velocities(self) -> Floats:
        """(3, t - 1, 3) of which those in each step are weighted means [m/s]."""
        return rates_around(self.place, self.velocity, self.step)

    @cached_property
    def fastest_turn(self) -> Floats:
        """(t - 1,) angular velocity in each step, at most [rad/s]."""
        rates = rates_around(*self.quaternions, self.step)
        return np.asarray(2.0 * np.linalg.norm(rates, axis=-1).max(axis=0) / _SHORTEST)

    def every_second(self) -> Path:
        """The same through half as many instants, the last one included."""
        return self.through(np.arange(len(self.time) - 1, -1, -2)[::-1])

    def through(self, rows: slice | Ints) -> Path:
        """Through some of the instants."""
        states = (self.time, self.place, self.velocity, self.attitude, self.spin)
        return Path(*(values[rows] for values in states))

    def when(self, time: Floats) -> Floats:
        """(n, 7) places [m] and attitudes at times (n,) [s] from the first instant to the last."""
        row = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, max(0, len(self.step) - 1))
        if not len(self.step):
            return self.poses[row]
        return self.at(row, (time - self.time[row]) / self.step[row])


def seen_from(poses: Floats, points: Floats) -> Floats:
    """(n, 3) points of the scene (n, 3) [m], from bodies at poses (n, 7) and in their axes."""
    return np.asarray(np.einsum("nij,ni->nj", rotation_matrix(poses[:, 3:]), points - poses[:, :3]))
