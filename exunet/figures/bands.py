"""Bands of moved starts behind the curves of a figure: one each of a few, one of all where they are many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from exunet.figures.known import tell_alone
from exunet.figures.lines import spread_band
from exunet.figures.style import BLACK, number
from exunet.results.ensemble_result import EnsembleResult

Floats = NDArray[np.float64]
Panel = tuple[Axes, Mapping[str, Any]]  # axes, and the colours of their curves by the names of the quantities
Band = tuple[Floats, Floats, Any]  # least and largest (t,), colour

MOST_BANDS = 4  # that can be seen, in one pair of axes, of curves of their own
_SEEN = 0.01  # of what all bands in a pair of axes reach over: the width of a band that can be seen
_SAME = 1e-6  # of an interval, by which others may differ


def bands_behind(
    panels: Sequence[Panel],
    spread: EnsembleResult | None,
    means_between: Floats | None = None,
    most: int = MOST_BANDS,
) -> list[float]:
    """Bands of all curves, told in the legend of the first axes; the top of the bands of each pair of axes.

    Where there are axes in which more than `most` bands could be seen, axes have one grey band each, from the
    least to the largest of all their curves. Without quantiles of each curve nothing is drawn and tops are 0;
    the legend then says that one run of a chaotic net is shown, where it is.

    means_between : (n,) times [s] between which the curves are means; None: they are values at times. Bands
                    are of means between the instants of the spread, which is told where these are others
    """
    first = panels[0][0]
    there = spread is not None and all(name in spread.quantiles for _, colors in panels for name in colors)
    if spread is None or not there or (means_between is not None and len(spread.time) < 2):
        tell_alone(first, spread)
        return [0.0] * len(panels)
    time, rows, remark = spread.time, slice(None), ""
    if means_between is not None:
        time, rows = 0.5 * (time[1:] + time[:-1]), slice(1, None)
        remark = _intervals(means_between, spread.time)
    found: list[list[Band]] = []
    for _, colors in panels:
        ends = {name: spread.band(name) for name in colors}
        found.append([(low[rows], high[rows], colors[name]) for name, (low, high) in ends.items()])
    words = "ranges of" if max(map(len, found)) > 1 else "range of"
    if max(map(_seen, found)) > most:
        found, words = [[_of_all(bands)] for bands in found], "range of all curves in"
    for (axes, _), bands in zip(panels, found, strict=True):
        for low, high, color in bands:
            spread_band(axes, spread, (low, high), color, None, time)
    spread_band(first, spread, None, BLACK, f"{words} {spread.runs} moved starts{remark}")
    return [float(_of_all(bands)[1].max()) for bands in found]


def _of_all(bands: Sequence[Band]) -> Band:
    """One from the least to the largest."""
    low, high = (np.array([band[side] for band in bands]) for side in (0, 1))
    return low.min(axis=0), high.max(axis=0), BLACK


def _seen(bands: Sequence[Band]) -> int:
    """How many are wide enough to be seen."""
    least, largest, _ = _of_all(bands)
    width = _SEEN * float(largest.max() - least.min())
    return sum(float((high - low).max()) > width for low, high, _ in bands)


def _intervals(of_curves: Floats, of_bands: Floats) -> str:
    """Words on the intervals of means, where those of the bands are not those of the curves; else ""."""
    own = float(of_bands[1] - of_bands[0])
    if np.allclose(np.diff(of_curves), own, rtol=_SAME, atol=0.0):
        return ""
    return f", means over {number(own)} s"
