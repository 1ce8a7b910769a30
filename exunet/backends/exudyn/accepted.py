"""The engine's coordinates at accepted steps that nobody has seen yet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.protocol import Arrays

Floats = NDArray[np.float64]

_ROWS = 256  # states that the observer gets in one go: enough to be fast, few enough to come soon
_NUMBERS = 2**19  # of one array; bounds memory


class Accepted:
    """Rows of coordinates, the first of which is the last of those that were taken before."""

    def __init__(self, now: Coordinates) -> None:
        rows = max(16, min(_ROWS, _NUMBERS // max(1, len(now.q))))
        self._time = np.empty(rows)
        self._held = Coordinates(*(np.empty((rows, len(part))) for part in now))
        self._q, self._v, self._y = self._held
        self._rows = 0

    def append(self, time: float, now: Coordinates) -> bool:
        """Add a row; True if there is no room for another."""
        row = self._rows
        self._time[row] = time
        self._q[row], self._v[row] = now.q, now.v
        if len(now.y):
            self._y[row] = now.y
        self._rows = row + 1
        return self._rows == len(self._time)

    @property
    def last_time(self) -> float:
        """[s]"""
        return float(self._time[self._rows - 1])

    @property
    def finite(self) -> bool:
        """True if the last row's velocities are."""
        return bool(np.isfinite(self._held.v[self._rows - 1]).all())

    def take(self) -> tuple[Floats, Coordinates] | None:
        """Times (k,) and copies of all rows; None if there is but one row.

        The last row stays as the first.
        """
        rows = self._rows
        if rows < 2:
            return None
        time, states = self._time, self._held
        all_rows = time[:rows].copy(), Coordinates(*(part[:rows].copy() for part in states))
        for held in (time, *states):
            held[0] = held[rows - 1]
        self._rows = 1
        return all_rows

    def begin_with(self, now: Coordinates) -> None:
        """An event has changed the state at the time of the only row."""
        for held, part in zip(self._held, now, strict=True):
            held[0] = part

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All rows, for a snapshot."""
        held = {"time": self._time, **self._held._asdict()}
        return {f"rows/{name}": part[: self._rows].copy() for name, part in held.items()}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave."""
        self._rows = len(arrays["rows/time"])
        for name, held in {"time": self._time, **self._held._asdict()}.items():
            held[: self._rows] = arrays[f"rows/{name}"]
