"""`exunet run` and `exunet resume`: prepare, check the room, simulate, describe, print the table."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import typer

from exunet.base.errors import ExunetError, FigureError, InputError, Interrupted, RunStopped, UncheckedRun
from exunet.base.interrupt import postponed
from exunet.cli.output import (
    ProgressBar,
    first_clause,
    folder_of,
    opened,
    ready,
    report,
    silent,
    terminal_width,
)
from exunet.kernels.compile import numba_installed
from exunet.model.limits import LARGE_FACTOR, describe_limit, drive_factor
from exunet.results.comparison import Agreement
from exunet.results.ensemble import Ensemble, save_ensemble
from exunet.results.io import ENSEMBLE_FILE, RESULT_FILE, load_result
from exunet.results.measures import energy_divisor
from exunet.results.observables import Observables
from exunet.results.result import Result
from exunet.results.run_folder import (
    DESCRIPTIONS,
    REPORT,
    SUMMARY,
    has_result,
    has_unfinished,
    held,
    refuse_taken,
    unfinished,
)
from exunet.results.summary import summarise, summary_of, write_summary
from exunet.results.table import GAP, text
from exunet.results.table import report as report_of
from exunet.scene.casefile import Case, implausible
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.recorder import validate_disk, validate_memory
from exunet.simulation.run import (
    Describe,
    Progress,
    Request,
    refuse_checkpoints,
    request_of,
    resume,
    run_into_held,
)
from exunet.studies.divisions import (
    Refinement,
    estimate_error,
    halve_step,
    has_step_for_metrics,
    is_checked,
    refine,
    runs_of_half_step,
)
from exunet.studies.divisions import summary_of as refined
from exunet.studies.ensemble import FEW_RUNS, NO_NUMBA, default_runs, member_bytes, perturbed_runs
from exunet.verification.reference_run import ReferenceRun

Simulate = Callable[[Progress | None, Describe], Result]


@dataclass(frozen=True)
class RunOptions:
    """Options of a run beside its case.

    Attributes
    ----------
    out : Path or None
        Folder; None: results/CASE, or the next that is free.
    overwrite : bool
        Replace an earlier result once the new one is complete.
    check, estimate : bool
        Also run the reference and compare; also estimate the error from two more runs.
    checkpoint_every : float or None
        Simulated time between two checkpoints [s]; None: by wall time.
    quiet : bool
        Print errors only.
    runs : int or None
        Number of perturbed runs; None: the case's own, see `default_runs`.
    divisions : bool or None
        Repeat perturbed runs with finer divisions; None: where 32 perturbed runs follow.
    """

    out: Path | None = None
    overwrite: bool = False
    check: bool = False
    estimate: bool = False
    checkpoint_every: float | None = None
    quiet: bool = False
    runs: int | None = None
    divisions: bool | None = None


@dataclass
class _Description:
    """Summary of a result, and the errors of what follows the run, the most important first."""

    summary: dict[str, Any] = field(default_factory=dict)
    errors: list[ExunetError] = field(default_factory=list)


def run_case(case: Case, options: RunOptions) -> ExunetError | None:
    """Simulate a case, write result.h5, figures and summary.json, print the table.

    Returns
    -------
    ExunetError or None
        The error of a run that stopped (its part is written, marked as incomplete), or of a check or an
        estimate that failed (the result is written).

    Raises
    ------
    InputError
        Before the run, if the folder cannot be written or has a result, or if disk or memory is too small.
    """
    wanted, say = options.out or folder_of(case), silent if options.quiet else report
    start = prepare_case(case)  # its errors come before a folder is made
    for fault in implausible(case):
        say(f"warning: {fault}")
    if drive_factor(start.system) > LARGE_FACTOR:
        say(f"step: {describe_limit(start.system, start.plan.method)}")
    refuse_checkpoints(start, options.checkpoint_every)
    request = Request(
        case, options.checkpoint_every, options.runs, options.check, options.estimate, options.divisions
    )
    with opened(wanted, own=options.out is None and not options.overwrite) as folder, held(folder):
        if not options.overwrite:
            refuse_taken(folder)
        elif has_unfinished(folder):
            say(f"{folder}: the unfinished run is moved into a folder beside, for `exunet resume`")
        if folder != wanted:
            say(_elsewhere(wanted, folder))

        def simulate(update: Progress | None, describe: Describe) -> Result:
            return run_into_held(folder, request, start, update, describe, overwrite=options.overwrite)

        return _run(request, start, simulate, folder, quiet=options.quiet)


def resume_run(folder: Path, *, quiet: bool = False, runs: int | None = None) -> ExunetError | None:
    """Continue the unfinished run in a folder, and describe it as `run_case` does, with the options it had.

    runs : number of perturbed runs; None: that of the run
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if not has_unfinished(folder):
        raise InputError(f"{folder}: there is no unfinished run in this folder")
    request = request_of(folder)
    if runs is not None:
        request = replace(request, perturbed_runs=runs)

    def simulate(update: Progress | None, describe: Describe) -> Result:
        return resume(folder, update, describe)

    return _run(request, prepare_case(request.case), simulate, folder, quiet=quiet)


