"""What closes the mouth of a net, over time."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.bands import bands_behind
from exunet.figures.lines import curve, from_zero
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, BLUE, RED
from exunet.net.areas import mouth_diameter
from exunet.results.course import EDGE, LINE
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import Result, over_blocks

Floats = NDArray[np.float64]


def closing(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Tension and length of a line, or the part of an edge that is left; below, the diameter of the mouth.

    None where nothing closes it. Behind each curve its band of moved starts.
    """
    if EDGE in result.states:
        panels = [_part]
    elif f"{LINE}way" in result.states:
        panels = [_tension, _lengths]
    else:
        return None
    if len(result.net.mouth) > 1:
        panels.append(_mouth)
    figure, axes = page.stacked_axes(result, "Closing", (1.0,) * len(panels), 55.0 + 40.0 * len(panels))
    drawn = [draw(result, one) for draw, one in zip(panels, axes, strict=True)]
    colors = [{name: color for name, (_, color) in curves.items()} for curves in drawn]
    tops = bands_behind(list(zip(axes, colors, strict=True)), spread)
    for one, curves, top in zip(axes, drawn, tops, strict=True):
        from_zero(one, max(top, *(float(values.max()) for values, _ in curves.values())))
    axes[-1].set_xlabel("stored time [s]")
    finish(figure, *axes)
    return figure


Drawn = dict[str, tuple[Floats, str]]  # values of each curve and its colour, by the name of the quantity


def _over_time(result: Result, name: str) -> Floats:
    return np.asarray(result.states[LINE + name].values[:])[:, 0]


def _tension(result: Result, axes: Axes) -> Drawn:
    """At both ends, which without friction are the same."""
    start, end = _over_time(result, "tension_start"), _over_time(result, "tension_end")
    same = np.array_equal(start, end)
    label = None if same else "at the start of the line"
    curve(axes, result.time, start, label=label, color=BLUE, linewidth=1.4)
    axes.set_ylabel("tension of the line\n[N]")
    drawn: Drawn = {f"{LINE}tension_start": (start, BLUE)}
    if not same:
        curve(axes, result.time, end, 0.5, label="at its end", color=RED, linestyle="--", linewidth=1.4)
        drawn[f"{LINE}tension_end"] = (end, RED)
    return drawn


def _lengths(result: Result, axes: Axes) -> Drawn:
    way, wound = _over_time(result, "way"), _over_time(result, "wound_up")
    curve(axes, result.time, way, label="way through the rings", color=BLUE, linewidth=1.4)
    curve(axes, result.time, wound, 0.5, label="wound up", color=RED, linestyle="--", linewidth=1.4)
    axes.legend(loc="best", frameon=False)
    axes.set_ylabel("length [m]")
    return {f"{LINE}way": (way, BLUE), f"{LINE}wound_up": (wound, RED)}


def _part(result: Result, axes: Axes) -> Drawn:
    part = _over_time(result, "part")
    curve(axes, result.time, part, color=BLUE, linewidth=1.4)
    axes.set_ylabel("part of the edge's\nlength that is left")
    return {EDGE: (part, BLUE)}


def _mouth(result: Result, axes: Axes) -> Drawn:
    diameter = over_blocks(partial(mouth_diameter, result.net), result.position)
    curve(axes, result.time, diameter, color=BLACK, linewidth=1.4)
    axes.set_ylabel("diameter of\nthe mouth [m]")
    return {"mouth": (diameter, BLACK)}
