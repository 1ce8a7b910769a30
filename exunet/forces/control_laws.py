"""From what the sensors of corner units tell to the forces that their thrusters fire.

What is demanded goes through three stages, in this order: the direction that the thrusters have, the largest
thrust, the minimum impulse.

Vectors of the units stand in lists, x, y, z of each unit after those of the one before: of the few numbers of
some units, between steps that have taken the processor's caches, arithmetic one by one takes a third of what
it takes with arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from exunet.forces.control_keys import Control, Noise

Floats = NDArray[np.float64]
Numbers = list[float]


@dataclass(frozen=True)
class Sensed:
    """What a controller knows at a sample.

    time               : [s]
    position, velocity : (3 n) of the units, with the errors of their sensors [m], [m/s]
    centre, drift      : (3) centre of mass of the body and its velocity, without errors [m], [m/s]; zeros of
                         a law that looks at none
    """

    time: float
    position: Numbers
    velocity: Numbers
    centre: Numbers
    drift: Numbers


def with_noise(
    noise: Noise | None, bullets: tuple[int, ...], sample: int, position: Numbers, velocity: Numbers
) -> tuple[Numbers, Numbers]:
    """Places and velocities (3 n) as sensors tell them at the sample of a number.

    The errors depend on seed, sample and bullet alone, so no state of a generator is to be kept.
    """
    if noise is None:
        return position, velocity
    group, place = divmod(sample, _AT_ONCE)
    of_position, of_velocity = _errors(noise.seed, bullets, group)[place]
    return _wrong_by(position, noise.position, of_position), _wrong_by(velocity, noise.velocity, of_velocity)


def _wrong_by(values: Numbers, deviation: float, errors: Numbers) -> Numbers:
    return [value + deviation * error for value, error in zip(values, errors, strict=True)]


_AT_ONCE = 64  # samples of which errors are drawn one after the other: far faster than each between steps


@lru_cache(maxsize=64)
def _errors(seed: int, bullets: tuple[int, ...], group: int) -> list[tuple[Numbers, Numbers]]:
    """Of `_AT_ONCE` samples (3 n) normal errors of places and of velocities, in standard deviations.

    Those of a new generator `Philox(key=seed, counter=(0, 0, 0, sample))` for each sample. To make one takes
    ten times as long as to set it: NumPy asks the operating system for entropy, too.
    """
    bits = np.random.Philox(key=seed)
    generator, begin = np.random.Generator(bits), bits.state
    found = []
    for sample in range(group * _AT_ONCE, (group + 1) * _AT_ONCE):
        begin["state"]["counter"][3] = sample
        bits.state = begin
        drawn = generator.standard_normal((max(bullets) + 1, 6))[list(bullets)]
        found.append((drawn[:, :3].ravel().tolist(), drawn[:, 3:].ravel().tolist()))
    return found


@dataclass(frozen=True, eq=False)
class UnitLaw:
    """The law of a case: what it asks for."""

    keys: Control

    def demanded(self, sensed: Sensed) -> Numbers:
        """(3 n) the force on each unit that it asks for [N]; none of kind "given"."""
        keys = self.keys
        if keys.kind == "table":
            return self._of_table(sensed.time)
        if keys.kind == "given":
            return [0.0] * len(sensed.position)
        k, c = keys.stiffness, keys.damping
        assert k is not None
        assert c is not None
        places, speeds = self._goal(sensed)
        return [
            k * (place - x) + c * (speed - v)
            for place, x, speed, v in zip(places, sensed.position, speeds, sensed.velocity, strict=True)
        ]

    def _of_table(self, time: float) -> Numbers:
        """Linear between the times of the table, zero outside."""
        times, forces = self._table
        if not times[0] <= time <= times[-1]:
            return [0.0] * forces.shape[1]
        k = min(int(np.searchsorted(times, time, side="right")), len(times) - 1)
        part = (time - times[k - 1]) / (times[k] - times[k - 1])
        found: Numbers = (forces[k - 1] + part * (forces[k] - forces[k - 1])).tolist()
        return found

    def _goal(self, sensed: Sensed) -> tuple[Numbers, Numbers]:
        """Where each unit is to be [m], and with what velocity [m/s]; (3 n)."""
        units = len(self.keys.bullets)
        if self.keys.kind == "point" and self.keys.body is None:
            return self._places, [0.0] * (3 * units)
        centre, drift = sensed.centre, sensed.drift
        if self.keys.body is None:
            centre, drift = _mean(sensed.position), _mean(sensed.velocity)
        return [a + b for a, b in zip(centre * units, self._places, strict=True)], drift * units

    @cached_property
    def _table(self) -> tuple[Floats, Floats]:
        """Times (m,) [s], forces (m, 3 n) [N]."""
        return np.array(self.keys.time), np.array(self.keys.force).reshape(len(self.keys.time or ()), -1)

    @cached_property
    def _places(self) -> Numbers:
        """(3 n) a point, or places from a centre [m]."""
        keys = self.keys
        if keys.kind == "formation":
            return [one for offset in keys.offsets or () for one in offset]
        return [*(keys.point or keys.offset or (0.0, 0.0, 0.0))] * len(keys.bullets)


def _mean(vectors: Numbers) -> Numbers:
    return [sum(vectors[axis + 3 :: 3], vectors[axis]) / (len(vectors) // 3) for axis in range(3)]


def fired(keys: Control, demand: Numbers, sensed: Sensed) -> Numbers:
    """(3 n) the force of each unit's thrusters until the next sample [N]."""
    if keys.direction != "any":
        demand = _along(keys.direction, demand, sensed)
    most = keys.largest_thrust
    found: Numbers = []
    for first in range(0, len(demand), 3):
        x, y, z = demand[first : first + 3]
        size = math.hypot(x, y, z)  # a square may overflow
        part = most / size if size > most else 1.0
        if min(size, most) * keys.period < keys.minimum_impulse:
            part = 0.0
        found += (x * part, y * part, z * part)
    return found


def _along(direction: str, demand: Numbers, sensed: Sensed) -> Numbers:
    """(3 n) what is left of a demand along the line that each unit's thrusters have; nothing without one."""
    position, velocity, wanted = (
        np.reshape(one, (-1, 3)) for one in (sensed.position, sensed.velocity, demand)
    )
    vectors = velocity if direction == "flight" else position - position.mean(axis=0)
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    found: Numbers = (np.einsum("na,na->n", wanted, along)[:, None] * along).ravel().tolist()
    return found


def growth_of_error(keys: Control, mass: float) -> float | None:
    """By which factor an error of a free unit changes from sample to sample; above 1 the loop is unstable.

    mass : of the unit [kg]. The spectral radius of x, v after a period under the force -k x - c v of its
    beginning. None of a law without gains.
    """
    if keys.stiffness is None or keys.damping is None:
        return None
    h = keys.period
    push = np.array([[0.5 * h * h], [h]]) @ np.array([[keys.stiffness, keys.damping]]) / mass
    free = np.array([[1.0, h], [0.0, 1.0]])
    return float(np.abs(np.linalg.eigvals(free - push)).max())