def _run(
    request: Request, start: Start, simulate: Simulate, folder: Path, *, quiet: bool
) -> ExunetError | None:
    """Check the room, simulate, describe, print the table."""
    ready(folder, (RESULT_FILE, *DESCRIPTIONS))
    runs = default_runs(start) if request.perturbed_runs is None else request.perturbed_runs
    validate_disk(start, folder)
    if runs:
        validate_memory(f"--ensemble: {runs} perturbed runs", runs * member_bytes(start))
    stopped, description = None, _Description()
    checking = ReferenceRun(request.case, start.scene) if request.check else nullcontext()
    with checking as reference, ProgressBar(quiet=quiet) as bar:
        if reference and (refused := reference.refusal()):
            (silent if quiet else report)(f"the result will not be checked: {refused}")
        update = bar.begin("simulated", start.scene.time.end, "s")

        def describe(result: Result, place: Path) -> None:
            _describe(request, start, runs, result, place, reference, bar, description)
            interrupted = next(
                (error for error in description.errors if isinstance(error, Interrupted)), None
            )
            if place != folder and interrupted:  # the earlier result stays
                raise interrupted

        try:
            simulate(lambda time, _, phase: update(time, phase), describe)
        except RunStopped as error:
            if error.result is None:
                raise
            stopped = error
    if description.summary and not quiet:
        print_summary(description.summary, folder if stopped is None else None)
        if stopped is not None:  # the table has all of its message
            verdict = description.summary["verdict"]
            stopped.args = (str(stopped).replace(verdict, first_clause(verdict), 1),)
    return stopped or next(iter(description.errors), None)


def _describe(
    request: Request,
    start: Start,
    runs: int,
    result: Result,
    folder: Path,
    reference: ReferenceRun | None,
    bar: ProgressBar,
    description: _Description,
) -> None:
    """Write summary, report, figures; fill the description, also with perturbed runs and the reference."""
    with postponed():  # Ctrl-C in what is called when an import cleans up would be lost
        from exunet.plots.registry import save_run_figures
        from exunet.plots.view import write_page
    check, unchecked = _check(reference, result, bar) if reference else (None, None)
    run = Observables(result)
    ensemble, interrupted = _perturbed_runs(request.case, runs, run, bar)
    summary: dict[str, Any] = summary_of(run, check, ensemble)
    summary["implausible"] = [str(fault) for fault in implausible(request.case)]
    if isinstance(ensemble, Ensemble) and interrupted is None:
        summary["step"], interrupted = _half_step(start, ensemble, run, bar)
        if interrupted is None:
            summary["divisions"], interrupted = _divisions(request, start, ensemble, run, bar)
    failed = None
    if request.estimate and result.complete:
        try:
            summary["error_estimate"] = asdict(estimate_error(request.case.scene, result))
        except RunStopped as error:
            failed = type(error)(f"the error could not be estimated: {error}")
    write_summary(summary, folder / SUMMARY)
    shown = ensemble if isinstance(ensemble, Ensemble) else None
    if shown is not None:
        save_ensemble(shown, folder / ENSEMBLE_FILE, overwrite=True)
    write_page(folder / REPORT, [run], report_of(summary, request.case.text))
    not_drawn = None
    try:
        save_run_figures(run, folder, check if isinstance(check, Agreement) else None, shown)
    except FigureError as error:
        not_drawn = error
    description.summary = summary
    description.errors = [error for error in (interrupted, failed, unchecked, not_drawn) if error is not None]


def _check(
    reference: ReferenceRun, result: Result, bar: ProgressBar
) -> tuple[Agreement | str, ExunetError | None]:
    """Return the agreement with the reference, or why it is unknown, and the error for the user."""
    if not result.complete:
        return "the run stopped before its end", None
    update = bar.begin("reference", float(result.time[-1]), "s")
    try:
        while reference.at_work:
            update(reference.simulated)
            clock.sleep(0.1)
        return reference.agreement(result), None
    except InputError as error:
        return str(error), UncheckedRun(f"the result is written but not checked: {error}")
    except KeyboardInterrupt:
        reason = "interrupted while waiting for the reference"
        return reason, Interrupted(f"{reason}; the result is written", result)


