"""Energies over time, and the error of their balance."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exunet.base.arrays import Floats
from exunet.plots.style import BLACK, BLUE, RED, YELLOW, FigureData
from exunet.plots.time_axes import curve, draw_bands, fill, finish, stacked_axes
from exunet.results import measures as metrics
from exunet.results.observables import DISSIPATED, Observables
from exunet.results.result import Result

Part = tuple[Floats, dict[str, Any]]  # values over time, style of their curve

# Of works: with the four energies as many curves as are distinguishable.
_WORKS: tuple[dict[str, Any], ...] = (
    {"color": "0.35", "linestyle": "-.", "marker": "^"},
    {"color": "0.55", "linestyle": (0, (7, 2)), "marker": "D"},
    {"color": "0.35", "linestyle": (0, (2.5, 1)), "marker": "x"},
    {"color": "0.55", "linestyle": "-", "marker": "*"},
)
# Of parts of the dissipation, in its colour.
_DISSIPATED: tuple[dict[str, Any], ...] = (
    {"linestyle": "--", "marker": "v"},
    {"linestyle": ":", "marker": "o"},
    {"linestyle": "-.", "marker": "d"},
    {"linestyle": (0, (7, 2)), "marker": "x"},
)


def energies(source: FigureData) -> Figure | None:
    """Changes of the energies since the first stored time; below, the error of their balance.

    Kinetic, elastic and potential energy, and the part of it that contacts store; the dissipation and the
    parts of it in contacts and a closing line; the works of reels, of an ejection and of bodies of prescribed
    motion. Bands reach to the extremes of kinetic and elastic energy over the steps between stored times.
    """
    result, ensemble = source.result, source.ensemble
    parts: dict[str, Part] = {
        "dissipated": (source.run.dissipated, {"color": YELLOW, "linewidth": 2.6, "marker": "s"}),
        "elastic": (np.asarray(result.elastic), {"color": RED, "linewidth": 1.6}),
        "kinetic": (np.asarray(result.kinetic), {"color": BLUE, "linewidth": 1.2, "linestyle": "--"}),
    }
    if np.any(result.potential != result.potential[0]):
        dotted = {"color": BLACK, "linewidth": 1.0, "linestyle": ":", "marker": "v"}
        parts["potential"] = (np.asarray(result.potential), dotted)
    parts |= _stored_in_contact(source.run) | _dissipated(source.run) | _works(result)
    if not any(np.ptp(values) for values, _ in parts.values()):
        return None
    labels = ["energy change [J]", "error of the\nbalance [J]"]
    figure, (axes, below) = stacked_axes(source, labels, 115.0, (3.0, 1.0))
    for name, (values, style) in parts.items():
        curve(axes, result.time, values - values[0], label=name, **style)
        draw_bands(axes, ensemble, {name: style["color"]}, offset=float(values[0]))
    for name, extremes in (("kinetic", result.least_kinetic), ("elastic", result.largest_elastic)):
        if extremes is not None:
            values, style = parts[name]
            _fill_to_extremes(axes, result.time, values, np.asarray(extremes), style["color"])
    errors = metrics.energy_errors(result)
    curve(below, result.time, errors, color=BLACK, linewidth=1.0)
    below.axhline(0.0, color="0.5", linewidth=0.6, linestyle=":", zorder=1)
    largest = 1.1 * (float(np.abs(errors).max()) or 1.0)
    below.set_ylim(-largest, largest)
    return finish(source, figure)


def _stored_in_contact(run: Observables) -> dict[str, Part]:
    """Return the energy that contacts store, where the potential energy has other parts too."""
    stored, whole = run.stored_in_contact, run.result.potential
    if stored is None or not np.any(stored) or np.allclose(stored, whole, rtol=1e-9, atol=0.0):
        return {}
    return {
        "stored in contact": (stored, {"color": BLACK, "linewidth": 1.0, "linestyle": "-.", "marker": "^"})
    }


def _dissipated(run: Observables) -> dict[str, Part]:
    """Return the parts of the dissipation in contacts and a closing line."""
    parts = run.dissipated_by.items()
    shown = [(f"by {DISSIPATED[name]}", values) for name, values in parts if np.ptp(values)]
    return {
        label: (part, {"color": YELLOW, "linewidth": 1.2, **style})
        for (label, part), style in zip(shown, _DISSIPATED, strict=False)
    }


def _works(result: Result) -> dict[str, Part]:
    """Return the works of reels, an ejection and bodies of prescribed motion.

    The largest have a curve each; those beyond the styles are summed.
    """
    works = {name: work for name, work in metrics.works_put_in(result).items() if np.ptp(work)}
    names = sorted(works, key=lambda name: -np.ptp(works[name]))
    if len(names) > len(_WORKS):
        own, others = names[: len(_WORKS) - 1], names[len(_WORKS) - 1 :]
        rest = np.sum([works[name] for name in others], axis=0)
        works = {name: works[name] for name in own} | {f"{len(others)} others": rest}
    return {
        f"work of {name}": (work, {"linewidth": 1.4, **style})
        for (name, work), style in zip(works.items(), _WORKS, strict=False)
    }


def _fill_to_extremes(axes: Axes, time: Floats, values: Floats, extremes: Floats, color: str) -> None:
    """Fill from an energy to its extreme between stored times, where that is beyond both of them."""
    before = np.append(values[:1], values[:-1])
    inside = (np.minimum(before, values) <= extremes) & (extremes <= np.maximum(before, values))
    reached = np.where(inside, values, extremes)
    if np.any(reached != values):
        label = "extremes of all steps" if "extremes of all steps" not in _labels(axes) else None
        style: dict[str, Any] = {"color": color, "alpha": 0.5, "step": "pre", "zorder": 1.5, "label": label}
        fill(axes, time, values - values[0], reached - values[0], **style)


def _labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]
