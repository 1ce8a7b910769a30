"""The largest tension of a run, over the steps that the guards look at and not only at the stored times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Peaks:
    """Keeps each new largest tension, so that a run which goes back in time can forget the later ones."""

    def __init__(self) -> None:
        self._found: list[tuple[float, float, int]] = [(0.0, 0.0, -1)]  # time [s], tension [N], element

    def look(self, time: Floats, tension: Floats) -> None:
        """Take tensions (k, n_elements) [N] at times (k,) [s], in order."""
        largest = tension.max(axis=1, initial=0.0)
        state = int(np.argmax(largest))
        if largest[state] > self._found[-1][1]:
            self._found.append((float(time[state]), float(largest[state]), int(np.argmax(tension[state]))))

    def take(self, time: float, tension: float, element: int) -> None:
        """Take the largest tension [N] of steps that nobody else looks at."""
        if tension > self._found[-1][1]:
            self._found.append((time, tension, element))

    def forget_after(self, time: float) -> None:
        """Drop what was seen after `time` [s]."""
        while len(self._found) > 1 and self._found[-1][0] > time:
            self._found.pop()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that was found, for a snapshot."""
        return {"peaks": np.array(self._found)}

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `arrays` gave."""
        self._found = [(float(t), float(n), int(e)) for t, n, e in arrays["peaks"]]

    def provenance(self) -> dict[str, Any]:
        """The largest tension [N], when [s] and in which element (-1: no element ever pulled)."""
        time, tension, element = self._found[-1]
        return {"tension_N": tension, "time_s": time, "element": element}