def _perturbed_runs(
    case: Case, runs: int, run: Observables, bar: ProgressBar
) -> tuple[Ensemble | str | None, Interrupted | None]:
    """Return the perturbed runs (None: not requested; or why they failed), and the error of Ctrl-C."""
    if not runs:
        return None, None
    if not numba_installed():
        return f"none: {NO_NUMBA}", None
    if not run.result.complete:
        return "none: the run stopped before its end", None
    update = bar.begin("perturbed runs", runs)
    try:
        return perturbed_runs(prepare_case(case), runs, progress=update), None
    except KeyboardInterrupt:
        reason = "interrupted during the perturbed runs"
        return reason, Interrupted(f"{reason}; the result is written", run.result)
    except ExunetError as error:  # it does not cost the result
        return f"none: {error}", None


def _divisions(
    request: Request, start: Start, ensemble: Ensemble, run: Observables, bar: ProgressBar
) -> tuple[dict[str, Any] | None, Interrupted | None]:
    """Return what the next division of threads changes, for the summary, and the error of Ctrl-C."""
    if not start.net.n_net_elements or not is_checked(start, requested=request.divisions):
        return None, None
    update = bar.begin("finer divisions", FEW_RUNS)
    return _moved(lambda: refine(request.case, ensemble, progress=update), "with finer divisions", run)


def _half_step(
    start: Start, ensemble: Ensemble, run: Observables, bar: ProgressBar
) -> tuple[dict[str, Any] | None, Interrupted | None]:
    """Return what half of a step for metrics changes, for the summary, and the error of Ctrl-C."""
    if not has_step_for_metrics(start):
        return None, None
    update = bar.begin("half of the step", runs_of_half_step(start, ensemble))
    scale = energy_divisor(run.result)
    return _moved(lambda: halve_step(start, ensemble, scale, progress=update), "with half of the step", run)


def _moved(
    compare: Callable[[], Mapping[str, Refinement]], what: str, run: Observables
) -> tuple[dict[str, Any], Interrupted | None]:
    """Return what finer runs change, or why that is not known, and the error of Ctrl-C."""
    try:
        return refined(compare()), None
    except KeyboardInterrupt:
        reason = f"interrupted during the runs {what}"
        return {"refused": reason}, Interrupted(f"{reason}; the result is written", run.result)
    except ExunetError as error:  # it does not cost the result
        return {"refused": str(error)}, None


def show(path: Path, *, every: bool) -> None:
    """Print the summary of a result again."""
    folder = path.parent if path.name == RESULT_FILE else path
    try:
        stored = (folder / SUMMARY).is_file()
        print_summary(summary_at(path), folder if stored else None, every=every)
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{folder / SUMMARY}: was written by another version") from error


def summary_at(path: Path) -> dict[str, Any]:
    """Read the summary in the folder of a result, or compute that of a file that Python wrote.

    Raises
    ------
    InputError
        If there is no result, only an unfinished run, or the summary is damaged.
    """
    file = (path.parent if path.name == RESULT_FILE else path) / SUMMARY
    if words := unfinished(path):
        if path.is_dir() and not has_result(path):
            raise InputError(words)
        report(words)
    if not file.is_file():
        return summarise(load_result(path))
    try:
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
    return found


def print_summary(summary: Mapping[str, Any], folder: Path | None, *, every: bool = False) -> None:
    """Print the answer of a run, and where its files are."""
    typer.echo(text(summary, every=every, width=terminal_width()))
    if folder is not None:
        names = [name for name in (REPORT, RESULT_FILE, SUMMARY, ENSEMBLE_FILE) if (folder / name).exists()]
        figures = sum(1 for _ in folder.glob("*.png"))
        more = "" if every else f"{GAP}exunet show {folder} --all"
        typer.echo(f"written to {folder}/: {', '.join(names)}, figures: {figures} (exunet plot: all){more}")


def _elsewhere(wanted: Path, folder: Path) -> str:
    """Return why a run does not use the first folder of its name."""
    if has_unfinished(wanted):
        return f"{wanted} has an unfinished run (exunet resume {wanted}); this run goes to {folder}"
    state = "has a result" if has_result(wanted) else "is there already"
    return f"{wanted} {state}; this run goes to {folder} (--overwrite replaces it)"
