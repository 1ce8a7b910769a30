"""One run: a simulation taken through the stored times, in memory or into files that survive its end."""

from __future__ import annotations

import re
import time as clock
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError, RunStopped, UnsoundStates
from exunet.base.interrupt import postponed
from exunet.case.casefile import Case, parse_case
from exunet.case.scene import Scene
from exunet.methods.method import METHODS, TimeLoop
from exunet.results.reading import RESULT_FILE, STORE_FOLDER, load_result
from exunet.results.result import Result
from exunet.results.segments import SegmentStore
from exunet.results.writing import join
from exunet.simulation.arguments import finite_number
from exunet.simulation.preparation import Start, prepare, prepare_case
from exunet.simulation.recorder import Recorder, columns_of, mass_properties
from exunet.simulation.simulation import Simulation, cannot_restart
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]
Progress = Callable[[float], None]

WALL_TIME = 30.0  # [s] between two checkpoints that nobody asked for
WALL_PART = 0.02  # of a run's wall time that those may take
_SHOWN = 0.1  # [s] of wall time between two calls of `progress`


def run(case: Case | Scene, progress: Progress | None = None) -> Result:
    """Simulate a case (or a scene) and return its result.

    progress : called with the simulated time [s] now and then
    Raises RunStopped (its `result` holds what was computed) if the run diverges or the integrator gives up
    and `solver.retry` finer attempts do not mend it, Interrupted (also with `result`) on Ctrl-C.
    """
    if isinstance(case, Scene):
        return simulate(prepare(case), {}, progress)
    return simulate(prepare_case(case), provenance(case), progress)


def provenance(case: Case) -> dict[str, Any]:
    """What a result records of the case."""
    return {"case": case.path.name, "text": case.text, "overrides": list(case.overrides)}


def simulate(
    start: Start, provenance: dict[str, Any] | None = None, progress: Progress | None = None
) -> Result:
    """Run from a prepared start, which a script may have changed (see `simulation.preparation.prepare`)."""
    recorder = Recorder(start, provenance or {})
    simulation = Simulation(start, recorder=recorder)
    try:
        drive(simulation, recorder, progress)
    except RunStopped as stop:
        _close(simulation, recorder, stop)
        stop.result = recorder.result(str(stop), simulation.monitor)
        raise
    _close(simulation, recorder)
    return recorder.result("ok", simulation.monitor)


def drive(
    simulation: Simulation,
    recorder: Recorder,
    progress: Progress | None = None,
    checkpoint: Callable[[], None] | None = None,
) -> None:
    """Take a simulation through the times of its recorder that are still to come.

    checkpoint : called after each stored time
    Ctrl-C is taken up within the steps, so that it does not interrupt the storing of a state.
    """
    try:
        with postponed():
            _through(simulation, recorder.times, progress, checkpoint)
    except KeyboardInterrupt:  # after the last step, or out of `progress`
        raise simulation.interrupted() from None


def _through(
    simulation: Simulation, times: Floats, progress: Progress | None, checkpoint: Callable[[], None] | None
) -> None:
    shown = 0.0
    while True:
        ahead = int(np.searchsorted(times, simulation.time, side="right"))
        if ahead == len(times):
            if simulation.finish():
                return
            continue
        if not simulation.attempt(float(times[ahead])):
            continue
        if checkpoint is not None:
            checkpoint()
        if progress is not None and clock.monotonic() - shown > _SHOWN:
            progress(simulation.time)
            shown = clock.monotonic()


def _close(simulation: Simulation, recorder: Recorder, stop: RunStopped | None = None) -> None:
    """Complete the record: what the run cost and where it ends."""
    recorder.flush()
    recorder.integrated(*simulation.spent())
    if stop is not None:
        simulation.monitor.forget_after(recorder.until)


def run_into(
    folder: str | Path,
    case: Case,
    start: Start | None = None,
    progress: Progress | None = None,
    checkpoint_every: float | None = None,
    begun: Callable[[], None] | None = None,
) -> Result:
    """Run a case and leave `result.h5` in a folder, which exists; memory is bounded, whatever is stored.

    While it runs, its states and checkpoints are in the folder "unfinished" in it, from which `resume` goes
    on if the process dies.

    checkpoint_every : [s] of simulated time between two checkpoints, which are made at stored times; None:
                       one every 30 s of wall time, where the method can restart exactly
    begun            : called when the run can begin, before its first step
    Raises as `run` (the part of a run that stopped is in `result.h5`), and InputError if files cannot be
    written.
    """
    import h5py  # noqa: F401 - so that a missing h5py shows before the run, not after it

    start = prepare_case(case) if start is None else start
    _refuse_checkpoints(start, checkpoint_every)
    simulation, recorder, files = _begun(Path(folder), case, start, checkpoint_every)
    if begun is not None:
        begun()
    return _into(Path(folder), simulation, recorder, files, progress)


