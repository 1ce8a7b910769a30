"""The page of a figure: its size in millimetres, its head, a legend that fits, and its file."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator

from exunet.figures.powers import tell_power_of_ten
from exunet.figures.style import METADATA, SMALL, blank, drawing

INCH = 25.4  # mm
ROUND = [1, 2, 5, 10]  # steps between the numbers at an axis
COLOR_BAR = "color bar"  # label of axes that are one, and may be thin
LEAST_AXES = 5.0  # mm, of a side of the axes in a figure


class HasVerdict(Protocol):
    """What a head says of a result, or of an ensemble: whether it is complete, else why not."""

    @property
    def complete(self) -> bool: ...

    @property
    def verdict(self) -> str: ...


@dataclass(frozen=True)
class Page:
    """How a figure is wanted.

    size  : (width, height) [mm]; None: the figure's own
    title : with a title; without one, a figure still names a result that is not complete
    """

    size: tuple[float, float] | None = None
    title: bool = False

    def curve_axes(self, result: HasVerdict, title: str) -> tuple[Figure, Axes]:
        """A figure with one pair of axes that fills it."""
        figure, (axes,) = self.stacked_axes(result, title, (1.0,), 95.0)
        return figure, axes

    def stacked_axes(
        self, result: HasVerdict, title: str, parts: Sequence[float], height: float
    ) -> tuple[Figure, list[Axes]]:
        """A figure with axes above each other, whose heights are in proportion, and one scale across.

        height : of the figure [mm], if no size is asked for
        """
        width, height = self.size or (170.0, height)
        figure = blank(width / INCH, height / INCH)
        figure.set_layout_engine("constrained")
        self.head(figure, result, title)
        grid = figure.subplots(len(parts), 1, sharex=True, height_ratios=parts, squeeze=False)[:, 0]
        for axes in grid:
            axes.xaxis.set_major_locator(MaxNLocator("auto", steps=ROUND))
            axes.yaxis.set_major_locator(MaxNLocator("auto", steps=ROUND))
        return figure, list(grid)

    def head(self, figure: Figure, result: HasVerdict, title: str) -> None:
        """The title, if wanted, and the verdict of an incomplete result."""
        lines = self.head_lines(result, title, 72 * figure.get_figwidth())
        if lines:
            top = 1 - 0.02 / figure.get_figheight()
            figure.suptitle("\n".join(lines), y=top, va="top", fontsize=8, parse_math=False)

    def head_height(self, result: HasVerdict) -> float:
        """Height of the head [inch]."""
        return 0.135 * (self.title + (not result.complete)) + 0.02

    def head_lines(self, result: HasVerdict, title: str, width: float) -> list[str]:
        """Lines of at most `width` [points]."""
        lines = [title] if self.title else []
        lines += [] if result.complete else ["INCOMPLETE: " + result.verdict]
        return [fitted(line, 0.97 * width, 8.0) for line in lines]


def has_room(figure: Figure) -> bool:
    """True if texts and legend leave axes of a size that shows something: `LEAST_AXES` in both directions."""
    with drawing(), warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")  # Matplotlib warns of a layout that it cannot make
        figure.draw_without_rendering()
    width, height = (INCH * side for side in figure.get_size_inches())
    boxes = [axes.get_position() for axes in figure.axes if axes.get_label() != COLOR_BAR]
    return not told and all(min(width * box.width, height * box.height) >= LEAST_AXES for box in boxes)


def line_scale(figure: Figure) -> float:
    """Widths of lines and markers, relative to a figure of 170 mm."""
    return min(1.0, max(0.65, math.sqrt(figure.get_figwidth() * INCH / 170.0)))


def finish(figure: Figure, axes: Axes, *others: Axes) -> None:
    """Lines and markers to suit the figure's size, powers of ten; above all the legend of the first axes."""
    scale = line_scale(figure)
    for one in (axes, *others):
        for line in one.get_lines():
            line.set_linewidth(scale * line.get_linewidth())
            line.set_markersize(scale * line.get_markersize())
        for axis, kind in ((one.xaxis, one.get_xscale()), (one.yaxis, one.get_yscale())):
            if kind == "linear":
                tell_power_of_ten(axis)
    legend_above(figure, *axes.get_legend_handles_labels())


def legend_above(figure: Figure, handles: Sequence[Any], labels: Sequence[str], **place: Any) -> None:
    """The legend above the axes, where it hides nothing, in as many columns as the width has room for.

    place : where, in a figure without a layout
    """
    if not labels:
        return
    words = None
    if figure.get_layout_engine():  # which keeps one thing at the top clear of the axes: the head joins it
        words = figure.get_suptitle() or None
        figure.suptitle("")
        place = {"loc": "outside upper center"}
    columns = columns_that_fit(labels, 72 * figure.get_figwidth() - 12)
    spacing: dict[str, Any] = {
        "handlelength": _HANDLE,
        "columnspacing": _BETWEEN,
        "handletextpad": 0.5,
        "borderpad": 0.2,
        "labelspacing": 0.35,
    }
    made = figure.legend(handles, labels, ncols=columns, frameon=False, **spacing, **place)
    if words:
        made.set_title(words, FontProperties(size=8))
        made.get_title().set_parse_math(False)
        made.get_title().set_multialignment("center")


_HANDLE, _BETWEEN = 3.0, 1.2  # in units of the font size


def columns_that_fit(labels: Sequence[str], width: float) -> int:
    """How many columns a legend may have within `width` [points], as even as its rows allow."""
    sizes = [text_width(label, SMALL) + (_HANDLE + 0.5 + _BETWEEN) * SMALL for label in labels]
    for rows in range(1, len(labels) + 1):
        columns = -(-len(labels) // rows)
        # Matplotlib fills column by column, the first ones with one more.
        parts = np.array_split(np.array(sizes), columns)
        if sum(part.max() for part in parts) <= width:
            return columns
    return 1


@lru_cache(maxsize=512)
def text_width(text: str, size: float) -> float:
    """Width of a text [points], mathematics included."""
    if not text.strip():  # Matplotlib has no path of nothing
        return 0.0
    outlines = TextPath((0, 0), text, size=size, prop=FontProperties("DejaVu Sans"))
    return float(np.max(outlines.vertices[:, 0], initial=0.0))


def fitted(text: str, width: float, size: float) -> str:
    """`text` on one line of at most `width` [points]; no mathematics."""
    least, most = 4, int(width / (0.2 * size))  # characters; no text is as narrow as this
    while least < most:  # the most that fit
        middle = (least + most + 1) // 2
        fits = text_width(shortened(text, middle).replace("$", "S"), size) <= width
        least, most = (middle, most) if fits else (least, middle - 1)
    return shortened(text, least)


FORMATS = tuple(METADATA)


def write(figure: Figure, path: Path, kind: str) -> None:
    """Write a figure in one of `FORMATS`."""
    figure.savefig(path, format=kind)


def shortened(text: str, width: int) -> str:
    """`text` on one line of at most `width` characters; what matplotlib's font does not have becomes "?"."""
    from matplotlib.font_manager import findfont, get_font

    font = get_font(findfont("DejaVu Sans"))
    line = "".join(c if font.get_char_index(ord(c)) else "?" for c in " ".join(text.split()))
    return line if len(line) <= width else line[: width - 3] + "..."
