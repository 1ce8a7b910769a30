"""Figures of a study: distributions, a map of outcomes, drivers, designs with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.plots.ensembles import folded, panels_of, unique_legend
from exunet.plots.style import (
    BLACK,
    BLUE,
    GREY,
    INCH,
    MAX_CURVES,
    RED,
    ROUND,
    SMALL,
    YELLOW,
    blank,
    curve_styles,
    number,
)
from exunet.results.outcome import Outcome

Interval = tuple[float, float, float]  # value, low, high

CAPTURED = Outcome.CAPTURED.value
MAX_PANELS = 6
MAX_POINTS = 3000  # of the map, evenly chosen
MAX_ROWS = 24  # designs, or points of a grid


@dataclass(frozen=True)
class StudyData:
    """Data of the figures of a study: arrays (rows,) by name, and estimates.

    inputs    : values, the strongest first
    outcome   : capture outcomes; "" of a run without one
    metrics   : values, by words and unit; NaN where a run does not have the metric
    design    : name of the design, or of the point of a grid, of each row
    limits    : of metrics
    drivers   : first order, level below which it is as good as none, and sign; by response and input
    estimates : with intervals; by words and unit, and design
    """

    inputs: Mapping[str, NDArray[Any]]
    outcome: NDArray[Any]
    metrics: Mapping[tuple[str, str], Floats]
    design: NDArray[Any]
    limits: Mapping[tuple[str, str], float] = field(default_factory=dict)
    drivers: Mapping[str, Mapping[str, tuple[float, float, int]]] = field(default_factory=dict)
    estimates: Mapping[tuple[str, str], Mapping[str, Interval]] = field(default_factory=dict)


def distributions(data: StudyData, width: float) -> Figure | None:
    """Histograms of metrics, for each of up to eight designs, with limits."""
    shown = [(key, values) for key, values in data.metrics.items() if not np.isnan(values).all()][:MAX_PANELS]
    names = list(dict.fromkeys(data.design.tolist()))
    if not shown or len(names) > MAX_CURVES:
        return None
    figure, panels = panels_of(len(shown), width)
    for axes, (key, values) in zip(panels, shown, strict=True):
        known = values[~np.isnan(values)]
        edges = np.histogram_bin_edges(known, int(np.clip(np.sqrt(len(known) / len(names)), 5, 40)))
        for name, style in zip(names, curve_styles(len(names)), strict=True):
            mine = known[data.design[~np.isnan(values)] == name]
            drawn = {
                "color": style["color"],
                "linestyle": style["linestyle"],
                "linewidth": style["linewidth"],
            }
            axes.hist(mine, edges.tolist(), histtype="step", label=name or None, **drawn)
        words, unit = key
        if (limit := data.limits.get(key)) is not None:
            words += f", limit {number(limit)}"
            if abs(limit - known.mean()) < 2.0 * np.ptp(known):
                axes.axvline(limit, color=BLACK, linestyle="--", linewidth=1.0, label="limit")
        axes.set_title(folded(words, unit, 28), loc="left", fontsize=SMALL)
        axes.set_ylabel("runs [1]")
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=ROUND))
        axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    unique_legend(figure, panels)
    return figure


def outcome_map(data: StudyData, width: float) -> Figure | None:
    """Capture outcomes, or the first metric, over the two strongest inputs that are numbers."""
    numbers = [(name, values) for name, values in data.inputs.items() if values.dtype.kind in "fiu"][:2]
    metric = next(iter(data.metrics.items()), None)
    known = [name for name in dict.fromkeys(data.outcome.tolist()) if name]
    if len(numbers) < 2 or (metric is None and not known):
        return None
    (name_x, x), (name_y, y) = numbers
    every = np.unique(np.linspace(0, len(x) - 1, min(len(x), MAX_POINTS)).round().astype(int))
    known.sort(key=lambda name: (name != CAPTURED, -int((data.outcome == name).sum())))
    colors = (BLUE, RED, YELLOW, BLACK, BLUE, RED, GREY)
    styles = {name: (colors[k % 7], "o^sx+Dv"[k % 7]) for k, name in enumerate(known)}
    names = list(dict.fromkeys(data.design.tolist()))[:MAX_PANELS]
    figure, panels = panels_of(len(names), width, 70.0)
    for axes, design in zip(panels, names, strict=True):
        rows = every[data.design[every] == design]
        for name, (color, marker) in styles.items():
            mine = rows[data.outcome[rows] == name]
            face = color if name == CAPTURED else "none"
            axes.plot(x[mine], y[mine], marker, markerfacecolor=face, markeredgecolor=color, label=name)
        if not known and metric is not None:
            drawn = axes.scatter(x[rows], y[rows], s=14, c=metric[1][rows], cmap="cividis")
            figure.colorbar(drawn, ax=axes).set_label(folded(*metric[0], 40))
        axes.set_title(design, loc="left", fontsize=SMALL)
        axes.set_xlabel(name_x)
        axes.set_ylabel(name_y)
    if known:
        unique_legend(figure, panels)
    return figure


def drivers(data: StudyData, width: float) -> Figure | None:
    """First-order effects of inputs on each response, with the level of inputs without effect."""
    shown = [(name, effects) for name, effects in data.drivers.items() if effects][:MAX_PANELS]
    if not shown:
        return None
    figure, panels = panels_of(len(shown), width, 16.0 + 6.0 * max(len(effects) for _, effects in shown))
    for axes, (name, effects) in zip(panels, shown, strict=True):
        order = sorted(effects.items(), key=lambda item: item[1][0])
        rows, index = np.arange(len(order)), [max(0.0, item[0]) for _, item in order]
        level = max(item[1] for _, item in order)
        colors = [BLUE if item[0] > item[1] else GREY for _, item in order]
        axes.barh(rows, index, color=colors, height=0.7)
        axes.axvline(level, color=BLACK, linestyle=":", linewidth=0.9, label="without effect: 95 % are below")
        signs = {1: " (+)", -1: " (\N{MINUS SIGN})", 0: ""}
        axes.set_yticks(rows, [f"{key}{signs[item[2]]}" for key, item in order])
        axes.set_xlim(0.0, max(*index, level) * 1.1)
        axes.set_title(folded(name, "", 34).removesuffix(" [1]"), loc="left", fontsize=SMALL)
        axes.set_xlabel("first-order effect [1]")
    unique_legend(figure, panels)
    return figure


def designs(data: StudyData, width: float) -> Figure | None:
    """Estimates of designs, or of points of a grid, with their intervals."""
    shown = [(key, rows) for key, rows in data.estimates.items() if 1 < len(rows) <= MAX_ROWS][:4]
    if not shown:
        return None
    count = max(len(rows) for _, rows in shown)
    figure = blank(width / INCH, (22.0 + 5.0 * count) / INCH)
    figure.set_layout_engine("constrained")
    panels = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    for axes, (key, rows) in zip(panels, shown, strict=True):
        places = np.arange(len(rows))[::-1]
        value, low, high = np.array(list(rows.values())).T
        axes.hlines(places, low, high, color=BLUE, linewidth=1.4)
        axes.plot(value, places, "o", color=BLACK)
        axes.set_yticks(places, list(rows))
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.set_xlabel(folded(*key, 26), fontsize=SMALL)
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=ROUND))
        axes.grid(axis="y", color=GREY, linewidth=0.4)
    return figure
