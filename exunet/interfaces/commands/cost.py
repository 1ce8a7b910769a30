"""`exunet cost`: climbs the ladder of methods on a case, or studies a capture; writes figure and tables."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from exunet.base.errors import InputError
from exunet.base.files import cannot_write, replacing
from exunet.base.markdown import markdown_table
from exunet.case.casefile import Case
from exunet.case.scene import SHORTEST
from exunet.codegen.compile import numba_installed
from exunet.figures.page import write
from exunet.figures.style import drawing
from exunet.interfaces.commands import capture_cost as capture
from exunet.interfaces.commands.capture_cost import is_capture, study_capture
from exunet.interfaces.commands.folders import folder_of
from exunet.interfaces.commands.output import print_table, status
from exunet.interfaces.options import as_options
from exunet.methods.method import METHODS
from exunet.results.run_folder import new_folder, refuse_replacing
from exunet.results.spread import COVERING
from exunet.simulation.planning import slow_turning
from exunet.simulation.preparation import prepare_case
from exunet.studies.both_codes import both_of
from exunet.studies.capture_cost.settings import MOST_SETTINGS, changed
from exunet.studies.capture_cost.study import CaptureStudyOptions
from exunet.studies.cost.converged import INSTANTS, Converged, converge
from exunet.studies.cost.figure import work_precision
from exunet.studies.cost.ranking import failed_rows, measure_rows, runnable_rows, write_csv
from exunet.studies.cost.runners import Subject
from exunet.studies.cost.settings import base
from exunet.studies.cost.study import Study, all_rungs, climb, untried
from exunet.studies.ensemble import metres
from exunet.studies.moved_starts import move_for_medians, refuse_far_moves, refuse_too_many

INTERRUPTED = 130
BUDGET = 120.0  # [s], unless another is given
FILES = TABLE, WORDS, FIGURE, PRINT = "cost.csv", "cost.md", "work_precision.png", "work_precision.pdf"


@dataclass(frozen=True)
class AskedCost:
    """What the user asked of a study beside the case: see `exunet cost -h`.

    out    : folder; None: results/CASE--cost, or the next that is free
    until  : end of the runs [s], at most the case's; None: the case's
    budget : wall time [s] of all of it; None: BUDGET, of a capture that of `capture_cost`
    overwrite : replace what an earlier study left in the folder
    runs, perturb : of a capture the number of moved starts, and their largest move [m]; None: the default
    """

    out: Path | None = None
    until: float | None = None
    budget: float | None = None
    overwrite: bool = False
    runs: int | None = None
    perturb: float | None = None


def cost(case: Case, asked: AskedCost) -> int:
    """Study a case, write tables and figure into a folder, print the answer; returns the exit code.

    A case with contact or [verdict] is judged by what became of its target, others by their trajectory.
    Raises InputError for options or a folder that cannot be used, RunStopped if not even the converged
    solution can be computed.
    """
    if is_capture(case):
        return _of_capture(case, asked)
    for name in ("runs", "perturb"):
        if getattr(asked, name) is not None:
            raise InputError(f"--{name}: is for captures; this case has neither contact nor [verdict]")
    return _of_trajectory(case, asked)


def _of_capture(case: Case, asked: AskedCost) -> int:
    if asked.until is not None:
        case = changed(case, f"time.end={_end(case, asked.until)!r}")
    start = prepare_case(case)
    move = move_for_medians(start) if asked.perturb is None else asked.perturb
    with as_options():
        metres("perturb", move)
        refuse_far_moves(start, move)
        refuse_too_many(MOST_SETTINGS * (asked.runs or COVERING), start)
    budget = capture.BUDGET if asked.budget is None else asked.budget

    def folder() -> Path:
        return _ready(asked.out, folder_of(case, "cost"), capture.FILES, overwrite=asked.overwrite)

    interrupted = study_capture(case, CaptureStudyOptions(budget, asked.runs, move), folder)
    return INTERRUPTED if interrupted else 0


def _of_trajectory(case: Case, asked: AskedCost) -> int:
    """At least the converged solution is computed, whatever the budget."""
    began, budget = clock.perf_counter(), BUDGET if asked.budget is None else asked.budget

    def left() -> float:
        return budget - (clock.perf_counter() - began)

    subject, refusal = _subject(case, asked.until)
    folder = _ready(asked.out, folder_of(case, "cost"), FILES, overwrite=asked.overwrite)
    compiled = numba_installed()
    with status() as say:
        say("converged solution")
        converged = converge(subject, compiled=compiled)
        if not converged.predicts:
            subject = subject.at(tuple(np.linspace(0.0, subject.end, INSTANTS + 1).tolist()))
        study = Study(converged)
        climb(study, subject, all_rungs(subject, compiled=compiled), left, say, base(compiled=compiled))
    title = f"{case.scene.title}, to t = {subject.end:g} s"
    _write(study, folder)
    notes = [("note", refusal)] if refusal else []
    if not compiled:
        notes.append(("note", "without Numba (pip install numba) there is no fused net, no compiled loop"))
    rows = [*_head(converged, subject), *runnable_rows(study, subject.speed)]
    if not converged.predicts:
        rows += measure_rows(study)
    rows += [*_failures(study), *_left_out(study, budget), *_untried(subject, compiled=compiled), *notes]
    if study.interrupted:
        rows.insert(0, ("INCOMPLETE", "interrupted; what was measured until then is kept"))
    brief = [row for row in rows if row[0] != "failed"]
    print_table(title, [*brief, *failed_rows(study), ("written to", f"{folder}/")])
    _write_words(folder, title, study, rows)
    return INTERRUPTED if study.interrupted else 0


def _subject(case: Case, until: float | None) -> tuple[Subject, str]:
    end = case.scene.time.end if until is None else _end(case, until)
    start = prepare_case(case)
    try:
        return Subject(start, both_of(case), (0.0, end)), ""
    except InputError as error:
        return Subject(start, None, (0.0, end)), f"without the reference: {error}"


def _end(case: Case, until: float) -> float:
    """`until` [s], which a case's runs can end at."""
    end = case.scene.time.end
    if not SHORTEST <= until <= end:
        words = f"must be in [{SHORTEST:g}, {end:g}] s, up to the case's time, got {until:g}"
        raise InputError(f"--until: {words}")
    return until


