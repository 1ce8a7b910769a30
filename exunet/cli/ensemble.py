"""`exunet ensemble`: many perturbed runs; their file, a table of quantiles, figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from exunet.base.errors import ExunetError, InputError, RunStopped
from exunet.cli.output import (
    ProgressBar,
    as_options,
    first_clause,
    folder_of,
    opened,
    print_table,
    ready,
)
from exunet.plots.registry import ENSEMBLE_FIGURES, save_figures
from exunet.results.ensemble import Ensemble, save_ensemble, sensitivity, words_of_endings
from exunet.results.io import ENSEMBLE_FILE
from exunet.results.run_folder import held, refuse_replacing
from exunet.scene.casefile import Case
from exunet.studies.ensemble import ensemble

_FILES = tuple(f"{name}.png" for name in ENSEMBLE_FIGURES)


@dataclass(frozen=True)
class EnsembleOptions:
    """Options of an ensemble beside its case: see `exunet ensemble -h`."""

    runs: int
    perturb: float
    seed: int | None
    out: Path | None = None
    overwrite: bool = False
    quiet: bool = False


def run_ensemble_case(case: Case, options: EnsembleOptions) -> ExunetError | None:
    """Run an ensemble, write ensemble.h5 and figures, print the table.

    Returns
    -------
    ExunetError or None
        The error of an ensemble that stopped; its complete runs are written.

    Raises
    ------
    InputError
        Before any run, for wrong options, or a folder that cannot be written or has an ensemble.
    """
    wanted = options.out or folder_of(case, "ensemble")
    with opened(wanted, own=options.out is None and not options.overwrite) as folder, held(folder):
        ready(folder, (ENSEMBLE_FILE, *_FILES))
        file = folder / ENSEMBLE_FILE
        if file.exists() and not options.overwrite:
            raise InputError(
                f"{folder}: there is an ensemble in this folder: use another --out, or --overwrite"
            )
        if not options.overwrite:
            refuse_replacing(folder, _FILES)
        stopped: RunStopped | None = None
        with as_options("runs", "perturb", "seed"), ProgressBar(quiet=options.quiet) as bar:
            update = bar.begin("run", options.runs)
            try:
                result = ensemble(case, options.runs, options.perturb, options.seed, progress=update)
            except RunStopped as error:
                if not isinstance(error.result, Ensemble) or file.exists():
                    raise
                result, stopped = error.result, error
        save_ensemble(result, file, overwrite=options.overwrite)
        save_figures(result, folder, overwrite=True)
        if not options.quiet:
            print_table(case.scene.title, rows(result))
            typer.echo(f"written to {folder}/")
            if stopped is not None:
                stopped.args = (first_clause(str(stopped)),)
        return stopped


def rows(result: Ensemble) -> list[tuple[str, str]]:
    """Return rows (name, value): the runs, and median and range of each metric."""
    record, runs, plan = result.run, result.runs, result.run.plan
    assert plan is not None
    assert record.seconds is not None
    assert record.move_m is not None
    setting = f"tolerance {plan.tolerance:.3g}" if plan.tolerance else f"step {plan.step:.4g} s"
    table = [
        ("verdict", result.verdict),
        ("runs", f"{runs} perturbed by up to {record.move_m:g} m (seed {record.seed})"),
        ("method", f"{plan.method}, {setting}, compiled loop"),
        ("wall time", f"{record.seconds:.2f} s, {runs / record.seconds:.3g} runs a second"),
    ]
    if record.outcomes:
        counts = ", ".join(f"{number} {name}" for name, number in record.outcomes.items())
        table.append(("capture", f"of {runs} runs: {counts}"))
    if ends := words_of_endings(record.endings):
        table.append(("ended", f"of {runs} runs: {ends}"))
    shown = [metric for metric in result.about.values() if not metric.detail]
    table += [(metric.words, str(result.range(metric.key))) for metric in shown]
    table += [*_elements(result), ("ranges", sensitivity(runs, record.move_m))]
    if details := len(result.about) - len(shown):
        table.append(
            ("note", f"ensemble.h5 has {details} more metrics, of single bodies, elements and nodes")
        )
    return table + [("note", note) for note in record.notes]


def _elements(result: Ensemble) -> list[tuple[str, str]]:
    """Count in which elements the runs have their largest tension."""
    elements = result.metrics.get("element_of_largest_tension", np.zeros(0))
    numbers = Counter(int(element) for element in elements if not np.isnan(element)).most_common()
    if not numbers:
        return []
    shown = ", ".join(f"{element} in {count}" for element, count in numbers[:5])
    others = f", others in {sum(count for _, count in numbers[5:])}" if len(numbers) > 5 else ""
    return [("elements", f"largest tension in element {shown}{others} of {result.runs} runs")]
