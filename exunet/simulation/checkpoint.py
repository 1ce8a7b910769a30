"""What a later process needs to go on with a run: the request that it started from, and checkpoints."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exunet.base.errors import InputError
from exunet.methods.method import METHODS, Backend
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import Recorder
from exunet.simulation.simulation import Simulation, cannot_restart

WALL_TIME = 30.0  # [s] between two checkpoints where no simulated time is given
WALL_PART = 0.02  # of a run's wall time that those may take


@dataclass(frozen=True)
class Request:
    """A case and what was requested with it.

    checkpoint_every : [s] of simulated time; None: by wall time
    perturbed_runs   : number of perturbed runs after it; None: the default
    check            : compare with the reference
    estimate         : estimate the error
    divisions        : repeat the perturbed runs with finer divisions; None: where these take seconds
    """

    case: Case
    checkpoint_every: float | None = None
    perturbed_runs: int | None = None
    check: bool = False
    estimate: bool = False
    divisions: bool | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON-like values."""
        own = {name: value for name, value in vars(self).items() if name != "case"}
        return provenance(self.case) | own

    @classmethod
    def of_json(cls, stored: dict[str, Any]) -> Request:
        """Return the request of what `as_json` returned; raises CaseError if its files have changed since."""
        own = dict(stored)
        path = Path(own.pop("folder", "")) / own.pop("case")
        return cls(parse_case(own.pop("text"), path, own.pop("overrides")), **own)


def provenance(case: Case) -> dict[str, Any]:
    """Return what a result records of the case."""
    found = {"case": case.path.name, "text": case.text, "overrides": list(case.overrides)}
    files = case.scene.initial.restart or any(keys.file for keys in case.scene.bodies.values())
    return found | ({"folder": str(case.path.parent.resolve())} if files else {})  # to resume with them


def request_of(folder: Path) -> Request:
    """Return the request of the unfinished run in a folder; raises InputError without such a run."""
    return Request.of_json(FileStore(folder / STORE_FILE, read_only=True).request)


def refuse_checkpoints(start: Start, every: float | None) -> None:
    """Raise InputError for a wrong time between checkpoints, or a method that cannot restart."""
    if every is None:
        return
    if not (np.isfinite(every) and every > 0.0):
        words = "the simulated time between two checkpoints must be positive and finite"
        raise InputError(
            f"--checkpoint-every: {words}, got {every:g} s; without it they are made by wall time"
        )
    if not METHODS[start.plan.method].restarts_exactly(Backend(start.scene.engine.backend)):
        raise InputError(f"--checkpoint-every: {cannot_restart(start.plan.method)}")


class Checkpoints:
    """Makes checkpoints after stored times; they never change a step.

    every : [s] of simulated time between two; None: by wall time
    """

    def __init__(
        self, simulation: Simulation, recorder: Recorder, store: FileStore, every: float | None
    ) -> None:
        self._simulation, self._recorder, self.store = simulation, recorder, store
        self._every = every
        self._due = 0.0 if every is None else (np.floor(simulation.time / every) + 1.0) * every
        self._wall = clock.monotonic() + WALL_TIME
        self._of_script = self._requested_by_script

    @property
    def _requested_by_script(self) -> int:
        """Number of checkpoints that the script of the case has requested."""
        return sum(event.get("event") == "checkpoint" for event in self._simulation.monitor.events)

    def __call__(self) -> None:
        """Make a checkpoint if one is due; with a method that cannot restart, store the rows."""
        began = clock.monotonic()
        if (requested := self._requested_by_script) > self._of_script:
            self._of_script = requested
        elif self._every is not None:
            if self._simulation.time < self._due:
                return
            self._due = (np.floor(self._simulation.time / self._every) + 1.0) * self._every
        elif began < self._wall:
            return
        if self._simulation.can_restart:
            self.store.keep_checkpoint(self._simulation.snapshot().as_bytes())  # which flushes the rows
        else:
            self._recorder.flush()
        ended = clock.monotonic()
        self._wall = ended + max(WALL_TIME, (ended - began) / WALL_PART)
