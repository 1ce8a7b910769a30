"""`exunet verify`: climbs the ladder, or with --hard runs the gallery; prints rows, writes the report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from exunet.figures.style import drawing
from exunet.interfaces.commands.estimates import duration
from exunet.interfaces.commands.lines import HANG, folded
from exunet.interfaces.commands.printing import console, status
from exunet.verification import hard
from exunet.verification.ladder import RUNGS, Ladder, later_steps, read_cases
from exunet.verification.processes import Followed, cores, followed, one_by_one
from exunet.verification.report import UNDER_NAME, UNDER_WORST, Report
from exunet.verification.step import Step

# Processor time [s] of the ladder over the shipped cases, whole and with --quick, and likewise the gallery:
# 4 min 15 s and 1 min of two cores of an idle machine that had nothing to compile; 468 s, in 4 min 37 s of
# two cores of a machine with other work beside, and 22 s.
LADDER, LADDER_QUICK, GALLERY, GALLERY_QUICK = 510.0, 120.0, 470.0, 22.0
SURELY, NAMED = 2.5, 5.0  # factors of uncertainty: of other machines, and of cases that nobody has measured
FAILED = 1
INTERRUPTED = 130

COMPARED = (
    "Exudyn is compared with `reference_impl`, a NumPy code that shares the case files with it and no line "
    "of code, and both with known answers."
)


def words_of_time(seconds: float, processes: int, factor: float) -> str:
    """How long it takes, beforehand; seconds: of a processor, factor: of uncertainty."""
    wall = seconds / processes
    ends = f"{duration(wall / factor)} to {duration(wall * factor)}"
    at_once = f"{processes} processes" if processes > 1 else "one process"
    return f"Time: about {duration(wall)} ({ends}), by {at_once}"


def verify(paths: Sequence[Path], folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Climb the ladder over the cases (none: the shipped ones); returns the exit code.

    processes : that run at the same time; None: one for each core

    0 if all checks hold, 1 if one fails, 130 if interrupted (what was done is in the report). Raises
    InputError before anything runs if a case is out of the reference's reach, the shipped cases are not there
    or the folder cannot be written.
    """
    cases = read_cases(paths)
    ladder = Ladder(cases, quick=quick, paper=not paths)
    over = f"{'Quick' if quick else 'Full'} ladder over {', '.join(case.name for case in cases)}."
    report = Report("Verification of exunet", "verification.md", RUNGS, (over, COMPARED))
    at_once = processes or cores()
    time = words_of_time(LADDER_QUICK if quick else LADDER, at_once, NAMED if paths else SURELY)
    if paths:
        time += "; more with large nets or long runs"
    return _follow(report, _climbed(ladder, paths, quick, at_once), folder, time)


def verify_hard(folder: Path, *, quick: bool, processes: int | None = None) -> int:
    """Run the gallery of hard cases, write hard.md; exit codes and errors as in `verify`."""
    forms = "In the compiled loop only." if quick else "In every form of the engine, and in the reference."
    report = Report("Hard cases of exunet", "hard.md", hard.ITEMS, (forms,), tolerances="HARD")
    at_once = processes or cores()
    time = words_of_time(GALLERY_QUICK if quick else GALLERY, at_once, SURELY)
    return _follow(report, followed(partial(_hard_steps, quick), at_once), folder, time)


def _climbed(ladder: Ladder, paths: Sequence[Path], quick: bool, processes: int) -> Iterator[Followed]:
    yield from one_by_one(ladder.nets())
    yield from followed(partial(later_steps, paths, quick, frozenset(ladder.different)), processes)


def _hard_steps(quick: bool) -> list[Step]:
    return list(hard.steps(quick=quick))


def _follow(report: Report, found: Iterable[Followed], folder: Path, time: str) -> int:
    report.open(folder)
    out = console()

    def tell(words: str, hang: int = HANG) -> None:
        for line in folded(words, out.width, hang):
            out.print(line, soft_wrap=True)

    tell(time)
    try:
        with drawing(), status() as say:
            for step, findings in found:
                say(f"{step.rung}. {step.subject}")
                for finding in findings:
                    for line in report.add(finding, folder):
                        tell(line, UNDER_WORST if line.startswith(" ") else UNDER_NAME)
    except KeyboardInterrupt:
        report.interrupted = True
    tell(f"{report.verdict} Report: {report.write(folder)}")
    if report.interrupted:
        return INTERRUPTED
    return 0 if report.holds else FAILED
