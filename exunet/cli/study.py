"""`exunet study`: a study from its file into a folder, and its answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from shlex import quote

import numpy as np
import typer

from exunet.base.errors import ExunetError, FigureError, InputError
from exunet.base.times import duration
from exunet.cli.output import RESULTS, ProgressBar, report, silent, terminal_width
from exunet.cli.run import RunOptions, run_case
from exunet.plots.registry import STUDY_FIGURES, save_figures
from exunet.results.outcome import Outcome
from exunet.scene.casefile import Case
from exunet.studies import estimates
from exunet.studies.executor import cluster
from exunet.studies.optimise import GIVEN, Optimum, gain, optimise, runs_of, scores_of
from exunet.studies.report import (
    CAPTURED,
    FIGURES,
    REPORT,
    drivers_of,
    labels_of,
    short,
    study_data,
    write_report,
)
from exunet.studies.rows import OK, ROWS_FILE
from exunet.studies.study import Study, StudyTable, name_of

TABLE = "table.csv"
_FILES = (REPORT, TABLE, ROWS_FILE, FIGURES)
_POINTS = 10  # of a grid that are printed
_LINES = 20  # that are printed
_NAME = 13


def run_study(
    path: Path,
    out: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    runs: int | None = None,
    *,
    dry: bool = False,
    quiet: bool = False,
) -> None:
    """Run a study's file, or go on with the study of a folder; write all files, print the answer."""
    if path.is_dir() and runs is not None:
        raise InputError("--runs: requires the study's file")
    study = Study.of_folder(path) if path.is_dir() else Study.read(path, runs=runs)
    folder = path if path.is_dir() else out or RESULTS / study.name
    if dry:
        study.validate()
        typer.echo("\n".join(_dry(study)))
        return
    part, say = _shard(shard), silent if quiet else lambda words: report(f"note: {words}")
    client = None if scheduler is None else cluster(scheduler)
    try:
        with ProgressBar(quiet=quiet) as bar:
            update = bar.begin("run", runs_of(study) / (part[1] if part else 1))
            progress = lambda done, _: update(done)  # noqa: E731
            if study.config.optimise is None:
                table = study.run(folder, workers, client=client, shard=part, progress=progress, note=say)
            elif part is not None:
                raise InputError("--shard: is not for a study with [optimise]")
            else:
                table = optimise(study, folder, workers, client=client, progress=progress, note=say)
    finally:
        if client is not None:
            client.close()
    failed: FigureError | None = None
    if shard is None or table.complete:
        table.write_csv(folder / TABLE)
        try:
            save_figures(study_data(table), folder / FIGURES, overwrite=True)
        except FigureError as error:
            failed = error
        figures = [path for name in STUDY_FIGURES if (path := folder / FIGURES / f"{name}.png").is_file()]
        write_report(table, list(_lines(table)), figures, folder / REPORT)
    if not quiet:
        show_study(folder)
    if failed is not None:
        raise failed


def show_study(folder: Path) -> None:
    """Print the answer of a study again."""
    first, *lines, last = _lines(StudyTable(folder))
    if (more := len(lines) - _LINES + 3) > 1:
        lines[-more:] = [f"  {more} lines more: {folder / REPORT}"]
    typer.echo("\n".join([first, *lines, last]))


def compare_studies(a: Path, b: Path) -> None:
    """Print outcomes and metrics of two studies beside each other, and their paired differences."""
    one, other = StudyTable(a), StudyTable(b)
    theirs = other.files.about("identity")
    differ = [key for key, value in one.files.about("identity").items() if theirs.get(key) != value]
    typer.echo(f"A: {a}, B: {b}\n  keys that differ   {', '.join(differ) or 'none'}")
    names = dict.fromkeys((*one.config.outputs.named, *other.config.outputs.named))
    for design in _designs(one):
        if design not in _designs(other):
            continue
        for side, table in (("A", one), ("B", other)):
            if (table.outcome != "").any():
                typer.echo(_row(f"{CAPTURED} {side}", str(table.probability(CAPTURED, design))))
            for name in names:
                typer.echo(_row(f"{name} {side}", _metric(table, name, design)))
        head = "B - A" if design is None else f"B - A of {design}"
        try:
            for name in (CAPTURED, *names):
                if (found := one.paired(name, design, design, other)) is not None:
                    typer.echo(_row(head, f"{name}: {found}"))
        except InputError as error:
            words = str(error) if set(one.inputs) == set(other.inputs) else "the inputs differ"
            typer.echo(_row(head, f"unpaired: {words}"))


def _designs(table: StudyTable) -> list[str | None]:
    return [item.name for item in table.config.designs] or [None]


def run_of_study(folder: Path, run: int, *, quiet: bool = False) -> ExunetError | None:
    """Compute the full result of a run of a study, into a folder of its own in the study's."""
    case = StudyTable(folder).case(run)
    assert isinstance(case, Case)  # no start: a table from a folder does not have a function
    return run_case(case, RunOptions(folder / f"run-{run}", overwrite=True, quiet=quiet, runs=0))


