"""`exunet cost` on a capture: settings from the same moved starts, judged by what became of the target."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.files import replacing
from exunet.case.casefile import Case
from exunet.figures.page import write
from exunet.figures.style import drawing
from exunet.interfaces.commands.output import duration, print_table, report, status
from exunet.simulation.preparation import prepare_case
from exunet.studies.capture_cost.figure import capture_cost
from exunet.studies.capture_cost.rows import LEGEND, recommendation, table, words, write_csv
from exunet.studies.capture_cost.study import (
    CaptureStudy,
    CaptureStudyOptions,
    CaptureStudyPlan,
    begun,
    first_seconds,
    run,
)
from exunet.studies.moved_starts import small_moves

TABLE, WORDS, FIGURE, PRINT = "cost.csv", "cost.md", "capture_cost.png", "capture_cost.pdf"
FILES = (TABLE, WORDS, FIGURE, PRINT)
BUDGET = 300.0  # [s], unless another is given


def is_capture(case: Case) -> bool:
    """True of a case with contact or [verdict]."""
    return case.scene.verdict is not None or getattr(case.scene.effects, "contact", None) is not None


def study_capture(case: Case, asked: CaptureStudyOptions, folder: Callable[[], Path]) -> bool:
    """Study a capture, write its files, print the answer; True if it was interrupted.

    folder : makes and proves it, once the case is known to be one that can be studied
    """
    study = begun(case, asked)
    first = first_seconds(study)
    if first > asked.budget:
        least = f"one run of the case takes some {duration(first)}, without what contact takes"
        raise InputError(f"--budget: {least}: give more, or an earlier --until")
    there = folder()
    small = small_moves(prepare_case(case), asked.move)
    report(f"time    the case as it is first: about {duration(first)}, with contact more")
    with status() as show:
        say = show if sys.stderr.isatty() else _Settings()
        run(study, asked, say, _expect)
    _write(study, there, case)
    rows = [*words(study), *recommendation(study), ("note", LEGEND), ("note", _moves(study))]
    rows += [("note", small)] if small else []
    if study.interrupted:
        rows.insert(0, ("INCOMPLETE", "interrupted; what was measured until then is kept"))
    print_table(_title(case), [*rows, ("written to", f"{there}/")])
    return study.interrupted


class _Settings:
    """Tells a line when another setting begins."""

    def __init__(self) -> None:
        self._last = ""

    def __call__(self, words: str) -> None:
        name = words.partition(":")[0]
        if name != self._last:
            self._last = name
            report(f"running {name}")


def _expect(expected: CaptureStudyPlan) -> None:
    which = f"{len(expected.settings)} settings, {expected.runs} moved starts each"
    report(f"time    about {duration(expected.seconds)} for {which}")
    if expected.left_out:
        names = ", ".join(one.name for one in expected.left_out)
        report(f"note    too long for the budget, left out: {names}; give a larger --budget or fewer --runs")


def _title(case: Case) -> str:
    return f"{case.scene.title}, to t = {case.scene.time.end:g} s"


def _moves(study: CaptureStudy) -> str:
    return (
        f"{study.runs} starts moved by up to {study.move:g} m, the same for all settings of one net; in the "
        "compiled loop, but for forms of Exudyn's"
    )


def _write(study: CaptureStudy, folder: Path, case: Case) -> None:
    write_csv(study, folder / TABLE)
    with drawing():
        figure = capture_cost(study)
    for name in (FIGURE, PRINT) if figure is not None else ():
        with replacing(folder / name) as part:
            assert figure is not None
            write(figure, part, Path(name).suffix[1:])
    lines = [f"# {_title(case)}", ""]
    if study.interrupted:
        lines += ["INCOMPLETE: interrupted.", ""]
    lines += [*table(study), LEGEND, "", f"{_moves(study)[0].upper()}{_moves(study)[1:]}.", ""]
    lines += [
        f"{name.strip()}: {value}  " if name else f"`{value}`  " for name, value in recommendation(study)
    ]
    lines += ["", f"![what became of the target against wall time]({FIGURE})"] if figure is not None else []
    with replacing(folder / WORDS) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
