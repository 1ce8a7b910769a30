"""Cost study as tables and rows of text, as a CSV file, and as a figure."""

from __future__ import annotations

import csv
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from exunet.base.files import replacing
from exunet.methods.method import Backend
from exunet.plots.style import BLACK, BLUE, GREY, INCH, RED, SMALL, YELLOW, blank, legend_above
from exunet.results.metrics import Metric, printed
from exunet.studies.cost.settings import ACCURACIES, ACCURATE, Setting, Varied, power
from exunet.studies.cost.study import LEVELS, Row, Status, Study, Verdict
from exunet.studies.divisions import PART, Refinement
from exunet.studies.samples import Comparison

Rows = list[tuple[str, str]]
Table = tuple[list[str], list[list[str]]]  # header, lines

BACKENDS = {Backend.COMPILED: "compiled loop", Backend.EXUDYN: "Exudyn", None: "reference"}
MARKS = {Verdict.HOLDS: "", Verdict.OPEN: "?", Verdict.FAILS: "!"}
LEGEND = "of a median: differs from the finest setting by a third of its range or more; ?: more runs are needed"
MANY = 6  # columns of metrics
_FLOOR = 1e-13  # errors below are drawn here
_NOISE = 1e3  # times its resolution that a metric must reach to be shown
_COLOURS = {Backend.COMPILED: BLUE, Backend.EXUDYN: RED, None: YELLOW}
_WIDTH, _HEIGHT = 170.0, 75.0  # mm


def wall(seconds: float) -> str:
    """Format a wall time to two digits."""
    return f"{float(f'{seconds:.2g}'):g} s"


def tables(parts: list[Study]) -> list[Table]:
    """Wall times against errors of trajectories, and settings against metrics of a capture."""
    found = [_wall_times(part) for part in parts if part.by_trajectory]
    return [*found, *(_metrics(part) for part in parts if not part.by_trajectory and len(parts) == 1)]


def _wall_times(study: Study) -> Table:
    """Wall time of the cheapest setting of each method for each error; then accuracies and what they reach."""
    levels = [level for level in LEVELS if level >= study.uncertainty]
    lines = list[tuple[int, list[float], list[str]]]()
    for name in dict.fromkeys(row.setting.name for row in study.rows if row.setting.name != ACCURATE):
        rows = [row for row in study.rows if row.setting.name == name]
        best = [study.cheapest(level, name) for level in levels]
        if not any(best):
            continue
        waits = any(row.status == Status.NOT_RUN for row in rows)
        cells = ["…" if row is None and waits else "–" if row is None else wall(row.median) for row in best]
        order = list(BACKENDS).index(rows[0].setting.backend)
        seconds = [math.inf if row is None else row.median for row in best]
        lines.append((order, seconds, [BACKENDS[rows[0].setting.backend], str(rows[0].setting.method), *cells]))
    accurate = {row.setting.accuracy: row for row in study.rows if row.setting.name == ACCURATE and row.run}
    found = [accurate.get(level) for level in levels]
    reached = ["…" if row is None else f"{row.error:.0e}".replace("e-0", "e-") for row in found]
    taken = ["…" if row is None else wall(row.median) for row in found]
    what = "bullets" if len(study.subject.start.net.bullet_nodes) else "nodes"
    head = [f"error at {study.subject.end:.3g} s", f"of the speed of {what}", *map(power, levels)]
    shown = [cells for _, _, cells in sorted(lines)]
    names = [["" if k and shown[k - 1][0] == line[0] else line[0], *line[1:]] for k, line in enumerate(shown)]
    return head, [*names, [ACCURATE, "reaches", *reached], ["", "in", *taken]]


