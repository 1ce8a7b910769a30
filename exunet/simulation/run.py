"""One run, in memory or into files that survive its end, and one that goes on from such files."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shlex import quote
from typing import Any

from exunet.base.arguments import takes
from exunet.base.errors import InputError, Interrupted, RunStopped, UnsoundStates
from exunet.base.files import path_of
from exunet.base.interrupt import postponed
from exunet.case.casefile import Case, load
from exunet.case.scene import Scene
from exunet.results.reading import RESULT_FILE, STORE_FOLDER, load_result
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
from exunet.results.segments import SegmentStore
from exunet.results.writing import join
from exunet.simulation.checkpoints import Checkpoints, refuse_checkpoints
from exunet.simulation.driving import Progress, drive
from exunet.simulation.expected_time import stored_bytes, validate_memory
from exunet.simulation.preparation import Start, prepare_case, start_of
from exunet.simulation.recorder import Recorder, columns_of, constants_of_bodies
from exunet.simulation.request import Request, provenance, request_of_store
from exunet.simulation.simulation import Simulation
from exunet.simulation.snapshot import Snapshot

Describe = Callable[[Result, Path], None]


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
    if isinstance(case, Start | Scene):
        return simulate(start_of(case), {}, progress)
    case = case if isinstance(case, Case) else load(path_of(case, "run"))
    return simulate(prepare_case(case), provenance(case), progress)


def simulate(
    start: Start, provenance: dict[str, Any] | None = None, progress: Progress | None = None
) -> Result:
    """Run from a prepared start, which a script may have changed (see `simulation.preparation.prepare`)."""
    validate_memory("time.output_step: the stored states", stored_bytes(start))
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
    describe: Describe | None = None,
    *,
    overwrite: bool = False,
    moved_starts: int | None = None,
) -> Result:
    """Run a case and leave `result.h5` in a folder, which exists; memory is bounded, whatever is stored.

    While it runs, its states and checkpoints are in the folder "unfinished" in it, from which `resume` goes
    on if the process dies.

    checkpoint_every : [s] of simulated time between two checkpoints, which are made at stored times; None:
                       one every 30 s of wall time, where the method can restart exactly
    describe         : writes what stands beside the result: called with it and the folder for that
    overwrite        : the new result, once it is complete, takes the place of one in the folder, which stays
                       bit for bit until then; an unfinished run there is put into a new folder beside
    moved_starts     : how many of them `describe` runs; kept with the states for one who resumes the run
    Raises as `run` (the part of a run that stopped is written, into a new folder beside if the folder keeps
    an earlier result; the words say where), and InputError if files cannot be written, if another run has
    the folder, or if without `overwrite` there is a result or an unfinished run in it.
    """
    start, folder = prepare_case(case) if start is None else start, Path(folder)
    request = Request(case, checkpoint_every, moved_starts)
    refuse_checkpoints(start, checkpoint_every)
    with held(folder):
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
    import h5py  # noqa: F401 - so that a missing h5py shows before the run, not after it

    if not overwrite:
        refuse_taken(folder)
    put_unfinished_aside(folder)
    return _into(folder, *_begun(folder, request, start), progress, describe)


@takes(progress=Callable, describe=Callable)
def resume(folder: str | Path, progress: Progress | None = None, describe: Describe | None = None) -> Result:
    """Go on with the run in a folder that `run_into` did not finish, from its last checkpoint.

    The result is the same to the last bit as that of a run that was not cut short, its wall times apart. It
    takes the place of an earlier one in the folder, as the run was to do; progress, describe: see `run_into`.
    What follows a run of the command, its moved starts, check and estimate of errors, `exunet resume` makes.
    Raises InputError if there is no unfinished run in it, or if its files are damaged or of another version.
    """
    folder = path_of(folder, "resume")
    if not (folder / STORE_FOLDER).is_dir():
        raise InputError(f"{folder}: there are no stored states of an unfinished run")
    with held(folder):
        return _into(folder, *_continued(folder), progress, describe)


def _continued(folder: Path) -> tuple[Simulation, Recorder, Checkpoints]:
    store = SegmentStore(folder / STORE_FOLDER)
    try:
        request = request_of_store(store)
        case, every = request.case, request.checkpoint_every
        start = prepare_case(case)
        if store.columns != columns_of(start.system):
            raise InputError(f"{folder}: damaged: the stored states are not those of its case")
        if store.checkpoint is None:
            store.drop_after(0)
            recorder = Recorder(start, provenance(case), store)
            simulation = Simulation(start, recorder=recorder)
        else:
            if re.fullmatch(r"checkpoint-\d{6,}\.exu", store.checkpoint) is None:
                raise InputError(f"{folder}: damaged: {store.checkpoint!r} is not the name of a checkpoint")
            store.back_to_checkpoint()
            snapshot = Snapshot.load(store.folder / store.checkpoint)
            recorder = Recorder(start, provenance(case), store)
            simulation = Simulation(start, recorder=recorder)
            simulation.restore(snapshot)
        return simulation, recorder, Checkpoints(simulation, recorder, store, every)
    except BaseException:
        store.close()
        raise


def _begun(folder: Path, request: Request, start: Start) -> tuple[Simulation, Recorder, Checkpoints]:
    case = request.case
    story = provenance(case) | request.story()
    bodies = constants_of_bodies(start.system)
    store = SegmentStore.create(folder / STORE_FOLDER, columns_of(start.system), start.net, bodies, story)
    try:
        recorder = Recorder(start, provenance(case), store)
        simulation = Simulation(start, recorder=recorder)
        return simulation, recorder, Checkpoints(simulation, recorder, store, request.checkpoint_every)
    except BaseException:
        store.discard()
        raise


def _into(
    folder: Path,
    simulation: Simulation,
    recorder: Recorder,
    files: Checkpoints,
    progress: Progress | None,
    describe: Describe | None,
) -> Result:
    verdict, stopped = "ok", None
    with _kept(files.store, folder):
        try:
            drive(simulation, recorder, progress, files)
        except RunStopped as stop:
            verdict, stopped = str(stop), stop
        _close(simulation, recorder, stopped)
        verdict, story = recorder.finish(verdict, simulation.monitor)
        net, bodies = simulation.start.net, constants_of_bodies(simulation.start.system)
        remove_waiting(folder)
        place = waiting_place(folder) if has_result(folder) else folder
        with postponed():  # an exception for Ctrl-C inside a destructor of h5py would be lost
            join(files.store, place / RESULT_FILE, net, bodies, story, verdict, verdict == "ok")
    failure: BaseException | None = stopped
    try:
        _describe(place, describe, alone=place == folder)
    except BaseException as error:  # noqa: BLE001 - it must not cost the result, and is raised below
        failure = error
    if place != folder and failure is None:
        take_place(folder)
        place = folder
    elif place != folder:
        place = put_waiting_aside(folder)
    files.store.discard()  # the checkpoints too
    result = load_result(place / RESULT_FILE)
    if failure is not None:
        raise _told(failure, result, folder, place)
    return result


@contextmanager
def _kept(store: SegmentStore, folder: Path) -> Iterator[None]:
    """Keep what is stored if it cannot be made into a result, and say how to go on."""
    try:
        yield
    except UnsoundStates:  # nor would they be sound after a resume
        remove_waiting(folder)
        store.discard()
        raise
    except BaseException as error:
        with suppress(InputError):  # the disk is full still
            store.close()
        if isinstance(error, InputError):
            raise InputError(f"{error}; {_left(store, folder)}") from error
        if isinstance(error, KeyboardInterrupt):
            raise Interrupted(f"interrupted; {_left(store, folder)}") from None
        raise


def _left(store: SegmentStore, folder: Path) -> str:
    """What there is of a run that could not be made into a result, and how to go on, in words."""
    resume = f"exunet resume {quote(str(folder))}"
    if store.checkpoint is not None:
        return f"what was stored is kept; to go on from the last checkpoint: {resume}"
    if store.written:
        return f"what was stored is kept, but there is no checkpoint: {resume} begins again from the start"
    return f"no state is stored yet: {resume} begins again from the start"


def _describe(place: Path, describe: Describe | None, *, alone: bool) -> None:
    if alone:
        remove_descriptions(place)
    if describe is not None:
        with postponed():  # as above
            result = load_result(place / RESULT_FILE)
        describe(result, place)


def _told(failure: BaseException, result: Result, folder: Path, place: Path) -> BaseException:
    """The error for a run that stopped, or could not be described, with words on what is where."""
    where = f"what was computed is in {place}" + (f"; {folder} is as it was" if place != folder else "")
    if isinstance(failure, RunStopped):
        return type(failure)(f"{failure}; {where}", result, failure.step_cause)
    if isinstance(failure, KeyboardInterrupt):
        return Interrupted(f"interrupted; {where}", result)
    return InputError(f"{failure}; {where}") if isinstance(failure, InputError) else failure
