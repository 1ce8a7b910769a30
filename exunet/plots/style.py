"""Colours, line styles and settings of all figures; the figure class."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from io import BytesIO
from threading import RLock
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.figure import Figure

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
