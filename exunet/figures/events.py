"""Events of a script in figures over time: a line at each, with the name of its entry and its cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.page import COLOR_BAR, fitted, text_width
from exunet.figures.style import SMALL
from exunet.results.result import Result
from exunet.results.script_story import done

_OVER_TIME = ("time [s]", "stored time [s]")
_TOP = 0.9  # of the axes' height, where texts begin; above it each is joined to its line
_LINE = 1.3  # height of a line of text over the size of its letters


def mark_events(figure: Figure, result: Result) -> None:
    """Put the events of the result's script, if it has one, into axes over time; no axis changes.

    Texts stand side by side, those of events that are near each other beside their lines, to which they are
    joined above. An entry that has happened several times has its text at the first.
    """
    events = done(result.provenance)
    every = [axes for axes in figure.axes if axes.get_label() != COLOR_BAR]
    if not events or not every or every[-1].get_xlabel() not in _OVER_TIME:
        return
    low, high = every[-1].get_xlim()
    for axes in every:
        for one in events:
            axes.axvline(one["time_s"], color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.9)
        axes.set_xlim(low, high)
    texts = [(time, words) for time, words in _texts(events) if low <= time <= high]
    top, size = every[0], SMALL - 1.0
    figure.draw_without_rendering()  # lays out the axes
    wide, tall = (72.0 / figure.dpi * side for side in top.get_window_extent().size)
    lines = np.array([(time - low) / (high - low) for time, _ in texts])
    for line, place, (_, words) in zip(lines, apart(lines, _LINE * size / wide), texts, strict=True):
        joined = {"arrowstyle": "-", "color": "0.35", "linewidth": 0.4, "shrinkA": 0.0, "shrinkB": 0.0}
        text = top.annotate(
            _fitted(words, _TOP * tall, size),
            (float(line), 1.0),
            (float(place), _TOP),
            xycoords="axes fraction",
            textcoords="axes fraction",
            arrowprops=joined | {"relpos": (1.0, 1.0)},
            rotation=90,
            zorder=4.5,  # above the curves, which would cross it
        )
        text.set(va="top", ha="right", color="0.35", fontsize=size, clip_on=True, in_layout=False)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.0})


def _fitted(words: tuple[str, str], room: float, size: float) -> str:
    """The longer of two texts if there is room for it [points], else what fits of the other."""
    short, whole = words
    return whole if text_width(whole, size) <= room else fitted(short, room, size)


def _texts(events: Sequence[Mapping[str, Any]]) -> list[tuple[float, tuple[str, str]]]:
    """First time and texts of each entry, without and with its cause, in the order of the times."""
    times: dict[str, list[float]] = {}
    causes = {one["entry"]: one["cause"] for one in events}
    for one in events:
        times.setdefault(one["entry"], []).append(one["time_s"])
    found = []
    for name, all_of_it in times.items():
        often = f", {len(all_of_it)} times" if len(all_of_it) > 1 else ""
        found.append((all_of_it[0], (f"{name}{often}", f"{name}: {causes[name]}{often}")))
    return found


def apart(places: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Increasing places moved so that neighbours are `least` apart, from `least` to 1, by least squares."""
    number = len(places)
    least = min(least, 1.0 / max(number, 1))
    step = least * np.arange(number)
    blocks: list[list[float]] = []  # sum and number of places that stand side by side
    for one in places - step:
        blocks.append([float(one), 1.0])
        while len(blocks) > 1 and blocks[-2][0] * blocks[-1][1] > blocks[-1][0] * blocks[-2][1]:
            last = blocks.pop()
            blocks[-1] = [blocks[-1][0] + last[0], blocks[-1][1] + last[1]]
    moved = np.array([total / count for total, count in blocks for _ in range(int(count))])
    return np.clip(moved, least, 1.0 - least * (number - 1)) + step if number else moved
