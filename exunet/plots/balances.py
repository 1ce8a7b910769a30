"""Balances over time: energies, momentum and angular momentum of the parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.plots.page import Source
from exunet.plots.style import BLACK, BLUE, MAX_CURVES, RED, YELLOW, curve_styles
from exunet.plots.time_axes import curve, draw_bands, fill, finish, stacked_axes
from exunet.results import measures as metrics
from exunet.results.course import CONTACT, SELF
from exunet.results.curves import momentum_name
from exunet.results.ensemble_result import ALONG, EnsembleResult
from exunet.results.momenta import KINDS, MomentumCourse, direction, gained_by_parts, given_impulses
from exunet.results.result import Result
from exunet.results.taken import TAKEN, stored_over_time, taken_of, taken_over_time

Floats = NDArray[np.float64]
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
_MOMENTA = {"linear": ("momentum", "kg m/s"), "angular": ("angular momentum", "kg m²/s")}


def energies(source: Source) -> Figure | None:
    """Changes of the energies since the first stored time; below, the error of their balance.

    Kinetic, elastic and potential energy, and the part of it that contacts store; the dissipation and the
    parts of it in contacts and a closing line; the works of reels, of an ejection and of bodies of prescribed
    motion. Bands reach to the extremes of kinetic and elastic energy over the steps between stored times.
    """
    result, ensemble = source.result, source.ensemble
    parts: dict[str, Part] = {
        "dissipated": (metrics.dissipation(result), {"color": YELLOW, "linewidth": 2.6, "marker": "s"}),
        "elastic": (np.asarray(result.elastic), {"color": RED, "linewidth": 1.6}),
        "kinetic": (np.asarray(result.kinetic), {"color": BLUE, "linewidth": 1.2, "linestyle": "--"}),
    }
    if np.any(result.potential != result.potential[0]):
        dotted = {"color": BLACK, "linewidth": 1.0, "linestyle": ":", "marker": "v"}
        parts["potential"] = (np.asarray(result.potential), dotted)
    parts |= _stored_in_contact(result) | _dissipated(result) | _works(result)
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


def _stored_in_contact(result: Result) -> dict[str, Part]:
    """Return the energy that contacts store, where the potential energy has other parts too."""
    names = [name for name in result.states if name.startswith((CONTACT, SELF))]
    stored = stored_over_time({name: np.asarray(result.states[name].values[:, 0]) for name in names})
    if stored is None or not np.any(stored) or np.allclose(stored, result.potential, rtol=1e-9, atol=0.0):
        return {}
    return {
        "stored in contact": (stored, {"color": BLACK, "linewidth": 1.0, "linestyle": "-.", "marker": "^"})
    }


def _dissipated(result: Result) -> dict[str, Part]:
    """Return the parts of the dissipation in contacts and a closing line."""
    names, values = taken_of(result.states), taken_over_time(result)
    shown = [(f"by {TAKEN[name]}", values[:, k]) for k, name in enumerate(names) if np.ptp(values[:, k])]
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


def momentum(source: Source) -> Figure | None:
    """Changes of momentum and of angular momentum about the scene's origin, of each body and the net.

    With the impulses of external effects and of bodies of prescribed motion, and the parts less the impulses,
    which is error. Each panel shows the components along the direction of the largest change, in the axes of
    the scene: that of the ensemble where there is one. Of more than seven curves the largest.
    """
    result, ensemble = source.result, source.ensemble
    if not result.bodies:
        return None
    parts, given = gained_by_parts(result), given_impulses(result)
    series = parts | given
    if not any(np.any(getattr(course, kind)) for course in series.values() for kind in KINDS):
        return None
    largest = sorted(series, key=lambda name: -_share(series, name))[: MAX_CURVES - 1]
    shown = [name for name in series if name in largest]
    styles = dict(zip(shown, curve_styles(len(shown)), strict=True))
    directions = _directions(series, ensemble)
    labels = [f"change of {name}\n[{unit}]" for name, unit in _MOMENTA.values()]
    figure, axes = stacked_axes(source, labels, 125.0)
    remarks = []
    for panel, kind in zip(axes, _MOMENTA, strict=True):
        changes = {name: getattr(course, kind) for name, course in series.items()}
        along = directions[kind]
        for place, (name, style) in enumerate(styles.items()):
            curve(panel, result.time, changes[name] @ along, place / len(shown), label=name, **style)
        rest = sum(changes[name] for name in parts) - sum((changes[name] for name in given), np.zeros(3))
        thin: dict[str, Any] = {"color": BLACK, "linewidth": 0.7, "linestyle": ":"}
        label = "parts less impulses" if given else "all parts"
        curve(panel, result.time, np.asarray(rest @ along), label=label, **thin)
        colors = {momentum_name(kind, name): style["color"] for name, style in styles.items()}
        draw_bands(panel, ensemble, colors)
        components = ", ".join(f"{round(part, 2) + 0.0:g}" for part in along)
        about = " about the origin" if kind == "angular" else ""
        remark = f"{_MOMENTA[kind][0]}{about} along ({components})"
        remarks.append(remark.replace("-", "\N{MINUS SIGN}"))
    if len(series) > len(shown):
        remarks.append(f"{len(series) - len(shown)} more, with smaller changes")
    return finish(source, figure, remarks)


def _directions(series: dict[str, MomentumCourse], ensemble: EnsembleResult | None) -> dict[str, Floats]:
    """Return the unit vector (3,) of each kind: that of the ensemble, or of the largest change."""
    known = {} if ensemble is None else ensemble.provenance.get(ALONG, {})
    return {
        kind: np.array(known[kind])
        if kind in known
        else direction({name: getattr(course, kind) for name, course in series.items()})
        for kind in KINDS
    }


def _share(series: dict[str, MomentumCourse], name: str) -> float:
    """Return the largest change of a part relative to that of all parts, of both kinds."""
    shares = []
    for kind in KINDS:
        sizes = {
            part: float(np.linalg.norm(getattr(course, kind), axis=1).max())
            for part, course in series.items()
        }
        shares.append(sizes[name] / (max(sizes.values()) or 1.0))
    return max(shares)