def _metrics(study: Study) -> Table:
    """Settings against metrics that vary."""
    shown, finest = varying(study)[:MANY], study.finest
    outcomes = len({tuple(row.outcomes) for row in study.rows if row.run}) > 1 or any(
        len(row.outcomes) > 1 for row in study.rows
    )
    head = ["setting", "a run", *["outcome"] * outcomes, *(_named(quantity) for quantity in shown)]
    lines = list[list[str]]()
    for row in _sorted(study):
        if row.status in (Status.NOT_RUN, Status.REFUSED):
            continue
        label = str(row.setting) if row.setting.varied == Varied.SIZE else row.setting.name
        label += " (finest)" if row is finest else " (the case)" if row is study.rows[0] else ""
        if row.status == Status.FAILED:
            lines.append([label, "failed", *[""] * (len(head) - 2)])
            continue
        cells = [_cell(quantity, row.comparisons.get(quantity.key)) for quantity in shown]
        counts = [f"{_outcomes(row)}{'' if row.same_outcome else '!'}"] * outcomes
        lines.append([label, wall(row.median), *counts, *cells])
        if row is finest:
            ranges = [_range(quantity, row.comparisons.get(quantity.key)) for quantity in shown]
            lines.append(["  its range", "", *[""] * outcomes, *ranges])
    return head, lines


def _named(quantity: Metric) -> str:
    return f"{quantity.words} [{quantity.unit}]" if quantity.unit else quantity.words


def _cell(quantity: Metric, one: Comparison | None) -> str:
    """Median with a mark if its shift matters."""
    if one is None:
        return "–"
    mark = "" if not one.matters else "!" if one.significant else "?"
    return f"{printed(one.median, quantity.last_digit(one.median))}{mark}"


def _range(quantity: Metric, one: Comparison | None) -> str:
    if one is None:
        return "–"
    low, high = (printed(end, quantity.last_digit(one.median)) for end in (one.values.min(), one.values.max()))
    return low if low == high else f"{low} to {high}"


def varying(study: Study) -> list[Metric]:
    """Quantities that differ between runs or settings by more than their printed digits, not round-off."""
    found = []
    for quantity in study.quantities:
        values = [row.comparisons[quantity.key].values for row in study.rows if quantity.key in row.comparisons]
        every = np.concatenate(values)
        largest = float(np.abs(every).max())
        if float(np.ptp(every)) > quantity.last_digit(largest) and largest > _NOISE * quantity.resolution:
            found.append(quantity)
    return found


def rows_of(parts: list[Study], budget: float, spent: float) -> Rows:
    """Rows (name, text): metrics beyond the horizon, divisions, the recommendation, settings without runs.

    budget, spent : wall times [s]
    """
    rows: Rows = []
    for study in parts:
        if study.by_trajectory:
            rows += _limits(study)
        else:
            rows += [*(_beyond(study, parts[0].subject.end) if len(parts) > 1 else [("? !", LEGEND)])]
            rows += _divisions(study)
    rows += _recommended(parts[-1])
    every = [(study, row) for study in parts for row in study.rows]
    waiting = [(study, row) for study, row in every if row.status == Status.NOT_RUN]
    if waiting:
        more = sum(study.wall_of(row) for study, row in waiting)
        needed = max(spent, budget) + 2.0 * more
        unit = 10.0 ** (math.floor(math.log10(needed)) - 1)
        rows.append(("not run", f"{len(waiting)} settings: --budget {math.ceil(needed / unit) * unit:g}"))
    for status, words in ((Status.FAILED, "failed"), (Status.REFUSED, "not possible")):
        if number := sum(row.status == status for _, row in every):
            rows.append((words, f"{number} of {len(every)} settings: cost.csv"))
    return rows


def _limits(study: Study) -> Rows:
    """What limits the trajectories: unresolved errors, and a start that is symmetric."""
    rows: Rows = []
    solution = study.converged
    if solution is not None and solution.uncertainty > LEVELS[-1]:
        words = f"errors below {solution.uncertainty:.0e}: the converged solutions differ by that"
        rows.append(("not resolved", words))
    if solution is not None and solution.sensitivity > max(1e-2, 1e3 * solution.uncertainty):
        words = f"for exactly this start: moved by 1e-12 m, speeds change by {solution.sensitivity:.0e}"
        rows.append(("errors hold", words))
    return rows


