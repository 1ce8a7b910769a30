"""Events of a script in figures over time: a line at each, with the name of its entry and its cause."""

from __future__ import annotations

from matplotlib.figure import Figure

from exunet.figures.page import COLOR_BAR
from exunet.figures.style import SMALL
from exunet.results.result import Result
from exunet.results.script_story import done

_OVER_TIME = ("time [s]", "stored time [s]")
_TOGETHER = 0.03  # of the axis: events that are nearer to each other have one text


def mark_events(figure: Figure, result: Result) -> None:
    """Put the events of the result's script, if it has one, into axes over time; no axis changes."""
    events = done(result.provenance)
    every = [axes for axes in figure.axes if axes.get_label() != COLOR_BAR]
    if not events or not every or every[-1].get_xlabel() not in _OVER_TIME:
        return
    low, high = every[-1].get_xlim()
    for axes in every:
        for one in events:
            axes.axvline(one["time_s"], color="0.6", linewidth=0.6, linestyle=(0, (1, 2)), zorder=0.9)
        axes.set_xlim(low, high)
    together: list[tuple[float, list[str]]] = []
    for one in events:
        words = f"{one['entry']}: {one['cause']}"
        if together and one["time_s"] - together[-1][0] < _TOGETHER * (high - low):
            together[-1][1].append(words)
        else:
            together.append((one["time_s"], [words]))
    top = every[0]
    for time, texts in together:
        words = "\n".join(texts)
        text = top.text(time, 0.98, words, transform=top.get_xaxis_transform(), rotation=90, zorder=1.1)
        text.set(va="top", ha="right", color="0.35", fontsize=SMALL - 1.0, clip_on=True)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 0.5})
