"""Figures of an ensemble: histograms of its metrics, and bands of quantities over time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from exunet.base.arrays import Floats
from exunet.plots.style import BLACK, INCH, ROUND, SMALL, WIDTHS, blank, legend_above, mark_incomplete
from exunet.results.ensemble import MANY, Ensemble
from exunet.results.metrics import STORED, Metric

MAX_PANELS, MAX_PANELS_NARROW = 15, 10
NO_BREAK = "\N{NO-BREAK SPACE}"
_COLUMN, _ROW, _HEAD = 42.0, 40.0, 12.0  # mm: narrowest panel, height of a row, legend
_BANDS = ((0.0, 1.0, "#d3dde8"), (0.05, 0.95, "#94adc9"), (0.25, 0.75, "#4d77a6"))  # levels, tint of BLUE


def histograms(ensemble: Ensemble, width: float = WIDTHS[1]) -> Figure | None:
    """Histograms of the metrics that differ between runs, of at most 15 (10 in a column) that differ most."""
    shown: list[tuple[Metric, Floats]] = []
    for key, values in ensemble.metrics.items():
        metric, defined = ensemble.about[key], values[~np.isnan(values)]
        if not (metric.balance or metric.detail) and np.ptp(defined) > metric.resolution:
            shown.append((metric, defined))
    if not shown:
        return None
    largest = sorted(shown, key=lambda item: -np.ptp(item[1]) / np.abs(item[1]).max())
    largest = largest[: MAX_PANELS if width == WIDTHS[1] else MAX_PANELS_NARROW]
    shown = [entry for entry in shown if any(entry is other for other in largest)]
    figure, panels = panels_of(len(shown), width)
    mark_incomplete(figure, ensemble)
    for axes, (metric, values) in zip(panels, shown, strict=True):
        bins = _bins(values, float(ensemble.time[1] - ensemble.time[0]) if metric.instant == STORED else 0.0)
        axes.hist(values, bins=bins.tolist(), color=_BANDS[1][2], edgecolor="white", linewidth=0.3)
        axes.axvline(float(np.median(values)), color=BLACK, linewidth=1.0, label="median")
        for level in (0.05, 0.95) if len(values) >= MANY else ():
            at = float(np.quantile(values, level))
            axes.axvline(at, color=BLACK, linewidth=0.8, linestyle=":", label="5 % and 95 %")
        # Above the panel: below it an offset of values that differ in late digits would touch it.
        axes.set_title(folded(metric.words, metric.unit, 24), loc="left", fontsize=SMALL)
        axes.set_ylabel("runs [1]")
        axes.xaxis.set_major_locator(MaxNLocator(3, steps=ROUND))
        axes.xaxis.set_major_formatter(ScalarFormatter(useOffset=True))
        axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    unique_legend(figure, panels[:1])
    return figure


def bands(ensemble: Ensemble, width: float = WIDTHS[1]) -> Figure | None:
    """Medians and quantiles of quantities over time."""
    general = [series for series in ensemble.series.values() if series.general]
    shown = [series for series in general if np.any(ensemble.quantiles[series.name])]
    if not shown:
        return None
    figure, panels = panels_of(len(shown), width)
    mark_incomplete(figure, ensemble)
    level = {float(value): k for k, value in enumerate(ensemble.levels)}
    for axes, series in zip(panels, shown, strict=True):
        values = ensemble.quantiles[series.name]
        for low, high, tint in _BANDS if ensemble.runs >= MANY else _BANDS[:1]:
            label = "all runs" if low == 0.0 else f"{100 * low:.0f} % to {100 * high:.0f} %"
            ends = values[level[low]], values[level[high]]
            axes.fill_between(ensemble.time, *ends, color=tint, linewidth=0, label=label)
        axes.plot(ensemble.time, values[level[0.5]], color=BLACK, linewidth=0.9, label="median")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(folded(series.words, series.unit, 22))
        axes.set_xlim(float(ensemble.time[0]), float(ensemble.time[-1]))
        axes.set_ylim(bottom=min(0.0, float(values.min())))
    unique_legend(figure, panels[:1])
    return figure


def _bins(values: Floats, spacing: float) -> Floats:
    """Return edges of 5 to 40 bins of equal width.

    Values (n,) that are multiples of a spacing have bins of whole multiples: a bin with one more of them
    than its neighbour would be higher for no other reason.
    """
    count, low, high = int(np.clip(np.sqrt(len(values)), 5, 40)), float(values.min()), float(values.max())
    if high - low < spacing or not spacing:
        return np.linspace(low, high, count + 1)
    steps = round((high - low) / spacing) + 1  # different values that there can be
    width = math.ceil(steps / count)
    return np.asarray(low + spacing * (width * np.arange(math.ceil(steps / width) + 1) - 0.5))


def folded(words: str, unit: str, length: int) -> str:
    """Return the label of an axis in lines of at most so many characters."""
    return textwrap.fill(f"{words} [{unit.replace('2', '²').replace(' ', NO_BREAK) or '1'}]", length)


def unique_legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """Add a legend above the panels, with each label once."""
    pairs = [axes.get_legend_handles_labels() for axes in panels]
    unique = {
        label: handle for handles, labels in pairs for label, handle in zip(labels, handles, strict=True)
    }
    legend_above(figure, list(unique.values()), list(unique))


def panels_of(count: int, width: float, height: float = _ROW) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels in up to four columns; height of a row [mm]."""
    columns = min(count, int(width / _COLUMN), 3 if count < 10 else 4)
    rows = math.ceil(count / columns)
    figure = blank(width / INCH, (_HEAD + height * rows) / INCH)
    figure.set_layout_engine("constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in panels[count:]:
        axes.remove()
    for axes in panels[:count]:
        axes.xaxis.label.set_size(SMALL)
        axes.yaxis.label.set_size(SMALL)
    return figure, panels[:count]
