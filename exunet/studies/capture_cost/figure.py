"""What became of the target against wall time: a panel for each quantity, with the range of the finest."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from exunet.figures.page import INCH, ROUND, legend_above
from exunet.figures.style import BLACK, BLUE, RED, YELLOW, blank
from exunet.results.headline import Headline
from exunet.studies.capture_cost.judging import Bias
from exunet.studies.capture_cost.rows import quantities
from exunet.studies.capture_cost.settings import Knob
from exunet.studies.capture_cost.study import CaptureRow, CaptureStudy

_WIDTH, _HEIGHT, _HEAD = 170.0, 34.0, 26.0  # mm: of the page, of a panel, of legend and label
_KNOBS: dict[Knob, dict[str, Any]] = {
    Knob.SIZE: {"color": BLUE, "marker": "o", "linestyle": "-"},
    Knob.STIFFNESS: {"color": RED, "marker": "^", "linestyle": "none"},
    Knob.DIVISIONS: {"color": YELLOW, "marker": "s", "linestyle": "none"},
    Knob.FORM: {"color": BLACK, "marker": "x", "linestyle": "none"},
}
_WORDS = {Knob.FORM: "form of Exudyn's, one run"}


def capture_cost(study: CaptureStudy) -> Figure | None:
    """Medians with ranges over moved starts; None where nothing ran."""
    shown = quantities(study)
    if not shown:
        return None
    figure = blank(_WIDTH / INCH, (_HEAD + _HEIGHT * len(shown)) / INCH)
    figure.set_layout_engine("constrained")
    if study.interrupted:
        figure.suptitle("INCOMPLETE: interrupted")
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, one in zip(panels, shown, strict=True):
        _panel(axes, study, one)
    panels[-1].set_xlabel("wall time of the stepping of one run [s]")
    legend_above(figure, *panels[0].get_legend_handles_labels())
    return figure


def _panel(axes: Axes, study: CaptureStudy, quantity: Headline) -> None:
    axes.set_xscale("log")
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=ROUND))
    finest = None if study.finest is None else _of(study, study.finest, quantity)
    if finest is not None:
        band = f"range of {finest.runs} finest runs"
        axes.axhspan(finest.least, finest.largest, color="0.93", zorder=0, label=band)
        allowed = max((one.allowed for row in study.rows if (one := _of(study, row, quantity))), default=0.0)
        within = "a third of it to each side of the median, or what is resolved"
        assert study.finest is not None
        axes.plot(
            study.finest.seconds,
            finest.median,
            "o",
            color=BLUE,
            mfc="none",
            markersize=9.0,
            label="the finest",
        )
        low, high = finest.median - allowed, finest.median + allowed
        axes.axhspan(low, high, color="0.84", zorder=0.5, label=within)
    for knob, style in _KNOBS.items():
        rows = sorted(study.rows, key=lambda row: -row.setting.size)  # the line goes from coarse to fine
        points = [
            (row.seconds, one)
            for row in rows
            if row.setting.knob == knob and (one := _of(study, row, quantity)) is not None
        ]
        if not points:
            continue
        x, found = [point[0] for point in points], [point[1] for point in points]
        middle = [one.median for one in found]
        ends = [[one.median - one.least for one in found], [one.largest - one.median for one in found]]
        axes.errorbar(
            x, middle, ends, label=_WORDS.get(knob, str(knob)), capsize=2.0, linewidth=1.0, markersize=4.5,
            elinewidth=0.8, zorder=3, **style,
        )  # fmt: skip
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    axes.set_ylabel(f"{_folded(quantity.words)}{unit}")
    axes.grid(visible=True, which="major", color="0.92", linewidth=0.5)


def _of(study: CaptureStudy, row: CaptureRow, quantity: Headline) -> Bias | None:
    """The quantity of a row; None where it has none."""
    return next((one for one in study.biases(row) if one.quantity.name == quantity.name), None)


def _folded(words: str) -> str:
    """In two lines, if it is long."""
    if len(words) < 16:
        return words
    middle = min(
        (k for k, c in enumerate(words) if c == " "), key=lambda k: abs(k - len(words) // 2), default=0
    )
    return f"{words[:middle]}\n{words[middle + 1 :]}" if middle else words
