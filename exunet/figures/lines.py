"""Curves and bands over time, and the axes that they stand in."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.page import Page
from exunet.figures.thinning import thinned
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import Result

Floats = NDArray[np.float64]


def curve_axes(result: Result, page: Page, title: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes for curves over time."""
    figure, axes = page.curve_axes(result, title)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(y_label)
    return figure, axes


def from_zero(axes: Axes, top: float) -> None:
    """Limits from zero to a largest value; a curve at zero stands clear of the axis."""
    axes.set_ylim(-0.02 * (top or 1.0), 1.05 * (top or 1.0))


def curve(axes: Axes, time: Floats, values: Floats, shift: float = 0.0, **style: Any) -> None:
    """One curve; its markers stand at every tenth of it, moved by `shift` of that, and at a lone point."""
    time, values = thinned(time, values)
    step = max(1, len(time) // 10)
    if len(time) == 1:
        style.setdefault("marker", "o")
    axes.plot(time, values, markevery=(int(shift * step), step), **style)


def spread_band(
    axes: Axes,
    spread: EnsembleResult,
    ends: tuple[Floats, Floats] | None,
    color: Any,
    label: str | None,
    time: Floats | None = None,
) -> None:
    """From the least to the largest of moved starts, pale, behind all curves; without ends for the legend.

    time : of the ends [s], where they are not at the instants of the spread
    """
    low, high = ends or (np.empty(0), np.empty(0))
    time = (spread.time if time is None else time) if ends else low
    axes.fill_between(time, low, high, color=color, alpha=0.22, linewidth=0, zorder=1, label=label)


def many(axes: Axes, time: Floats, values: Floats, label: str) -> None:
    """More curves than styles: one colour scale from the first to the last."""
    colors = colormaps["cividis"](np.linspace(0, 0.9, values.shape[1]))
    for k, color in enumerate(colors):
        order = 2.0 - 0.4 * k / len(colors)  # dark over light: where all coincide, it can be seen
        style = {"color": color, "linewidth": 0.9, "zorder": order, "label": label if k == 0 else None}
        curve(axes, time, values[:, k], **style)
