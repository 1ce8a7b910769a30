"""Figures of an ensemble: histograms of its headlines, and bands of quantities over time."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.base.files import replacing
from exunet.figures.page import FORMATS, INCH, ROUND, Page, legend_above, text_width, write
from exunet.figures.powers import tell_power_of_ten
from exunet.figures.style import BLACK, SMALL, blank, drawing
from exunet.results.curves import CURVES
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.headlines import headline
from exunet.results.spread import FEWEST

Floats = NDArray[np.float64]

FIGURES = {
    "histograms": "how often each value of each headline occurs; needs a headline that differs between runs",
    "bands": "median and quantiles of quantities over time",
}
WIDTH, HEAD, ROW, LEAST_ROW = 170.0, 12.0, 48.0, 38.0  # [mm] of the figure, its legend, and a row of panels
FEW, HIGHEST = 8, 230.0  # panels in two columns, more are in three; [mm] of a page, if rows can be so low
_BESIDE = 44.0  # points of a panel's width that are not its axis; a label is centred below the axis
BANDS = ((0.0, 1.0, "#d3dde8"), (0.05, 0.95, "#94adc9"), (0.25, 0.75, "#4d77a6"))  # levels, tint of BLUE


@takes(result=EnsembleResult, name=str, title=bool)
def ensemble_figure(result: EnsembleResult, name: str, *, title: bool = False) -> Figure:
    """One figure of an ensemble, "histograms" or "bands", as a Matplotlib figure that belongs to the caller.

    Raises InputError for a name that is not known, or an ensemble that has not what the figure shows.
    """
    if name not in FIGURES:
        raise InputError(f"figure: {name!r} is not one of {', '.join(FIGURES)}")
    page = Page(None, title)
    with drawing():
        made = histograms(result, page) if name == "histograms" else bands(result, page)
    if made is None:
        raise InputError(f"figure: this ensemble cannot have {name!r}: {FIGURES[name]}")
    return made


def save_ensemble_figures(
    result: EnsembleResult,
    folder: str | Path,
    *,
    format: str = "png",  # noqa: A002 - as Matplotlib calls it
    title: bool = False,
) -> list[Path]:
    """Write each figure as NAME.FORMAT ("png", "pdf" or "svg") into a folder; the paths of the files."""
    if format not in FORMATS:
        raise InputError(f"format: must be one of {', '.join(FORMATS)}, got {format!r}")
    page, paths = Page(None, title), []
    with drawing():
        made = {"histograms": histograms(result, page), "bands": bands(result, page)}
    for name, figure in made.items():
        if figure is not None:
            path = Path(folder) / f"{name}.{format}"
            with replacing(path) as part:
                write(figure, part, format)
            paths.append(path)
    return paths


def histograms(result: EnsembleResult, page: Page) -> Figure | None:
    """A panel for each headline of the table that differs between runs, but not of the books; or None."""
    shown = [
        (one, values[~np.isnan(values)])
        for one, values in ((headline(key), values) for key, values in result.headlines.items())
        if not (one.of_book or one.detail) and np.nanmax(values) - np.nanmin(values) > one.least
    ]
    if not shown:
        return None
    figure, panels = _panels(result, page, len(shown), f"Headlines of {result.runs} runs")
    for axes, (one, values) in zip(panels, shown, strict=True):
        values, label = _from_a_round_number(values, one.words, _unit(one.unit))
        bins = _bins(values, float(result.time[1] - result.time[0]) if one.at_a_time else 0.0)
        axes.hist(values, bins=bins.tolist(), color=BANDS[1][2], edgecolor="white", linewidth=0.3)
        axes.axvline(float(np.median(values)), color=BLACK, linewidth=1.0, label="median")
        for level in (0.05, 0.95) if len(values) >= FEWEST else ():
            words = "5 % and 95 %" if level < 0.5 else None
            at = float(np.quantile(values, level))
            axes.axvline(at, color=BLACK, linewidth=0.8, linestyle=":", label=words)
        axes.set_xlabel(label)
        axes.set_ylabel("runs")
        axes.xaxis.set_major_locator(MaxNLocator(6 if len(shown) <= FEW else 4, steps=ROUND))
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        tell_power_of_ten(axes.xaxis)
        axes.set_xlabel(_wrapped(axes.get_xlabel(), 72.0 * WIDTH / INCH / _columns(len(shown)) - _BESIDE))
    legend_above(figure, *panels[0].get_legend_handles_labels())
    return figure


def _bins(values: Floats, spacing: float) -> Floats:
    """Edges of 5 to 40 bins of equal width; of values (n,) that are multiples of a spacing about whole ones.

    A bin that had one of the spacings more than its neighbour would be higher for no other reason.
    """
    number, low, high = int(np.clip(np.sqrt(len(values)), 5, 40)), float(values.min()), float(values.max())
    if high - low < spacing or not spacing:
        return np.linspace(low, high, number + 1)
    steps = round((high - low) / spacing) + 1  # different values that there can be
    width = math.ceil(steps / number)
    return np.asarray(low + spacing * (width * np.arange(math.ceil(steps / width) + 1) - 0.5))


def _from_a_round_number(values: Floats, words: str, unit: str) -> tuple[Floats, str]:
    """Values that differ in late digits less a round number near their median; and the label that says so."""
    spread, middle = float(np.ptp(values)), float(np.median(values))
    name = f"{words} [{unit}]" if unit else words
    if spread > 1e-3 * abs(middle):
        return values, name
    power = math.ceil(math.log10(spread))
    start = round(middle, -power)
    sign = "+" if start < 0.0 else "\N{MINUS SIGN}"
    less = f"{words} {sign} {abs(start):.{max(0, -power)}f} {unit}".rstrip()
    return values - start, f"{less} [{unit}]" if unit else less


def _wrapped(label: str, width: float) -> str:
    """A label in lines of at most `width` [points], divided at what is taken off, the unit, or words."""
    lines: list[str] = []
    words, *others = re.split(r" (?=[+\N{MINUS SIGN}[])", label)
    for part in (*([words] if text_width(words, SMALL) <= width else words.split()), *others):
        if lines and text_width(f"{lines[-1]} {part}", SMALL) <= width:
            lines[-1] += f" {part}"
        else:
            lines.append(part)
    return "\n".join(lines)


def bands(result: EnsembleResult, page: Page) -> Figure | None:
    """One panel for each of `CURVES`: median, and bands from the least to the largest, 5-95 %, 25-75 %.

    None where all are zero all the time.
    """
    shown = [curve for curve in CURVES if np.any(result.quantiles.get(curve.name, 0.0))]
    if not shown:
        return None
    figure, panels = _panels(
        result,
        page,
        len(shown),
        f"{'Quantiles' if result.runs >= FEWEST else 'Range'} of {result.runs} run{'s' * (result.runs > 1)}",
    )
    level = {float(value): k for k, value in enumerate(result.levels)}
    for axes, curve in zip(panels, shown, strict=True):
        values = result.quantiles[curve.name]
        for low, high, tint in BANDS if result.runs >= FEWEST else BANDS[:1]:
            label = "all runs" if low == 0.0 else f"{low:.0%} to {high:.0%}".replace("%", " %")
            ends = values[level[low]], values[level[high]]
            axes.fill_between(result.time, *ends, color=tint, linewidth=0, label=label)
        axes.plot(result.time, values[level[0.5]], color=BLACK, linewidth=0.9, label="median")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"{curve.words} [{_unit(curve.unit)}]")
        axes.set_xlim(float(result.time[0]), float(result.time[-1]))
        axes.set_ylim(bottom=min(0.0, float(values.min())))
        tell_power_of_ten(axes.xaxis)
        tell_power_of_ten(axes.yaxis)
    legend_above(figure, *panels[0].get_legend_handles_labels())
    return figure


def _unit(unit: str) -> str:
    return unit.replace("2", "²")


def _columns(count: int) -> int:
    return min(count, 2 if count <= FEW else 3)


def _panels(result: EnsembleResult, page: Page, count: int, title: str) -> tuple[Figure, list[Axes]]:
    columns = _columns(count)
    rows = -(-count // columns)
    row = min(ROW, max(LEAST_ROW, (HIGHEST - HEAD) / rows))
    figure = blank(WIDTH / INCH, (HEAD + row * rows) / INCH)
    figure.set_layout_engine("constrained")
    page.head(figure, result, title)
    grid = figure.subplots(rows, columns, squeeze=False)
    panels = list(grid.ravel())
    for axes in panels[count:]:
        axes.remove()
    for axes in panels[:count]:
        axes.xaxis.label.set_size(SMALL)
        axes.yaxis.label.set_size(SMALL)
    return figure, panels[:count]
