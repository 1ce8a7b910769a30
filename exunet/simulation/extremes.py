"""Extremes of a run over all accepted steps: tensions, and energies between stored times.

A largest value does not tell what it was before. So what belongs to intervals between stored times is kept
apart until the run cannot go back before them: it continues from the last safe state, or ends with the last
one that was stored.

A snap may last less than the time between two stored states, which then show nothing of it.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.protocol import Largest

Floats = NDArray[np.float64]


class Peaks:
    """Keeps the largest tensions in the order in which they were found, each above those before it.

    A run that goes back to a state forgets those that were found after it. So one is kept of the states after
    each to which a run may go back, until the next, if it is above all before: the first of the largest, and
    of elements that have it in the same state the one of the lowest number.

    groups : of elements, by name, of each of which such largest are kept
    """

    def __init__(self, groups: Mapping[str, range]) -> None:
        self._groups = dict(groups)
        self._found = [[Largest(0.0, 0.0, -1)] for _ in self._groups]

    def look(self, time: Floats, tension: Floats, marked: Iterable[int] = ()) -> None:
        """Take tensions (k, n_elements) [N] at times (k,) [s], in order.

        marked : rows of the states to which a run may go back, in order
        """
        for found, group in zip(self._found, self._groups.values(), strict=True):
            own = tension[:, group.start : group.stop]
            largest, begin = own.max(axis=1, initial=0.0), 0
            for end in dict.fromkeys((*(row + 1 for row in marked), len(time))):
                state = begin + int(np.argmax(largest[begin:end]))
                if largest[state] > found[-1].tension:
                    element = group.start + int(np.argmax(own[state]))
                    found.append(Largest(float(largest[state]), float(time[state]), element))
                begin = end

    def take(self, largest: Iterable[Largest]) -> None:
        """Take the largest tension of each group, of steps that nobody else looks at."""
        for found, one in zip(self._found, largest, strict=True):
            if one.tension > found[-1].tension:
                found.append(one)

    def forget_after(self, time: float) -> None:
        """Drop what was seen after `time` [s]."""
        for found in self._found:
            while len(found) > 1 and found[-1].time > time:
                found.pop()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that was found, for a snapshot: rows of group, tension, time, element."""
        rows = [(float(k), *one) for k, found in enumerate(self._found) for one in found]
        return {"peaks": np.array(rows)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `arrays` gave."""
        for k, found in enumerate(self._found):
            rows = arrays["peaks"][arrays["peaks"][:, 0] == k].tolist()
            found[:] = [Largest(tension, time, int(element)) for _, tension, time, element in rows]

    @property
    def largest(self) -> tuple[Largest, ...]:
        """Of each group."""
        return tuple(found[-1] for found in self._found)

    def provenance(self) -> dict[str, Any]:
        """The largest tension [N], when [s] and in which element (-1: no element ever pulled)."""
        return _told(max(self.largest, key=lambda one: (one.tension, -one.time)))

    def of_groups(self) -> dict[str, dict[str, Any]]:
        """The same of each group, by its name."""
        return {name: _told(one) for name, one in zip(self._groups, self.largest, strict=True)}


def _told(one: Largest) -> dict[str, Any]:
    return {"tension_N": one.tension, "time_s": one.time, "element": one.element}


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
