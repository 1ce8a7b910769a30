"""Labels and headings of axes above each other, folded so that none reaches over another or off the page."""

from __future__ import annotations

import re
from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from exunet.figures.page import COLOR_BAR, text_width

MOST_LINES = 4
LEAST_SIZE = 5.0  # points, of a label that does not fit otherwise
_FREE = 2.0  # points between two labels
_WORD = re.compile(r"\[[^\]]*\]|\([^)]*\)[,.]?|\S+")  # a unit, a bracket: none is folded


def fit_labels(figure: Figure) -> None:
    """Fold labels of vertical axes that are longer than these have room for, and headings, to the page.

    Letters become smaller, `LEAST_SIZE` at least, where that is not enough. Axes whose labels fit keep them.
    """
    figure.draw_without_rendering()  # lays out the axes
    folded = False
    for axes, room in _rooms(figure):
        folded |= _fit(axes.yaxis.label, room)
        wide = 72.0 * figure.get_figwidth() * (1.0 - axes.get_position().x0) - _FREE
        folded |= _fit(_heading(axes), wide)
    if folded:
        figure.draw_without_rendering()


def labels_overlap(figure: Figure) -> bool:
    """True if the label of a vertical axis reaches over that of another, or is off the page."""
    high = figure.bbox.height
    ends = [
        (box.y0, box.y1)
        for axes in _stacked(figure)
        if axes.get_ylabel()
        for box in [axes.yaxis.label.get_window_extent()]
    ]
    off = any(low < 0.0 or top > high for low, top in ends)
    return off or any(upper[0] < lower[1] for upper, lower in pairwise(ends))


def _stacked(figure: Figure) -> list[Axes]:
    """From the highest to the lowest, of a figure of axes above each other; none of others."""
    found = [axes for axes in figure.axes if axes.get_label() != COLOR_BAR]
    left = {round(axes.get_position().x0, 6) for axes in found}
    if len(left) > 1 or figure.get_layout_engine() is None:
        return []
    return sorted(found, key=lambda axes: -axes.get_position().y0)


def _rooms(figure: Figure) -> list[tuple[Axes, float]]:
    """How long labels of vertical axes may be [points]: to the middle between two, or the page's edge."""
    if not (every := _stacked(figure)):
        return []
    high = 72.0 * figure.get_figheight()
    middles = [high * 0.5 * (box.y0 + box.y1) for box in (axes.get_position() for axes in every)]
    bounds = [high, *(0.5 * (a + b) for a, b in pairwise(middles)), 0.0]
    rooms = [
        2.0 * min(above - middle, middle - below) - _FREE
        for middle, (above, below) in zip(middles, pairwise(bounds), strict=True)
    ]
    return list(zip(every, rooms, strict=True))


def _heading(axes: Axes) -> Text | None:
    """The title at the left of axes."""
    words = axes.get_title(loc="left")
    return next((one for one in axes.findobj(Text) if words and one.get_text() == words), None)


def _fit(text: Text | None, room: float) -> bool:
    """Fold a text into lines of at most `room` [points]; True if it was changed."""
    if text is None:
        return False
    words, size = text.get_text(), float(text.get_fontsize())
    if not words or _longest(words, size) <= room:
        return False
    least = words.count("\n") + 1
    ways = (fold(words, lines) for lines in range(least, MOST_LINES + 1))
    best = min(ways, key=lambda one: (max(_longest(one, size), room), one.count("\n")))
    text.set_text(best)
    text.set_fontsize(max(LEAST_SIZE, min(size, size * room / _longest(best, size))))
    return True


def _longest(words: str, size: float) -> float:
    return max(text_width(line, size) for line in words.split("\n"))


def fold(words: str, lines: int) -> str:
    """Words in at most so many lines, the longest of which is as short as can be."""
    parts = _WORD.findall(words)
    low, high = max(map(len, parts)), len(" ".join(parts))
    while low < high:  # the least width in characters that so many lines need
        middle = (low + high) // 2
        low, high = (low, middle) if len(_filled(parts, middle)) <= lines else (middle + 1, high)
    return "\n".join(_filled(parts, low))


def _filled(parts: list[str], width: int) -> list[str]:
    """Lines of at most `width` characters, or of one word."""
    found: list[str] = []
    for part in parts:
        if found and len(found[-1]) + 1 + len(part) <= width:
            found[-1] += f" {part}"
        else:
            found.append(part)
    return found
