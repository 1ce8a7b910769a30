"""Cost study as tables and rows of text, and as a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np

from exunet.base.files import replacing
from exunet.base.times import duration
from exunet.methods.method import Backend
from exunet.results.metrics import Metric, printed
from exunet.studies.cost.settings import ACCURATE, INTEGRATION, Setting, Varied, power
from exunet.studies.cost.study import FEWEST, LEVELS, CostStudy, Row, Status, Verdict
from exunet.studies.divisions import PART, Refinement
from exunet.studies.samples import SettingComparison

Rows = list[tuple[str, str]]
Table = tuple[list[str], list[list[str]]]  # header, lines

BACKENDS = {Backend.COMPILED: "compiled loop", Backend.EXUDYN: "Exudyn", None: "reference"}
LEGEND = f"a median a third of its range off the finest's ({FEWEST} runs or more); ?: open, needs more runs"
MANY = 6  # columns of metrics
_NOISE = 1e3  # times its resolution that a metric must reach to be shown


def tables(parts: list[CostStudy]) -> list[Table]:
    """Wall times against errors of trajectories, or settings against metrics."""
    return [_wall_times(parts[0]) if parts[0].by_trajectory else _metrics(parts[0])]


def _wall_times(study: CostStudy) -> Table:
    """Wall time of the cheapest setting of each method for each error; what accuracies reach."""
    levels = [level for level in LEVELS if level >= study.uncertainty]
    lines = list[tuple[int, list[float], list[str]]]()
    names = dict.fromkeys((row.setting.name, row.setting.method, row.setting.backend) for row in study.rows)
    for name, method, backend in names:
        best = [study.cheapest(level, name) for level in levels]
        if any(best) and name != ACCURATE:
            left = [row for row in study.rows if row.setting.name == name and row.status == Status.NOT_RUN]
            loosest = max((row.setting.size for row in left), default=0.0)
            none = "…" if left else "–"
            cells = [
                none if row is None else "≤ " * (loosest > row.setting.size) + duration(row.wall)
                for row in best
            ]
            seconds = [math.inf if row is None else row.wall for row in best]
            lines.append((list(BACKENDS).index(backend), seconds, [BACKENDS[backend], str(method), *cells]))
    shown = [cells for _, _, cells in sorted(lines)]
    for before, line in reversed(list(pairwise(shown))):
        line[0] = "" if line[0] == before[0] else line[0]
    accurate = {row.setting.accuracy: row for row in study.rows if row.run}
    found = [accurate.get(level) for level in levels]
    floor = study.uncertainty
    reached = ["…" if row is None else f"{'≤ ' * (row.error <= floor)}{_error(row.error)}" for row in found]
    taken = ["…" if row is None else duration(row.wall) for row in found]
    what = "bullets" if len(study.subject.start.net.bullet_nodes) else "nodes"
    head = [f"error at {study.subject.end:.3g} s", f"of the speed of {what}", *map(power, levels)]
    return head, [*shown, [ACCURATE, "reaches", *reached], ["", "in", *taken]]


def _error(error: float) -> str:
    return power(error) if error else "0"


def _metrics(study: CostStudy) -> Table:
    """Settings against metrics that vary."""
    shown, finest = varying(study)[:MANY], study.finest
    outcomes = len({name for row in study.rows for name in row.outcomes}) > 1
    head = ["setting", "runs", "time", *["outcome"] * outcomes, *map(named, shown)]
    lines = list[list[str]]()
    for row in in_order(study):
        label = brief(row.setting)
        label = label.replace(row.setting.name, "the case") if row is study.rows[0] else label
        label += " (finest)" * (row is finest)
        if row.status == Status.FAILED:
            lines.append([label, "", "failed", *[""] * (len(head) - 3)])
        elif row.status == Status.RAN:
            compared = [row.comparisons.get(quantity.key) for quantity in shown]
            counts = [f"{_outcomes(row)}{'!' * (not row.same_outcome)}"] * outcomes
            number = str(len(row.distribution))
            lines.append([label, number, duration(row.wall), *counts, *map(_cell, shown, compared)])
            if row is finest:
                lines.append(["  its range", "", "", *[""] * outcomes, *map(_range, shown, compared)])
    return head, lines


def brief(setting: Setting) -> str:
    """Name a setting without the backend that all but one have."""
    words = str(setting) if setting.varied in INTEGRATION else setting.name
    return words.replace(f" ({Backend.COMPILED})", "")


def named(quantity: Metric) -> str:
    """Words and unit of a metric."""
    return f"{quantity.words} [{quantity.unit}]" if quantity.unit else quantity.words


def _cell(quantity: Metric, one: SettingComparison | None) -> str:
    """Median with a mark if its shift matters."""
    if one is None:
        return "–"
    mark = "" if not one.matters else "!" if one.significant and len(one.values) >= FEWEST else "?"
    return f"{printed(one.median, quantity.last_digit(one.median))}{mark}"


def _range(quantity: Metric, one: SettingComparison | None) -> str:
    values = [] if one is None else [one.values.min(), one.values.max()]
    return " to ".join(dict.fromkeys(printed(end, quantity.last_digit(end)) for end in values))


def varying(study: CostStudy) -> list[Metric]:
    """Quantities that differ between runs or settings by more than their printed digits, not round-off."""
    found = []
    for quantity in study.quantities:
        compared = [row.comparisons[quantity.key] for row in study.rows if quantity.key in row.comparisons]
        every = np.concatenate([one.values for one in compared])
        largest = float(np.abs(every).max())
        if float(np.ptp(every)) > quantity.last_digit(largest) and largest > _NOISE * quantity.resolution:
            found.append(quantity)
    return found


def rows_of(parts: list[CostStudy], spent: float) -> Rows:
    """Rows (name, text): metrics beyond the horizon, divisions, the recommendation, settings without runs.

    spent : wall time of the study, or its budget [s]
    """
    first, last = parts[0], parts[-1]
    rows: Rows = [*(_limits(first) if first.by_trajectory else [("!", LEGEND)])]
    if not last.by_trajectory:
        rows += [*(_beyond(last, first.subject.end) if last is not first else ()), *_divisions(last)]
    rows.append(("recommended", _recommended(last)))
    every = [(study, row) for study in parts for row in study.rows]
    waiting = [study.wall_of(row) for study, row in every if row.status == Status.NOT_RUN]
    if waiting:
        needed = spent + 1.5 * sum(waiting)
        unit = 10.0 ** (math.floor(math.log10(needed)) - 1)
        rows.append(("not run", f"{len(waiting)} settings: --budget {math.ceil(needed / unit) * unit:g}"))
    for status, words in ((Status.FAILED, "failed"), (Status.REFUSED, "not possible")):
        if number := sum(row.status == status for _, row in every):
            rows.append((words, f"{number} of {len(every)} settings: cost.csv"))
    return rows


def _limits(study: CostStudy) -> Iterator[tuple[str, str]]:
    """Yield what limits errors of trajectories: the converged solution, and a start that is symmetric."""
    solution = study.converged
    assert solution is not None
    if solution.uncertainty > LEVELS[-1]:
        words = f"errors below {_error(solution.uncertainty)}, by which converged solutions differ"
        yield "not resolved", words
    if solution.sensitivity > max(1e-2, 1e3 * solution.uncertainty):
        words = f"perturbed by 1e-12 m, speeds change by {_error(solution.sensitivity)}"
        yield "sensitive", f"errors hold for exactly this start: {words}"


def _beyond(study: CostStudy, horizon: float) -> Rows:
    """From which setting of each method on the medians hold, and the medians of the finest."""
    name, finest, groups = f"after {horizon:.3g} s", study.finest, dict[str, list[Row]]()
    for row in study.rows:
        if study.complete(row) and row.setting.varied in INTEGRATION:
            group = ACCURATE if row.setting.accuracy else str(row.setting.method)
            groups.setdefault(group, []).append(row)
    numbers = sorted(len(row.samples) for rows in groups.values() for row in rows)
    if finest is None or len(numbers) < 2:
        return [(name, "no two settings have their perturbed runs: give a larger --budget")]
    texts = []
    for group, rows in groups.items():
        rows.sort(key=lambda row: row.setting.size)
        held = next((k for k, row in enumerate(rows) if row.verdict != Verdict.HOLDS), len(rows))
        texts.append(f"{group} {rows[0].verdict}")
        if held:
            row = rows[held - 1]
            size = str(row.setting).removeprefix(f"{row.setting.name}, ")
            texts[-1] = f"{size if group == ACCURATE else f'{group} {size}'}, {duration(row.wall)} a run"
    runs = " to ".join(map(str, dict.fromkeys((numbers[0], numbers[-1]))))
    return [(name, f"metrics (medians of {runs} runs) hold from {'; '.join(texts)}")]


def _divisions(study: CostStudy) -> Iterator[tuple[str, str]]:
    """Yield for each division of the threads the metrics that it moves, and the time it takes."""
    before, about = study.rows[0], {quantity.key: quantity for quantity in varying(study)}
    for row in study.rows:
        if row.setting.varied != Varied.DIVISIONS or not (study.complete(row) and study.complete(before)):
            continue
        pairs = [(key, before.comparisons.get(key), row.comparisons.get(key)) for key in about]
        every = [
            Refinement(about[key], one.median, other.median, one.values.min(), one.values.max())
            for key, one, other in pairs
            if one is not None and other is not None
        ]
        moved = sorted((item for item in every if not item.converged), key=lambda item: -item.change)
        words = ", ".join(map(str, moved[:2])) or f"no metric moves out of its range by more than {PART:.0%}"
        more = f" and {len(moved) - 2} more" * (len(moved) > 2)
        times = f"at {row.wall / before.wall:.2g} times the time{': not converged' * bool(moved)}"
        yield f"divisions x {row.setting.elements}", f"{words}{more} {times}"
        before = row


def _recommended(study: CostStudy) -> str:
    """Options of the cheapest setting that holds or, of trajectories alone, that has the largest error."""
    row, finest = study.recommended, study.finest
    why = "more accuracy moves no metric out of its range"
    if study.by_trajectory:
        row = next((found for level in LEVELS if (found := study.cheapest(level)) is not None), None)
        why = "" if row is None else f"error {_error(row.error)}{'' if study.finer(row) else ', unconfirmed'}"
    elif row is finest:
        ran = [other for other in study.rows if other.samples and other.setting.varied in INTEGRATION]
        waits = [brief(other.setting) for other in ran if other.verdict == Verdict.OPEN and other is not row]
        why = f"undecided, more runs needed: {', '.join(waits[:2])}" if waits else "no cheaper setting holds"
        row = row if len(ran) > 1 else None
    if row is None:
        return "nothing: too few settings ran; give a larger --budget or an earlier --until"
    *changes, _ = row.setting.overrides()
    options = " ".join(f"--set '{key}'" for key in changes)
    return f"{options} --backend {row.setting.backend}   {duration(row.wall)} a run: {why}"


def in_order(study: CostStudy) -> list[Row]:
    """Rows by what they vary and by name, from loose to fine."""
    order, names = list(Varied), list(dict.fromkeys(row.setting.name for row in study.rows))

    def key(row: Row) -> tuple[int, int, float]:
        setting = row.setting
        sizes = setting.varied == Varied.SIZE  # whose names have the factor
        place = int(setting.accuracy is not None) if sizes else names.index(setting.name)
        return order.index(setting.varied), place, -setting.size

    return sorted(study.rows, key=key)


def _outcomes(row: Row) -> str:
    return ", ".join(f"{name} {number}" for name, number in row.outcomes.items())


def write_csv(parts: list[CostStudy], path: Path) -> None:
    """Write a line for each setting of each part; cells are empty where nothing was measured."""
    lines = list[dict[str, object]]()
    for study in parts:
        front = study.front if study.by_trajectory else []
        part = {"compared": "trajectory" if study.by_trajectory else "metrics", "until": study.subject.end}
        lines += [part | _fields(row) | {"pareto": row in front} for row in in_order(study)]
    names = list(dict.fromkeys(name for line in lines for name in line))
    with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(lines)


def _fields(row: Row) -> dict[str, object]:
    fields: dict[str, object] = asdict(row.setting)
    fields |= {"status": row.status, "message": row.reason, "expected_seconds": row.expected}
    if row.run is not None:
        fields |= {**asdict(row.run.work), "energy_error": row.run.energy}
    if row.seconds:
        fields |= {"seconds": row.wall, "repeats": len(row.seconds), "speed_error": row.error}
    for key, one in row.comparisons.items():
        fields |= {key: one.median, f"{key}_min": one.values.min(), f"{key}_max": one.values.max()}
        fields |= {f"{key}_shift": one.shift, f"{key}_allowed": one.allowed}
        fields |= {f"{key}_significant": one.significant}
    compared = row.samples and any(one.allowed for one in row.comparisons.values())
    fields |= {"perturbed_runs": len(row.samples), "outcomes": _outcomes(row)}
    fields |= {"verdict": row.verdict if compared else ""}
    return {name: "" if value != value else value for name, value in fields.items()}  # nan
