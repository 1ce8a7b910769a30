"""What is stored of memories that compiled code keeps: their values at the stored times."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from exunet.forces.terms import Series
from exunet.system.system import System

Floats = NDArray[np.float64]


def series_of(system: System) -> tuple[tuple[str, Series], ...]:
    """The series of a system's forces, each with the name of its memory."""
    memories = (term.memory for term in system.forces.memories)
    return tuple((one.name, series) for one in memories if one is not None for series in one.series)


class KeptSeries:
    """Takes memories at the ends of stretches, and gives their series at the times that are stored.

    memory : at the start
    """

    def __init__(self, system: System, time: float, memory: Mapping[str, Floats]) -> None:
        self._series = series_of(system)
        self._at: dict[float, Floats] = {}
        self.take(time, memory)

    def take(self, time: float, memory: Mapping[str, Floats]) -> None:
        """Memories at a time [s]."""
        if self._series:
            self._at[time] = np.array([memory[name][one.place] for name, one in self._series])

    def arrays(self) -> dict[str, Floats]:
        """What was taken and may still be asked for, for a snapshot; nothing without series."""
        if not self._series:
            return {}
        return {"time": np.array(list(self._at)), "values": np.array(list(self._at.values()))}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Go back to what `arrays` gave."""
        if self._series:
            self._at = dict(zip(arrays["time"].tolist(), arrays["values"], strict=True))

    def at(self, time: Floats) -> Floats:
        """(k, n_series) at times (k,) [s], in their order; what was before these is forgotten."""
        if not self._series:
            return np.zeros((len(time), 0))
        found = np.array([self._at[one] for one in time.tolist()])
        self._at = {one: values for one, values in self._at.items() if one >= time[-1]}
        return found
