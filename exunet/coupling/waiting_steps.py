"""Steps of a coupling that count, on their way into the books."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.port import FrameState
from exunet.coupling.books import Books, work_on_host
from exunet.coupling.net_system import PortLoad

Floats = NDArray[np.float64]

# Steps that wait for the books: one after the other they take a third of the time that they take one by one,
# between all else that a step does.
_WAITING = 256


class Ended(NamedTuple):
    """A step that counts.

    applied : (n,) forces and torques of all ports, one port after the other, that the host's method applied
    recoils : the jump of a throw is in it
    before, after : where the markers were at both ends
    """

    loads: Mapping[str, PortLoad]
    applied: Floats
    recoils: bool
    before: Mapping[str, FrameState]
    after: Mapping[str, FrameState]


class WaitingSteps:
    """Those that are not in the books yet, of the ports of a net."""

    def __init__(self, ports: Sequence[str]) -> None:
        self._ports = tuple(ports)
        self._ended: list[Ended] = []

    def add(self, step: Ended, books: Books) -> None:
        """Let a step wait, or write all that wait into the books."""
        self._ended.append(step)
        if len(self._ended) >= _WAITING:
            self.write(books)

    def write(self, books: Books) -> None:
        """Take the steps that wait into the books."""
        for loads, applied, recoils, before, after in self._ended:
            duration = next(load.end - load.begin for load in loads.values())
            works = {
                name: work_on_host(six[:3], six[3:], duration, before[name], after[name])
                for name, six in zip(self._ports, applied.reshape(-1, 6), strict=True)
            }
            books.add(loads, works, recoils=recoils)
        self.forget()

    def forget(self) -> None:
        """Drop those that wait."""
        self._ended.clear()
