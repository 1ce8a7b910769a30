"""How far the bodies of two runs are apart, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from exunet.results.result import BodyStates

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BodyDifferences:
    """Differences of one body over the times that both runs have stored, (n,) each.

    position         : [m]
    velocity         : [m/s]
    attitude         : angle between the two [rad]; None if it is a point mass in either run
    angular_velocity : [rad/s], in body axes; None as above
    allowed_position, allowed_attitude : up to which the two agree [m], [rad]
    agrees_until     : when one of the two first exceeds what is allowed, or is NaN [s]; None: never
    """

    position: Floats
    velocity: Floats
    attitude: Floats | None = None
    angular_velocity: Floats | None = None
    allowed_position: float = math.inf
    allowed_attitude: float = math.inf
    agrees_until: float | None = None


@dataclass(frozen=True)
class ComparedBodies:
    """The bodies of two runs a and b.

    both           : differences of those that both have, by name
    only_a, only_b : names of those that one has
    """

    both: Mapping[str, BodyDifferences] = field(default_factory=dict)
    only_a: tuple[str, ...] = ()
    only_b: tuple[str, ...] = ()


def compare_bodies(
    a: Mapping[str, BodyStates],
    b: Mapping[str, BodyStates],
    rows: tuple[Ints, Ints],
    time: Floats,
    allowed: tuple[float, float],
) -> ComparedBodies:
    """Compare the bodies of two runs at their rows (n,) of the same times (n,) [s].

    allowed : differences of position [m] and attitude [rad] up to which they agree
    """
    found = {name: _differences(body, b[name], *rows) for name, body in a.items() if name in b}
    return ComparedBodies(
        {name: _judged(one, time, *allowed) for name, one in found.items()},
        tuple(name for name in a if name not in b),
        tuple(name for name in b if name not in a),
    )


def _judged(one: BodyDifferences, time: Floats, position: float, attitude: float) -> BodyDifferences:
    """The same with what is allowed, and until when it holds."""
    within = one.position <= position  # as a NaN is not
    if one.attitude is not None:
        within &= one.attitude <= attitude
    until = None if within.all() else float(time[int(np.argmin(within))])
    return replace(one, allowed_position=position, allowed_attitude=attitude, agrees_until=until)


def _differences(a: BodyStates, b: BodyStates, at_a: Ints, at_b: Ints) -> BodyDifferences:
    position = np.linalg.norm(a.position[at_a] - b.position[at_b], axis=-1)
    velocity = np.linalg.norm(a.velocity[at_a] - b.velocity[at_b], axis=-1)
    if a.attitude is None or b.attitude is None or a.angular_velocity is None or b.angular_velocity is None:
        return BodyDifferences(position, velocity)
    turned = _angle(a.attitude[at_a], b.attitude[at_b])
    spin = np.linalg.norm(a.angular_velocity[at_a] - b.angular_velocity[at_b], axis=-1)
    return BodyDifferences(position, velocity, turned, spin)


def _angle(a: Floats, b: Floats) -> Floats:
    """(n,) angles [rad] between unit quaternions (n, 4); q and -q are the same attitude.

    2 arcsin(|a - b| / 2) of the nearer of the two is precise for small angles, where 2 arccos(a . b) is not.
    """
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
