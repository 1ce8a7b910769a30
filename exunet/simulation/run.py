"""One run, in memory or into a folder, with checkpoints, and one that goes on from what was stored there."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from exunet.base.arguments import takes
from exunet.base.errors import InputError, Interrupted, RunStopped, UnsoundStates
from exunet.base.files import path_of
from exunet.base.interrupt import postponed
from exunet.base.run_events import ScriptEvent
from exunet.base.times import next_multiple, reached
from exunet.methods.method import METHODS
from exunet.results.io import ENSEMBLE_FILE, RESULT_FILE, head_of, load_result, write_rows
from exunet.results.result import Result
from exunet.results.run_folder import (
    has_result,
    held,
    put_unfinished_aside,
    put_waiting_aside,
    refuse_taken,
    remove_descriptions,
    remove_waiting,
    take_place,
    waiting_place,
)
from exunet.results.run_record import CaseText, RunRecord
from exunet.results.store import STORE_FILE, FileStore
from exunet.scene.casefile import Case, case_of, files_of, parse_case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare_case, start_of
from exunet.simulation.recorder import (
    Recorder,
    columns_of,
    constants_of_bodies,
    stored_bytes,
    validate_memory,
)
from exunet.simulation.simulation import Simulation, cannot_restart
from exunet.simulation.snapshot import Snapshot

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
        return asdict(case_text(self.case)) | own

    @classmethod
    def of_json(cls, stored: dict[str, Any]) -> Request:
        """Return the request of what `as_json` returned; raises CaseError if its files have changed since."""
        own = dict(stored)
        path = Path(own.pop("folder")) / own.pop("name")
        return cls(parse_case(own.pop("text"), path, own.pop("overrides")), **own)


def case_text(case: Case) -> CaseText:
    """Return what a result records of the case."""
    files = case.scene.initial.restart or files_of(case.scene)
    folder = str(case.path.parent.resolve()) if files else ""  # to resume with them
    return CaseText(case.path.name, case.text, case.overrides, folder)


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
    if not METHODS[start.plan.method].restarts_exactly(start.plan.backend):
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
        self._due = 0.0 if every is None else next_multiple(simulation.time, every)
        self._wall = clock.monotonic() + WALL_TIME
        self._of_script = self._requested_by_script

    @property
    def _requested_by_script(self) -> int:
        """Number of checkpoints that the script of the case has requested."""
        events = self._simulation.log.events
        return sum(isinstance(event, ScriptEvent) and event.event == "checkpoint" for event in events)

    def __call__(self) -> None:
        """Make a checkpoint if one is due; with a method that cannot restart, store the rows."""
        began = clock.monotonic()
        if (requested := self._requested_by_script) > self._of_script:
            self._of_script = requested
        elif self._every is not None:
            if not reached(self._simulation.time, self._due):
                return
            self._due = next_multiple(self._simulation.time, self._every)
        elif began < self._wall:
            return
        if self._simulation.can_restart:
            self.store.keep_checkpoint(self._simulation.snapshot().as_bytes())  # which flushes the rows
        else:
            self._recorder.flush()
        ended = clock.monotonic()
        self._wall = ended + max(WALL_TIME, (ended - began) / WALL_PART)


Describe = Callable[[Result, Path], None]
# Simulated time [s], right-hand sides so far, the last entry of the script that has happened ("": none).
Progress = Callable[[float, int, str], None]

_SHOWN = 0.1  # [s] of wall time between two calls of `progress`


@takes(progress=Callable)
def run(case: str | Path | Case | Scene | Start, progress: Progress | None = None) -> Result:
    """Simulate a case and return its result.

    case     : a case file's name, or what `exunet.load` or `prepare` gave, or a scene
    progress : called now and then with the simulated time [s], the number of right-hand sides, and the name
               of the last entry of the script that has happened, "" for none
    Raises RunStopped (its `result` holds what was computed) if the run diverges or the integrator gives up
    and `solver.retry` finer attempts do not mend it, Interrupted (also with `result`) on Ctrl-C; CaseError or
    InputError for what is no valid case.
    """
    if isinstance(case, Start):
        return simulate(start_of(case), progress=progress)
    made = case_of(case, "run")
    return simulate(prepare_case(made), case_text(made), progress)


def simulate(start: Start, case: CaseText | None = None, progress: Progress | None = None) -> Result:
    """Run from a prepared start, which a script may have changed (see `simulation.preparation.prepare`)."""
    validate_memory("time.output_step: the stored states", stored_bytes(start))
    recorder = Recorder(start, case)
    simulation = Simulation(start, recorder=recorder)
    try:
        drive(simulation, recorder, progress)
    except RunStopped as stop:
        _complete(simulation, recorder)
        stop.result = recorder.result(str(stop))
        raise
    _complete(simulation, recorder)
    return recorder.result("ok")


def drive(
    simulation: Simulation,
    recorder: Recorder,
    progress: Progress | None = None,
    checkpoint: Callable[[], None] | None = None,
) -> None:
    """Take a simulation through the times of its recorder that are still to come.

    checkpoint : called after each stored time
    Ctrl-C acts between steps, so that it does not interrupt the storing of a state.
    """
    shown = 0.0

    def tell() -> None:
        nonlocal shown
        if progress is not None:
            progress(simulation.time, simulation.counts.right_hand_sides, simulation.log.phase)
        shown = clock.monotonic()

    def stopped() -> None:
        if checkpoint is not None:
            checkpoint()
        if progress is not None and clock.monotonic() - shown > _SHOWN:
            tell()

    try:
        with postponed():
            tell()
            times = recorder.times[recorder.times > simulation.time].tolist()
            simulation.run.go(times, stopped, settle=True)
    except KeyboardInterrupt:  # after the last step, or out of `progress`
        raise simulation.run.interrupted() from None


def _complete(simulation: Simulation, recorder: Recorder) -> None:
    """Complete the record: what the run cost."""
    recorder.flush()
    recorder.integrated(simulation.counts, simulation.run.seconds)
    recorder.record = replace(recorder.record, observed=simulation.run.observers.report())


def run_into(
    folder: str | Path,
    case: str | Path | Case | Scene,
    progress: Progress | None = None,
    checkpoint_every: float | None = None,
    describe: Describe | None = None,
    *,
    overwrite: bool = False,
) -> Result:
    """Run a case and leave `result.h5` in a folder, which exists; memory is bounded, whatever is stored.

    While it runs, its states and its last checkpoint are in "unfinished.sqlite" in it, from which `resume`
    goes on if the process dies.

    Parameters
    ----------
    checkpoint_every : [s] of simulated time between two checkpoints, which are made at stored times; None:
        one every 30 s of wall time, where the method can restart exactly
    describe : writes summary and figures: called with the result and the folder for them
    overwrite : the new result, once it is complete, takes the place of one in the folder, which stays bit for
        bit until then; an unfinished run there is put into a new folder beside

    Raises
    ------
    RunStopped, Interrupted : as `run`; what was computed is written, into a new folder beside if the folder
        keeps an earlier result.
    InputError : files cannot be written, another run has the folder, or without `overwrite` there is a
        result or an unfinished run in it.
    """
    made = case_of(case, "run_into")
    start, folder = prepare_case(made), Path(folder)
    refuse_checkpoints(start, checkpoint_every)
    with held(folder):
        request = Request(made, checkpoint_every)
        return run_into_held(folder, request, start, progress, describe, overwrite=overwrite)


def run_into_held(
    folder: Path,
    request: Request,
    start: Start,
    progress: Progress | None = None,
    describe: Describe | None = None,
    *,
    overwrite: bool = False,
) -> Result:
    """As `run_into`, of a folder that the caller holds (see `exunet.results.run_folder.held`)."""
    if not overwrite:
        refuse_taken(folder)
    put_unfinished_aside(folder)
    record = RunRecord(case=case_text(request.case))
    head = head_of(start.net, constants_of_bodies(start.system), record)
    store = FileStore.create(folder / STORE_FILE, columns_of(start.system), head, request.as_json())
    try:
        recorder = Recorder(start, record.case, store)
        simulation = Simulation(start, recorder=recorder)
        files = Checkpoints(simulation, recorder, store, request.checkpoint_every)
    except BaseException:
        store.discard()
        raise
    return _into(folder, simulation, recorder, files, progress, describe)


@takes(progress=Callable, describe=Callable)
def resume(folder: str | Path, progress: Progress | None = None, describe: Describe | None = None) -> Result:
    """Go on with the run in a folder that `run_into` did not finish, from its last checkpoint.

    The result is the same to the last bit as that of a run that was not cut short, its wall times apart. It
    takes the place of an earlier one in the folder, as the run was to do; progress, describe: see `run_into`.
    `exunet resume` adds the perturbed runs, the check and the estimate of errors of the command.
    Raises InputError if there is no unfinished run in it, or if its file is damaged or of another version.
    """
    folder = path_of(folder, "resume")
    if not (folder / STORE_FILE).is_file():
        raise InputError(f"{folder}: there are no stored states of an unfinished run")
    with held(folder):
        store = FileStore(folder / STORE_FILE)
        try:
            request = Request.of_json(store.request)
            start = prepare_case(request.case)
            if store.columns != columns_of(start.system):
                raise InputError(f"{folder}: damaged: the stored states are not those of its case")
            content = store.back_to_checkpoint()
            recorder = Recorder(start, case_text(request.case), store)
            simulation = Simulation(start, recorder=recorder)
            if content is not None:
                simulation.restore(Snapshot.of_bytes(content))
            files = Checkpoints(simulation, recorder, store, request.checkpoint_every)
        except BaseException:
            store.close()
            raise
        return _into(folder, simulation, recorder, files, progress, describe)


def _into(
    folder: Path,
    simulation: Simulation,
    recorder: Recorder,
    files: Checkpoints,
    progress: Progress | None,
    describe: Describe | None,
) -> Result:
    """Take a run to its end, write its result and describe it."""
    failure = None
    with _stored(files.store, folder):
        try:
            drive(simulation, recorder, progress, files)
        except RunStopped as stop:
            failure = stop
        _complete(simulation, recorder)
        record = recorder.finish("ok" if failure is None else str(failure))
        net, bodies = simulation.start.net, constants_of_bodies(simulation.start.system)
        place = waiting_place(folder) if has_result(folder) else folder
        with postponed():  # an exception for Ctrl-C inside a destructor of h5py would be lost
            write_rows(files.store, place / RESULT_FILE, net, bodies, record)
            result = load_result(place / RESULT_FILE)
    error: BaseException | None = failure
    try:
        if place == folder:
            remove_descriptions(place)
        if describe is not None:
            describe(result, place)
    except BaseException as cause:  # noqa: BLE001 - it must not cost the result, and is raised below
        error = cause
    if place != folder:
        del result  # which closes its file, before that is moved
        place = take_place(folder) if error is None else put_waiting_aside(folder)
        result = load_result(place / RESULT_FILE)
    elif (beside := place / ENSEMBLE_FILE).is_file():
        result = replace(result, ensemble_file=beside)
    files.store.discard()
    if error is not None:
        raise _located(error, result, folder, place)
    return result


@contextmanager
def _stored(store: FileStore, folder: Path) -> Iterator[None]:
    """Keep the stored states if no result can be made of them, and say how to go on."""
    try:
        yield
    except UnsoundStates:  # nor would they be sound after a resume
        remove_waiting(folder)
        store.discard()
        raise
    except BaseException as error:
        remove_waiting(folder)
        whence = "from its start"
        with suppress(InputError):
            whence = whence if store.checkpoint is None else "from the last checkpoint"
        store.close()
        remedy = f"to go on {whence}: exunet resume {quote(str(folder))}"
        if isinstance(error, InputError):
            raise InputError(f"{error}; {remedy}") from error
        if isinstance(error, KeyboardInterrupt):
            raise Interrupted(f"interrupted; {remedy}") from None
        raise


def _located(error: BaseException, result: Result, folder: Path, place: Path) -> BaseException:
    """The error for a run that stopped, or could not be described, with the folder of what was computed."""
    where = f"what was computed is in {place}" + (f"; {folder} is as it was" if place != folder else "")
    if isinstance(error, RunStopped):
        return type(error)(f"{error}; {where}", result, error.step_cause)
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(f"interrupted; {where}", result)
    return InputError(f"{error}; {where}") if isinstance(error, InputError) else error
