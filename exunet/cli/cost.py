"""`exunet cost`: measure what accuracy costs in wall time; table, figure and recommendation."""

from __future__ import annotations

import time as clock
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.files import markdown_table, replacing
from exunet.base.times import duration
from exunet.cli.cost_figure import figure_of
from exunet.cli.output import folder_of, opened, print_columns, print_table, ready, status
from exunet.kernels.compile import numba_installed
from exunet.plots.style import drawing
from exunet.results.run_folder import refuse_replacing
from exunet.scene.casefile import Case
from exunet.scene.scene import SHORTEST
from exunet.studies.cost.report import Rows, rows_of, tables, write_csv
from exunet.studies.cost.settings import is_capture
from exunet.studies.cost.study import CostStudy, run_studies, studies_of

INTERRUPTED = 130
BUDGET, BUDGET_OF_CAPTURE = 120.0, 300.0  # [s], unless another is given
LEAST = 1.0  # [s]
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
    """Study a case, write table and figure into a folder, print the tables; returns the exit code.

    out       : folder; None: results/CASE--cost, or the next that is free
    until     : end of the runs [s], at most that of the case
    budget    : wall time of all runs [s]
    runs      : perturbed runs of each setting, where distributions are compared
    overwrite : replace an earlier study in the folder
    Raises InputError for options or a folder that cannot be used, RunStopped if the converged solution stops.
    """
    began, end = clock.perf_counter(), case.scene.time.end
    if until is not None and not SHORTEST <= until <= end:
        raise InputError(
            f"--until: must be in [{SHORTEST:g}, {end:g}] s, up to the case's time, got {until:g}"
        )
    if budget is None:
        budget = BUDGET_OF_CAPTURE if is_capture(case) else BUDGET
    if not budget >= LEAST:
        raise InputError(f"--budget: must be at least {LEAST:g} s, got {budget:g}")
    with opened(out or folder_of(case, "cost"), own=out is None) as folder:
        ready(folder, FILES)
        if not overwrite:
            refuse_replacing(folder, FILES)

        def left() -> float:
            return began + budget - clock.perf_counter()

        with status() as say:
            say("converged solution")
            parts, notes = studies_of(case, until, runs, left)
            complete = run_studies(parts, left, say)
        seconds = clock.perf_counter() - began
        rows = rows_of(parts, max(budget, seconds))
        if not complete:
            rows.insert(0, ("INCOMPLETE", "interrupted; settings measured before are stored"))
        if not numba_installed():
            rows.append(("note", "no compiled loop without Numba (pip install numba)"))
        facts, solution = f"took {duration(seconds)}", parts[0].converged
        if solution is not None:
            horizon = "its end" if solution.horizon is None else f"{solution.horizon:.3g} s"
            facts = f"predictable until {horizon}; {facts}"
        _write(f"What accuracy costs: {case.scene.title} ({facts})", parts, rows, notes, folder)
    return 0 if complete else INTERRUPTED


def _write(title: str, parts: list[CostStudy], rows: Rows, notes: tuple[str, ...], folder: Path) -> None:
    """Write the files of a study and print its tables."""
    shown = [table for table in tables(parts) if table[1]]
    write_csv(parts, folder / TABLE)
    lines = [f"# {title}", ""]
    for head, cells in shown:
        lines += markdown_table(head, cells)
    lines += markdown_table(("", ""), [*rows, *(("how", note) for note in notes)])
    with drawing():
        if (figure := figure_of(parts)) is not None:
            lines.append(f"![errors, metrics and wall times]({FIGURE})")
            for name in (FIGURE, PRINT):
                with replacing(folder / name) as part:
                    figure.savefig(part, format=Path(name).suffix[1:])
    with replacing(folder / TEXT) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if not any(part.by_trajectory for part in parts):
        rows += [("note", note) for note in notes if note.startswith("trajectories")]
    print_table(title, [])
    for head, cells in shown:
        print_columns(head, cells, narrow=1)
    print_table("", [*rows, ("written to", f"{folder}/")])
