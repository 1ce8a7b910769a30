"""`exunet study`: a study from its file into a folder, and its answer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
import typer

from exunet.base.errors import ExunetError, InputError
from exunet.cli.output import RESULTS, ProgressBar, duration, report, silent, terminal_width
from exunet.results.outcome import Outcome
from exunet.studies import estimates
from exunet.studies.executor import cluster
from exunet.studies.inputs import as_toml
from exunet.studies.rows import OK, ROWS_FILE
from exunet.studies.study import Study, StudyTable, name_of

TABLE = "table.csv"
MOST = 20  # lines
_POINTS = 10  # of a grid
_NAME = 13


@dataclass(frozen=True)
class StudyOptions:
    """Options of a study beside its file: see `exunet study -h`."""

    out: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    shard: str | None = None
    runs: int | None = None
    dry: bool = False
    quiet: bool = False


def run_study(path: Path, options: StudyOptions) -> None:
    """Run a study's file, or go on with what is in a folder; print the answer."""
    if path.is_dir():
        study, folder = Study.of_folder(path), path
    else:
        study = Study.read(path, runs=options.runs)
        folder = options.out or RESULTS / study.name
    if options.dry:
        study.validate()
        typer.echo("\n".join(_dry(study)))
        return
    client = None if options.scheduler is None else cluster(options.scheduler)
    try:
        with ProgressBar(quiet=options.quiet) as bar:
            update = bar.begin("run", study.config.number_of_rows)
            table = study.run(
                folder, options.workers, client=client, shard=_shard(options.shard),
                progress=lambda done, of: update(done),
                note=silent if options.quiet else lambda words: report(f"note: {words}"),
            )  # fmt: skip
    finally:
        if client is not None:
            client.close()
    if options.shard is None or table.complete:
        table.write_csv(folder / TABLE)
    if not options.quiet:
        show_study(folder)


def show_study(folder: Path) -> None:
    """Print the answer of a study again."""
    typer.echo("\n".join(_lines(StudyTable(folder))))


def run_of_study(folder: Path, run: int, *, quiet: bool = False) -> ExunetError | None:
    """Compute the full result of a run of a study, into a folder of its own in the study's."""
    from exunet.cli.run import RunOptions, run_case

    case = StudyTable(folder).case(run)
    return run_case(case, RunOptions(folder / f"run-{run}", overwrite=True, quiet=quiet, runs=0))


