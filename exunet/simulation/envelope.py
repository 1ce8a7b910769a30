"""The energies between stored times: the largest elastic and the least kinetic one, over every accepted step.

A snap may last less than the time between two stored states, which then show nothing of it.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Envelope:
    """Takes the energies of accepted steps; each belongs to the interval that ends with a stored time.

    times : (n,) the stored times [s] of the whole run
    """

    def __init__(self, times: Floats) -> None:
        self._times, self._next = times, 0
        self._elastic = np.zeros(len(times))
        self._kinetic = np.full(len(times), np.inf)

    def look(self, time: Floats, elastic: Floats, kinetic: Floats) -> None:
        """Take energies (k,) [J] of steps that end at times (k,) [s]."""
        # Round-off may put a step behind the end.
        interval = np.minimum(np.searchsorted(self._times, time), len(self._times) - 1)
        np.maximum.at(self._elastic, interval, elastic)
        np.minimum.at(self._kinetic, interval, kinetic)

    def take(self, until: float, elastic: float, kinetic: float) -> None:
        """Take the extremes [J] of the interval that ends with a stored time [s]."""
        k = self._next
        if k >= len(self._times) or self._times[k] != until:
            k = min(bisect_left(self._times, until), len(self._times) - 1)
        self._next = k + 1
        self._elastic[k] = max(self._elastic[k], elastic)
        self._kinetic[k] = min(self._kinetic[k], kinetic)

    def forget_after(self, time: float) -> None:
        """Drop what was seen after the stored time [s] that a run goes back to."""
        late = self._times > time
        self._elastic[late], self._kinetic[late] = 0.0, np.inf

    def arrays(self, until: float) -> dict[str, Floats]:
        """What was seen of the intervals until a time [s], for a snapshot."""
        number = int(np.searchsorted(self._times, until, side="right")) + 1
        return {"elastic": self._elastic[:number].copy(), "kinetic": self._kinetic[:number].copy()}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Go back to what `arrays` gave."""
        self._elastic[:], self._kinetic[:] = 0.0, np.inf
        self._elastic[: len(arrays["elastic"])] = arrays["elastic"]
        self._kinetic[: len(arrays["kinetic"])] = arrays["kinetic"]

    def around(self, first: int, elastic: Floats, kinetic: Floats) -> tuple[Floats, Floats]:
        """Largest elastic and least kinetic energy of intervals, both ends included, (k,) each [J].

        first            : number of the first interval
        elastic, kinetic : (k + 1,) energies [J] of the stored states, from the one before that interval on
        """
        ours = slice(first, first + len(elastic) - 1)
        largest = np.maximum(self._elastic[ours], np.maximum(elastic[1:], elastic[:-1]))
        least = np.minimum(self._kinetic[ours], np.minimum(kinetic[1:], kinetic[:-1]))
        return largest, least
