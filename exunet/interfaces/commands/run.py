"""`exunet run`: folder, progress, reference beside, files and table."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile

from exunet.base.errors import ExunetError, InputError, Interrupted, RunStopped, UncheckedRun
from exunet.base.files import cannot_write, sweep
from exunet.case.casefile import Case, parse_case
from exunet.figures import save_figures
from exunet.interfaces.commands.earlier import FILES, giving_back, set_aside
from exunet.interfaces.commands.printing import print_table
from exunet.interfaces.commands.waiting import waiting
from exunet.results.agreement import Agreement
from exunet.results.reading import STORE_FOLDER
from exunet.results.result import Result
from exunet.results.segments import Segments, is_store
from exunet.results.summary import rows, summarise, write_summary
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import Progress, resume, run_into
from exunet.studies.error_estimate import ErrorEstimate, estimate_error
from exunet.verification.reference_run import ReferenceRun


def run_case(
    case: Case,
    folder: Path,
    *,
    check: bool,
    estimate: bool = False,
    checkpoint_every: float | None = None,
) -> ExunetError | None:
    """Simulate, write result.h5, figures and summary.json into `folder`, print the table.

    check    : also run the reference and compare
    estimate : also estimate the error, from two more runs
    checkpoint_every : [s] of simulated time, see `run_into`

    Returns the error of a run that stopped (its part is written, marked as incomplete), or of a check or an
    estimate that could not be made (the result is written), else None. Raises InputError, before the run
    starts, if the folder cannot be written.
    """
    start = prepare_case(case)  # whose faults come before any folder is made
    with _made(folder):
        _ready(folder)

        def simulate(progress: Progress | None) -> Result:
            return run_into(folder, case, start, progress, checkpoint_every, partial(set_aside, folder))

        return _run(case, simulate, folder, check=check, estimate=estimate)


def resume_run(folder: Path) -> ExunetError | None:
    """Go on with an unfinished run in a folder, and describe it as `run_case` does."""
    if not is_store(folder / STORE_FOLDER):
        raise InputError(f"{folder}: there is no unfinished run in this folder")
    story = Segments(folder / STORE_FOLDER).provenance
    case = parse_case(story["text"], Path(story["case"]), story["overrides"])
    _ready(folder)
    return _run(case, lambda progress: resume(folder, progress), folder, check=False, estimate=False)


def _run(
    case: Case,
    simulate: Callable[[Progress | None], Result],
    folder: Path,
    *,
    check: bool,
    estimate: bool,
) -> ExunetError | None:
    stopped: ExunetError | None = None
    unchecked: ExunetError | None = None
    agreement = error_estimate = None
    no_check: str | None = None
    with ReferenceRun(case) if check else nullcontext() as reference:
        try:
            with _progress(case.scene.time.end) as progress, giving_back(folder):
                result = simulate(progress)
        except RunStopped as error:
            if error.result is None:
                raise
            stopped, result = error, error.result
        if reference and stopped is None:
            agreement, unchecked, no_check = _agreement(reference, result)
        elif reference:
            no_check = "the run stopped before its end"
    if estimate and stopped is None:
        error_estimate, stopped = _estimate(case, result)
    _describe(result, folder, agreement or no_check, error_estimate)
    return stopped or unchecked


def _estimate(case: Case, result: Result) -> tuple[ErrorEstimate | None, RunStopped | None]:
    """The error, or what stopped its runs; neither must cost the result that is already computed."""
    try:
        return estimate_error(case.scene, result), None
    except RunStopped as error:
        return None, type(error)(f"the error could not be estimated: {error}")


def _agreement(
    reference: ReferenceRun, result: Result
) -> tuple[Agreement | None, ExunetError | None, str | None]:
    """What the reference says; or the error that it could not be asked, and the reason for the summary."""
    try:
        with waiting("waiting for the reference"):
            return reference.agreement(result), None, None
    except InputError as error:
        return None, UncheckedRun(f"the result is written but not checked: {error}"), str(error)
    except KeyboardInterrupt:
        words = "interrupted while waiting for the reference"
        return None, Interrupted(f"{words}; the result is written", result), words


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Takes away again the folders that were made for a run, if it ended with nothing in them."""
    new = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        yield
    finally:
        for one in new:
            with suppress(OSError):  # not empty: a part of the run is kept
                one.rmdir()


def _ready(folder: Path) -> None:
    """Make the folder and prove that it can be written; what an earlier run left there stays as it is."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise cannot_write(folder, error) from error
    for name in FILES:
        if (folder / name).exists() and not (folder / name).is_file():
            raise InputError(f"{folder / name}: cannot be written: it is not an ordinary file")


def _describe(
    result: Result, folder: Path, check: Agreement | str | None, error_estimate: ErrorEstimate | None
) -> None:
    summary = summarise(result, check)
    table = rows(summary)
    if error_estimate is not None:
        summary["error_estimate"] = error_estimate.numbers()
        table += error_estimate.rows()
    write_summary(summary, folder / "summary.json")
    save_figures(result, folder, check if isinstance(check, Agreement) else None)
    print_table(summary["title"], [*table, ("written to", f"{folder}/")])


@contextmanager
def _progress(end: float) -> Iterator[Progress | None]:
    """A bar in simulated time on stderr; nothing when that is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("simulated"),
        BarColumn(),
        TextColumn("{task.completed:.3f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=end)
        yield lambda time: bar.update(task, completed=time)
