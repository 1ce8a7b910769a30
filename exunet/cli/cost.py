"""`exunet cost`: study what accuracy costs on a case; table, figure and recommendation."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.files import markdown_table, replacing
from exunet.cli.output import folder_of, opened, print_table, ready, status
from exunet.kernels.compile import numba_installed
from exunet.methods.method import METHODS
from exunet.plots.style import drawing
from exunet.results.run_folder import refuse_replacing
from exunet.scene.casefile import Case
from exunet.scene.scene import SHORTEST
from exunet.simulation.planning import slow_turning
from exunet.studies.cost.report import figure_of, notes, recommendation, write_csv
from exunet.studies.cost.settings import is_capture
from exunet.studies.cost.study import Study, run_study, study_of
from exunet.studies.divisions import rows_of_study, study_divisions

INTERRUPTED = 130
BUDGET, BUDGET_OF_CAPTURE = 120.0, 300.0  # [s], unless another is given
FILES = TABLE, TEXT, FIGURE, PRINT = "cost.csv", "cost.md", "cost.png", "cost.pdf"


def cost(
    case: Case,
    out: Path | None = None,
    until: float | None = None,
    budget: float | None = None,
    runs: int | None = None,
    *,
    overwrite: bool = False,
) -> int:
    """Study a case, write table and figure into a folder, print the recommendation; returns the exit code.

    out       : folder; None: results/CASE--cost, or the next that is free
    until     : end of the runs [s], at most that of the case
    budget    : wall time of the compared runs [s]; that of the converged solution is not counted
    runs      : perturbed runs of each setting, where distributions are compared
    overwrite : replace an earlier study in the folder
    Raises InputError for options or a folder that cannot be used, RunStopped if the converged solution stops.
    """
    end = case.scene.time.end
    if until is not None and not SHORTEST <= until <= end:
        raise InputError(
            f"--until: must be in [{SHORTEST:g}, {end:g}] s, up to the case's time, got {until:g}"
        )
    if budget is None:
        budget = BUDGET_OF_CAPTURE if is_capture(case) else BUDGET
    with opened(out or folder_of(case, "cost"), own=out is None) as folder:
        ready(folder, FILES)
        if not overwrite:
            refuse_replacing(folder, FILES)
        with status() as say:
            say("converged solution")
            study = study_of(case, until, runs)
            limit = clock.perf_counter() + budget
            run_study(study, lambda: limit - clock.perf_counter(), say)
            rows: list[tuple[str, str]] = []
            if not (study.interrupted or is_capture(case)):
                try:
                    rows = _divisions(case, budget, say)
                except KeyboardInterrupt:  # the study is complete and is written
                    study.interrupted = True
        _write(case, study, folder, rows)
    return INTERRUPTED if study.interrupted else 0


def _divisions(case: Case, budget: float, say: Callable[[str], None]) -> list[tuple[str, str]]:
    """Return rows on the division of threads, from perturbed runs of a deployment."""
    if not numba_installed():
        return []
    return rows_of_study(*study_divisions(case, budget, say))


def _write(case: Case, study: Study, folder: Path, of_divisions: list[tuple[str, str]]) -> None:
    rows = [*recommendation(study), *of_divisions, *notes(study)]
    rows += [] if numba_installed() else [("note", "no compiled backends without Numba (pip install numba)")]
    scene, system = study.subject.start.scene, study.subject.start.system
    rows += [("note", words) for method in METHODS if (words := slow_turning(scene, system, method))]
    if study.interrupted:
        rows.insert(0, ("INCOMPLETE", "interrupted; what was measured before is stored"))
    title = f"{case.scene.title}, to t = {study.subject.end:g} s"
    write_csv(study, folder / TABLE)
    lines = [f"# {title}", "", *markdown_table(("", ""), rows)]
    with drawing():
        if (figure := figure_of(study)) is not None:
            lines.append(f"![cost and errors]({FIGURE})")
            for name in (FIGURE, PRINT):
                with replacing(folder / name) as part:
                    figure.savefig(part, format=Path(name).suffix[1:])
    with replacing(folder / TEXT) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print_table(title, [*rows, ("written to", f"{folder}/")])
