"""Panels whose data units are equally long on all axes, as large as the page has room for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.figures.page import INCH, Page, columns_that_fit, legend_above
from exunet.figures.style import blank
from exunet.figures.views import View
from exunet.results.result import Result

Floats = NDArray[np.float64]

AXES = ("$x$", "$y$", "$z$")
MOST_COLUMNS = 3  # on a page of its own size
NARROWEST = 85.0 / INCH  # a figure with room for its legend
HIGHEST = 230.0  # mm; of a printed page
LEFT, RIGHT, FOOT, GAP, GAP_INSIDE = 0.52, 0.08, 0.4, 0.16, 0.08  # inch


def framed(
    result: Result,
    page: Page,
    view: View,
    count: int,
    title: str,
    entries: list[Line2D],
    above: float,
    width: float,
    names: Sequence[str] = AXES,
) -> tuple[Figure, list[list[Axes]]]:
    """Panels with a head and a legend over them; `above` [inch] is kept free over each panel."""
    labels = [str(entry.get_label()) for entry in entries]
    wide = page.size[0] if page.size else min(width, 85.0)  # which is the least of its own
    rows = -(-len(labels) // columns_that_fit(labels, 72 * wide / INCH - 12)) if labels else 0
    over = page.head_height(result)
    head = 0.04 + over + 0.13 * rows
    figure, grid = panels(view, count, page, head, above, width, names)
    page.head(figure, result, title)
    top = 1 - (0.01 + over) / figure.get_figheight()
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, top), "borderaxespad": 0.0}
    legend_above(figure, entries, labels, **place)
    return figure, grid


def panels(
    view: View, count: int, page: Page, head: float, title: float, width: float, names: Sequence[str] = AXES
) -> tuple[Figure, list[list[Axes]]]:
    """`count` panels, each with one axes for each plane of `view`: (figure, axes by panel).

    head, title : heights [inch] kept free above the whole and above each panel
    width       : of the figure [mm], if the page asks for no size; it is then as high as it needs to be
    names       : of the three coordinates, at the outer axes
    All axes have the view's limits and equal scales. On a page of given size there are as many columns as
    give the largest panels.
    """
    choice = range(1, count + 1) if page.size else [min(count, MOST_COLUMNS)]
    grids = [Grid.of(view, count, columns, page, head, title, width) for columns in choice]
    grid = max(grids, key=lambda one: one.scale)
    figure = blank(grid.width, grid.height)
    made: list[list[Axes]] = []
    for k in range(count):
        row, column = divmod(k, grid.columns)
        panel: list[Axes] = []
        outer = (column == 0, k + grid.columns >= count)
        for number, plane in enumerate(view.planes):
            axes = figure.add_axes(grid.place(row, column, number))
            sides = grid.scale * (view.high - view.low)[list(plane)]
            _set_axes(axes, view, plane, sides, (outer[0] and not number, outer[1]), names)
            panel.append(axes)
        made.append(panel)
    return figure, made


@dataclass(frozen=True)
class Grid:
    """Panels in rows and columns; lengths in inches, `scale` [inch/m]."""

    width: float
    height: float
    scale: float
    columns: int
    rows: int
    left: float
    foot: float
    title: float
    spans: tuple[tuple[float, ...], float]  # of a panel: widths of its axes, height [m]

    @classmethod
    def of(
        cls, view: View, count: int, columns: int, page: Page, head: float, title: float, width: float
    ) -> Grid:
        """The largest panels in so many columns."""
        rows = -(-count // columns)
        span = view.high - view.low
        wide, tall = tuple(float(span[a]) for a, _ in view.planes), float(span[view.planes[0][1]])
        whole = (page.size[0] if page.size else width) / INCH
        left = LEFT
        free = whole - left - RIGHT - (columns - 1) * GAP - columns * (len(wide) - 1) * GAP_INSIDE
        scale = max(free, 0.1) / (columns * sum(wide))
        highest = (page.size[1] if page.size else HIGHEST) / INCH
        scale = min(scale, max(highest - head - FOOT - rows * title, 0.1) / (rows * tall))
        used = scale * columns * sum(wide)
        height = page.size[1] / INCH if page.size else head + FOOT + rows * (scale * tall + title)
        if page.size is None and whole - (free - used) >= NARROWEST:
            whole -= free - used
        elif page.size is None:
            left, whole = left + (NARROWEST - whole + free - used) / 2, NARROWEST
        else:
            left += (free - used) / 2
        return cls(whole, height, scale, columns, rows, left, FOOT, title, (wide, tall))

    def place(self, row: int, column: int, number: int) -> tuple[float, float, float, float]:
        """Where axes stand, as parts of the figure: left, bottom, width, height."""
        wide, tall = self.spans
        panel = self.scale * sum(wide) + (len(wide) - 1) * GAP_INSIDE + GAP
        x = self.left + column * panel + self.scale * sum(wide[:number]) + number * GAP_INSIDE
        y = self.foot + (self.rows - 1 - row) * (self.scale * tall + self.title)
        size = self.scale * wide[number] / self.width, self.scale * tall / self.height
        return x / self.width, y / self.height, *size


def _set_axes(
    axes: Axes,
    view: View,
    plane: tuple[int, int],
    sides: Floats,
    outer: tuple[bool, bool],
    names: Sequence[str],
) -> None:
    """Limits, ticks to suit the `sides` [inch], and labels on the (left, bottom) axes that are `outer`."""
    from matplotlib.ticker import MaxNLocator

    a, b = plane
    axes.set_xlim(view.low[a], view.high[a])
    axes.set_ylim(view.low[b], view.high[b])
    steps = [1, 2, 3, 5, 10]
    for axis, side, each, least in zip(
        (axes.xaxis, axes.yaxis), sides, (0.38, 0.18), (0.7, 0.4), strict=True
    ):
        most = max(1 if side < least else 3, min(8, int(side / each)))
        axis.set_major_locator(MaxNLocator(most, steps=steps, min_n_ticks=1))
    axes.tick_params(labelleft=outer[0], labelbottom=outer[1])
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for spine in axes.spines.values():
        spine.set_color("0.6")
    if outer[0]:
        axes.set_ylabel(f"{names[b]} [m]")
    if outer[1]:
        axes.set_xlabel(f"{names[a]} [m]")
