"""`exunet ensemble`: many perturbed runs; their file, a table of quantiles, figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from exunet.base.errors import ExunetError, InputError, RunStopped
from exunet.cli.folders import folder_of, opened, ready
from exunet.cli.options import as_options
from exunet.cli.output import ProgressBar, print_table, report
from exunet.kernels.compile import require_numba
from exunet.plots.registry import ENSEMBLE_FIGURES, save_figures
from exunet.results.endings import words_of_endings
from exunet.results.ensemble_result import ENSEMBLE_FILE, EnsembleResult, save_ensemble
from exunet.results.headline import Headline, printed, unit_of_last_digit
from exunet.results.headlines import headline
from exunet.results.run_folder import held, refuse_replacing
from exunet.results.spread import COVERING, FEWEST
from exunet.scene.casefile import Case
from exunet.simulation.preparation import prepare_case
from exunet.studies.perturbed_runs import (
    ensemble,
    small_perturbation_note,
    validate_arguments,
    validate_memory,
    validate_method,
    validate_perturbation,
)

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
    with as_options():
        validate_arguments(options.runs, options.perturb, options.seed)
    start = prepare_case(case)
    validate_method(start)
    require_numba("an ensemble")
    with as_options():
        validate_memory(options.runs, start)
        validate_perturbation(start, options.perturb)
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
        if not options.quiet and (note := small_perturbation_note(start, options.perturb)):
            report(f"note: {note}")
        stopped: RunStopped | None = None
        with ProgressBar(quiet=options.quiet) as bar:
            update = bar.begin("run", options.runs)
            try:
                result = ensemble(case, options.runs, options.perturb, options.seed, progress=update)
            except RunStopped as error:
                if not isinstance(error.result, EnsembleResult) or file.exists():
                    raise
                result, stopped = error.result, error
        save_ensemble(result, file, overwrite=options.overwrite)
        save_figures(result, folder, overwrite=True)
        if not options.quiet:
            print_table(case.scene.title, rows(result))
            typer.echo(f"written to {folder}/")
        return stopped


def rows(result: EnsembleResult) -> list[tuple[str, str]]:
    """Return rows (name, value): the runs, and quantiles of each metric, or the range of few runs."""
    facts, runs = result.provenance, result.runs
    setting = f"tolerance {facts['tolerance']:.3g}" if facts["tolerance"] else f"step {facts['step']:.4g} s"
    table = [
        ("verdict", result.verdict),
        ("runs", f"{runs} perturbed by up to {facts['move_m']:g} m (seed {facts['seed']})"),
        ("method", f"{facts['method']}, {setting}, compiled loop"),
        ("wall time", f"{facts['seconds']:.2f} s, {runs / facts['seconds']:.3g} runs a second"),
    ]
    if outcomes := facts.get("outcomes"):
        counts = ", ".join(f"{number} {name}" for name, number in outcomes.items())
        table.append(("capture", f"of {runs} runs: {counts}"))
    if endings := words_of_endings(facts.get("endings", [])):
        table.append(("ended", f"of {runs} runs: {endings}"))
    metrics = list(map(headline, result.headlines))
    table += [(metric.words, _quantiles(metric, result)) for metric in metrics if not metric.detail]
    notes = [*facts.get("notes", [])]
    if not facts["move_m"] or runs < FEWEST:
        few = "no start is perturbed" if not facts["move_m"] else f"{runs} run{'s' * (runs > 1)}"
        notes.append(f"{few}: no range of the metrics (-n {COVERING} --perturb 1e-9)")
    if details := sum(metric.detail for metric in metrics):
        notes.append(f"ensemble.h5 has {details} more metrics, of single bodies, elements and nodes")
    return [*table, *_elements(result), *(("note", note) for note in notes)]


def _quantiles(metric: Headline, result: EnsembleResult) -> str:
    """Format median, quantiles and range of a metric over the runs that have it."""
    least, low, middle, high, largest = result.quantile(metric.key, (0.0, 0.05, 0.5, 0.95, 1.0))
    unit = f" {metric.unit}" if metric.unit else ""
    last = max(unit_of_last_digit(max(abs(least), abs(largest)), metric.digits), metric.least)
    least, low, middle, high, largest = (printed(float(x), last) for x in (least, low, middle, high, largest))
    missing = int(np.isnan(result.headlines[metric.key]).sum())
    having = result.runs - missing
    some = f"; not in {missing} of the runs" if missing else ""
    if least == largest:
        perturbed = result.provenance["move_m"] > 0.0 and having > 1
        return f"{middle}{unit}{f' in all {having} runs' if perturbed else ''}{some}"
    if having < FEWEST:
        return f"{least} to {largest}{unit}, least to largest of {having} runs{some}"
    return f"median {middle}{unit}, 5 % to 95 %: {low} to {high}{unit}, all: {least} to {largest}{unit}{some}"


def _elements(result: EnsembleResult) -> list[tuple[str, str]]:
    """Count in which elements the runs have their largest tension."""
    elements, counts = np.unique(result.elements[result.elements >= 0], return_counts=True)
    if not len(elements):
        return []
    order = np.argsort(-counts, kind="stable")[:5]
    shown = ", ".join(f"{elements[k]} in {counts[k]}" for k in order)
    others = f", others in {result.runs - counts[order].sum()}" if len(elements) > len(order) else ""
    return [("elements", f"largest tension in element {shown}{others} of {result.runs} runs")]
