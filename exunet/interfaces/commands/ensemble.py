"""`exunet ensemble`: many runs from moved starts; their file, a table of quantiles, figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from exunet.base.errors import ExunetError, InputError, RunStopped
from exunet.case.casefile import Case
from exunet.codegen.compile import require_numba
from exunet.figures.ensemble import FIGURES, save_ensemble_figures
from exunet.interfaces.commands.folders import folder_of, opened, ready
from exunet.interfaces.commands.output import ProgressBar, print_table, report
from exunet.interfaces.options import as_options
from exunet.results.digits import printed, unit_of_last_digit
from exunet.results.endings import words_of_endings
from exunet.results.ensemble_result import ENSEMBLE_FILE, EnsembleResult, save_ensemble
from exunet.results.headline import Headline
from exunet.results.headlines import headline
from exunet.results.run_folder import held, refuse_replacing
from exunet.results.spread import COVERING, FEWEST
from exunet.simulation.preparation import prepare_case
from exunet.studies.moved_starts import (
    ensemble,
    refuse_far_moves,
    refuse_other_methods,
    refuse_too_many,
    refuse_wrong,
    small_moves,
)

_FILES = tuple(f"{name}.png" for name in FIGURES)


@dataclass(frozen=True)
class AskedEnsemble:
    """What the user asked of an ensemble beside the case: see `exunet ensemble -h`."""

    runs: int
    perturb: float
    seed: int | None
    out: Path | None = None
    overwrite: bool = False
    quiet: bool = False


def run_ensemble_case(case: Case, asked: AskedEnsemble) -> ExunetError | None:
    """Run, write ensemble.h5 and figures, print the table.

    Returns the error of an ensemble that stopped, of which complete runs are kept, else None. Raises
    InputError, before any run, for what cannot be meant, or a folder that cannot be written or has an
    ensemble.
    """
    with as_options():
        refuse_wrong(asked.runs, asked.perturb, asked.seed)
    start = prepare_case(case)
    refuse_other_methods(start)
    require_numba("an ensemble")
    with as_options():
        refuse_too_many(asked.runs, start)
        refuse_far_moves(start, asked.perturb)
    wanted = asked.out or folder_of(case, "ensemble")
    with opened(wanted, own=asked.out is None and not asked.overwrite) as folder, held(folder):
        ready(folder, (ENSEMBLE_FILE, *_FILES))
        file = folder / ENSEMBLE_FILE
        if file.exists() and not asked.overwrite:
            words = "there is an ensemble in this folder: replace it (--overwrite), or give another --out"
            raise InputError(f"{folder}: {words}")
        if not asked.overwrite:
            refuse_replacing(folder, _FILES)
        if not asked.quiet and (words := small_moves(start, asked.perturb)):
            report(f"note: {words}")
        stopped: RunStopped | None = None
        with ProgressBar(quiet=asked.quiet) as bar:
            update = bar.begin("run", asked.runs)
            try:
                found = ensemble(case, asked.runs, asked.perturb, asked.seed, progress=update)
            except RunStopped as error:
                if not isinstance(error.result, EnsembleResult) or file.exists():
                    raise
                found, stopped = error.result, error
        save_ensemble(found, file, overwrite=asked.overwrite)
        save_ensemble_figures(found, folder)
        if not asked.quiet:
            print_table(case.scene.title, rows(found))
            typer.echo(f"written to {folder}/")
        return stopped


def rows(found: EnsembleResult) -> list[tuple[str, str]]:
    """Rows of the table: which runs, and quantiles of each headline, or of fewer than 8 runs its range."""
    story = found.provenance
    setting = f"tolerance {story['tolerance']:.3g}" if story["tolerance"] else f"step {story['step']:.4g} s"
    runs = f"{found.runs} from starts moved by up to {story['move_m']:g} m (seed {story['seed']})"
    table = [
        ("verdict", found.verdict),
        ("runs", runs),
        ("method", f"{story['method']}, {setting}, compiled loop"),
        ("wall time", f"{story['seconds']:.2f} s, {found.runs / story['seconds']:.3g} runs a second"),
    ]
    if outcomes := story.get("outcomes"):
        counts = ", ".join(f"{number} {name}" for name, number in outcomes.items())
        table.append(("capture", f"of {found.runs} runs: {counts}"))
    if words := words_of_endings(story.get("endings", [])):
        table.append(("ended", f"of {found.runs} runs: {words}"))
    every = list(map(headline, found.headlines))
    table += [(one.words, _quantiles(one, found)) for one in every if not one.detail]
    notes = [*story.get("notes", []), *worth(found)]
    if details := sum(one.detail for one in every):
        notes.append(f"ensemble.h5 has {details} more headlines, each of one of many")
    return [*table, *_elements(found), *(("note", words) for words in notes)]


def worth(found: EnsembleResult) -> list[str]:
    """Words for runs that are too few to show how far a number is known, or that are all the same one."""
    lone = "these are the numbers of one run of a chaotic net"
    if not found.provenance["move_m"]:
        return [f"{lone}: no start is moved; --perturb 1e-9 shows how far each is known"]
    if found.runs == 1:
        return [f"{lone}: -n {COVERING} shows how far each is known"]
    if found.runs < FEWEST:
        return [
            f"ranges of {found.runs} runs, of which nothing is claimed; -n {COVERING} holds most of others"
        ]
    return []


def _quantiles(one: Headline, found: EnsembleResult) -> str:
    least, low, middle, high, largest = found.quantile(one.key, (0.0, 0.05, 0.5, 0.95, 1.0))
    unit = f" {one.unit}" if one.unit else ""
    last = max(unit_of_last_digit(max(abs(least), abs(largest)), one.digits), one.least)
    words = [printed(float(value), last) for value in (middle, low, high, least, largest)]
    missing = int(np.isnan(found.headlines[one.key]).sum())
    having = found.runs - missing
    some = f"; not in {missing} of the runs" if missing else ""
    if words[3] == words[4]:
        moved = found.provenance["move_m"] > 0.0 and having > 1
        return f"{words[0]}{unit}{f' in all {having} runs' if moved else ''}{some}"
    if having < FEWEST:
        return f"{words[3]} to {words[4]}{unit}, least to largest of {having} runs{some}"
    return (
        f"median {words[0]}{unit}, 5 % to 95 %: {words[1]} to {words[2]}{unit}, all: {words[3]} to "
        f"{words[4]}{unit}{some}"
    )


def _elements(found: EnsembleResult) -> list[tuple[str, str]]:
    elements, counts = np.unique(found.elements[found.elements >= 0], return_counts=True)
    if not len(elements):
        return []
    order = np.argsort(-counts, kind="stable")[:5]
    words = ", ".join(f"{elements[k]} in {counts[k]}" for k in order)
    more = f", others in {found.runs - counts[order].sum()}" if len(elements) > len(order) else ""
    return [("elements", f"largest tension in element {words}{more} of {found.runs} runs")]
