"""The figures of the report: curves over time on a logarithmic scale, bands, and convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.style import BLACK, BLUE, RED, YELLOW, blank

Floats = NDArray[np.float64]

STYLES: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linestyle": "-", "linewidth": 1.6},
    {"color": RED, "linestyle": "--", "linewidth": 1.4},
    {"color": YELLOW, "linestyle": "-", "linewidth": 2.4, "zorder": 1},
    {"color": BLACK, "linestyle": ":", "linewidth": 1.3},
)


def curves(
    title: str,
    y_label: str,
    time: Floats,
    lines: Mapping[str, Floats],
    marks: Mapping[str, float] | None = None,
    floor: float = 1e-17,
) -> Figure:
    """Lines (t,) over time [s] on a logarithmic scale, zeros at its `floor`; marks are named instants [s]."""
    figure = blank(6.4, 3.8)
    axes = figure.add_axes((0.12, 0.13, 0.84, 0.77))
    figure.suptitle(title, fontsize=10)
    for (label, line), style in zip(lines.items(), STYLES, strict=False):
        axes.plot(time, np.maximum(line, floor), label=label, **style)
    for (label, instant), dashes in zip((marks or {}).items(), ("-", "--", ":"), strict=False):
        if np.isfinite(instant) and instant <= time[-1]:
            axes.axvline(instant, color="0.45", linewidth=1.0, linestyle=dashes, label=label)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(y_label)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlim(float(time[0]), float(time[-1]))
    axes.set_yscale("log")
    axes.legend(loc="best")
    return figure


def bands(
    title: str, time: Floats, panels: Mapping[str, tuple[Floats, str]], mark: tuple[str, float]
) -> Figure:
    """Ensembles (runs, t) over time: mean, spread of one standard deviation, and extremes; one row each.

    panels : y label -> (values, name); mark : a named instant [s]
    """
    figure = blank(6.4, 1.9 * len(panels) + 0.9)
    figure.suptitle(title, fontsize=10)
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (label, (values, name)) in zip(grid, panels.items(), strict=True):
        mean, spread = values.mean(axis=0), values.std(axis=0)
        axes.fill_between(
            time, values.min(axis=0), values.max(axis=0), color="0.88", label="all runs", linewidth=0
        )
        axes.fill_between(
            time, mean - spread, mean + spread, color="0.68", label="standard deviation", linewidth=0
        )
        axes.plot(time, mean, color=BLUE, linewidth=1.4, label="mean")
        if np.isfinite(mark[1]):
            axes.axvline(mark[1], color=BLACK, linewidth=0.9, linestyle="--", label=mark[0])
        axes.set_ylabel(label)
        axes.set_ylim(0.0, 1.05 * float(values.max()))
        axes.set_title(name, fontsize=9)
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
    grid[-1].set_xlabel("time [s]")
    grid[-1].set_xlim(float(time[0]), float(time[-1]))
    handles, names = grid[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncols=4, frameon=False)
    height = figure.get_figheight()
    figure.subplots_adjust(left=0.12, right=0.97, top=1 - 0.6 / height, bottom=0.85 / height, hspace=0.35)
    return figure


def convergence(
    title: str, x_label: str, lines: Mapping[str, tuple[Floats, Floats]], panels: Mapping[str, Sequence[str]]
) -> Figure:
    """Errors against step or number of steps, both logarithmic; panels name the lines that they show."""
    figure = blank(3.9 * len(panels), 4.8)
    figure.suptitle(title, fontsize=10)
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    markers = "osv^xD+*pP"
    for axes, (name, shown) in zip(grid, panels.items(), strict=True):
        for k, (label, style) in enumerate(zip(shown, _shades(len(shown)), strict=True)):
            x, y = lines[label]
            axes.loglog(x, y, label=label, marker=markers[k % len(markers)], markersize=4, **style)
        axes.set_title(name, fontsize=9)
        axes.set_xlabel(x_label)
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    grid[0].set_ylabel("largest error of a position [m]")
    figure.subplots_adjust(left=0.1, right=0.98, top=0.88, bottom=0.34, wspace=0.06)
    return figure


def _shades(count: int) -> list[dict[str, Any]]:
    """From light and broad to dark and thin, so that a later curve hides no earlier one."""
    from matplotlib import colormaps

    colours = colormaps["cividis_r"](np.linspace(0.0, 1.0, max(count, 2)))
    widths = np.linspace(2.2, 0.9, max(count, 2))
    return [{"color": colours[k], "linewidth": widths[k]} for k in range(count)]
