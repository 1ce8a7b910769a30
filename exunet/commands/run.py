"""`exunet run`: folder, progress, reference beside, files and table."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path

from exunet.agreement import Agreement
from exunet.casefile import Case
from exunet.commands.table import print_table
from exunet.crosscheck import ReferenceRun
from exunet.error_estimate import ErrorEstimate, estimate_error
from exunet.errors import InputError, RunStopped
from exunet.files import cannot_write, replacing, sweep
from exunet.result import Result, save
from exunet.summary import rows, summarise, write_summary
from exunet.timeloop import Progress, run

FIGURES = ("reference_net", "snapshots", "bullet_speeds", "energies", "area", "agreement")


def run_case(case: Case, folder: Path, *, check: bool, estimate: bool = False) -> RunStopped | None:
    """Simulate, write result.h5, figures and summary.json into `folder`, print the table.

    check    : also run the reference and compare
    estimate : also estimate the error, from two more runs

    Returns the error of a run that stopped (its part is written, marked as incomplete), else None. Raises
    InputError, before the run starts, if the folder cannot be written.
    """
    _ready(folder)
    stopped: RunStopped | None = None
    with ReferenceRun(case) if check else nullcontext() as reference:
        try:
            with _progress(case.scene.time.end) as progress:
                result = run(case, progress, lambda part: _keep(part, folder))
        except RunStopped as error:
            if error.partial is None:
                raise
            stopped, result = error, error.partial
        agreement, refusal = _agreement(reference if stopped is None else None, result)
    error_estimate = None
    if estimate and stopped is None:
        error_estimate, stopped = _estimate(case, result)
    _write(result, folder, agreement, error_estimate)
    if refusal:
        raise refusal
    return stopped


def _estimate(case: Case, result: Result) -> tuple[ErrorEstimate | None, RunStopped | None]:
    """The error, or what stopped its runs; neither must cost the result that is already computed."""
    try:
        return estimate_error(case.scene, result), None
    except RunStopped as error:
        return None, type(error)(f"the error could not be estimated: {error}")


def _agreement(reference: ReferenceRun | None, result: Result) -> tuple[Agreement | None, InputError | None]:
    """What the reference says; its refusal must not cost the result that is already computed."""
    if reference is None:
        return None, None
    try:
        return reference.agreement(result), None
    except InputError as error:
        return None, error


def _ready(folder: Path) -> None:
    """Make the folder, prove that it can be written, and remove what an earlier run left there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        with replacing(folder / "summary.json"):
            pass
        for name in ("result.h5", "summary.json", *(f"{figure}.png" for figure in FIGURES)):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error


def _write(
    result: Result, folder: Path, agreement: Agreement | None, error: ErrorEstimate | None = None
) -> None:
    from exunet.plot import save_figures

    save(result, folder / "result.h5")
    summary = summarise(result, agreement)
    table = rows(summary)
    if error is not None:
        summary["error_estimate"] = asdict(error)
        table += error.rows()
    write_summary(summary, folder / "summary.json")
    save_figures(result, folder, agreement)
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
