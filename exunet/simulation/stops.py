"""The times that a simulation was taken to since the last state that it may go back to.

A retry goes through them again, with what acted from outside then (`exunet.simulation.outside`): it ends
where the caller is, along the way that the caller took.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Stops:
    """Times [s], in order, each with the vector of what acts from outside until there."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._forces: list[Floats] = []

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, k: int) -> tuple[float, Floats]:
        return self._times[k], self._forces[k]

    def add(self, time: float, force: Floats) -> None:
        """One more, after the others; the array is kept as it is, once for stops with the same vector."""
        last = self._forces[-1] if self._forces else force
        self._times.append(time)
        self._forces.append(last if force is last or np.array_equal(force, last) else force)

    def after(self, time: float) -> int:
        """Number of the first stop after a time [s]."""
        return bisect_right(self._times, time)

    def forget_until(self, time: float) -> None:
        """Drop the stops until a time [s]."""
        first = self.after(time)
        del self._times[:first], self._forces[:first]

    def forget_after(self, time: float) -> None:
        """Drop the stops after a time [s]."""
        first = self.after(time)
        del self._times[first:], self._forces[first:]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All of them, for a snapshot; each vector that acted is in it once."""
        distinct = {id(force): force for force in self._forces}
        number = {key: k for k, key in enumerate(distinct)}
        return {
            "times": np.array(self._times, dtype=float),
            "force": np.array([number[id(force)] for force in self._forces], dtype=np.int64),
            "forces": np.array(list(distinct.values()), dtype=float),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `arrays` gave."""
        forces = [np.array(force) for force in arrays["forces"]]
        self._times = arrays["times"].tolist()
        self._forces = [forces[k] for k in arrays["force"].tolist()]
