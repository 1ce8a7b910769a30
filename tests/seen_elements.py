"""What the compiled loop sees of steps, for elements that are given one by one."""

from __future__ import annotations

import numpy as np

from exunet.integrators.compiled.workspace import LARGEST, PEAKS, ObservedSteps

NONE = np.zeros(0)


def seen_of(
    ends: np.ndarray,
    length: np.ndarray = NONE,
    stiffness: np.ndarray = NONE,
    twice_time: np.ndarray = NONE,
    *,
    half: np.ndarray = NONE,
    look_above: float = 0.0,
    bounds: tuple[int, ...] | None = None,
) -> ObservedSteps:
    """Nothing seen so far; all elements are one group unless the bounds of several are given."""
    bounds = (0, len(ends)) if bounds is None else bounds
    peaks = np.array([(0.0, np.inf, np.inf, look_above)], dtype=PEAKS)
    largest = np.array([(0.0, 0.0, -1)] * (len(bounds) - 1), dtype=LARGEST)
    first, second = 3 * np.reshape(ends, (-1, 2)).T
    numbers = length, stiffness, twice_time, twice_time, np.zeros(len(ends)), length**2
    return ObservedSteps(peaks, largest, np.array(bounds), half, first, second, *numbers)
