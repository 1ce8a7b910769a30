"""How far two codes agree on the same case, over time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from exunet.base.short_repr import ShortRepr
from exunet.results.body_comparison import ComparedBodies

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ComparedBreaks:
    """Elements that broke in two runs a and b, in a's numbers, until the last time that both have stored.

    both           : element, when it broke in a, and in b [s]
    only_a, only_b : elements that broke in one only
    """

    both: tuple[tuple[int, float, float], ...]
    only_a: tuple[int, ...]
    only_b: tuple[int, ...]

    @property
    def apart(self) -> float:
        """Largest difference [s] of the times at which an element broke."""
        return max((abs(a - b) for _, a, b in self.both), default=0.0)


@dataclass(frozen=True, repr=False)
class Agreement(ShortRepr):
    """Differences between a result and the reference's, at the times that both have stored.

    time                : (n,) [s]
    position_difference : (n,) [m], the largest over the nodes
    speed_difference    : (n,) [m/s], the largest over the bullets (over the nodes without bullets)
    allowed             : the speed difference up to which the two agree [m/s]
    allowed_position    : the same for positions [m]
    agrees_until        : when one of the two first exceeds what is allowed, or is NaN [s]; None: never
    apart_from          : the first stored time from which it never comes back within both [s], or None.
                          Earlier disagreement is that of single instants within a snap, where a shift of
                          its beginning by 1e-7 s shows as 1e-4 m/s
    reference_speeds    : (n, n_bullets) speeds of the bullets in the reference [m/s]
    bodies              : those beside the net, each judged by itself
    broken              : what broke, likewise; None: nothing did
    """

    time: Floats
    position_difference: Floats
    speed_difference: Floats
    allowed: float
    allowed_position: float
    agrees_until: float | None
    apart_from: float | None
    reference_speeds: Floats
    bodies: ComparedBodies = field(default_factory=ComparedBodies)
    broken: ComparedBreaks | None = None

    @property
    def speeds_of(self) -> str:
        """Whose speeds are compared: "bullets", or "nodes" of a net without bullets."""
        return "bullets" if self.reference_speeds.shape[1] else "nodes"
