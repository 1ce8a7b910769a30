"""`exunet verify`: run the verification suite or the hard cases, print and write the report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from exunet.cli.output import print_line, status
from exunet.plots.style import drawing
from exunet.verification import hard
from exunet.verification.ladder import RUNGS, Ladder, later_steps, read_cases
from exunet.verification.one_step import Step
from exunet.verification.processes import Followed, cores, followed, one_by_one
from exunet.verification.report import Report

FAILED = 1
INTERRUPTED = 130

COMPARED = (
    "Exudyn is compared with `reference_impl`, a NumPy code that shares the case files with it and no line "
    "of code, and both with known answers."
)


def verify(paths: Sequence[Path], folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Run the verification suite over the cases, print and write verification.md.

    Parameters
    ----------
    paths : sequence of Path
        Case files; none: the shipped ones.
    processes : int or None
        Processes that run at the same time; None: one for each core.

    Returns
    -------
    int
        Exit code: 0 if all checks hold, 1 if one fails, 130 if interrupted (the report has what was done).

    Raises
    ------
    InputError
        Before any check, if the reference does not cover a case, a shipped case is missing, or the folder
        cannot be written.
    """
    cases = read_cases(paths)
    ladder = Ladder(cases, quick=quick, paper=not paths)
    over = f"{'Quick' if quick else 'Full'} ladder over {', '.join(case.name for case in cases)}."
    report = Report("Verification of exunet", "verification.md", RUNGS, (over, COMPARED))
    return _follow(report, _climbed(ladder, paths, quick, processes or cores()), folder)


def verify_hard(folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Run the hard cases, print and write hard.md; exit codes and errors as in `verify`."""
    forms = "In the compiled loop only." if quick else "On both backends, and in the reference."
    report = Report("Hard cases of exunet", "hard.md", hard.ITEMS, (forms,), tolerances="HARD")
    return _follow(report, followed(partial(_hard_steps, quick), processes or cores()), folder)


def _climbed(ladder: Ladder, paths: Sequence[Path], quick: bool, processes: int) -> Iterator[Followed]:
    yield from one_by_one(ladder.nets())
    yield from followed(partial(later_steps, paths, quick, frozenset(ladder.different)), processes)


def _hard_steps(quick: bool) -> list[Step]:
    return list(hard.steps(quick=quick))


def _follow(report: Report, steps: Iterable[Followed], folder: Path) -> int:
    """Print the findings of the steps as they come, write the report, return the exit code."""
    report.open(folder)
    try:
        with drawing(), status() as show:
            for step, findings in steps:
                show(f"{step.rung}. {step.subject}")
                for finding in findings:
                    for line in report.add(finding, folder):
                        print_line(line)
    except KeyboardInterrupt:
        report.interrupted = True
    print_line(f"{report.verdict} Report: {report.write(folder)}")
    if report.interrupted:
        return INTERRUPTED
    return 0 if report.holds else FAILED