def resume(folder: str | Path, progress: Progress | None = None) -> Result:
    """Go on with the run in a folder that `run_into` did not finish, from its last checkpoint.

    The result is the same to the last bit as that of a run that was not cut short, its wall times apart.
    Raises InputError if there is no unfinished run in it, or if its files are damaged or of another version.
    """
    folder = Path(folder)
    store = SegmentStore(folder / STORE_FOLDER)
    try:
        case, every = _as_it_was(store)
        start = prepare_case(case)
        if store.columns != columns_of(start.system):
            raise InputError(f"{folder}: damaged: the stored states are not those of its case")
        if store.checkpoint is None:
            store.drop_after(0)
            recorder = Recorder(start, provenance(case), store)
            simulation = Simulation(start, recorder=recorder)
        else:
            if re.fullmatch(r"checkpoint-\d{6,}\.exu", store.checkpoint) is None:
                raise InputError(f"{folder}: damaged: {store.checkpoint!r} is no name of a checkpoint")
            store.back_to_checkpoint()
            snapshot = Snapshot.load(store.folder / store.checkpoint)
            recorder = Recorder(start, provenance(case), store)
            simulation = Simulation(start, recorder=recorder)
            simulation.restore(snapshot)
        files = _Checkpoints(simulation, recorder, store, every)
    except BaseException:
        store.close()
        raise
    return _into(folder, simulation, recorder, files, progress)


def _as_it_was(store: SegmentStore) -> tuple[Case, float | None]:
    """The case of a run that was killed, and the time between its checkpoints; InputError if damaged."""
    story = store.provenance
    text, name, overrides = (story.get(key) for key in ("text", "case", "overrides"))
    every = story.get("checkpoint_every")
    listed = isinstance(overrides, list) and all(isinstance(one, str) for one in overrides)
    timed = every is None or (finite_number(every) or 0.0) > 0.0
    if not (isinstance(text, str) and isinstance(name, str) and listed and timed):
        raise InputError(f"{store.folder}: damaged: it does not tell the case of its run")
    return parse_case(text, Path(name), overrides or ()), every


def _refuse_checkpoints(start: Start, every: float | None) -> None:
    """Raise InputError for a wrong time between checkpoints, or a method that cannot restart."""
    if every is None:
        return
    if not (np.isfinite(every) and every > 0.0):
        raise InputError(f"checkpoints: the time between them must be positive and finite, got {every:g} s")
    if not METHODS[start.plan.method].restarts_exactly(TimeLoop(start.scene.engine.loop)):
        raise InputError(f"checkpoints: {cannot_restart(start.plan.method)}")


def _begun(
    folder: Path, case: Case, start: Start, checkpoint_every: float | None
) -> tuple[Simulation, Recorder, _Checkpoints]:
    story = provenance(case) | {"checkpoint_every": checkpoint_every}
    bodies = mass_properties(start.system)
    store = SegmentStore.create(folder / STORE_FOLDER, columns_of(start.system), start.net, bodies, story)
    try:
        recorder = Recorder(start, provenance(case), store)
        simulation = Simulation(start, recorder=recorder)
        return simulation, recorder, _Checkpoints(simulation, recorder, store, checkpoint_every)
    except BaseException:
        store.discard()
        raise


def _into(
    folder: Path,
    simulation: Simulation,
    recorder: Recorder,
    files: _Checkpoints,
    progress: Progress | None,
) -> Result:
    verdict, stopped = "ok", None
    try:
        drive(simulation, recorder, progress, files)
    except RunStopped as stop:
        verdict, stopped = str(stop), stop
    except BaseException:
        files.store.close()
        raise
    _close(simulation, recorder, stopped)
    verdict, story = recorder.finish(verdict, simulation.monitor)
    bodies, path = mass_properties(simulation.start.system), folder / RESULT_FILE
    with postponed():  # an exception for Ctrl-C inside a destructor of h5py would be lost
        try:
            join(files.store, path, simulation.start.net, bodies, story, verdict, verdict == "ok")
        except UnsoundStates:  # nor would they be sound after a resume
            files.store.discard()
            raise
        except BaseException:
            files.store.close()
            raise
        files.store.discard()  # the checkpoints too
        result = load_result(path)
    if stopped is not None:
        stopped.result = result
        raise stopped
    return result


class _Checkpoints:
    """Makes a checkpoint now and then, after a stored time; it never changes a step."""

    def __init__(
        self, simulation: Simulation, recorder: Recorder, store: SegmentStore, every: float | None
    ) -> None:
        self._simulation, self._recorder, self.store = simulation, recorder, store
        self._every = every
        self._due = 0.0 if every is None else (np.floor(simulation.time / every) + 1.0) * every
        self._wall = clock.monotonic() + WALL_TIME
        self._able = simulation.can_restart
        self._number = 0 if store.checkpoint is None else int(store.checkpoint.split("-")[1].split(".")[0])

    def __call__(self) -> None:
        began = clock.monotonic()
        if self._every is not None:
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
