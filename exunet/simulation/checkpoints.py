"""Checkpoints of a run that is kept in files: when one is due, and what may be asked of them."""

from __future__ import annotations

import time as clock
from contextlib import suppress

import numpy as np

from exunet.base.errors import InputError
from exunet.methods.method import METHODS, TimeLoop
from exunet.results.segments import SegmentStore
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import Recorder
from exunet.simulation.simulation import Simulation, cannot_restart

WALL_TIME = 30.0  # [s] between two checkpoints that nobody asked for
WALL_PART = 0.02  # of a run's wall time that those may take


def refuse_checkpoints(start: Start, every: float | None) -> None:
    """Raise InputError for a wrong time between checkpoints, or a method that cannot restart."""
    if every is None:
        return
    if not (np.isfinite(every) and every > 0.0):
        words = "the simulated time between two checkpoints must be positive and finite"
        raise InputError(
            f"--checkpoint-every: {words}, got {every:g} s; without it they are made by wall time"
        )
    if not METHODS[start.plan.method].restarts_exactly(TimeLoop(start.scene.engine.loop)):
        raise InputError(f"--checkpoint-every: {cannot_restart(start.plan.method)}")


class Checkpoints:
    """Makes a checkpoint now and then, after a stored time; it never changes a step."""

    def __init__(
        self, simulation: Simulation, recorder: Recorder, store: SegmentStore, every: float | None
    ) -> None:
        self._simulation, self._recorder, self.store = simulation, recorder, store
        self._every = every
        self._due = 0.0 if every is None else (np.floor(simulation.time / every) + 1.0) * every
        self._wall = clock.monotonic() + WALL_TIME
        self._able = simulation.can_restart
        self._asked = self._asked_so_far
        self._number = 0 if store.checkpoint is None else int(store.checkpoint.split("-")[1].split(".")[0])

    @property
    def _asked_so_far(self) -> int:
        """How many the script of the case has asked for."""
        return sum(one.get("event") == "checkpoint" for one in self._simulation.monitor.events)

    def __call__(self) -> None:
        began = clock.monotonic()
        if (asked := self._asked_so_far) > self._asked:
            self._asked = asked
        elif self._every is not None:
            if self._simulation.time < self._due:
                return
            self._due = (np.floor(self._simulation.time / self._every) + 1.0) * self._every
        elif began < self._wall:
            return
        if self._able:
            self._number += 1
            name = f"checkpoint-{self._number:06d}.exu"
            self._simulation.snapshot().save(self.store.folder / name)
            self.store.flush(checkpoint=name)
            self._remove_others(name)
        else:
            self._recorder.flush()
            self.store.flush()
        ended = clock.monotonic()
        self._wall = ended + max(WALL_TIME, (ended - began) / WALL_PART)

    def _remove_others(self, name: str) -> None:
        for path in self.store.folder.glob("checkpoint-*.exu"):
            if path.name != name:
                with suppress(OSError):
                    path.unlink()
