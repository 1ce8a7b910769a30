"""`exunet run`: folder, estimate, progress, reference beside, files and table."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exunet.base.errors import ExunetError, InputError, Interrupted, RunStopped, UncheckedRun
from exunet.base.interrupt import postponed
from exunet.case.casefile import Case
from exunet.case.scene import Scene
from exunet.interfaces.commands.estimates import (
    ExpectedSpread,
    estimated,
    not_counted,
    refuse_beyond,
    refuse_spread_beyond,
    words_of_time,
)
from exunet.interfaces.commands.folders import opened, ready
from exunet.interfaces.commands.lines import silent, tell
from exunet.interfaces.commands.measures import rows_on_measures
from exunet.interfaces.commands.naming import folder_of
from exunet.interfaces.commands.printing import print_table
from exunet.interfaces.commands.progress import told_progress, told_runs
from exunet.interfaces.commands.reference_progress import wait_for
from exunet.results.agreement import Agreement
from exunet.results.course import course_of
from exunet.results.ensemble_result import save_ensemble
from exunet.results.reading import RESULT_FILE, SPREAD_FILE, STORE_FOLDER
from exunet.results.result import Result
from exunet.results.run_folder import (
    DESCRIPTIONS,
    SUMMARY,
    has_result,
    has_unfinished,
    held,
    refuse_taken,
)
from exunet.results.segments import Segments
from exunet.results.spread import Spread
from exunet.results.summary import summarise, write_summary
from exunet.results.table import rows
from exunet.simulation.checkpoints import refuse_checkpoints
from exunet.simulation.driving import Progress
from exunet.simulation.preparation import prepare_case
from exunet.simulation.request import Request, request_of_store
from exunet.simulation.run import Describe, resume, run_into_held
from exunet.studies.error_estimate import ErrorEstimate, estimate_error
from exunet.studies.spread import BESIDE, spread_of
from exunet.verification.reference_run import ReferenceRun

Simulate = Callable[[Progress | None, Describe], Result]


@dataclass(frozen=True)
class RunOptions:
    """What the user asked of a run beside the case.

    out       : folder; None: results/CASE, or the next that is free
    overwrite : take the place of an earlier result, once the new one is complete
    check     : also run the reference and compare
    estimate  : also estimate the error, from two more runs
    checkpoint_every : [s] of simulated time, see `run_into`
    quiet     : nothing is printed but errors
    """

    out: Path | None = None
    overwrite: bool = False
    check: bool = False
    estimate: bool = False
    checkpoint_every: float | None = None
    quiet: bool = False
    spread: int | None = None


@dataclass
class _Story:
    """What comes of a run beside its result.

    title, table : of what is printed at the end; empty: there is nothing
    unchecked    : the error that the reference could not be asked
    failed       : the error that the error could not be estimated
    """

    title: str = ""
    table: list[tuple[str, str]] = field(default_factory=list)
    unchecked: ExunetError | None = None
    failed: ExunetError | None = None


def run_case(case: Case, asked: RunOptions) -> ExunetError | None:
    """Simulate, write result.h5, figures and summary.json, print the table.

    Returns the error of a run that stopped (its part is written, marked as incomplete), or of a check or an
    estimate that could not be made (the result is written), else None. Raises InputError, before the run
    starts, if the folder cannot be written or holds what would be lost, or if there is not enough memory or
    disk.
    """
    start = prepare_case(case)  # whose faults come before any folder is made
    if asked.estimate and case.scene.solver.accuracy_of == "measures":
        raise InputError('--estimate-error: is of the trajectory, not for solver.accuracy_of = "measures"')
    refuse_checkpoints(start, asked.checkpoint_every)
    wanted = asked.out or folder_of(case)
    say = silent if asked.quiet else tell
    with opened(wanted, own=asked.out is None and not asked.overwrite) as folder, held(folder):
        ready(folder, (RESULT_FILE, *DESCRIPTIONS))
        if not asked.overwrite:
            refuse_taken(folder)
        elif has_unfinished(folder):
            say(f"{folder}: the unfinished run there is put aside, into a folder beside that `resume` takes")
        if folder != wanted:
            say(_elsewhere(wanted, folder))
        with _beside(case, start.scene if asked.check else None) as reference:
            refused = reference.refusal() if reference else ""
            checks = asked.check and not refused
            cost = estimated(start, spread=asked.spread, check=checks, quiet=asked.quiet)
            refuse_beyond(cost, start, folder)
            for name, words in [*cost.rows(), *not_counted(error=asked.estimate)]:
                say(f"{name:8s}{words}", 8)
            if refused:
                say(f"check   {_unchecked(refused)}", 8)

            def simulate(progress: Progress | None, describe: Describe) -> Result:
                moved_starts = None if cost.spread.refused else cost.spread.runs
                request = Request(case, asked.checkpoint_every, moved_starts, asked.check, asked.estimate)
                return run_into_held(folder, request, start, progress, describe, overwrite=asked.overwrite)

            return _run(case, simulate, folder, asked, cost.spread, cost.run.known, reference)


def resume_run(folder: Path, *, quiet: bool = False, spread: int | None = None) -> ExunetError | None:
    """Go on with an unfinished run in a folder, and describe it as `run_case` does: with the check and the
    estimate of errors that the run was asked for.

    spread : number of moved starts; None: that of the run
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if not has_unfinished(folder):
        raise InputError(f"{folder}: there is no unfinished run in this folder")
    begun = request_of_store(Segments(folder / STORE_FOLDER))
    case, spread = begun.case, begun.moved_starts if spread is None else spread
    ready(folder, (RESULT_FILE, *DESCRIPTIONS))

    def simulate(progress: Progress | None, describe: Describe) -> Result:
        return resume(folder, progress, describe)

    start = prepare_case(case)
    cost = estimated(start, spread=spread, quiet=quiet)
    moved = cost.spread
    refuse_spread_beyond(moved)
    asked = RunOptions(check=begun.check, estimate=begun.estimate, quiet=quiet, spread=spread)
    say = silent if quiet else tell
    time = f"of the whole run, some of which is done, {words_of_time(cost.run)}"
    for name, words in [("time", time), *cost.room(), *cost.moved_starts()]:
        say(f"{name:8s}{words}", 8)
    with _beside(case, start.scene if asked.check else None) as reference:
        if reference:
            words = "with the reference, which begins anew: the run was asked for it"
            refused = reference.refusal()
            say(f"check   {_unchecked(refused) if refused else words}", 8)
        if asked.estimate:
            say("error   from two more runs after this one: the run was asked for it", 8)
        return _run(case, simulate, folder, asked, moved, reference=reference)


