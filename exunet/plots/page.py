"""The page of a figure: width, legend above the axes, mark of an incomplete result, file."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from exunet.plots.style import METADATA, RED, blank
from exunet.results.comparison import Agreement
from exunet.results.ensemble import Ensemble
from exunet.results.observables import Observables
from exunet.results.result import Result

INCH = 25.4  # mm
WIDTHS = (85.0, 170.0)  # mm, of a column and of a page of a journal
MAX_HEIGHT = 230.0  # mm
ROUND = [1, 2, 5, 10]  # steps between the numbers at an axis
FORMATS = tuple(METADATA)
_LEGEND_ROW = 3.6  # mm


@dataclass(frozen=True)
class Source:
    """What a figure is drawn from, and its width.

    result    : the run
    ensemble  : its perturbed runs, if any
    agreement : its comparison with the reference, if any
    width     : of the figure [mm]
    grid      : draw a reference grid below 3-D views
    known     : its observables, if they were computed before
    """

    result: Result
    ensemble: Ensemble | None = None
    agreement: Agreement | None = None
    width: float = 170.0
    grid: bool = False
    known: Observables | None = None

    @cached_property
    def run(self) -> Observables:
        """Observables of the result."""
        return self.known or Observables(self.result)

    @property
    def is_narrow(self) -> bool:
        """True for a figure of one column."""
        return self.width < WIDTHS[1]


def new_figure(
    source: Source, height: float, layout: Literal["constrained", "compressed"] = "constrained"
) -> Figure:
    """Return an empty figure of the source's width and a height [mm]; an incomplete result is named below."""
    height = min(height, MAX_HEIGHT)
    figure = blank(source.width / INCH, height / INCH)
    figure.set_layout_engine(layout)
    mark_incomplete(figure, source.result)
    return figure


def mark_incomplete(figure: Figure, result: Result | Ensemble) -> None:
    """Write below the axes that a result is incomplete, and why."""
    if not result.complete:
        length = int(figure.get_figwidth() * INCH / 1.7)  # characters of 8 points
        text = textwrap.shorten(f"INCOMPLETE: {result.verdict}", length, placeholder=" ...")
        figure.supxlabel(text, fontsize=8, color=RED, parse_math=False)


def legend_above(figure: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Add a legend above the axes in as many columns as fit; a figure with more than two rows grows.

    Long labels are folded.
    """
    labels = [textwrap.fill(label, int(INCH * figure.get_figwidth() / 1.5)) for label in labels]
    style: dict[str, Any] = {"handlelength": 3.0, "columnspacing": 1.2, "handletextpad": 0.5}
    style |= {"borderpad": 0.2, "labelspacing": 0.35, "frameon": False, "loc": "outside upper center"}
    for columns in range(len(labels), 0, -1):
        if columns > 1 and -(-len(labels) // columns) == -(-len(labels) // (columns - 1)):
            continue  # fewer columns give as many rows
        legend = figure.legend(handles, labels, ncols=columns, **style)
        if columns == 1 or legend.get_window_extent().width <= 0.98 * figure.bbox.width:
            break
        legend.remove()
    else:
        return
    rows = sum(label.count("\n") + 1 for label in labels) / columns
    figure.set_figheight(figure.get_figheight() + _LEGEND_ROW / INCH * max(0, math.ceil(rows) - 2))


def write(figure: Figure, path: Path, kind: str, dpi: float) -> None:
    """Write a figure in one of `FORMATS`, within `drawing`; dpi : dots per inch of a PNG."""
    if kind == "png" and (layout := figure.get_layout_engine()) is not None:
        figure.set_dpi(dpi)
        layout.execute(figure)
        figure.set_layout_engine(None)  # otherwise Matplotlib draws twice, the first time for the layout
    figure.savefig(path, format=kind, dpi=dpi)