def _shard(text: str | None) -> tuple[int, int] | None:
    try:
        k, n = (0, 0) if text is None else (int(part) for part in text.split("/"))
    except ValueError:
        raise InputError(f"--shard: must be K/N, such as 3/16, got {text}") from None
    return None if text is None else (k, n)


def _dry(study: Study) -> Iterator[str]:
    """Yield the design, the number of runs and three samples."""
    config = study.config
    kind = f"{config.design}, {config.points} samples"
    if config.designs:
        kind += f" x {len(config.designs)} designs ({', '.join(item.name for item in config.designs)})"
    if config.replicates > 1:
        kind += f" x {config.replicates} replicates"
    if config.optimise is not None:
        kind += f", for each of {config.optimise.designs} designs and the given one"
    yield f"{study.title}: {kind}: {runs_of(study)} runs"
    for run in range(min(3, study.number_of_cases)):
        sample = study.samples.of_runs([run])[0]
        values = [*_design(study, run), *(f"{key} = {short(sample[key])}" for key in config.inputs)]
        yield f"  sample {run}   {'   '.join(values)}"


def _design(study: Study, run: int) -> list[str]:
    designs = study.config.designs
    return [designs[study.samples.design(run)].name] if designs else []


def _lines(table: StudyTable) -> Iterator[str]:
    """Yield the answer of a study, at most 20 lines."""
    study, config, width = table.study, table.config, terminal_width()
    number = f"{len(table)} runs" if table.complete else f"{len(table)} of {config.number_of_rows} runs"
    seed = "" if config.design == "grid" else f", seed {config.seed}"
    workers = max(table.files.abouts("workers"))
    cost = f"{duration(float(table.seconds.sum()))} of runs on {workers} core{'s' if workers > 1 else ''}"
    known = f"{number} of {study.case_names}, {config.design}{seed}; {cost}"
    gap = width - len(study.title) - len(known)
    yield f"{study.title}{' ' * gap}{known}" if gap > 1 else f"{study.title}\n  {known}"
    if len(table):
        designs = _designs(table)
        yield from _outcomes(table, designs)
        if config.design == "grid":
            yield from _points(table)
        else:
            yield from (
                _row(name, _metric(table, name, design)) if design is None
                else _row(f"{name}, {design}", _metric(table, name, design))
                for name in config.outputs.named for design in designs
            )  # fmt: skip
            for second in designs[1:] if designs[0] is not None else ():
                yield from _pairs(table, designs[0], second)
            yield from _drivers(table)
            yield from _optimum(table)
    present, folder = [name for name in _FILES if (table.folder / name).exists()], quote(str(table.folder))
    yield f"  {table.folder}/   {'  '.join(present)}        exunet study {folder} --run 0"


def _row(name: str, words: str) -> str:
    return f"  {name:<{_NAME}}{words}" if len(name) < _NAME else f"  {name}   {words}"


def _outcomes(table: StudyTable, designs: list[str | None]) -> Iterator[str]:
    """Yield probabilities of capture, other outcomes, and runs without an outcome."""
    outcome, status = table.outcome.tolist(), table.status
    others = Counter(words for words in outcome if words)
    if others.keys() - {Outcome.UNDETERMINED.value} and table.config.design != "grid":
        for design in designs:
            words = str(table.probability(CAPTURED, design))
            words += "   conservative: a Latin hypercube" if table.config.design == "lhs" else ""
            yield _row(CAPTURED, f"{design}   {words}" if design else words)
    others.pop(CAPTURED, None)
    words = ", ".join(f"{name} {count}" for name, count in others.most_common())
    if others[Outcome.UNDETERMINED.value]:
        first = table.column("run")[outcome.index(Outcome.UNDETERMINED.value)]
        words += f" (first undetermined: run {first})"
    if (bad := np.flatnonzero(status != OK)).size:
        counts = ", ".join(f"{name} {count}" for name, count in Counter(status[bad]).most_common())
        run = name_of(*(int(table.column(name)[bad[0]]) for name in ("run", "replicate")))
        note = str(table.column("note")[bad[0]]).strip().rpartition("\n")[2]
        words += f"{'; ' if words else ''}{counts} (run {run}: {note[:60]})"
    if words:
        yield _row("otherwise", words)


def _metric(table: StudyTable, name: str, design: str | None) -> str:
    """Return the quantiles of a metric of a design, and the part above its limit."""
    mine = table.of_design(design)
    if (found := estimates.quantiles(values := table.responses(name)[mine])) is None:
        return "no run has it"
    words = f"{found.low:.3g} to {found.high:.3g}"
    if found.median is not None:
        words = f"median {found.median:.3g}, 95 % of runs below {found.high:.3g}"
        words += "" if found.upper is None else f" (at most {found.upper:.3g}, one-sided 95 %)"
    words += f", in {found.runs} runs" if found.runs < mine.sum() else ""
    limit = table.config.outputs.limits.get(name)
    return words if limit is None else f"{words}; {estimates.exceedance(values, limit)}"


