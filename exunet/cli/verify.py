"""`exunet verify`: run the verification suite or the hard cases, print a summary and write the report."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import exunet
from exunet.cli.output import print_line, status
from exunet.verification import hard
from exunet.verification.cross_code import STATES
from exunet.verification.report import Report, line_of
from exunet.verification.suite import SECTIONS, Item, run, suite

FAILED = 1
INTERRUPTED = 130
QUICK_STATES = 5  # of each kind

COMPARED = (
    "exunet is compared with reference_impl, a NumPy code that shares the case files with it and no line of "
    "code, and both with known answers. A check holds if its error is within its tolerance; the last table "
    "gives the reason of each tolerance."
)


def verify(paths: Sequence[Path], folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Run the verification suite over cases, print a summary and write report.html.

    Parameters
    ----------
    paths : sequence of Path
        Case files; none: the shipped ones, and the known answers.
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
    items = suite(paths, QUICK_STATES if quick else STATES, compiled=not quick)
    opening = [COMPARED]
    if quick:
        count, items = len(items), [item for item in items if item.quick]
        opening.append(f"Quick: {len(items)} of {count} items, {QUICK_STATES} random states of each kind.")
    return _follow(
        Report(f"Verification of exunet {exunet.__version__}", SECTIONS, opening), items, folder, processes
    )


def verify_hard(folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Run the hard cases, print a summary and write report.html; exit codes and errors as in `verify`."""
    backends = "In the compiled loop only." if quick else "On both backends, and in the reference."
    report = Report("Hard cases of exunet", hard.SECTIONS, (backends,))
    return _follow(report, hard.items(compiled=quick), folder, processes)


def _follow(report: Report, items: Sequence[Item], folder: Path, processes: int | None) -> int:
    """Collect the findings of items, write the report, return the exit code."""
    report.open(folder)
    try:
        with status() as show:
            for number, (item, findings) in enumerate(run(items, processes), 1):
                show(f"{number} of {len(items)}: {item.section}, {item.subject}")
                known = len(report.failed)
                report.findings += findings
                for check in report.failed[known:]:
                    print_line(line_of(check))
    except KeyboardInterrupt:
        report.interrupted = True
    seconds = (datetime.now(UTC) - report.started).total_seconds()
    print_line(f"{report.title}: {len(report.checks)} checks in {seconds:.0f} s")
    for section, holding, nearest in report.summary():
        print_line(f"{section:48s} {holding:>12s}   {nearest}")
    path = report.write(folder)
    print_line(f"{report.verdict} Report: {path}")
    if report.interrupted:
        return INTERRUPTED
    return FAILED if report.failed else 0
