"""From what the sensors of corner units tell to the forces that their thrusters fire.

What is demanded goes through three stages, in this order: the direction that the thrusters have, the largest
thrust, the minimum impulse.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces.control_keys import Control, Noise

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sensed:
    """What a controller knows at a sample.

    time               : [s]
    position, velocity : (n, 3) of the units, with the errors of their sensors [m], [m/s]
    centre, drift      : (3,) centre of mass of the body and its velocity, without errors [m], [m/s]; zeros
                         of a law that looks at none
    """

    time: float
    position: Floats
    velocity: Floats
    centre: Floats
    drift: Floats


def with_noise(
    noise: Noise | None, bullets: tuple[int, ...], sample: int, position: Floats, velocity: Floats
) -> tuple[Floats, Floats]:
    """Places and velocities (n, 3) as sensors tell them at the sample of a number.

    The errors depend on seed, sample and bullet alone, so no state of a generator is to be kept.
    """
    if noise is None:
        return position, velocity
    errors = _generator_at(noise.seed, sample).standard_normal((max(bullets) + 1, 6))[list(bullets)]
    return position + noise.position * errors[:, :3], velocity + noise.velocity * errors[:, 3:]


class _Generator(threading.local):
    """Of each thread: a generator, and the state in which one with this key begins."""

    def __init__(self) -> None:
        self.key, self.drawn = 0, np.random.Generator(np.random.Philox(key=0))
        self.begin: dict[str, Any] = dict(self.drawn.bit_generator.state)


_generator = _Generator()


def _generator_at(seed: int, sample: int) -> np.random.Generator:
    """As a new one of `Philox(key=seed, counter=(0, 0, 0, sample))`.

    To make one takes ten times as long as to set it: NumPy asks the operating system for entropy, too.
    """
    own = _generator
    if own.key != seed:
        own.key, own.begin = seed, dict(np.random.Philox(key=seed).state)
    own.begin["state"]["counter"][3] = sample
    own.drawn.bit_generator.state = own.begin
    return own.drawn


def demanded(keys: Control, sensed: Sensed) -> Floats:
    """(n, 3) the force on each unit that the law of the case asks for [N]; none of kind "given"."""
    if keys.kind == "table":
        return _of_table(keys, sensed.time)
    if keys.kind == "given":
        return np.zeros_like(sensed.position)
    assert keys.stiffness is not None
    assert keys.damping is not None
    place, velocity = _goal(keys, sensed)
    return keys.stiffness * (place - sensed.position) + keys.damping * (velocity - sensed.velocity)


def _of_table(keys: Control, time: float) -> Floats:
    """Linear between the times of the table, zero outside."""
    times, forces = np.array(keys.time), np.array(keys.force)
    if not times[0] <= time <= times[-1]:
        return np.zeros(forces.shape[1:])
    k = min(int(np.searchsorted(times, time, side="right")), len(times) - 1)
    part = (time - times[k - 1]) / (times[k] - times[k - 1])
    return np.asarray(forces[k - 1] + part * (forces[k] - forces[k - 1]))


def _goal(keys: Control, sensed: Sensed) -> tuple[Floats, Floats]:
    """Where each unit is to be [m], and with what velocity [m/s]; broadcast to (n, 3)."""
    if keys.kind == "point" and keys.point is not None:
        return np.array(keys.point), np.zeros(3)
    if keys.kind == "point":
        return sensed.centre + np.array(keys.offset or (0.0, 0.0, 0.0)), sensed.drift
    about = (sensed.centre, sensed.drift)
    if keys.body is None:
        about = (sensed.position.mean(axis=0), sensed.velocity.mean(axis=0))
    return about[0] + np.array(keys.offsets), about[1]


def fired(keys: Control, demand: Floats, sensed: Sensed) -> Floats:
    """(n, 3) the force of each unit's thrusters until the next sample [N]."""
    if keys.direction != "any":
        along = _unit_vectors(sensed, keys.direction)
        demand = np.einsum("na,na->n", demand, along)[:, None] * along
    size = np.sqrt(np.einsum("na,na->n", demand, demand))
    scale = np.ones(len(size))
    above = size > keys.largest_thrust
    scale[above] = keys.largest_thrust / size[above]
    scale[np.minimum(size, keys.largest_thrust) * keys.period < keys.minimum_impulse] = 0.0
    return demand * scale[:, None]


def _unit_vectors(sensed: Sensed, direction: str) -> Floats:
    """(n, 3) the line that each unit's thrusters have; zeros where there is none."""
    vectors = sensed.velocity if direction == "flight" else sensed.position - sensed.position.mean(axis=0)
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)


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
