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

MOST_BANDS = 4  # in one pair of axes, of curves of their own
_SAME = 1e-6  # of an interval, by which others may differ


def bands_behind(
    panels: Sequence[Panel], spread: EnsembleResult | None, means_between: Floats | None = None
) -> list[float]:
    """Bands of all curves, told in the legend of the first axes; the top of the bands of each pair of axes.

    Where there are axes with more than four curves, each has one grey band from the least to the largest of
    its curves in all runs. Without quantiles of each curve nothing is drawn and tops are 0; the legend then
    says that one run of a chaotic net is shown, where it is.

    means_between : (n,) times [s] between which the curves are means; None: they are values at times. Bands
                    are of means between the instants of the spread, which is told where these are others
    """
    first = panels[0][0]
    instants = 0 if spread is None else len(spread.time)
    there = spread is not None and all(name in spread.quantiles for _, colors in panels for name in colors)
    if spread is None or not there or (means_between is not None and instants < 2):
        tell_alone(first, spread)
        return [0.0] * len(panels)
    most, tops = max(len(colors) for _, colors in panels), []
    words = "range" if most == 1 else "ranges" if most <= MOST_BANDS else "range of all curves"
    words += f" {'of' if most <= MOST_BANDS else 'in'} {spread.runs} moved starts"
    time, rows = spread.time, slice(None)
    if means_between is not None:
        time, rows = 0.5 * (time[1:] + time[:-1]), slice(1, None)
        words += _intervals(means_between, spread.time)
    for axes, colors in panels:
        bands = [(*(side[rows] for side in spread.band(name)), color) for name, color in colors.items()]
        if most > MOST_BANDS:
            least = np.min([low for low, _, _ in bands], axis=0)
            bands = [(least, np.max([high for _, high, _ in bands], axis=0), BLACK)]
        for low, high, color in bands:
            spread_band(axes, spread, (low, high), color, None, time)
        tops.append(max(float(high.max()) for _, high, _ in bands))
    spread_band(first, spread, None, BLACK, words)
    return tops


def _intervals(of_curves: Floats, of_bands: Floats) -> str:
    """Words on the intervals of means, where those of the bands are not those of the curves; else ""."""
    own = float(of_bands[1] - of_bands[0])
    if np.allclose(np.diff(of_curves), own, rtol=_SAME, atol=0.0):
        return ""
    return f", means over {number(own)} s"