def _run(
    case: Case,
    simulate: Simulate,
    folder: Path,
    asked: RunOptions,
    moved: ExpectedSpread,
    expected: float | None = None,
    reference: ReferenceRun | None = None,
) -> ExunetError | None:
    """reference : at work, for a check"""
    story, stopped = _Story(), None
    with told_progress(case.scene.time.end, expected, quiet=asked.quiet) as progress:

        def describe(result: Result, place: Path) -> None:
            progress.end()
            _describe(case, result, place, story, reference, asked, moved)
            if place != folder and (cut := _cut_short(story)):
                raise cut

        try:
            simulate(progress, describe)
        except RunStopped as error:
            if error.result is None:
                raise
            stopped = error
    if story.table and not asked.quiet:
        where = [] if stopped else [("written to", f"{folder}/")]
        print_table(story.title, [*story.table, *where])
    return stopped or story.failed or story.unchecked


def _beside(case: Case, scene: Scene | None) -> AbstractContextManager[ReferenceRun | None]:
    """The reference at work, None without a scene, which has its choice of effects made."""
    return nullcontext() if scene is None else ReferenceRun(case, scene)


def _describe(
    case: Case,
    result: Result,
    folder: Path,
    story: _Story,
    reference: ReferenceRun | None,
    asked: RunOptions,
    moved: ExpectedSpread,
) -> None:
    """Write summary and figures, and fill the story, with what moved starts and the reference say."""
    with postponed():  # Ctrl-C in what is called when an import cleans up would be lost
        from exunet.figures import save_figures
    agreement: Agreement | None = None
    no_check: str | None = None
    if reference and result.complete:
        agreement, story.unchecked, no_check = _agreement(reference, result, quiet=asked.quiet)
    elif reference:
        no_check = "the run stopped before its end"
    spread = _spread(case, result, story, moved, quiet=asked.quiet)
    summary: dict[str, Any] = summarise(result, agreement or no_check, spread)
    table = [] if asked.quiet else rows(summary, spread) + rows_on_measures(case.scene, spread)
    if asked.estimate and result.complete:
        error_estimate, failed = _estimate(case, result)
        story.failed = story.failed or failed
        if error_estimate is not None:
            summary["error_estimate"] = error_estimate.numbers()
            table += error_estimate.rows()
    write_summary(summary, folder / SUMMARY)
    shown = None
    if isinstance(spread, Spread):
        shown = spread.as_ensemble()
        save_ensemble(shown, folder / SPREAD_FILE, overwrite=True)
    spread = None  # whose courses are as long as the run, and of no use to figures
    save_figures(result, folder, agreement, shown, overwrite=True)
    story.title, story.table = summary["title"], table


