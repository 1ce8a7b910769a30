"""The largest tension of each element over all steps of a run, which may go back to an earlier state.

A largest value does not tell what it was before. So what belongs to intervals between stored times is kept
apart until the run cannot go back before them: it continues from the last safe state, or ends with the last
one that was stored.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class ElementPeaks:
    """Takes the tensions of accepted steps; each step belongs to the interval that ends with a stored time.

    times : (n,) the stored times [s] of the whole run
    """

    def __init__(self, times: Floats, n_elements: int) -> None:
        self._times = times
        self._safe = np.zeros(n_elements)  # until the last safe state
        self._stored, self._stored_until = (
            np.zeros(n_elements),
            -math.inf,
        )  # from there to the last stored one
        self._later: dict[int, Floats] = {}  # by the interval

    def look(self, time: Floats, tension: Floats) -> None:
        """Take tensions (k, n_elements) [N] of steps that end at times (k,) [s], in order."""
        interval = np.searchsorted(self._times, time)
        first = np.flatnonzero(np.append(True, np.diff(interval) > 0))
        for k, peaks in zip(interval[first].tolist(), np.maximum.reduceat(tension, first), strict=True):
            self._take(k, peaks)

    def take(self, until: float, peaks: Floats) -> None:
        """Take the largest tensions (n_elements,) [N] of steps after the stored time before `until` [s]."""
        self._take(int(self._times.searchsorted(until)), peaks)

    def _take(self, interval: int, peaks: Floats) -> None:
        interval = min(interval, len(self._times) - 1)  # round-off may put a step behind the end
        known = self._later.get(interval)
        if known is None:
            self._later[interval] = peaks.copy()
        else:
            np.maximum(known, peaks, out=known)

    def settle(self, safe: float, stored: float) -> None:
        """From now on a run may go back to the first of these stored times [s], or end at the second."""
        if safe >= self._stored_until:
            np.maximum(self._safe, self._stored, out=self._safe)
            self._stored[:] = 0.0
        for interval in [k for k in self._later if self._times[k] <= stored]:
            into = self._safe if self._times[interval] <= safe else self._stored
            np.maximum(into, self._later.pop(interval), out=into)
        self._stored_until = stored

    def forget_after(self, time: float) -> None:
        """Drop what was seen after a time [s] that `settle` has named."""
        if time < self._stored_until:
            self._stored[:], self._stored_until = 0.0, time
        self._later = {k: peaks for k, peaks in self._later.items() if self._times[k] <= time}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that was found, for a snapshot."""
        return {
            "safe": self._safe.copy(),
            "stored": self._stored.copy(),
            "stored_until": np.array([self._stored_until]),
            "intervals": np.array(sorted(self._later), dtype=np.int64),
            "later": np.array([self._later[k] for k in sorted(self._later)]).reshape(-1, len(self._safe)),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `arrays` gave."""
        self._safe[:], self._stored[:] = arrays["safe"], arrays["stored"]
        self._stored_until = float(arrays["stored_until"][0])
        intervals = np.clip(arrays["intervals"], 0, len(self._times) - 1).tolist()
        self._later = {k: peaks.copy() for k, peaks in zip(intervals, arrays["later"], strict=True)}

    @property
    def largest(self) -> Floats:
        """(n_elements,) [N]"""
        return np.max([self._safe, self._stored, *self._later.values()], axis=0)
