"""`exunet study`: a study from its file into a folder, and its answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
import typer

from exunet.base.errors import ExunetError, InputError
from exunet.cli.output import RESULTS, ProgressBar, duration, report, silent, terminal_width
from exunet.cli.run import RunOptions, run_case
from exunet.results.outcome import Outcome
from exunet.studies import estimates
from exunet.studies.executor import cluster
from exunet.studies.inputs import as_toml
from exunet.studies.rows import OK, ROWS_FILE
from exunet.studies.study import Study, StudyTable, name_of

TABLE = "table.csv"
_FILES = ("report.html", TABLE, ROWS_FILE, "figures")
_POINTS = 10  # of a grid that are printed
_NAME = 13
CAPTURED = Outcome.CAPTURED.value


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
    """Run a study's file, or go on with the study of a folder; write table.csv, print the answer."""
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
            update = bar.begin("run", study.config.number_of_rows / (part[1] if part else 1))
            progress = lambda done, _: update(done)  # noqa: E731
            table = study.run(folder, workers, client=client, shard=part, progress=progress, note=say)
    finally:
        if client is not None:
            client.close()
    if shard is None or table.complete:
        table.write_csv(folder / TABLE)
    if not quiet:
        show_study(folder)


def show_study(folder: Path) -> None:
    """Print the answer of a study again."""
    typer.echo("\n".join(_lines(StudyTable(folder))))


def run_of_study(folder: Path, run: int, *, quiet: bool = False) -> ExunetError | None:
    """Compute the full result of a run of a study, into a folder of its own in the study's."""
    case = StudyTable(folder).case(run)
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
    yield f"{study.title}: {kind}: {config.number_of_rows} runs"
    for run in range(min(3, study.number_of_cases)):
        sample = study.samples.of_runs([run])[0]
        values = [*_design(study, run), *(f"{key} = {_short(sample[key])}" for key in config.inputs)]
        yield f"  sample {run}   {'   '.join(values)}"


def _design(study: Study, run: int) -> list[str]:
    designs = study.config.designs
    return [designs[study.samples.design(run)].name] if designs else []


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else as_toml(value)


def _lines(table: StudyTable) -> Iterator[str]:
    """Yield the answer of a study, at most 20 lines."""
    study, config, width = table.study, table.config, terminal_width()
    number = f"{len(table)} runs" if table.complete else f"{len(table)} of {config.number_of_rows} runs"
    seed = "" if config.design == "grid" else f", seed {config.seed}"
    cost = f"{duration(sum(table.files.abouts('wall_s')))} on {max(table.files.abouts('workers'))} cores"
    known = f"{number} of {study.case_names}, {config.design}{seed}; {cost}"
    gap = width - len(study.title) - len(known)
    yield f"{study.title}{' ' * gap}{known}" if gap > 1 else f"{study.title}\n  {known}"
    if len(table):
        designs: list[str | None] = [item.name for item in config.designs] or [None]
        yield from _outcomes(table, designs)
        if config.design == "grid":
            yield from _points(table)
        else:
            yield from (
                _row(name, _metric(table, name, design)) if design is None
                else _row(f"{name}, {design}", _metric(table, name, design))
                for name in config.outputs.named for design in designs
            )  # fmt: skip
            yield from _drivers(table)
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
    values = table.column(name)[mine] if name in table.metrics else np.full(mine.sum(), np.nan)
    if (found := estimates.quantiles(values)) is None:
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
    config, names = table.config, [key for key in table.config.outputs.named if key in table.metrics]
    name, response = CAPTURED, np.where(table.undetermined, np.nan, table.outcome == CAPTURED)
    if np.ptp(response[~np.isnan(response)]) == 0.0 and names:
        name, response = names[0], table.column(names[0])
    labels = {key.rpartition(".")[2]: key for key in table.inputs}
    if len(labels) < len(table.inputs):
        labels = {key: key for key in table.inputs}
    if config.designs:
        return
    if config.design == "saltelli":
        blocks = response.reshape(-1, config.rows_of_point).T if table.complete else np.zeros((0, 0))
        indices = estimates.sobol_indices(list(labels), blocks, config.seed) if blocks.size else None
        if indices is not None:
            parts = (f"{item.name} {item.first.value:.2f}, {item.excess:.2f}" for item in indices.inputs)
            words = f"{'   '.join(parts)}   (first order, total - dummy of {indices.scatter:.2f})"
            yield _row(f"Sobol' indices of {name}", words)
    elif found := estimates.drivers({k: table.column(labels[k]) for k in labels}, response, config.seed):
        signs = {1: " (+)", -1: " (−)"}
        words = "   ".join(f"{item.name} {item.index:.2f}{signs.get(item.sign, '')}" for item in found[:5])
        level = max(item.level for item in found)
        yield _row(f"drivers of {name}", f"{words}   (first order; below {level:.2g} as good as none)")


def _points(table: StudyTable) -> Iterator[str]:
    """Yield the median of the metrics, and the part captured, of each point of a grid."""
    study, config, runs = table.study, table.config, table.column("run")
    names = [name for name in config.outputs.named if name in table.metrics]
    columns, captured = [table.column(name) for name in names], table.outcome == CAPTURED
    counted = [CAPTURED] if captured.any() else []
    lines = [[*(["design"] if config.designs else []), *config.inputs, *counted, *names]]
    for run in np.unique(runs)[:_POINTS].tolist():
        mine, sample = runs == run, study.samples.of_runs([run])[0]
        line = [*_design(study, run), *(_short(sample[key]) for key in config.inputs)]
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
