"""What closes the mouth of a net, over time."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.known import tell_alone
from exunet.figures.lines import curve, from_zero
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, BLUE, RED
from exunet.net.areas import mouth_diameter
from exunet.net.closing import NAME
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import Result
from exunet.results.rows import over_blocks

Floats = NDArray[np.float64]


def closing(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Tension and length of a line, or the part of an edge that is left; below, the diameter of the mouth.

    None where nothing closes it.
    """
    if f"{NAME}/part" in result.states:
        panels = [_part]
    elif f"{NAME}/way" in result.states:
        panels = [_tension, _lengths]
    else:
        return None
    if len(result.net.mouth) > 1:
        panels.append(_mouth)
    figure, axes = page.stacked_axes(result, "Closing", (1.0,) * len(panels), 55.0 + 40.0 * len(panels))
    for draw, one in zip(panels, axes, strict=True):
        draw(result, one)
    axes[-1].set_xlabel("stored time [s]")
    tell_alone(axes[0], spread)
    finish(figure, *axes)
    return figure


def _over_time(result: Result, name: str) -> Floats:
    return np.asarray(result.states[f"{NAME}/{name}"].values[:])[:, 0]


def _tension(result: Result, axes: Axes) -> None:
    """At both ends, which without friction are the same."""
    start, end = _over_time(result, "tension_start"), _over_time(result, "tension_end")
    same = np.array_equal(start, end)
    label = None if same else "at the start of the line"
    curve(axes, result.time, start, label=label, color=BLUE, linewidth=1.4)
    if not same:
        curve(axes, result.time, end, 0.5, label="at its end", color=RED, linestyle="--", linewidth=1.4)
    from_zero(axes, float(max(start.max(), end.max())))
    axes.set_ylabel("tension of the line\n[N]")


def _lengths(result: Result, axes: Axes) -> None:
    way, wound = _over_time(result, "way"), _over_time(result, "wound_up")
    curve(axes, result.time, way, label="way through the rings", color=BLUE, linewidth=1.4)
    curve(axes, result.time, wound, 0.5, label="wound up", color=RED, linestyle="--", linewidth=1.4)
    from_zero(axes, float(max(way.max(), wound.max())))
    axes.legend(loc="best", frameon=False)
    axes.set_ylabel("length [m]")


def _part(result: Result, axes: Axes) -> None:
    curve(axes, result.time, _over_time(result, "part"), color=BLUE, linewidth=1.4)
    from_zero(axes, 1.0)
    axes.set_ylabel("part of the edge's\nlength that is left")


def _mouth(result: Result, axes: Axes) -> None:
    diameter = over_blocks(partial(mouth_diameter, result.net), result.position)
    curve(axes, result.time, diameter, color=BLACK, linewidth=1.4)
    from_zero(axes, float(diameter.max()))
    axes.set_ylabel("diameter of\nthe mouth [m]")
