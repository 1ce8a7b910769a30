"""Colours, line styles and settings of all figures; the figure class, its page and its file."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from threading import RLock
from typing import Any, Literal, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from exunet.results.comparison import Agreement
from exunet.results.ensemble import Ensemble
from exunet.results.observables import Observables
from exunet.results.result import Result

PRINT, SCREEN = 300, 200  # dots per inch: of files, of the figures of a run
SMALL = 7.0  # points: ticks, legends, titles of panels

GREY = "#b5b5b5"
BLUE = "#004488"  # Tol's high-contrast scheme, made for colour-blind readers and for print in grey
RED = "#BB5566"
YELLOW = "#DDAA33"
BLACK = "#000000"

MAX_CURVES = 8  # distinguishable curves of one figure
_LINES: tuple[Any, ...] = (*("-", "-", "--", ":", "-.", (0, (4, 1, 1, 1, 1, 1)), (0, (7, 2)), (0, (2.5, 1))),)
_MARKERS = "os^xDv*P"
_FOUR = (YELLOW, RED, BLUE, BLACK)


def curve_styles(count: int) -> list[dict[str, Any]]:
    """Return colour, line, width and marker of up to eight curves that differ in grey as well.

    Broad and light first, thin and dark last: each curve shows even where all of them coincide.
    """
    colors: Sequence[Any] = _FOUR if count > 1 else (BLUE,)
    if count > len(_FOUR):  # evenly spaced in lightness
        colors = [tuple(c) for c in matplotlib.colormaps["cividis"](np.linspace(0.92, 0.0, count))]
    widths = np.geomspace(2.6, 1.1, count) if count > 1 else [1.6]
    return [
        {"color": colors[k], "linestyle": _LINES[k], "linewidth": float(widths[k]), "marker": _MARKERS[k]}
        for k in range(count)
    ]


CURVES = tuple(curve_styles(4))

_RC: dict[str, Any] = {
    "savefig.dpi": PRINT,
    "pdf.fonttype": 42,  # fonts as text, which editors and journals can use; not as outlines
    "svg.fonttype": "none",
    "svg.hashsalt": "exunet",  # the same figure gives the same bytes
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.useoffset": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "lines.markersize": 4.0,
    "lines.solid_capstyle": "round",
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}


_DRAWING = RLock()
_blocks: list[bool] = []  # of the thread that has the lock


@contextmanager
def drawing() -> Iterator[None]:
    """Set the parameters of figures for the outermost block; restore the caller's afterwards.

    Matplotlib's parameters and its parser of text belong to the process: other threads wait.
    """
    with _DRAWING, nullcontext() if _blocks else matplotlib.rc_context():
        if not _blocks:
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(cast(Any, _RC))
        _blocks.append(True)
        try:
            yield
        finally:
            _blocks.pop()


# Without the time of writing: the same figure gives the same bytes.
METADATA: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}


class StyledFigure(Figure):
    """A figure that is saved under the settings under which it was drawn, and shows itself in notebooks."""

    def savefig(self, fname: Any, **kwargs: Any) -> None:
        ending = str(getattr(fname, "suffix", "") or str(fname).rpartition(".")[2]).lstrip(".")
        kwargs.setdefault("metadata", METADATA.get(kwargs.get("format", ending).lower()))
        with drawing():
            super().savefig(fname, **kwargs)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        self.savefig(file, format="png", dpi=150)
        return file.getvalue()


def blank(width: float, height: float) -> Figure:
    """Return an empty figure that belongs to the caller; sizes in inches."""
    return StyledFigure(figsize=(width, height), dpi=SCREEN)


def number(value: float) -> str:
    """Return a number of at most four digits for a label."""
    return f"{value:.4g}"


INCH = 25.4  # mm
WIDTHS = (85.0, 170.0)  # mm, of a column and of a page of a journal
MAX_HEIGHT = 230.0  # mm
ROUND = [1, 2, 5, 10]  # steps between the numbers at an axis
FORMATS = tuple(METADATA)
_LEGEND_ROW = 3.6  # mm


@dataclass(frozen=True)
class FigureData:
    """Data that a figure is drawn from, and its width.

    result    : the run
    ensemble  : its perturbed runs, if any
    agreement : its comparison with the reference, if any
    width     : of the figure [mm]
    known     : its observables, if they were computed before
    """

    result: Result
    ensemble: Ensemble | None = None
    agreement: Agreement | None = None
    width: float = 170.0
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
    source: FigureData, height: float, layout: Literal["constrained", "compressed"] = "constrained"
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
