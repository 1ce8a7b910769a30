"""The engine's accepted steps, as the observer of a run gets them, and the memories that steps change."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.sight import THINNED
from exunet.backends.events import Events
from exunet.backends.exudyn.accepted import Accepted
from exunet.backends.exudyn.build import remember
from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.exudyn.model import Model
from exunet.backends.exudyn.seen_steps import SeenSteps
from exunet.backends.protocol import Arrays, Batch, Observer
from exunet.forces.terms import Change
from exunet.system.system import State, System

Floats = NDArray[np.float64]


class Observed:
    """Hands over every accepted state; or, where compiled code looks at each (`SeenSteps`), one in some.

    seen : compiled code looks at each
    """

    def __init__(self, system: System, events: Events, observer: Observer, *, seen: bool) -> None:
        self._system, self._events, self._observer, self._sees = system, events, observer, seen
        memories = (term.memory for term in system.forces.memories)
        self._keeps = any(memory is not None and memory.kept_in for memory in memories)
        self._lets_remember = any(call.remember is not None for call in system.forces.calls)
        self._every = THINNED  # steps of which one is handed over
        self._accepted: Accepted | None = None

    def open(self, model: Model, state: State) -> None:
        """The steps are those of a model that was built at a state."""
        self._model = model
        self._seen = SeenSteps(model, self._system, state, self._observer) if self._sees else None
        self.remember(state.memory)
        if self._accepted is None:
            self._accepted = Accepted(model.coordinates())
            self._append(state.time, model.coordinates())

    @property
    def accepted(self) -> Accepted:
        """The states that are to be handed over."""
        assert self._accepted is not None
        return self._accepted

    @property
    def _taken(self) -> float:
        return 0.0 if self._seen is None else float(self._seen.taken[0])

    def begin(self) -> None:
        """The steps that come are told of together."""
        if self._seen is not None:
            self._seen.sight.begin()

    def end(self, time: float) -> None:
        """Tell of the steps until a time [s]; raises what the observer raises."""
        if self._seen is not None:
            self._observer.between(time, self._seen.sight.extremes)
        self._events.tell(time, self._remembered(), self.hand_over)

    def look_from(self, time: float, now: Coordinates) -> None:
        """The step to come begins at a time [s], from these coordinates, with the memories as they are."""
        if self._seen is not None:
            self._every = 1 if self._events.in_each_step else THINNED
            self._seen.begin(time, now)

    def look_at_step(self, begin: float, end: float, now: Coordinates, number: int, *, last: bool) -> None:
        """Look at an accepted step between two times [s] that ends with these coordinates.

        number : of steps so far; last : no other comes before somebody asks for the state
        """
        if self._seen is None:
            if self._lets_remember:
                self._model.applied.accepted(end, now.q, now.v)
        elif not self._seen.step(begin, end, now) and number % self._every and not last:
            return
        self._append(end, now)
        if (last or self._seen is not None) and not self.accepted.finite:
            self.hand_over()

    def change(self, time: float, change: Change) -> None:
        """An event is about to change memories, or the state, at a time [s]."""
        if change.quiet:
            return
        now = self._model.coordinates()
        if self.accepted.last_time != time:
            self._append(time, now)
        self.hand_over()  # so that no batch has states from before and after
        if self._seen is not None:
            self._seen.taken += change.energy_lost or 0.0
            self.changed(now)

    def changed(self, now: Coordinates) -> None:
        """Events have made another state of the last one."""
        self.accepted.begin_with(now, self._taken)

    def _append(self, time: float, now: Coordinates) -> None:
        if self.accepted.append(time, now, self._taken):
            self.hand_over()

    def hand_over(self) -> None:
        """Let the observer see the states that it has not seen."""
        rows = self.accepted.take()
        if rows is not None:
            time, states, taken = rows
            self.recall()
            moving = self._model.places.unpack(states, time, self._events.memory)
            self._observer.take(Batch(time, *moving, None if self._seen is None else taken))

    def remember(self, memory: Arrays, x: Floats | None = None) -> None:
        """Let all forces take the memories as they are now.

        x : (n_x,) the state, if an event has changed it
        """
        remember(self._model, self._system, memory)
        if self._seen is not None:
            self._seen.remember(memory, x)

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
        if self._seen is not None:
            self._seen.push(force)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For a snapshot: what is not handed over, what was seen, all memories."""
        self.recall()
        memory = {f"memory/{name}": values.copy() for name, values in self._events.memory.items()}
        seen = {} if self._seen is None else self._seen.arrays()
        return {**self.accepted.arrays(), **memory, **seen}

    def restore(self, arrays: Arrays, time: float, now: Coordinates) -> None:
        """Go back to what `arrays` gave at a time [s], in a model that has the memories and coordinates."""
        self.accepted.restore(arrays)
        if self._seen is not None:
            self._seen.begin(time, now)
            self._seen.remember(self._events.memory)
            self._seen.restore(arrays)
