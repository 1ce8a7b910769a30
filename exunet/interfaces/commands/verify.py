"""`exunet verify`: climbs the ladder, prints the table as it grows, writes the report."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from exunet.figures.style import drawing
from exunet.verification.check import Check, Finding, Plate
from exunet.verification.ladder import RUNGS, Ladder, read_cases
from exunet.verification.report import make_folder, number, save_plate, verdict, write_report

FAILED = 1
INTERRUPTED = 130


def verify(paths: Sequence[Path], folder: Path, *, quick: bool) -> int:
    """Climb the ladder over the cases (none: the shipped ones); returns the exit code.

    0 if all checks hold, 1 if one fails, 130 if interrupted (what was done is in the report). Raises
    InputError before anything runs if a case is out of the reference's reach, the shipped cases are not there
    or the folder cannot be written.
    """
    pairs = read_cases(paths)
    ladder = Ladder(pairs, quick=quick, study=not paths)
    make_folder(folder)
    findings: list[Finding] = []
    console = plain_console()
    interrupted = False
    try:
        for finding in _climb(ladder, console):
            findings.append(finding)
            if isinstance(finding, Check):
                show(finding, console)
            elif isinstance(finding, Plate):
                save_plate(finding, folder)
    except KeyboardInterrupt:
        interrupted = True
    names = [pair.name for pair in pairs]
    report = write_report(folder, findings, names, quick=quick, interrupted=interrupted)
    checks = [finding for finding in findings if isinstance(finding, Check)]
    console.print(f"{verdict(checks, interrupted=interrupted)} Report: {report}")
    if interrupted:
        return INTERRUPTED
    return 0 if all(check.holds for check in checks) else FAILED


def _climb(ladder: Ladder, console: Console) -> Iterator[Finding]:
    """All findings, under a heading for each rung; the step at work is shown on a terminal."""
    rung = 0
    with drawing(), _status() as say:
        for step in ladder.steps():
            say(f"rung {step.rung}: {step.title}")
            for finding in step.run():
                if isinstance(finding, Check) and finding.rung != rung:
                    rung = finding.rung
                    console.print(f"\n{rung}. {RUNGS[rung]}")
                    console.print(
                        f"{'case':24s} {'check':52s} {'measured':>10s} {'allowed':>8s}  verdict    unit"
                    )
                yield finding


def show(check: Check, console: Console, width: int = 24) -> None:
    """Print a check as a line of the table, with what is worst where it fails."""
    allowed = number(check.allowed.value) if check.allowed else "-"
    console.print(
        f"{check.subject:{width}s} {check.name:52s} {number(check.measured):>10s} {allowed:>8s}  "
        f"{check.verdict:9s}  {check.allowed.unit if check.allowed else ''}".rstrip()
    )
    if not check.holds:
        console.print(f"    worst: {check.worst}")
    if check.left_out:
        console.print(f"    because: {check.worst}")


def plain_console() -> Console:
    """A console on stdout that takes words as they are and breaks no line."""
    width = None if sys.stdout.isatty() else 120
    return Console(markup=False, emoji=False, highlight=False, width=width, soft_wrap=True)


@contextmanager
def _status():  # type: ignore[no-untyped-def]
    """A function that names the step at work on stderr; it says nothing when that is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda words: None
        return
    console = Console(stderr=True, markup=False, emoji=False, highlight=False)
    with console.status("") as status:
        yield lambda words: status.update(words)