def _cut_short(story: _Story) -> Interrupted | None:
    """The Ctrl-C while a result was described, so that it may not take the place of an earlier one."""
    return next((one for one in (story.failed, story.unchecked) if isinstance(one, Interrupted)), None)


def _spread(
    case: Case, result: Result, story: _Story, moved: ExpectedSpread, *, quiet: bool
) -> Spread | str | None:
    """The spread, or why there is none, which must not cost the result; None if none was asked for."""
    if not moved.runs:
        return moved.refused or None
    if not result.complete:
        return "none: the run stopped before its end"
    try:
        with told_runs("spread: ", moved.runs + BESIDE, quiet=quiet) as progress:
            found = spread_of(prepare_case(case), moved.runs, progress=progress)
            return replace(found, run=course_of(result))
    except KeyboardInterrupt:
        words = "interrupted during the runs of moved starts"
        story.failed = Interrupted(f"{words}; the result is written", result)
        return words
    except ExunetError as error:
        return f"not known: {error}"


def _estimate(case: Case, result: Result) -> tuple[ErrorEstimate | None, RunStopped | None]:
    """The error, or what stopped its runs; neither must cost the result that is already computed."""
    try:
        return estimate_error(case.scene, result), None
    except RunStopped as error:
        return None, type(error)(f"the error could not be estimated: {error}")


def _agreement(
    reference: ReferenceRun, result: Result, *, quiet: bool
) -> tuple[Agreement | None, ExunetError | None, str | None]:
    """What the reference says; or the error that it could not be asked, and the reason for the summary."""
    try:
        wait_for(reference, float(result.time[-1]), quiet=quiet)
        return reference.agreement(result), None, None
    except InputError as error:
        return None, UncheckedRun(f"the result is written but not checked: {error}"), str(error)
    except KeyboardInterrupt:
        words = "interrupted while waiting for the reference"
        return None, Interrupted(f"{words}; the result is written", result), words


def _unchecked(refused: str) -> str:
    return f"the result will not be checked: {refused}"


def _elsewhere(wanted: Path, folder: Path) -> str:
    """Why a run does not go to the first folder of its name."""
    if has_unfinished(wanted):
        return f"{wanted} has an unfinished run (exunet resume {wanted}); this run goes to {folder}"
    there = "has a result" if has_result(wanted) else "is there already"
    return f"{wanted} {there}; this run goes to {folder} (--overwrite replaces it)"
