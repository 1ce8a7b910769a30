"""Figure of a cost study: errors and metrics against wall time."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from exunet.methods.method import Backend
from exunet.plots.style import BLACK, BLUE, GREY, INCH, RED, SMALL, YELLOW, blank
from exunet.results.metrics import Metric
from exunet.studies.cost.report import BACKENDS, brief, in_order, named, varying
from exunet.studies.cost.settings import ACCURATE, INTEGRATION, Setting
from exunet.studies.cost.study import LEVELS, CostStudy, Row

_FLOOR = 1e-13  # errors below are drawn here
_COLOURS = {Backend.COMPILED: BLUE, Backend.EXUDYN: RED, None: YELLOW}
_MARKERS = "os^Dv<>Pdhp8"  # of methods, in both parts
_WIDTH, _HEIGHT = 170.0, 95.0  # mm
_SPAN = 4.0  # least ratio of the ends of an axis of wall times


def figure_of(parts: list[CostStudy]) -> Figure | None:
    """Draw errors against wall time, and beside it at most two metrics; None without runs."""
    errors = next((part for part in parts if part.by_trajectory and part.front), None)
    metrics = [(part, quantity) for part in parts if part.finest for quantity in varying(part)[:2]]
    if errors is None and not metrics:
        return None
    figure = blank(_WIDTH / INCH, _HEIGHT / INCH)
    figure.set_layout_engine("constrained")
    rows: list[Any] = [[f"metric {k}"] for k in range(len(metrics))]
    if errors is None:
        rows = [[name for (name,) in rows]]
    else:
        rows = [["errors", *row] for row in rows] or [["errors"]]
    panels, marks = figure.subplot_mosaic(rows), dict[str, str]()
    if errors is not None:
        _error_panel(panels["errors"], errors, marks)
    for k, (part, quantity) in enumerate(metrics):
        _metric_panel(panels[f"metric {k}"], part, quantity, marks)
    found = [pair for axes in panels.values() for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    labels = dict[str, Any]()
    for handle, label in found:
        labels.setdefault(label, handle)
    place: dict[str, Any] = {"loc": "outside upper center", "ncols": 3, "frameon": False, "fontsize": SMALL}
    figure.legend(list(labels.values()), list(labels), **place)
    return figure


def _style(setting: Setting, marks: dict[str, str]) -> dict[str, Any]:
    """Return colour (the backend), marker (the method, or what is varied of the model) and label."""
    if setting.name == ACCURATE:
        return {"color": BLACK, "marker": "*", "markersize": 6.0, "label": ACCURATE}
    same = setting.varied in INTEGRATION
    name = str(setting.method if same else setting.varied)
    marker = marks.setdefault(name, _MARKERS[len(marks) % len(_MARKERS)])
    label = f"{name}, {BACKENDS[setting.backend]}" if same else name
    color = _COLOURS[setting.backend] if same else "0.4"  # another model
    return {"color": color, "marker": marker, "markersize": 3.5, "label": label}


def _error_panel(axes: Axes, study: CostStudy, marks: dict[str, str]) -> None:
    """Errors against wall time: a curve a method that is in the table, the front, and accuracies."""
    limits = [max(row.error, _FLOOR) for row in study.rows if row.seconds]
    style: dict[str, Any] = {"color": GREY, "linewidth": 7, "alpha": 0.6, "solid_capstyle": "round"}
    axes.loglog(*_points(study.front), label="front: fastest for each error", **style)
    for name in dict.fromkeys(row.setting.name for row in study.rows):
        rows = [row for row in study.rows if row.setting.name == name and row.seconds]
        if rows and (name == ACCURATE or study.cheapest(LEVELS[0], name) is not None):
            style = _style(rows[0].setting, marks) | {"linewidth": 0.9 * (name != ACCURATE)}
            axes.loglog(*_points(rows), zorder=4 if name == ACCURATE else 3, **style)
    axes.set_xlabel("wall time of a run [s]")
    axes.set_ylabel(f"error of speeds at {study.subject.end:.3g} s / launch speed")
    if study.uncertainty > _FLOOR:
        axes.axhspan(_FLOOR, study.uncertainty, color="0.92", zorder=0, label="not resolved")
    axes.set_ylim(min(limits) / 3.0, 5.0 * max(limits))
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)


def _points(rows: list[Row]) -> tuple[list[float], list[float]]:
    return [row.wall for row in rows], [max(row.error, _FLOOR) for row in rows]


def _metric_panel(axes: Axes, study: CostStudy, quantity: Metric, marks: dict[str, str]) -> None:
    """Medians and ranges of a metric against wall time, with the range of the finest setting."""
    complete = [row for row in in_order(study) if study.complete(row) and quantity.key in row.comparisons]
    for row in complete:  # a single run beyond the horizon is no median
        one = row.comparisons[quantity.key]
        ends = [[one.median - one.values.min()], [one.values.max() - one.median]]
        style = _style(row.setting, marks) | {"capsize": 2.0, "elinewidth": 0.8, "linestyle": ""}
        axes.errorbar([row.wall], [one.median], ends, **style)
    if (finest := study.finest) is not None and quantity.key in finest.comparisons:
        values, style = finest.comparisons[quantity.key].values, {"color": "0.9", "zorder": 0}
        axes.axhspan(
            values.min(), values.max(), label=f"range of the finest: {brief(finest.setting)}", **style
        )
    walls = [row.wall for row in complete]
    middle = math.sqrt(min(walls) * max(walls))
    half = math.sqrt(max(_SPAN, 1.5 * max(walls) / min(walls)))
    axes.set_xscale("log")
    axes.set_xlim(middle / half, middle * half)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(named(quantity).replace(" [", "\n["))
    if (spec := axes.get_subplotspec()) is not None and spec.is_last_row():
        axes.set_xlabel("wall time of a run [s]")
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)