def _head(converged: Converged, subject: Subject) -> list[tuple[str, str]]:
    rows = [("converged solution", words) for words in converged.words]
    rows.append(("converged solution", f"took {converged.seconds:.3g} s"))
    if names := (*subject.start.system.blocks.body, *subject.start.system.blocks.rigid):
        words = "velocities and places over time, attitudes and angular velocities by what they move"
        rows.append(("speeds", f"those of {', '.join(names)} count too: {words}"))
    if not converged.predicts:
        rows.append(
            (
                "after the horizon",
                f"from about t = {converged.horizon:.3g} s on no speed is predictable here: errors below are "
                "those of the energy balance, the measures of deployment stand beside. For speeds give a "
                "shorter --until",
            )
        )
    elif converged.sensitivity > max(1e-2, 1e3 * converged.uncertainty):
        rows.append(
            (
                "sensitive start",
                f"the speeds at t = {subject.end:g} s hold for exactly this start only: what is symmetric in "
                "it stays so; a real start, moved a little, has no predictable speeds there",
            )
        )
    return rows


def _failures(study: Study) -> list[tuple[str, str]]:
    return [("failed", f"{entry.setting}: {entry.reason}") for entry in study.entries if entry.failed]


def _left_out(study: Study, budget: float) -> list[tuple[str, str]]:
    left_out = [entry for entry in study.entries if entry.reason and not entry.failed]
    if not left_out:
        return []
    ran = {entry.setting.name for entry in study.entries if entry not in left_out}
    never = list(dict.fromkeys(entry.setting.name for entry in left_out if entry.setting.name not in ran))
    words = (
        f"{len(left_out)} settings, for the budget of {budget:g} s, of which the converged solution took "
        f"{study.converged.seconds:.3g} s; give a larger --budget"
    )
    rows = [("left out", words)]
    return rows + ([("never run", ", ".join(never))] if never else [])


def _untried(subject: Subject, *, compiled: bool) -> list[tuple[str, str]]:
    """Methods that the scene refuses, and why; what others do badly with its bodies."""
    found = untried(subject, compiled=compiled)
    rows = [("not tried", f"{', '.join(names)}: cannot run {reason}") for reason, names in found.items()]
    words = (slow_turning(subject.start.scene, subject.start.system, method) for method in METHODS)
    return rows + [("note", one) for one in words if one]


def _ready(out: Path | None, own: Path, files: tuple[str, ...], *, overwrite: bool) -> Path:
    """The folder; one that cannot be written, or has a study, is refused before hours are spent."""
    if out is None:
        return new_folder(own)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=out):
            pass
        for name in files:
            if (out / name).exists() and not (out / name).is_file():
                raise InputError(f"{out / name}: cannot be written: it is not an ordinary file")
        if not overwrite:
            refuse_replacing(out, files)
    except OSError as error:
        raise cannot_write(out, error) from error
    return out


def _write(study: Study, folder: Path) -> None:
    write_csv(study, folder / TABLE)
    with drawing():
        figure = work_precision(study)
    for name in (FIGURE, PRINT):
        with replacing(folder / name) as part:
            write(figure, part, Path(name).suffix[1:])


def _write_words(folder: Path, title: str, study: Study, rows: list[tuple[str, str]]) -> None:
    what = "Errors are those of speeds at the end, relative to the launch speed."
    if not study.converged.predicts:
        what = "Errors are those of the energy balance, relative to the energy that can deform the net."
    lines = [f"# {title}", "", what, "", *markdown_table(("", ""), rows)]
    lines += ["![work-precision diagram](work_precision.png)"]
    with replacing(folder / WORDS) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
