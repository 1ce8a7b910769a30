"""Books of a run without guards: the energy that leaves it, and what breaks."""

from __future__ import annotations

from dataclasses import dataclass

from exunet.backends.protocol import Arrays, Batch, Extremes
from exunet.forces.terms import Change
from exunet.system.states import States
from exunet.system.system import State, System


@dataclass(frozen=True)
class Break:
    """An element that broke, and when [s]."""

    element: int
    time: float


class RunBooks:
    """An observer (see `exunet.backends.protocol.Observer`).

    booked     : False if only what breaks is told
    dissipated : energy [J] that has left the system until the last state that was handed over, and what
                 guided bodies and reels have given to it
    breaks     : what has broken, in order of time
    """

    asks_for_elements = False

    def __init__(self, system: System, state: State, *, booked: bool) -> None:
        self._system, self._memory, self._booked = system, dict(state.memory), booked
        begun = system.lost_at_start + float(system.given_work(state.first_order))
        self.dissipated = self._begun = begun
        self.breaks: list[Break] = []

    def take(self, batch: Batch) -> None:
        if batch.taken is not None:
            self.dissipated = self._begun + float(batch.taken[-1])
        elif self._booked:
            states = States(self._system, *batch[:4], self._memory, batch.first_order)
            self.dissipated += float(states.work_taken().sum())

    def between(self, until: float, extremes: Extremes) -> None: ...

    def ends(self, time: float) -> None: ...

    def remembered(self, time: float, memory: Arrays) -> None: ...

    def changed(self, time: float, memory: str, change: Change) -> None:
        self.dissipated += change.energy_lost or 0.0
        self._memory = {**self._memory, **change.others, memory: change.memory}
        self.breaks += [Break(one["element"], time) for one in change.events if "element" in one]
