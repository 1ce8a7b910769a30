"""What all figures share: colours that also differ in grey, line styles, a canvas without global state."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import matplotlib
from matplotlib.figure import Figure

from exunet.results.result import Result

GREY = "#b5b5b5"
BLUE = "#004488"  # Tol's high-contrast scheme, made for colour-blind readers and for print in grey
RED = "#BB5566"
YELLOW = "#DDAA33"
BLACK = "#000000"

# Broad and light first, thin and dark last: each curve shows even where all of them coincide.
CURVES: tuple[dict[str, Any], ...] = (
    {"color": YELLOW, "linestyle": "-", "linewidth": 3.0, "marker": "o"},
    {"color": RED, "linestyle": "-", "linewidth": 1.8, "marker": "s"},
    {"color": BLUE, "linestyle": "--", "linewidth": 1.4, "marker": "^"},
    {"color": BLACK, "linestyle": ":", "linewidth": 1.2, "marker": "x"},
)

_RC: dict[str, Any] = {
    "savefig.dpi": 150,
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "legend.fontsize": 8,
    "legend.framealpha": 0.9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "lines.solid_capstyle": "round",
}


@contextmanager
def drawing() -> Iterator[None]:
    """The settings under which figures are made and saved; the caller's are put back afterwards."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(cast(Any, _RC))
        yield


def blank(width: float, height: float) -> Figure:
    """An empty figure, sizes in inches; it belongs to nobody but its caller."""
    return Figure(figsize=(width, height))


def heading(figure: Figure, result: Result, text: str) -> None:
    """The figure's title; an incomplete result is named so, with its verdict."""
    if not result.complete:
        fits = int(10.5 * figure.get_figwidth())
        text += "\n" + shortened("INCOMPLETE: " + result.verdict, fits)
    top = 1 - 0.08 / figure.get_figheight()
    figure.suptitle(text, y=top, va="top", fontsize=10, parse_math=False)


def shortened(text: str, width: int) -> str:
    """`text` on one line of at most `width` characters; what matplotlib's font does not have becomes "?"."""
    from matplotlib.font_manager import findfont, get_font

    font = get_font(findfont("DejaVu Sans"))
    line = "".join(c if font.get_char_index(ord(c)) else "?" for c in " ".join(text.split()))
    return line if len(line) <= width else line[: width - 3] + "..."


def number(value: float) -> str:
    """A number for a label: up to four digits, no more than it needs."""
    return f"{value:.4g}"
