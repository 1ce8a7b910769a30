"""Figures of the report: curves over time on a logarithmic scale, and convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exunet.plots.style import BLACK, CURVES, blank
from exunet.verification.check import Floats, Picture

LEAST = 1e-17  # [m], where logarithmic scales show zeros
MARKERS = "osv^xD+*pP"


def picture(name: str, figure: Figure, caption: str) -> Picture:
    """Draw a figure; within `exunet.plots.style.drawing`, as it was made."""
    png = BytesIO()
    figure.savefig(png, format="png", dpi=150)
    return Picture(name, png.getvalue(), caption)


def curves(title: str, time: Floats, lines: Mapping[str, Floats], horizon: float) -> Figure:
    """Draw differences of positions (t,) [m] over time [s], logarithmic, and the horizon [s]."""
    figure = blank(6.4, 3.8)
    axes = figure.add_axes((0.12, 0.13, 0.84, 0.77))
    figure.suptitle(title, fontsize=10)
    for (label, line), style in zip(lines.items(), CURVES, strict=False):
        seen = np.where(line > LEAST, line, np.nan) if np.any(line > LEAST) else np.full_like(line, LEAST)
        axes.plot(time, seen, label=label, **(style | {"marker": ""}))
    if horizon <= time[-1]:
        label = f"horizon, t = {horizon:.3g} s"
        axes.axvline(horizon, color=BLACK, linewidth=0.9, linestyle="--", label=label)
    axes.set(xlabel="time [s]", ylabel="largest difference of a position [m]", yscale="log")
    axes.set_xlim(float(time[0]), float(time[-1]))
    _gridded(axes)
    axes.legend(loc="best")
    return figure


def convergence(
    title: str, lines: Mapping[str, tuple[Floats, Floats]], panels: Mapping[str, Sequence[str]]
) -> Figure:
    """Draw errors [m] against the number of steps, both logarithmic; panels name the lines that they show."""
    figure = blank(3.9 * len(panels), 4.8)
    figure.suptitle(title, fontsize=10)
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (name, shown) in zip(grid, panels.items(), strict=True):
        # From light and broad to dark and thin, so that a later curve hides no earlier one.
        for label, part, marker in zip(shown, np.linspace(0.1, 1.0, len(shown)), MARKERS, strict=False):
            style = {"color": colormaps["cividis_r"](part), "linewidth": 2.2 - 1.3 * part, "markersize": 4}
            steps, errors = lines[label]
            axes.loglog(steps, np.maximum(errors, LEAST), label=label, marker=marker, **style)
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("steps")
        _gridded(axes)
        axes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    grid[0].set_ylabel("largest error of a position [m]")
    figure.subplots_adjust(left=0.1, right=0.98, top=0.88, bottom=0.34, wspace=0.06)
    return figure


def _gridded(axes: Axes) -> None:
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
