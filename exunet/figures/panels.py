"""Panels whose data units are equally long on all axes, as large as the page has room for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.figures.page import INCH, Page, columns_that_fit, legend_above, text_width
from exunet.figures.style import SMALL, blank
from exunet.figures.ticks import ticks
from exunet.figures.views import View
from exunet.results.result import Result

Floats = NDArray[np.float64]

AXES = ("$x$ [m]", "$y$ [m]", "$z$ [m]")
MOST_COLUMNS = (3, 2)  # on a page of its own size
NARROWEST = 85.0 / INCH  # a figure with room for its legend
HIGHEST = 230.0  # mm; of a printed page
BESIDE_NUMBERS = 20.0  # points: ticks, the label of an axis, and what is free between
LEFT, RIGHT, FOOT, GAP, GAP_INSIDE, LEAST_GAP = 0.52, 0.08, 0.4, 0.16, 0.08, 0.04  # inch


class Panels(NamedTuple):
    """What stands around panels, and how much room they have.

    words   : over each of them; `above` [inch] is kept free for it
    entries : of the legend
    width   : of the figure [mm], if the page asks for no size; it is then as high as it needs to be
    names   : of the three coordinates, at the outer axes
    """

    words: Sequence[str]
    entries: list[Line2D]
    above: float
    width: float
    names: Sequence[str] = AXES


def framed(
    result: Result, page: Page, view: View, panels: Panels, title: str
) -> tuple[Figure, list[list[Axes]]]:
    """Panels with a head and a legend over them: (figure, axes by panel, one for each plane of `view`).

    All axes have the view's limits and equal scales.
    """
    grid = grid_of(result, page, view, panels)
    figure = blank(grid.width, grid.height)
    made: list[list[Axes]] = []
    for k, words in enumerate(panels.words):
        row, column = divmod(k, grid.columns)
        panel: list[Axes] = []
        outer = (column == 0, k + grid.columns >= len(panels.words))
        for number, plane in enumerate(view.planes):
            axes = figure.add_axes(grid.place(row, column, number))
            _set_axes(axes, view, plane, grid.scale, (outer[0] and not number, outer[1]), panels.names)
            panel.append(axes)
        if outer[1]:
            _spread_labels(panel)
        panel[0].set_title(words, loc="left", fontsize=SMALL, pad=3)
        made.append(panel)
    page.head(figure, result, title)
    top = 1 - (0.01 + page.head_height(result)) / figure.get_figheight()
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, top), "borderaxespad": 0.0}
    legend_above(figure, panels.entries, _labels(panels), **place)
    return figure, made


def _labels(panels: Panels) -> list[str]:
    return [str(entry.get_label()) for entry in panels.entries]


def grid_of(result: Result, page: Page, view: View, panels: Panels) -> Grid:
    """How `framed` places the panels: as large as they can be on a page of given size.

    On a page of its own size they stand in three columns, or in two where words need more room.
    """
    labels, count = _labels(panels), len(panels.words)

    def placed(columns: int, wide: float) -> Grid:
        """With the legend in rows as wide as this [inch]."""
        rows = -(-len(labels) // columns_that_fit(labels, 72 * wide - 12)) if labels else 0
        head = 0.04 + page.head_height(result) + 0.13 * rows
        grid = Grid.of(page, view, panels, columns, head)
        left = _room_of_numbers(view, grid.scale)
        return grid if left <= LEFT else Grid.of(page, view, panels, columns, head, left)

    if page.size:
        grids = [placed(columns, page.size[0] / INCH) for columns in range(1, count + 1)]
        return max(grids, key=lambda one: (one.legible(view, panels), one.scale))
    columns = [min(count, most) for most in MOST_COLUMNS]
    grids = [placed(one, placed(one, NARROWEST).width) for one in columns]
    return next((one for one in grids if one.legible(view, panels)), grids[0])


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
        cls, page: Page, view: View, panels: Panels, columns: int, head: float, left: float = LEFT
    ) -> Grid:
        """The largest panels in so many columns; `head` is kept free over them, `left` for numbers [inch]."""
        rows, title = -(-len(panels.words) // columns), panels.above
        span = view.high - view.low
        wide, tall = tuple(float(span[a]) for a, _ in view.planes), float(span[view.planes[0][1]])
        whole = (page.size[0] if page.size else panels.width) / INCH
        free = whole - left - RIGHT - (columns - 1) * GAP - columns * (len(wide) - 1) * GAP_INSIDE
        scale = max(free, 0.1) / (columns * sum(wide))
        highest = (page.size[1] if page.size else HIGHEST) / INCH
        scale = min(scale, max(highest - head - FOOT - rows * title, 0.1) / (rows * tall))
        used = scale * columns * sum(wide)
        height = page.size[1] / INCH if page.size else head + FOOT + rows * (scale * tall + title)
        foot = height - head - rows * (scale * tall + title)  # of a given page with the rest of it
        if page.size is None and whole - (free - used) >= NARROWEST:
            whole -= free - used
        elif page.size is None:
            left, whole = left + (NARROWEST - whole + free - used) / 2, NARROWEST
        else:
            left += (free - used) / 2
        return cls(whole, height, scale, columns, rows, left, foot, title, (wide, tall))

    def legible(self, view: View, panels: Panels) -> bool:
        """True if the words over the panels and at the axes have room, and two ticks at each axis."""
        wide, tall = self.spans
        names = panels.names
        labels = sum(text_width(names[a], 8.0) / 72 for a, _ in view.planes) + LEAST_GAP * len(wide)
        words = max(text_width(line, SMALL) / 72 for words in panels.words for line in words.split("\n"))
        across = self.scale * sum(wide) + (len(wide) - 1) * GAP_INSIDE
        up = self.scale * tall + self.title - text_width(names[view.planes[0][1]], 8.0) / 72
        fits = across >= labels and across + GAP - LEAST_GAP >= words and up >= LEAST_GAP
        return fits and all(room for plane in view.planes for _, room in _ticks(view, plane, self.scale))

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
    scale: float,
    outer: tuple[bool, bool],
    names: Sequence[str],
) -> None:
    """Limits, ticks to suit the `scale` [inch/m], and labels on the (left, bottom) axes that are `outer`."""
    a, b = plane
    axes.set_xlim(view.low[a], view.high[a])
    axes.set_ylim(view.low[b], view.high[b])
    (across, _), (up, _) = _ticks(view, plane, scale)
    axes.set_xticks(across)
    axes.set_yticks(up)
    axes.tick_params(labelleft=outer[0], labelbottom=outer[1])
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for spine in axes.spines.values():
        spine.set_color("0.6")
    if outer[0]:
        axes.set_ylabel(names[b])
    if outer[1]:
        axes.set_xlabel(names[a])


def _ticks(view: View, plane: tuple[int, int], scale: float) -> tuple[tuple[Floats, bool], ...]:
    """Ticks of both axes, each with whether they have room; scale [inch/m]."""
    sides = scale * (view.high - view.low)
    return tuple(
        ticks(view.low[a], view.high[a], sides[a], horizontal, beyond)
        for a, horizontal, beyond in zip(plane, (True, False), (GAP_INSIDE / 2, SMALL / 144), strict=True)
    )


def _room_of_numbers(view: View, scale: float) -> float:
    """Width [inch] of the numbers and the label to the left of the panels; scale [inch/m]."""
    _, (up, _) = _ticks(view, view.planes[0], scale)
    longest = max(text_width(f"{value:.6g}".replace("-", "\N{MINUS SIGN}"), SMALL) for value in up)
    return (longest + BESIDE_NUMBERS) / 72


def _spread_labels(panel: list[Axes]) -> None:
    """The labels of a front and a side view to the left and to the right, if one is longer than its axis."""
    figure = panel[0].get_figure(root=True)
    assert figure is not None
    sides = [axes.get_position().width * figure.get_figwidth() for axes in panel]
    words = [axes.get_xlabel() for axes in panel]
    if any(text_width(one, 8.0) / 72 > side for one, side in zip(words, sides, strict=True)):
        panel[0].set_xlabel(words[0], loc="left")
        panel[-1].set_xlabel(words[-1], loc="right")
