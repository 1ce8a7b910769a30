"""The largest tensions of a run, over the steps that the guards look at and not only at the stored times."""

from __future__ import annotations

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
