"""Cost study as rows of text with a recommendation, as a CSV file, and as a figure."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from exunet.base.files import replacing
from exunet.plots.style import MAX_CURVES, blank, curve_styles
from exunet.results.metrics import Metric, printed
from exunet.studies.cost.settings import Setting, Varied
from exunet.studies.cost.study import Comparison, Row, Status, Study

Rows = list[tuple[str, str]]

LEVELS = tuple(10.0**-k for k in range(2, 9))
LEGEND = (
    "medians, with their shifts against the finest setting in brackets; *: significant, !: matters, since it "
    "is a third of the range of the finest runs or more"
)
_FLOOR = 1e-13  # errors below are drawn here
_WIDTH, _HEIGHT, _HEAD, _INCH = 170.0, 45.0, 35.0, 25.4  # mm: figure, row of panels, legend and label


def recommendation(study: Study) -> Rows:
    """Rows (name, text): the cheapest setting for each error, or with the distributions of the finest."""
    return _cheapest_for_errors(study) if study.by_trajectory else _cheapest_that_holds(study)


def _cheapest_for_errors(study: Study) -> Rows:
    """A row for each cheapest setting, with the smallest error that it has."""
    found: dict[str, tuple[str, Row | None]] = {}
    for level in LEVELS:
        row = study.cheapest(level)
        text = "no setting that was run"
        if level < study.uncertainty:
            text = f"not resolved: the converged solutions differ by {study.uncertainty:.1e}"
        elif row is not None:
            text = f"{row.setting}: {row.median:.3g} s, error {row.error:.1e}"
            text += "" if study.finer(row) else "; unconfirmed: no finer setting ran"
        name = f"error <= {level:.0e}"
        found[text] = (name, row) if row is not None else found.get(text, (name, None))
    rows: Rows = []
    for text, (name, row) in found.items():
        rows += [(name, text), *(_options(row.setting) if row is not None else ())]
    return rows


def _cheapest_that_holds(study: Study) -> Rows:
    rows = [_summary(row) for row in _sorted(study)] + [("", LEGEND)]
    best, finest = study.recommended, study.finest
    if best is None or not any(study.complete(row) for row in study.rows if row is not finest):
        text = "no two settings have their perturbed runs: give a larger --budget or an earlier --until"
        return [*rows, ("recommended", text)]
    why = "no other setting holds" if best is finest else "no shift matters, same outcome as the finest"
    rows += [
        ("recommended", f"{best.setting.name}, {best.median:.3g} s a run: {why}"),
        *_options(best.setting),
    ]
    shown = {key: one.shown_equal for key, one in best.comparisons.items()} if best is not finest else {}
    unsure = [quantity.words for quantity in study.quantities if not shown.get(quantity.key, True)]
    if unsure:
        text = "more runs are needed to show that the shift does not matter (two one-sided tests at 5 %)"
        rows.append(("not shown", f"{', '.join(unsure)}: {text}"))
    return rows


def _options(setting: Setting) -> Rows:
    return [("to run it" if k == 0 else "", f"--set '{key}'") for k, key in enumerate(setting.overrides())]


def _summary(row: Row) -> tuple[str, str]:
    """Setting, with cost, measures and outcome."""
    parts = [] if row.run is None else [f"{row.median:.3g} s, {row.evaluations:g} evaluations of the forces"]
    samples = row.distribution[:1]
    parts += [
        f"{of.words} {_cell(of, row.comparisons[of.key])}"
        for sample in samples
        for of in sample.measures.values()
    ]
    return str(row.setting), "; ".join([*parts, *filter(None, (_outcomes(row), _remark(row)))])


def _cell(quantity: Metric, one: Comparison) -> str:
    """Median with its shift and marks; of the finest with its range."""
    last = quantity.last_digit(one.median)
    value = f"{printed(one.median, last)} {quantity.unit}".rstrip()
    if math.isnan(one.shift):
        low, high = (printed(float(end(one.values)), last) for end in (np.min, np.max))
        return f"{value} ({low} to {high})"
    size = printed(abs(one.shift), last)
    sign = "" if size == "0" else "+" if one.shift > 0.0 else "-"
    return f"{value} ({sign}{size}){'*' * one.significant}{'!' * one.matters}"


def _outcomes(row: Row) -> str:
    counts = ", ".join(f"{name} {number}" for name, number in row.outcomes.items())
    return counts if row.same_outcome else f"{counts} !"


def _remark(row: Row) -> str:
    """Why a row did not run, or how it compares with the finest."""
    if row.status != Status.RAN:
        return f"{row.status}: {row.reason}" if row.reason else str(row.status)
    if not any(comparison.allowed for comparison in row.comparisons.values()):
        return ""
    return str(row.verdict) if row.samples else "single run"


def notes(study: Study) -> Rows:
    """Rows (name, text): the converged solution, perturbed runs, and settings that did not run."""
    rows: Rows = []
    solution = study.converged
    if solution is not None:
        rows += [("converged solution", text) for text in solution.notes]
        if not solution.predicts:
            text = f"speeds are not predictable from about t = {solution.horizon:.3g} s on: measures are"
            rows.append(("horizon", f"{text} compared; an earlier --until compares trajectories"))
        elif solution.sensitivity > max(1e-2, 1e3 * solution.uncertainty):
            text = "speeds at the end hold for exactly this start, for example because it is symmetric"
            rows.append(("sensitive start", text))
    rows += [("note", study.note)] if study.note else []
    if not study.by_trajectory:
        numbers = sorted(len(row.samples) for row in study.rows if row.samples) or [0]
        text = f"{numbers[0]} to {numbers[-1]} of each setting, perturbed by up to {study.perturbation:.2g} m"
        return [*rows, ("perturbed runs", text)]
    refused: dict[str, dict[str, None]] = {}
    for row in study.rows:
        if row.status == Status.REFUSED:
            refused.setdefault(row.reason, {})[row.setting.name] = None
    rows += [("not possible", f"{', '.join(names)}: {reason}") for reason, names in refused.items()]
    failed = Counter(row.setting.name for row in study.rows if row.status == Status.FAILED)
    if failed:
        names = ", ".join(f"{name} {number}" for name, number in failed.items())
        rows.append(("failed", f"{failed.total()} settings ({names}): reasons in cost.csv"))
    waiting = sum(row.status == Status.NOT_RUN for row in study.rows)
    if waiting:
        rows.append(("not run", f"{waiting} of {len(study.rows)} settings: give a larger --budget"))
    return rows


def _sorted(study: Study) -> list[Row]:
    """Rows by what they vary and by name, from loose to fine."""
    order, names = list(Varied), list(dict.fromkeys(row.setting.name for row in study.rows))

    def key(row: Row) -> tuple[int, int, float]:
        sizes = row.setting.varied == Varied.SIZE  # whose names have the factor
        return (
            order.index(row.setting.varied),
            0 if sizes else names.index(row.setting.name),
            -row.setting.size,
        )

    return sorted(study.rows, key=key)


def write_csv(study: Study, path: Path) -> None:
    """Write a line for each setting; cells are empty where nothing was measured."""
    front = study.pareto(lambda row: row.median)
    lines = [_fields(row) | {"pareto": row in front} for row in _sorted(study)]
    names = list(dict.fromkeys(name for line in lines for name in line))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(lines)


def _fields(row: Row) -> dict[str, object]:
    names = ("varied", "name", "method", "backend", "tolerance", "step")
    fields: dict[str, object] = {name: getattr(row.setting, name) for name in names}
    if row.run is not None:
        fields |= {"seconds": row.median, "repeats": len(row.seconds), **asdict(row.run.work)}
        fields |= {
            "speed_error": row.error,
            "energy_error": row.run.energy,
            "momentum_error": row.run.momentum,
        }
    for key, one in row.comparisons.items():
        fields |= {key: one.median, f"{key}_min": one.values.min(), f"{key}_max": one.values.max()}
        fields |= {f"{key}_shift": one.shift, f"{key}_low": one.low, f"{key}_high": one.high}
        fields |= {f"{key}_allowed": one.allowed, f"{key}_significant": one.significant}
    fields |= {"perturbed_runs": len(row.samples), "outcomes": _outcomes(row)}
    fields |= {"status": row.status, "remark": _remark(row)}
    return {name: "" if value != value else value for name, value in fields.items()}  # nan


def figure_of(study: Study) -> Figure | None:
    """Draw errors against wall time and evaluations, or measures against wall time; None without runs."""
    panels: list[Callable[[Axes], None]] = []
    if study.by_trajectory and any(row.run for row in study.rows):
        panels.append(
            lambda axes: _error_panel(axes, study, lambda row: row.median, "wall time of a run [s]")
        )
        panels.append(
            lambda axes: _error_panel(axes, study, lambda row: row.evaluations, "evaluations of forces")
        )
    panels += [partial(_measure_panel, study=study, quantity=quantity) for quantity in study.quantities]
    if not panels:
        return None
    count = -(-len(panels) // 2)
    figure = blank(_WIDTH / _INCH, (_HEAD + _HEIGHT * max(count, 1.5)) / _INCH)
    figure.set_layout_engine("constrained")
    grid, handles = figure.subplots(count, 2, squeeze=False).ravel(), dict[str, Any]()
    for draw, axes in zip(panels, grid, strict=False):
        draw(axes)
        axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    place: dict[str, Any] = {"loc": "outside upper center", "ncols": 3, "frameon": False}
    title = "INCOMPLETE: interrupted" if study.interrupted else None
    figure.legend(list(handles.values()), list(handles), title=title, **place)
    return figure


def _error_panel(axes: Axes, study: Study, effort: Callable[[Row], float], label: str) -> None:
    """Errors against effort with the Pareto front; curves far from it are pale."""
    curves: dict[str, list[Row]] = {}
    for row in _sorted(study):
        if row.run is not None:
            curves.setdefault(row.setting.name, []).append(row)
    front = study.pareto(lambda row: row.median)

    def behind(name: str) -> float:
        """Smallest ratio of wall times at equal error to the front."""
        best = [min(item.median for item in front if item.error <= row.error) for row in curves[name]]
        return min(row.median / seconds for row, seconds in zip(curves[name], best, strict=True))

    def draw(rows: list[Row], **style: Any) -> None:
        axes.loglog([effort(row) for row in rows], [max(row.error, _FLOOR) for row in rows], **style)

    names = sorted(curves, key=behind)
    draw(study.pareto(effort), label="Pareto front", color="0.7", linewidth=6, marker="o", zorder=2)
    for name, style in zip(names[:MAX_CURVES], curve_styles(len(names[:MAX_CURVES])), strict=True):
        draw(curves[name], label=name, **style | {"markersize": 4.0, "linewidth": 1.2, "zorder": 3})
    for k, name in enumerate(names[MAX_CURVES:]):
        others = f"{len(names) - MAX_CURVES} others" if k == 0 else None
        draw(curves[name], label=others, color="0.82", linewidth=0.6, marker=".", markersize=2.5, zorder=1)
    axes.set_xlabel(label)
    axes.set_ylabel("speed error / launch speed")
    if study.uncertainty > _FLOOR:
        axes.axhspan(_FLOOR, study.uncertainty, color="0.93", zorder=0, label="not resolved")
    errors = [max(row.error, _FLOOR) for rows in curves.values() for row in rows]
    axes.set_ylim(min(errors) / 5.0, 5.0 * max(errors))


def _measure_panel(axes: Axes, study: Study, quantity: Metric) -> None:
    """Medians and ranges of a quantity against wall time, with the band of shifts that do not matter."""
    rows = [row for row in _sorted(study) if quantity.key in row.comparisons]
    for k, varied in enumerate(Varied):
        found = [(row.median, row.comparisons[quantity.key]) for row in rows if row.setting.varied == varied]
        if found:
            seconds, middle = (
                np.array(of) for of in zip(*((x, one.median) for x, one in found), strict=True)
            )
            low, high = (np.array([end(one.values) for _, one in found]) for end in (np.min, np.max))
            line = ("-" if varied == Varied.SIZE else "") + "osDv^"[k]
            style: dict[str, Any] = {"color": f"C{k}", "capsize": 2.0, "markersize": 4.5, "linewidth": 1.0}
            axes.errorbar(seconds, middle, [middle - low, high - middle], fmt=line, label=varied, **style)
    compared = [one for row in rows if not math.isnan((one := row.comparisons[quantity.key]).shift)]
    if compared:
        center, width = compared[0].median - compared[0].shift, max(item.allowed for item in compared)
        label = "shift that does not matter"
        axes.axhspan(center - width, center + width, color="0.88", zorder=0, label=label)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("wall time of a run [s]")
    axes.set_ylabel(f"{quantity.words} [{quantity.unit}]" if quantity.unit else quantity.words, wrap=True)
