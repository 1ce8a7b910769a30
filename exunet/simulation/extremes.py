"""Records beside the stored states: extremes over all accepted steps, discrete states at stored times."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces.terms import Series
from exunet.integrators.protocol import Largest
from exunet.model.system import System

Floats = NDArray[np.float64]


class Peaks:
    """Largest tensions of groups of elements over all steps, in increasing order of time and tension.

    A run that goes back to a state forgets maxima after it. So a maximum is kept for each interval between
    states to which the run may go back, if it exceeds all before: at its first time, of the lowest element.

    groups : elements of each group, by name
    """

    def __init__(self, groups: Mapping[str, range]) -> None:
        self._groups = dict(groups)
        self._maxima = [[Largest(0.0, 0.0, -1)] for _ in self._groups]

    def look(self, time: Floats, tension: Floats, marked: Iterable[int] = ()) -> None:
        """Update by tensions (k, n_elements) [N] at times (k,) [s], in order.

        marked : rows of the states to which a run may go back, in order
        """
        for maxima, group in zip(self._maxima, self._groups.values(), strict=True):
            own = tension[:, group.start : group.stop]
            largest, begin = own.max(axis=1, initial=0.0), 0
            for end in dict.fromkeys((*(row + 1 for row in marked), len(time))):
                state = begin + int(np.argmax(largest[begin:end]))
                if largest[state] > maxima[-1].tension:
                    element = group.start + int(np.argmax(own[state]))
                    maxima.append(Largest(float(largest[state]), float(time[state]), element))
                begin = end

    def take(self, largest: Iterable[Largest]) -> None:
        """Update by the largest tension of each group in steps without stored states."""
        for maxima, new in zip(self._maxima, largest, strict=True):
            if new.tension > maxima[-1].tension:
                maxima.append(new)

    def forget_after(self, time: float) -> None:
        """Drop maxima after a time [s]."""
        for maxima in self._maxima:
            while len(maxima) > 1 and maxima[-1].time > time:
                maxima.pop()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the maxima for a snapshot: rows of group, tension, time, element."""
        rows = [(float(k), *peak) for k, maxima in enumerate(self._maxima) for peak in maxima]
        return {"peaks": np.array(rows)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        for k, maxima in enumerate(self._maxima):
            rows = arrays["peaks"][arrays["peaks"][:, 0] == k].tolist()
            maxima[:] = [Largest(tension, time, int(element)) for _, tension, time, element in rows]

    @property
    def largest(self) -> tuple[Largest, ...]:
        """Largest tension of each group."""
        return tuple(maxima[-1] for maxima in self._maxima)

    def provenance(self) -> dict[str, Any]:
        """Return the largest tension [N] with its time [s] and element (-1 if no element was taut)."""
        return _as_json(max(self.largest, key=lambda peak: (peak.tension, -peak.time)))

    def of_groups(self) -> dict[str, dict[str, Any]]:
        """Return the largest tension of each group, by name."""
        return {name: _as_json(peak) for name, peak in zip(self._groups, self.largest, strict=True)}


def _as_json(peak: Largest) -> dict[str, Any]:
    return {"tension_N": peak.tension, "time_s": peak.time, "element": peak.element}


class ElementPeaks:
    """Largest tension of each element over all accepted steps.

    A maximum does not contain earlier values. So maxima of intervals between stored times are kept apart
    until the run cannot go back before them: it continues from the last safe state, or ends at the last
    stored one.

    times : (n,) stored times of the run [s]; a step belongs to the interval that ends with a stored time
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
        """Update by tensions (k, n_elements) [N] of steps that end at times (k,) [s], in order."""
        interval = np.searchsorted(self._times, time)
        first = np.flatnonzero(np.append(True, np.diff(interval) > 0))
        for k, peaks in zip(interval[first].tolist(), np.maximum.reduceat(tension, first), strict=True):
            self._take(k, peaks)

    def take(self, until: float, peaks: Floats) -> None:
        """Update by the largest tensions (n_elements,) [N] of the interval that ends at `until` [s]."""
        self._take(int(self._times.searchsorted(until)), peaks)

    def _take(self, interval: int, peaks: Floats) -> None:
        interval = min(interval, len(self._times) - 1)  # round-off may put a step behind the end
        known = self._later.get(interval)
        if known is None:
            self._later[interval] = peaks.copy()
        else:
            np.maximum(known, peaks, out=known)

    def settle(self, safe: float, stored: float) -> None:
        """Set the stored times [s] to which the run may go back (safe), or at which it may end (stored)."""
        if safe >= self._stored_until:
            np.maximum(self._safe, self._stored, out=self._safe)
            self._stored[:] = 0.0
        for interval in [k for k in self._later if self._times[k] <= stored]:
            into = self._safe if self._times[interval] <= safe else self._stored
            np.maximum(into, self._later.pop(interval), out=into)
        self._stored_until = stored

    def forget_after(self, time: float) -> None:
        """Drop maxima after a time [s] that was given to `settle`."""
        if time < self._stored_until:
            self._stored[:], self._stored_until = 0.0, time
        self._later = {k: peaks for k, peaks in self._later.items() if self._times[k] <= time}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the maxima for a snapshot."""
        return {
            "safe": self._safe.copy(),
            "stored": self._stored.copy(),
            "stored_until": np.array([self._stored_until]),
            "intervals": np.array(sorted(self._later), dtype=np.int64),
            "later": np.array([self._later[k] for k in sorted(self._later)]).reshape(
                len(self._later), len(self._safe)
            ),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore from `arrays`."""
        self._safe[:], self._stored[:] = arrays["safe"], arrays["stored"]
        self._stored_until = float(arrays["stored_until"][0])
        intervals = np.clip(arrays["intervals"], 0, len(self._times) - 1).tolist()
        self._later = {k: peaks.copy() for k, peaks in zip(intervals, arrays["later"], strict=True)}

    @property
    def largest(self) -> Floats:
        """(n_elements,) largest tensions [N]."""
        return np.max([self._safe, self._stored, *self._later.values()], axis=0)


class Envelope:
    """Largest elastic and smallest kinetic energy between stored times, over all accepted steps.

    A snap may be shorter than the time between two stored states, which then do not show it.

    times : (n,) stored times of the run [s]; a step belongs to the interval that ends with a stored time
    """

    def __init__(self, times: Floats) -> None:
        self._times, self._next = times, 0
        self._elastic = np.zeros(len(times))
        self._kinetic = np.full(len(times), np.inf)

    def look(self, time: Floats, elastic: Floats, kinetic: Floats) -> None:
        """Update by energies (k,) [J] of steps that end at times (k,) [s]."""
        # Round-off may put a step behind the end.
        interval = np.minimum(np.searchsorted(self._times, time), len(self._times) - 1)
        np.maximum.at(self._elastic, interval, elastic)
        np.minimum.at(self._kinetic, interval, kinetic)

    def take(self, until: float, elastic: float, kinetic: float) -> None:
        """Update by the extremes [J] of the interval that ends with a stored time [s]."""
        k = self._next
        if k >= len(self._times) or self._times[k] != until:
            k = min(bisect_left(self._times, until), len(self._times) - 1)
        self._next = k + 1
        self._elastic[k] = max(self._elastic[k], elastic)
        self._kinetic[k] = min(self._kinetic[k], kinetic)

    def forget_after(self, time: float) -> None:
        """Drop extremes after the stored time [s] to which a run goes back."""
        late = self._times > time
        self._elastic[late], self._kinetic[late] = 0.0, np.inf

    def arrays(self, until: float) -> dict[str, Floats]:
        """Return the extremes of the intervals until a time [s], for a snapshot."""
        number = int(np.searchsorted(self._times, until, side="right")) + 1
        return {"elastic": self._elastic[:number].copy(), "kinetic": self._kinetic[:number].copy()}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Restore from `arrays`."""
        self._elastic[:], self._kinetic[:] = 0.0, np.inf
        self._elastic[: len(arrays["elastic"])] = arrays["elastic"]
        self._kinetic[: len(arrays["kinetic"])] = arrays["kinetic"]

    def around(self, first: int, elastic: Floats, kinetic: Floats) -> tuple[Floats, Floats]:
        """Return the largest elastic and smallest kinetic energy of intervals, ends included, (k,) each [J].

        first            : number of the first interval
        elastic, kinetic : (k + 1,) energies [J] of the stored states, from the one before that interval on
        """
        ours = slice(first, first + len(elastic) - 1)
        largest = np.maximum(self._elastic[ours], np.maximum(elastic[1:], elastic[:-1]))
        least = np.minimum(self._kinetic[ours], np.minimum(kinetic[1:], kinetic[:-1]))
        return largest, least


def series_of(system: System) -> tuple[tuple[str, Series], ...]:
    """Return the recorded entries of discrete states of a system, each with the name of its state."""
    memories = (term.memory for term in system.forces.memories)
    return tuple(
        (memory.name, series) for memory in memories if memory is not None for series in memory.series
    )


class DiscreteSeries:
    """Values of discrete states at the ends of intervals, which are stored at the stored times.

    memory : discrete states at the start
    """

    def __init__(self, system: System, time: float, memory: Mapping[str, Floats]) -> None:
        self._series = series_of(system)
        self._at: dict[float, Floats] = {}
        self.take(time, memory)

    def take(self, time: float, memory: Mapping[str, Floats]) -> None:
        """Record the discrete states at a time [s]."""
        if self._series:
            self._at[time] = np.concatenate(
                [memory[name][np.arange(one.place, one.place + one.size)] for name, one in self._series]
            )

    def arrays(self) -> dict[str, Floats]:
        """Return the recorded values for a snapshot; empty without series."""
        if not self._series:
            return {}
        return {"time": np.array(list(self._at)), "values": np.array(list(self._at.values()))}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Restore from `arrays`."""
        if self._series:
            self._at = dict(zip(arrays["time"].tolist(), arrays["values"], strict=True))

    def at(self, time: Floats) -> Floats:
        """Return (k, n) values at times (k,) [s], in order; forget earlier ones."""
        if not self._series:
            return np.zeros((len(time), 0))
        rows = np.array([self._at[instant] for instant in time.tolist()])
        self._at = {instant: values for instant, values in self._at.items() if instant >= time[-1]}
        return rows