def _beyond(study: Study, horizon: float) -> Rows:
    """From which setting on the medians hold, of each method, and the medians of the finest."""
    complete = [row for row in _sorted(study) if study.complete(row)]
    finest, groups = study.finest, dict[str, list[Row]]()
    for row in complete:
        if row.setting.varied in (Varied.SIZE, Varied.METHOD):
            name = ACCURATE if row.setting.accuracy else str(row.setting.method)
            groups.setdefault(name, []).append(row)
    if finest is None or len(complete) < 2:
        text = "no two settings have their perturbed runs: give a larger --budget"
        return [(f"after {horizon:.3g} s", text)]
    numbers = sorted(len(row.samples) for row in complete)
    runs = f"{numbers[0]}" if numbers[0] == numbers[-1] else f"{numbers[0]} to {numbers[-1]}"
    parts = []
    for name, rows in groups.items():
        rows.sort(key=lambda row: row.setting.size)
        held = next((k for k, row in enumerate(rows) if row.verdict != Verdict.HOLDS), len(rows))
        words = f"{name}: open" if rows[0].verdict == Verdict.OPEN else f"{name}: none"
        if held:
            row = rows[held - 1]
            words = f"{row.setting.method}, {_size(row.setting)}" if name != ACCURATE else str(row.setting)
            words += f", {wall(row.median)}"
        parts.append(words)
    shown = [quantity for quantity in varying(study) if quantity.key in finest.comparisons][:3]
    medians = [
        f"{quantity.words} {_cell(quantity, one)} {quantity.unit} ({_range(quantity, one)})".replace("  ", " ")
        for quantity in shown
        for one in (finest.comparisons[quantity.key],)
    ]
    return [
        (f"after {horizon:.3g} s", f"medians of {runs} runs hold from {'; '.join(parts)}"),
        ("", f"{finest.setting}: {', '.join(medians) or 'no metric varies'}"),
    ]


def _size(setting: Setting) -> str:
    return str(setting).removeprefix(f"{setting.name}, ")


def _divisions(study: Study) -> Rows:
    """Each refinement of the threads beside the one before: metrics that move, and the time it takes."""
    rows: Rows = []
    finer = [row for row in study.rows if row.setting.varied == Varied.DIVISIONS and row.samples]
    before = study.rows[0]
    for row in finer if before.samples else ():
        pairs = [(key, one, row.comparisons.get(key)) for key, one in before.comparisons.items()]
        about = {quantity.key: quantity for quantity in varying(study)}
        every = [
            Refinement(about[key], one.median, other.median, one.values.min(), one.values.max())
            for key, one, other in pairs
            if key in about and other is not None
        ]
        moved = sorted((item for item in every if not item.converged), key=lambda item: -item.change)
        times = f"at {row.median / before.median:.2g} times the time"
        words = f"no metric moves by more than {PART:.0%}, {times}"
        if moved:
            more = f" and {len(moved) - 2} more" if len(moved) > 2 else ""
            words = f"{', '.join(map(str, moved[:2]))}{more} {times}: not converged"
        rows.append((f"divisions x {row.setting.elements}", words))
        before = row
    return rows


def _recommended(study: Study) -> Rows:
    """The cheapest setting that holds or, of trajectories alone, that has the largest error reported."""
    if study.by_trajectory:
        row = next((row for level in LEVELS if (row := study.cheapest(level)) is not None), None)
        why = "" if row is None else f"error {row.error:.0e}" + ("" if study.finer(row) else ", no finer one ran")
    else:
        row, finest = study.recommended, study.finest
        why = "no other setting holds" if row is finest else "more accuracy moves no metric out of its range"
        if row is not None and row is not finest:
            unsure = sum(not one.shown_equal for one in row.comparisons.values())
            why += f" ({unsure} of {len(row.comparisons)} metrics: more runs would show it)" if unsure else ""
        row = row if any(study.complete(other) for other in study.rows if other is not finest) else None
    if row is None:
        return [("recommended", "nothing: too few settings ran; give a larger --budget or an earlier --until")]
    options = " ".join(f"--set '{key}'" for key in row.setting.overrides())
    return [("recommended", f"{options}   {wall(row.median)} a run: {why}")]


