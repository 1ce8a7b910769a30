"""The engine's accepted steps, as the observer of a run gets them, and the memories that steps change."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.events import Events
from exunet.backends.exudyn.accepted import Accepted
from exunet.backends.exudyn.build import remember
from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.exudyn.model import Model
from exunet.backends.protocol import Arrays, Batch, Observer
from exunet.forces.terms import Change
from exunet.system.system import State, System

Floats = NDArray[np.float64]


class Observed:
    """The accepted states of a run, passed to the observer in batches."""

    def __init__(self, system: System, events: Events, observer: Observer) -> None:
        self._system, self._events, self._observer = system, events, observer
        memories = (term.memory for term in system.forces.memories)
        self._keeps = any(memory is not None and memory.kept_in for memory in memories)
        self._lets_remember = any(call.remember is not None for call in system.forces.calls)
        self._accepted: Accepted | None = None

    def open(self, model: Model, state: State) -> None:
        """The steps are those of a model that was built at a state."""
        self._model = model
        self.remember(state.memory)
        if self._accepted is None:
            self._accepted = Accepted(model.coordinates())
            self._append(state.time, model.coordinates())

    @property
    def accepted(self) -> Accepted:
        """The states that are to be handed over."""
        assert self._accepted is not None
        return self._accepted

    def report_memories(self, time: float) -> None:
        """Report the memories at a time [s]; raises what the observer raises."""
        self._events.tell(time, self._remembered(), self.hand_over)

    def add(self, end: float, now: Coordinates, *, last: bool) -> None:
        """Take the accepted step that ends at a time [s] with these coordinates.

        last : no other comes before somebody asks for the state
        """
        if self._lets_remember:
            self._model.applied.accepted(end, now.q, now.v)
        self._append(end, now)
        if last and not self.accepted.finite:
            self.hand_over()

    def change(self, time: float, change: Change) -> None:
        """An event is about to change memories, or the state, at a time [s]."""
        if change.quiet:
            return
        if self.accepted.last_time != time:
            self._append(time, self._model.coordinates())
        self.hand_over()  # so that no batch has states from before and after

    def changed(self, now: Coordinates) -> None:
        """Events have made another state of the last one."""
        self.accepted.begin_with(now)

    def _append(self, time: float, now: Coordinates) -> None:
        if self.accepted.append(time, now):
            self.hand_over()

    def hand_over(self) -> None:
        """Let the observer see the states that it has not seen."""
        rows = self.accepted.take()
        if rows is not None:
            time, states = rows
            self.recall()
            moving = self._model.places.unpack(states, time, self._events.memory)
            self._observer.take(Batch(time, *moving))

    def remember(self, memory: Arrays) -> None:
        """Let all forces take the memories as they are now."""
        remember(self._model, self._system, memory)

    def recall(self) -> None:
        """Take over the memories that compiled code has changed itself."""
        for name, values in self._remembered():
            self._events.memory[name][:] = values

    def _remembered(self) -> Iterator[tuple[str, Floats]]:
        """These memories, with their names; not copies."""
        if self._keeps:
            yield from self._model.applied.remembered.items()

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._model.applied.push(force)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For a snapshot: what is not handed over, and all memories."""
        self.recall()
        memory = {f"memory/{name}": values.copy() for name, values in self._events.memory.items()}
        return {**self.accepted.arrays(), **memory}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave, in a model that has the memories."""
        self.accepted.restore(arrays)