def _drivers(table: StudyTable) -> Iterator[str]:
    """Yield the inputs that drive the probability of capture, or the first metric."""
    config = table.config
    if config.designs:
        return
    if config.design == "saltelli":
        names = (CAPTURED, *config.outputs.named) if table.complete else ()
        response = {name: table.responses(name) for name in names}
        name = next((name for name, values in response.items() if np.nanstd(values) > 0.0), "")
        blocks = response[name].reshape(-1, config.rows_of_point).T if name else np.zeros((1, 1))
        indices = estimates.sobol_indices(list(labels_of(table.inputs)), blocks, config.seed)
        if indices is not None:
            parts = (f"{item.name} {item.first.value:.2f}, {item.excess:.2f}" for item in indices.inputs)
            words = f"{'   '.join(parts)}   (first order, total - dummy of {indices.scatter:.2f})"
            yield _row(f"Sobol' indices of {name}", words)
    elif found := drivers_of(table):
        name, effects = next(iter(found.items()))
        signs = {1: " (+)", -1: " (−)"}
        words = "   ".join(f"{item.name} {item.index:.2f}{signs.get(item.sign, '')}" for item in effects[:5])
        level = max(item.level for item in effects)
        yield _row(f"drivers of {name}", f"{words}   (first order; below {level:.2g} as good as none)")


def _pairs(table: StudyTable, first: str | None, second: str | None) -> Iterator[str]:
    """Yield the paired differences of two designs."""
    for name in (CAPTURED, *table.config.outputs.named):
        if (name != CAPTURED or (table.outcome == CAPTURED).any()) and (
            found := table.paired(name, first, second)
        ) is not None:
            words = f"{second} - {first}: "
            if name == CAPTURED:
                parts = (
                    f"{design} {table.probability(name, design).value:.3f}" for design in (first, second)
                )
                words = f"{', '.join(parts)}; "
            yield _row(name, f"{words}{found}")


def _optimum(table: StudyTable) -> Iterator[str]:
    """Yield the best designs, their gain in fresh runs, and whether the constraints hold there."""
    config, optimum = table.config.optimise, Optimum.of(table)
    if config is None or optimum is None:
        return
    if optimum.fresh is None:
        yield _row("optimise", f"none of {len(optimum.trials)} designs satisfies the constraints")
        return
    fresh = StudyTable(table.folder / optimum.fresh)
    first = fresh.of_design(GIVEN)
    before, given = scores_of(config, fresh, GIVEN)
    for number in optimum.best:
        values = "   ".join(f"{key} = {short(value)}" for key, value in optimum.trials[number].values.items())
        yield _row("best" if len(optimum.best) == 1 else "front", f"design {number}: {values}")
        second = fresh.of_design(str(number))
        scores, margins = scores_of(config, fresh, str(number))
        for k, text in enumerate(config.maximise):
            quantity = config.quantities[k]
            response = fresh.responses(quantity.name)
            found = gain(quantity, response[first], response[second], fresh.config.seed)
            name = "gain" if found.low > 0.0 else "loss" if found.high < 0.0 else "no gain shown:"
            words = (
                f"{text}: given {before[k]:.4g}, design {number} {scores[k]:.4g}; {name} {found.value:+.3g} "
            )
            words += f"({found.low:+.3g} to {found.high:+.3g})"
            yield _row("", f"{words}, in {second.sum()} fresh runs")
        for text, margin, other in zip(config.constraints, margins, given, strict=True):
            words = f"{'holds' if margin >= 0.0 else 'DOES NOT HOLD'} by {margin:+.3g}, given {other:+.3g}"
            yield _row("", f"{text}: {words}")


def _points(table: StudyTable) -> Iterator[str]:
    """Yield the median of the metrics, and the part captured, of each point of a grid."""
    study, config, runs = table.study, table.config, table.column("run")
    names = [name for name in config.outputs.named if name in table.metrics]
    columns, captured = [table.column(name) for name in names], table.outcome == CAPTURED
    counted = [CAPTURED] if captured.any() else []
    lines = [[*(["design"] if config.designs else []), *config.inputs, *counted, *names]]
    for run in np.unique(runs)[:_POINTS].tolist():
        mine, sample = runs == run, study.samples.of_runs([run])[0]
        line = [*_design(study, run), *(short(sample[key]) for key in config.inputs)]
        line += [f"{captured[mine].sum()} of {mine.sum()}" for _ in counted]
        for values in columns:
            there = values[mine][~np.isnan(values[mine])]
            line.append(f"{np.median(there):.4g}" if len(there) else "-")
        lines.append(line)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        yield "  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
    if (more := study.number_of_cases - len(lines) + 1) > 0:
        yield f"  {more} points more: {TABLE}"
    if config.replicates > 1:
        yield f"  medians of {config.replicates} runs, all but one from starts perturbed by 1e-9 m"