def _sorted(study: Study) -> list[Row]:
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


def write_csv(parts: list[Study], path: Path) -> None:
    """Write a line for each setting of each part; cells are empty where nothing was measured."""
    lines = list[dict[str, object]]()
    for study in parts:
        front = study.front if study.by_trajectory else []
        part = {"compared": "trajectory" if study.by_trajectory else "metrics", "until": study.subject.end}
        lines += [part | _fields(row) | {"pareto": row in front} for row in _sorted(study)]
    names = list(dict.fromkeys(name for line in lines for name in line))
    with replacing(path) as file_part, file_part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(lines)


def _fields(row: Row) -> dict[str, object]:
    names = ("varied", "name", "method", "backend", "accuracy", "tolerance", "step")
    fields: dict[str, object] = {name: getattr(row.setting, name) for name in names}
    fields |= {"status": row.status, "message": row.reason, "expected_seconds": row.expected}
    if row.run is not None:
        fields |= {"seconds": row.median, "repeats": len(row.seconds), **asdict(row.run.work)}
        fields |= {
            "speed_error": row.error,
            "energy_error": row.run.energy,
        }
    for key, one in row.comparisons.items():
        fields |= {key: one.median, f"{key}_min": one.values.min(), f"{key}_max": one.values.max()}
        fields |= {f"{key}_shift": one.shift, f"{key}_low": one.low, f"{key}_high": one.high}
        fields |= {f"{key}_allowed": one.allowed, f"{key}_significant": one.significant}
    compared = any(one.allowed for one in row.comparisons.values())
    fields |= {"perturbed_runs": len(row.samples), "outcomes": _outcomes(row)}
    fields |= {"verdict": row.verdict if compared and row.samples else ""}
    return {name: "" if value != value else value for name, value in fields.items()}  # nan


def figure_of(parts: list[Study]) -> Figure | None:
    """Draw errors against wall time, and beside it two metrics against wall time; None without runs."""
    errors = [part for part in parts if part.by_trajectory and part.front]
    metrics = [(part, quantity) for part in parts for quantity in varying(part)[:2]]
    if not errors and not metrics:
        return None
    figure = blank(_WIDTH / INCH, _HEIGHT / INCH)
    figure.set_layout_engine("constrained")
    if errors and metrics:
        left, right = figure.subfigures(1, 2, width_ratios=(1.25, 1.0))
        grid = [left.subplots(), *np.ravel(right.subplots(len(metrics), 1, sharex=True))]
    else:
        grid = list(np.ravel(figure.subplots(1, len(errors) + len(metrics))))
    handles = dict[str, Any]()
    for axes in grid:
        if errors and axes is grid[0]:
            _error_panel(axes, errors[0])
        else:
            part, quantity = metrics[grid.index(axes) - len(errors)]
            _metric_panel(axes, part, quantity)
        axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)
        axes.set_axisbelow(True)
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        if axes is grid[-1] or (len(grid) - len(errors) == 2 and not errors) or (errors and axes is grid[0]):
            axes.set_xlabel("wall time of a run [s]")
    legend_above(figure, list(handles.values()), list(handles))
    return figure


