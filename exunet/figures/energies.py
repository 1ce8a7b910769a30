"""Energies over time: their changes, and the error of their balance."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.lines import curve, spread_band
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, BLUE, RED, SMALL, YELLOW
from exunet.figures.thinning import BINS, thinned_band
from exunet.results import measures as metrics
from exunet.results.course import CONTACT, SELF
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.result import Result
from exunet.results.taken import TAKEN, stored_over_time, taken_of, taken_over_time

Floats = NDArray[np.float64]

# Of works: with the four energies as many curves as can be told apart.
_WORKS: tuple[dict[str, Any], ...] = (
    {"color": "0.35", "linestyle": "-.", "marker": "^"},
    {"color": "0.55", "linestyle": (0, (7, 2)), "marker": "D"},
    {"color": "0.35", "linestyle": (0, (2.5, 1)), "marker": "x"},
    {"color": "0.55", "linestyle": "-", "marker": "*"},
)
# Of parts of what is dissipated, in its colour.
_TAKEN: tuple[dict[str, Any], ...] = (
    {"linestyle": "--", "marker": "v"},
    {"linestyle": ":", "marker": "o"},
    {"linestyle": "-.", "marker": "d"},
    {"linestyle": (0, (7, 2)), "marker": "x"},
)
_REACHED = 0.5  # opacity of what is reached between stored times


def energies(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure:
    """Changes of the energies since the first stored time, and the error of their balance below.

    Kinetic, elastic and potential energy and the part of it that contacts store, where it is not all of it;
    what is dissipated and the parts of it that contacts and a closing line took; and the works that each
    reel, an ejection and each body whose motion is given have put in, if any. What a thrust puts in counts as
    dissipated below zero. Where known, bands reach from kinetic and elastic energy to their extremes over the
    steps between stored times.
    """
    taken = metrics.dissipation(result)
    parts: dict[str, tuple[Floats, dict[str, Any]]] = {
        "dissipated": (taken, {"color": YELLOW, "linewidth": 2.6, "marker": "s"}),
        "elastic": (np.asarray(result.elastic), {"color": RED, "linewidth": 1.6}),
        "kinetic": (np.asarray(result.kinetic), {"color": BLUE, "linewidth": 1.2, "linestyle": "--"}),
    }
    if np.any(result.potential != result.potential[0]):
        dotted = {"color": BLACK, "linewidth": 1.0, "linestyle": ":", "marker": "v"}
        parts["potential"] = (np.asarray(result.potential), dotted)
    parts |= _stored(result)
    parts |= _taken(result)
    parts |= _put_in(result)
    figure, (axes, below) = page.stacked_axes(result, "Changes of the energies", (3.0, 1.0), 115.0)
    axes.set_ylabel("energy change [J]")
    for name, (values, style) in parts.items():
        curve(axes, result.time, values - values[0], **style, label=name, markersize=4.0)
    extremes = {"kinetic": result.least_kinetic, "elastic": result.largest_elastic}
    for name, reached in extremes.items():
        if reached is not None:
            values, style = parts[name]
            _band(axes, result.time, values - values[0], np.asarray(reached) - values[0], style["color"])
    if any(reached is not None for reached in extremes.values()):
        axes.fill_between([], [], color="0.5", alpha=_REACHED, linewidth=0, label="extremes of all steps")
    if spread is not None:
        for name, (values, style) in parts.items():
            if name in spread.quantiles:
                least, largest = spread.band(name)
                spread_band(axes, spread, (least - values[0], largest - values[0]), style["color"], None)
        spread_band(axes, spread, None, "0.5", f"range of {spread.runs} moved starts")
    _balance(below, result)
    finish(figure, axes, below)
    # Above its axes, which are lower than the words are long.
    below.set_title(below.get_ylabel(), loc="left", fontsize=SMALL, pad=3)
    below.set_ylabel("")
    return figure


def _stored(result: Result) -> dict[str, tuple[Floats, dict[str, Any]]]:
    """The curve of what contacts store, where the potential energy has other parts too."""
    names = [name for name in result.states if name.startswith((CONTACT, SELF))]
    stored = stored_over_time({name: np.asarray(result.states[name].values[:, 0]) for name in names})
    if stored is None or not np.any(stored) or np.allclose(stored, result.potential, rtol=1e-9, atol=0.0):
        return {}
    style = {"color": BLACK, "linewidth": 1.0, "linestyle": "-.", "marker": "^"}
    return {"stored in contact": (stored, style)}


def _taken(result: Result) -> dict[str, tuple[Floats, dict[str, Any]]]:
    """Curves of the parts of what is dissipated that contacts and a closing line took, if any."""
    names, every = taken_of(result.states), taken_over_time(result)
    shown = [(f"by {TAKEN[name]}", every[:, k]) for k, name in enumerate(names) if np.ptp(every[:, k])]
    return {
        words: (values, {"color": YELLOW, "linewidth": 1.2, **style})
        for (words, values), style in zip(shown, _TAKEN, strict=False)
    }


def _put_in(result: Result) -> dict[str, tuple[Floats, dict[str, Any]]]:
    """Curves of the works of reels, of an ejection and of bodies whose motion is given, where they do any.

    Those that did most by size have one each; what is beyond the styles is summed.
    """
    works = {name: work for name, work in metrics.works_put_in(result).items() if np.ptp(work)}
    names = sorted(works, key=lambda name: -np.ptp(works[name]))
    if len(names) > len(_WORKS):
        own, others = names[: len(_WORKS) - 1], names[len(_WORKS) - 1 :]
        works = {name: works[name] for name in own} | {
            f"{len(others)} others": np.sum([works[name] for name in others], axis=0)
        }
    return {
        f"work of {name}": (work, {"linewidth": 1.4, **style})
        for (name, work), style in zip(works.items(), _WORKS, strict=False)
    }


def _balance(axes: Axes, result: Result) -> None:
    """The error of the energy balance over time, about zero."""
    errors = metrics.energy_errors(result)
    curve(axes, result.time, errors, color=BLACK, linewidth=1.0)
    axes.axhline(0.0, color="0.5", linewidth=0.6, linestyle=":", zorder=1)
    largest = float(np.abs(errors).max()) or 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    outer = power * min(factor for factor in (1, 2, 5, 10) if factor * power >= largest)
    axes.set_ylim(-1.1 * outer, 1.1 * outer)
    axes.set_yticks([-outer, 0.0, outer])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("error of the energy balance [J]")


def _band(axes: Axes, time: Floats, values: Floats, extremes: Floats, color: str) -> None:
    """What is reached beyond a curve in each interval, which ends with one of its times."""
    before = np.append(values[:1], values[:-1])
    covered = np.clip(extremes, np.minimum(before, values), np.maximum(before, values))
    reached = np.where(extremes == covered, values, extremes)
    style: dict[str, Any] = {"color": color, "alpha": _REACHED, "linewidth": 0.7, "zorder": 1.5}
    if len(time) > 4 * BINS:
        axes.fill_between(*thinned_band(time, values, reached), step="pre", **style)
        return
    ends = np.flatnonzero(reached[1:] != values[1:]) + 1
    across = np.stack([time[ends - 1], time[ends - 1], time[ends], time[ends]], axis=1)
    up = np.stack([before[ends], reached[ends], reached[ends], values[ends]], axis=1)
    axes.add_collection(PolyCollection(list(np.stack([across, up], axis=2)), **style))
    axes.autoscale_view()