def _shard(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    try:
        k, n = (int(part) for part in text.split("/"))
    except ValueError:
        raise InputError(f"--shard: must be K/N, such as 3/16, got {text}") from None
    return k, n


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
        values = "   ".join(f"{key} = {_short(sample[key])}" for key in config.inputs)
        yield f"  sample {run}   {_design_of(study, run)}{values}"


def _design_of(study: Study, run: int) -> str:
    designs = study.config.designs
    return f"{designs[study.samples.design(run)].name}   " if designs else ""


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else as_toml(value)


def _lines(table: StudyTable) -> Iterator[str]:
    """Yield the answer of a study, at most 20 lines."""
    study, config = table.study, table.config
    files = table.files
    wall = sum(files.abouts("wall_s"))
    cores = max(files.abouts("workers"))
    number = f"{len(table)} runs" if table.complete else f"{len(table)} of {config.number_of_rows} runs"
    seed = "" if config.design == "grid" else f", seed {config.seed}"
    names = ", ".join(dict.fromkeys(path.stem for _, path in study._cases))
    known = f"{number} of {names}, {config.design}{seed}; {duration(wall)} on {cores} cores"
    gap = terminal_width() - len(study.title) - len(known)
    yield f"{study.title}{' ' * gap}{known}" if gap > 1 else f"{study.title}\n  {known}"
    if not len(table):
        return
    yield from _outcomes(table)
    if config.design == "grid":
        yield from _points(table)
    else:
        for name in config.outputs.named:
            yield from _metric(table, name)
        yield from _drivers(table)
    present = [
        name for name in ("report.html", TABLE, ROWS_FILE, "figures") if (table.folder / name).exists()
    ]
    folder = quote(str(table.folder))
    yield f"  {table.folder}/   {'  '.join(present)}        exunet study {folder} --run 0"


def _row(name: str, words: str) -> str:
    return f"  {name:<{_NAME}}{words}" if len(name) < _NAME else f"  {name}   {words}"


def _designs(table: StudyTable) -> list[str | None]:
    return [item.name for item in table.config.designs] or [None]


def _outcomes(table: StudyTable) -> Iterator[str]:
    """Yield probabilities of capture, other outcomes, and runs without an outcome."""
    outcome, status, wanted = table.outcome, table.status, Outcome.CAPTURED.value
    determined = np.array([bool(words) and words != Outcome.UNDETERMINED.value for words in outcome])
    for design in _designs(table) if determined.any() else ():
        found = table.probability(wanted, design)
        hits = round(found.value * found.runs)
        words = f"{hits} of {found.runs} = {found.value:.3g}"
        either = f", {_runs(found.undetermined)} counted either way" if found.undetermined else ""
        conservative = ", conservative" if table.config.design == "lhs" else ""
        words += f"   ({found.level:.0%}: {found.low:.3f} to {found.high:.3f}{either}{conservative})"
        yield _row(wanted, words if design is None else f"{design}   {words}")
    others = Counter(words for words in outcome.tolist() if words and words != wanted)
    words = ", ".join(f"{name} {count}" for name, count in others.most_common())
    lost = Counter(state for state in status.tolist() if state != OK)
    if lost:
        first = int(np.flatnonzero(status != OK)[0])
        run = name_of(int(table.column("run")[first]), int(table.column("replicate")[first]))
        note = str(table.column("note")[first]).strip().splitlines()[-1:] or [""]
        counts = ", ".join(f"{name} {count}" for name, count in lost.most_common())
        words += f"{'; ' if words else ''}{counts} (run {run}: {note[0][:60]})"
    if words:
        yield _row("otherwise", words)


def _runs(number: int) -> str:
    return "the undetermined run" if number == 1 else f"{number} undetermined runs"


def _metric(table: StudyTable, name: str) -> Iterator[str]:
    """Yield the quantiles of a metric for each design, and the part above its limit."""
    limit = table.config.outputs.limits.get(name)
    for design in _designs(table):
        label = name if design is None else f"{name}, {design}"
        mine = table.of_design(design)
        values = table.column(name)[mine] if name in table.metrics else np.zeros(0)
        values = values[~np.isnan(values)]
        if not len(values):
            yield _row(label, "no run has it")
            continue
        if len(values) < MOST:
            words = f"{values.min():.3g} to {values.max():.3g}"
        else:
            found = estimates.quantile(values, 0.95, 0.95)
            words = f"median {found.median:.3g}, 95 % of runs below {found.value:.3g}"
            if math.isfinite(found.bound):
                words += f" (at most {found.bound:.3g}, one-sided 95 %)"
        if len(values) < mine.sum():
            words += f", in {len(values)} runs"
        if limit is not None:
            above = estimates.exceedance(values, limit)
            hits = round(above.value * above.runs)
            words += f"; above {limit:g}: {hits} of {above.runs} (below {above.high:.2g})"
        yield _row(label, words)


def _drivers(table: StudyTable) -> Iterator[str]:
    """Yield the inputs that drive the probability of capture, or the first metric."""
    outcome, config = table.outcome, table.config
    if config.designs or config.design == "saltelli" or len(table) < MOST:
        return
    captured = outcome == Outcome.CAPTURED.value
    name, response = Outcome.CAPTURED.value, captured.astype(np.float64)
    if not (captured.any() and not captured.all()):
        name = next((key for key in config.outputs.named if key in table.metrics), "")
        response = table.column(name) if name else np.zeros(0)
    inputs = {key: table.column(key) for key in table.inputs}
    inputs = {key: values for key, values in inputs.items() if values.dtype != object}
    there = ~np.isnan(response)
    if not name or there.sum() < MOST:
        return
    found = estimates.drivers({k: v[there] for k, v in inputs.items()}, response[there], config.seed)
    if not found:
        return
    signs = {1: " (+)", -1: " (−)"}
    words = [f"{item.name} {item.index:.2f}{signs.get(int(np.sign(item.sign)), '')}" for item in found[:5]]
    level = max(item.level for item in found)
    yield _row(f"drivers of {name}", f"{'   '.join(words)}  (first order; below {level:.2g} as good as none)")


def _points(table: StudyTable) -> Iterator[str]:
    """Yield the median of the metrics, or the part captured, of each point of a grid."""
    config, runs = table.config, table.column("run").astype(int)
    names = [name for name in config.outputs.named if name in table.metrics]
    columns = {name: table.column(name) for name in names}
    captured = table.outcome == Outcome.CAPTURED.value
    head = [*(["design"] if config.designs else []), *config.inputs]
    head += [Outcome.CAPTURED.value] if captured.any() else []
    lines = [[*head, *names]]
    every = np.unique(runs)
    for run in every[:_POINTS].tolist():
        mine = runs == run
        sample = table.study.samples.of_runs([run])[0]
        line = [config.designs[table.study.samples.design(run)].name] if config.designs else []
        line += [_short(sample[key]) for key in config.inputs]
        line += [f"{captured[mine].sum()} of {mine.sum()}"] if captured.any() else []
        for values in columns.values():
            there = values[mine][~np.isnan(values[mine])]
            line.append(f"{np.median(there):.4g}" if len(there) else "-")
        lines.append(line)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        yield "  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
    if len(every) > _POINTS:
        yield f"  {len(every) - _POINTS} points more: {TABLE}"
    if config.replicates > 1:
        yield f"  medians of {config.replicates} starts perturbed by 1e-9 m"