def _error_panel(axes: Axes, study: Study) -> None:
    """Errors against wall time: a curve a method in the colour of its backend, the front, and accuracies."""
    front, limits = study.front, [max(row.error, _FLOOR) for row in study.rows if row.run]
    style: dict[str, Any] = {"color": GREY, "linewidth": 7, "alpha": 0.6, "solid_capstyle": "round"}
    axes.loglog(*_points(front), label="front: nothing is both faster and more accurate", **style)
    named = set[Backend | None]()
    best = [name for backend in BACKENDS if (name := _best(study, backend))]
    for name in dict.fromkeys(row.setting.name for row in study.rows):
        rows = [row for row in study.rows if row.setting.name == name and row.run]
        if not rows:
            continue
        backend, top = rows[0].setting.backend, name in best
        style = {"color": _COLOURS[backend], "marker": "o", "markersize": 3.5 if top else 2.0}
        style |= {"linewidth": 1.4 if top else 0.5, "alpha": 1.0 if top else 0.45}
        if name == ACCURATE:
            style = {"color": BLACK, "marker": "*", "markersize": 6.0, "linestyle": "", "zorder": 5}
            for row in rows:
                if row.setting.accuracy in ACCURACIES[1::2]:
                    axes.annotate(
                        power(row.setting.accuracy), (row.median, max(row.error, _FLOOR)), (-4, -7),
                        textcoords="offset points", ha="right", fontsize=SMALL,
                    )  # fmt: skip
        label = ACCURATE if name == ACCURATE else None
        if backend not in named and top:
            label = BACKENDS[backend]
            named.add(backend)
        axes.loglog(*_points(rows), label=label, **style)
        if top:
            where = min(rows, key=lambda row: row.error)
            axes.annotate(
                str(where.setting.method), (where.median, max(where.error, _FLOOR)), (5, 0),
                textcoords="offset points", color=_COLOURS[backend], fontsize=SMALL, va="center",
            )  # fmt: skip
    axes.set_ylabel(f"error of speeds at {study.subject.end:.3g} s / launch speed")
    if study.uncertainty > _FLOOR:
        axes.axhspan(_FLOOR, study.uncertainty, color="0.94", zorder=0, label="not resolved")
    axes.set_ylim(min(limits) / 3.0, 3.0 * max(limits))
    axes.margins(x=0.12)


def _best(study: Study, backend: Backend | None) -> str | None:
    """Name of the method of a backend that is nearest to the front."""
    rows = [row for row in study.rows if row.run and row.setting.backend == backend and not row.setting.accuracy]
    tight = [row for row in rows if row.error <= LEVELS[1]] or rows
    return min(tight, key=lambda row: row.median).setting.name if tight else None


def _points(rows: list[Row]) -> tuple[list[float], list[float]]:
    return [row.median for row in rows], [max(row.error, _FLOOR) for row in rows]


def _metric_panel(axes: Axes, study: Study, quantity: Metric) -> None:
    """Medians and ranges of a metric against wall time, with the range of the finest setting."""
    rows = [row for row in _sorted(study) if quantity.key in row.comparisons]
    groups = dict[str, list[Row]]()
    for row in rows:
        varied = row.setting.varied
        name = ACCURATE if row.setting.accuracy else str(row.setting.method)
        groups.setdefault(name if varied in (Varied.SIZE, Varied.METHOD) else str(varied), []).append(row)
    for k, (name, group) in enumerate(groups.items()):
        found = [row.comparisons[quantity.key] for row in group]
        middle = np.array([one.median for one in found])
        low, high = (np.array([end(one.values) for one in found]) for end in (np.min, np.max))
        joined = group[0].setting.varied in (Varied.SIZE, Varied.METHOD)
        style: dict[str, Any] = {"color": (BLUE, BLACK, RED, YELLOW, GREY)[k % 5], "capsize": 2.0}
        style |= {"markersize": 4.0, "linewidth": 1.0, "fmt": ("-" if joined else "") + "o*sDv^"[k % 6]}
        label = None if name == ACCURATE else name
        axes.errorbar([row.median for row in group], middle, [middle - low, high - middle], label=label, **style)
    if (finest := study.finest) is not None and quantity.key in finest.comparisons:
        values = finest.comparisons[quantity.key].values
        axes.axhspan(values.min(), values.max(), color="0.88", zorder=0, label="range of the finest setting")
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(_named(quantity).replace(" [", "\n["))
