"""Figure of a cost study: errors and metrics against wall time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from exunet.methods.method import Backend
from exunet.plots.style import BLACK, BLUE, GREY, INCH, RED, SMALL, YELLOW, blank
from exunet.results.metrics import Metric
from exunet.studies.cost.report import BACKENDS, in_order, named, varying
from exunet.studies.cost.settings import ACCURATE, Varied, power
from exunet.studies.cost.study import LEVELS, Row, Study

_FLOOR = 1e-13  # errors below are drawn here
_COLOURS = {Backend.COMPILED: BLUE, Backend.EXUDYN: RED, None: YELLOW}
_WIDTH, _HEIGHT = 170.0, 85.0  # mm
_LEGEND: dict[str, Any] = {"loc": "outside upper center", "ncols": 2, "frameon": False, "fontsize": SMALL}


def figure_of(parts: list[Study]) -> Figure | None:
    """Draw errors against wall time, and beside it at most two metrics; None without runs."""
    errors = next((part for part in parts if part.by_trajectory and part.front), None)
    metrics = [(part, quantity) for part in parts for quantity in varying(part)[:2]]
    if errors is None and not metrics:
        return None
    figure = blank(_WIDTH / INCH, _HEIGHT / INCH)
    figure.set_layout_engine("constrained")
    both = errors is not None and bool(metrics)
    left, right = np.ravel(np.array(figure.subfigures(1, 2))).tolist() if both else (figure, figure)
    if errors is not None:
        _error_panel(left.subplots(), errors)
        left.legend(**_LEGEND)
    if metrics:
        shape = (len(metrics), 1) if both else (1, len(metrics))
        panels = np.ravel(right.subplots(*shape, sharex=both))
        for axes, (part, quantity) in zip(panels, metrics, strict=True):
            _metric_panel(axes, part, quantity)
        right.legend(*panels[0].get_legend_handles_labels(), **_LEGEND)
    return figure


def _error_panel(axes: Axes, study: Study) -> None:
    """Errors against wall time: a curve a method in the colour of its backend, the front, and accuracies."""
    limits = [max(row.error, _FLOOR) for row in study.rows if row.run]
    style: dict[str, Any] = {"color": GREY, "linewidth": 7, "alpha": 0.6, "solid_capstyle": "round"}
    axes.loglog(*_points(study.front), label="front: fastest for each error", **style)
    best = {_best(study, backend): words for backend, words in BACKENDS.items()}
    for name in dict.fromkeys(row.setting.name for row in study.rows):
        rows = [row for row in study.rows if row.setting.name == name and row.run]
        if not rows:
            continue
        color, top = _COLOURS[rows[0].setting.backend], name in best
        style = {"color": color, "marker": "o", "markersize": 2.0, "linewidth": 0.5, "alpha": 0.45}
        if top:
            style |= {"markersize": 3.5, "linewidth": 1.4, "alpha": 1.0}
        if name == ACCURATE:
            style = {"color": BLACK, "marker": "*", "markersize": 5.0, "linestyle": "", "zorder": 5}
        axes.loglog(*_points(rows), label=ACCURATE if name == ACCURATE else best.get(name), **style)
        if top or name == ACCURATE:
            row = rows[-1] if name == ACCURATE else rows[0]
            label = power(row.setting.accuracy) if row.setting.accuracy else str(row.setting.method)
            where, how = (row.median, max(row.error, _FLOOR)), {"color": style["color"], "fontsize": SMALL}
            axes.annotate(label, where, (4, 4), textcoords="offset points", **how)
    axes.set_xlabel("wall time of a run [s]")
    axes.set_ylabel(f"error of speeds at {study.subject.end:.3g} s / launch speed")
    if study.uncertainty > _FLOOR:
        axes.axhspan(_FLOOR, study.uncertainty, color="0.92", zorder=0, label="not resolved")
    axes.set_ylim(min(limits) / 3.0, 5.0 * max(limits))
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)


def _best(study: Study, backend: Backend | None) -> str:
    """Name of the method of a backend that is fastest for an error of 1e-3, or at all."""
    rows = [row for row in study.rows if row.run and row.setting.backend == backend]
    rows = [row for row in rows if row.setting.accuracy is None]
    return min(rows, key=lambda row: (row.error > LEVELS[1], row.median)).setting.name if rows else ""


def _points(rows: list[Row]) -> tuple[list[float], list[float]]:
    return [row.median for row in rows], [max(row.error, _FLOOR) for row in rows]


def _metric_panel(axes: Axes, study: Study, quantity: Metric) -> None:
    """Medians and ranges of a metric against wall time, with the range of the finest setting."""
    groups = dict[str, list[Row]]()
    for row in in_order(study):
        if quantity.key in row.comparisons:
            sizes = row.setting.varied in (Varied.SIZE, Varied.METHOD)
            groups.setdefault(str(row.setting.method if sizes else row.setting.varied), []).append(row)
    for k, (name, rows) in enumerate(groups.items()):
        rows.sort(key=lambda row: row.median)
        found = [row.comparisons[quantity.key] for row in rows]
        middle = np.array([one.median for one in found])
        low, high = (np.array([end(one.values) for one in found]) for end in (np.min, np.max))
        joined = "-" * (rows[0].setting.varied in (Varied.SIZE, Varied.METHOD))
        style: dict[str, Any] = {"color": (BLUE, RED, YELLOW, BLACK, GREY)[k % 5], "capsize": 2.0}
        style |= {"markersize": 4.0, "linewidth": 1.0, "fmt": f"{joined}{'osDv^*'[k % 6]}", "label": name}
        axes.errorbar([row.median for row in rows], middle, [middle - low, high - middle], **style)
    if (finest := study.finest) is not None and quantity.key in finest.comparisons:
        values = finest.comparisons[quantity.key].values
        axes.axhspan(values.min(), values.max(), color="0.88", zorder=0, label="range of the finest")
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(named(quantity).replace(" [", "\n["))
    if (spec := axes.get_subplotspec()) is not None and spec.is_last_row():
        axes.set_xlabel("wall time of a run [s]")
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)
