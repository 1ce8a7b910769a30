"""Axes over time: curves, bands of ensembles, events of a script, and words for uncertain values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.plots.style import BLACK, ROUND, SMALL, FigureData, legend_above, new_figure
from exunet.results.ensemble import Ensemble, Range
from exunet.results.result import Result

TIME = "time [s]"
BINS = 2000  # of a long curve; axes of 170 mm at 300 dots per inch have as many pixels
MAX_BANDS = 4  # distinguishable bands of one pair of axes
_EVENT_HEIGHT = 9.0  # mm, of the names of events above the axes
_EVENT_GAP = 13.0  # points between names of events at 45 degrees


def stacked_axes(
    source: FigureData,
    labels: Sequence[str],
    height: float,
    ratios: Sequence[float] | None = None,
    x_label: str = TIME,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with axes over one horizontal axis, of time unless another is given.

    Parameters
    ----------
    source : Source
        What is drawn, and the width.
    labels : sequence of str
        Label with unit of each vertical axis, from top to bottom.
    height : float
        Height of the figure [mm], without the names of events.
    ratios : sequence of float, optional
        Heights of the axes in proportion; default: equal.
    x_label : str
        Label with unit of the horizontal axis.
    """
    has_events = x_label == TIME and source.result.run.done
    figure = new_figure(source, height + (_EVENT_HEIGHT if has_events else 0.0))
    grid = figure.subplots(len(labels), 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
    for axes, label in zip(grid, labels, strict=True):
        axes.set_ylabel(label)
        axes.yaxis.set_major_locator(MaxNLocator("auto", steps=ROUND))
    grid[-1].set_xlabel(x_label)
    figure.align_ylabels(list(grid))
    return figure, list(grid)


def finish(source: FigureData, figure: Figure, remarks: Iterable[str] = ()) -> Figure:
    """Add the events of the script and the legend of all axes, with remarks at its end."""
    if figure.axes[-1].get_xlabel() == TIME:
        _mark_events(figure, source.result)
    handles: list[Any] = []
    labels: list[str] = []
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in labels:
                handles.append(handle)
                labels.append(label)
    (blank,) = figure.axes[0].plot([], [], " ")
    for remark in remarks:
        handles.append(blank)
        labels.append(remark)
    if len(labels) > 0:
        legend_above(figure, handles, labels)
    return figure


def from_zero(axes: Axes, top: float | None = None) -> None:
    """Set the lower limit to zero; a curve at zero stands clear of the axis.

    top : upper limit, if not that of everything drawn
    """
    top = float(axes.dataLim.y1) if top is None else top
    axes.set_ylim(-0.02 * (top or 1.0), 1.05 * (top or 1.0))


def curve(axes: Axes, time: Floats, values: Floats, shift: float = 0.0, **style: Any) -> None:
    """Draw a curve; markers stand at every tenth of it, moved by `shift` of a tenth, and at a lone point."""
    rows = rows_with_extremes(time, values)
    step = max(1, len(rows) // 10)
    if len(time) == 1:
        style.setdefault("marker", "o")
    axes.plot(time[rows], values[rows], markevery=(int(shift * step), step), **style)


def many_curves(axes: Axes, time: Floats, values: Floats, label: str) -> None:
    """Draw more curves than there are styles, columns of (t, n), on one colour scale."""
    colors = colormaps["cividis"](np.linspace(0, 0.9, values.shape[1]))
    for k, color in enumerate(colors):
        order = 2.0 - 0.4 * k / len(colors)  # dark over light: the darkest shows where all coincide
        style = {"color": color, "linewidth": 0.9, "zorder": order, "label": label if k == 0 else None}
        curve(axes, time, values[:, k], **style)


def fill(axes: Axes, time: Floats, low: Floats, high: Floats, **style: Any) -> None:
    """Fill the band between two curves."""
    rows = rows_with_extremes(time, low, high)
    axes.fill_between(time[rows], low[rows], high[rows], linewidth=0, **style)


def rows_with_extremes(time: Floats, *series: Floats) -> NDArray[np.int64]:
    """Select the rows that a figure can show of long series.

    All rows of up to 8000; of more, for each of 2000 intervals its first and last row and those of the
    smallest and largest value of each series (n,). NaN are gaps.
    """
    if len(time) <= 4 * BINS:
        return np.arange(len(time))
    edges = np.linspace(0, len(time), BINS + 1).astype(np.int64)
    chosen = [edges[:-1], edges[1:] - 1]
    for values in series:
        for sign in (1.0, -1.0):
            filled = np.where(np.isnan(values), np.inf, sign * values)
            chosen.append(np.array([a + filled[a:b].argmin() for a, b in pairwise(edges)]))
    return np.unique(np.concatenate(chosen))


def draw_bands(
    axes: Axes,
    ensemble: Ensemble | None,
    colors: Mapping[str, Any],
    *,
    offset: float = 0.0,
    scale: float = 1.0,
    means: bool = False,
    max_bands: int = MAX_BANDS,
) -> None:
    """Draw bands of an ensemble behind curves, from the smallest to the largest of its runs.

    More than `max_bands` become one grey band, from the smallest to the largest of all curves.

    Parameters
    ----------
    axes : Axes
        Axes of the curves.
    ensemble : Ensemble or None
        Perturbed runs; None, and quantities that it does not have, draw nothing.
    colors : mapping of str to colour
        Colour of each quantity, by its name among the quantiles.
    offset, scale : float, optional
        The axis shows the quantity less the offset, as a part of the scale.
    means : bool, optional
        True for quantities that are means since the instant before: they stand at the middle of the interval.
    max_bands : int, optional
        Number of bands from which on there is one of all.
    """
    names = [name for name in colors if ensemble is not None and name in ensemble.quantiles]
    if ensemble is None or not names or (means and len(ensemble.time) < 2):
        return
    time, rows = ensemble.time, slice(None)
    if means:
        time, rows = 0.5 * (time[1:] + time[:-1]), slice(1, None)
    bands = [
        (*((limit[rows] - offset) / scale for limit in ensemble.band(name)), colors[name]) for name in names
    ]
    if len(bands) > max_bands:
        bands = [(np.min([low for low, *_ in bands], 0), np.max([high for _, high, _ in bands], 0), BLACK)]
    for low, high, color in bands:
        fill(axes, time, low, high, color=color, alpha=0.22, zorder=1)
    label = f"range of {ensemble.runs} perturbed runs"
    axes.fill_between([], [], color=BLACK, alpha=0.22, linewidth=0, label=label)


def range_of(ensemble: Ensemble | None, key: str) -> Range | None:
    """Return the range of a metric of an ensemble; None if it is not available."""
    return None if ensemble is None else ensemble.range(key)


def label_of_mark(name: str, value: Range | None, when: Range | None = None) -> str:
    """Return the label of a mark at this run's value, with its range over perturbed runs."""
    if value is None:
        return f"{name} of this run"
    if not value.known:
        return f"{name} of this run ({label_of_runs(value)})"
    at = f" at {when}" if when is not None and when.known else ""
    return f"{name}: {value}{at}"


def label_of_runs(value: Range) -> str:
    """Return the label of a metric of perturbed runs."""
    return f"{value.runs} perturbed runs: {value}"


def _mark_events(figure: Figure, result: Result) -> None:
    """Mark the events of the script by lines, with their names above the highest axes.

    Names that would overlap are joined; an entry with several events is named at the first.
    """
    low, high = figure.axes[-1].get_xlim()
    events = [event for event in result.run.done if low <= event.time_s <= high]
    if not events:
        return
    for axes in figure.axes:
        for event in events:
            axes.axvline(event.time_s, color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.9)
        axes.set_xlim(low, high)
    first: dict[str, float] = {}
    for event in events:
        first.setdefault(event.entry, event.time_s)
    gap = (high - low) * _EVENT_GAP / (0.85 * 72.0 * figure.get_figwidth())
    places: list[float] = []
    names: list[str] = []
    for name, time in first.items():
        if places and time - places[-1] < gap:
            names[-1] += f", {name}"
        else:
            places.append(time)
            names.append(name)
    above = figure.axes[0].secondary_xaxis("top")
    style: dict[str, Any] = {"rotation": 45, "ha": "left", "va": "bottom", "rotation_mode": "anchor"}
    above.set_xticks(places, [name if len(name) < 30 else f"{name[:27]}..." for name in names], **style)
    above.tick_params(labelsize=SMALL - 1.0, labelcolor="0.35", color="0.6", length=2, pad=1)
    above.spines["top"].set_visible(False)
