"""Curves over time: bullet speeds, areas, distances, rotations, thrusts, differences from the reference."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from exunet.base.arrays import Floats
from exunet.plots.style import (
    BLACK,
    BLUE,
    INCH,
    MAX_CURVES,
    RED,
    WIDTHS,
    YELLOW,
    FigureData,
    blank,
    curve_styles,
    legend_above,
    mark_incomplete,
    number,
)
from exunet.plots.time_axes import (
    TIME,
    curve,
    draw_bands,
    finish,
    from_zero,
    label_of_mark,
    many_curves,
    range_of,
    stacked_axes,
)
from exunet.results import measures as metrics
from exunet.results.clearance import gaps_of, movers_of, nearest, pairs_of
from exunet.results.comparison import Agreement
from exunet.results.ensemble import Ensemble
from exunet.results.observables import Observables, spin_name, thrust_name
from exunet.results.result import over_blocks

_HEIGHT = 90.0  # mm, of a figure with one pair of axes
_BODY_LINES = ("-", "--", ":", "-.")
_OF_AXES = (YELLOW, RED, BLUE)  # of a body
_MAX_SPINS = 6  # distinguishable bands of angular velocities: those of two bodies
_MARK: dict[str, Any] = {"color": BLACK, "markersize": 6, "markerfacecolor": "none", "clip_on": False}


def bullet_speeds(source: FigureData) -> Figure | None:
    """Speed of each bullet over time, and of the reference's; band: slowest to fastest of perturbed runs."""
    result, agreement = source.result, source.agreement
    speeds = source.run.bullet_speed
    count = speeds.shape[1]
    if not np.any(speeds):
        return None
    figure, (axes,) = stacked_axes(source, ["speed [m/s]"], _HEIGHT)
    if count <= MAX_CURVES:
        for k, style in enumerate(curve_styles(count)):
            curve(axes, result.time, speeds[:, k], k / count, label=f"bullet {k}", **style)
    else:
        many_curves(axes, result.time, speeds, f"{count} bullets (dark to light)")
    if agreement is not None:
        # Thin over the broad curves of a few bullets, broad below the thin ones of many.
        grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "zorder": 4}
        if count > MAX_CURVES:
            grey = {"color": "0.75", "linewidth": 2.6, "zorder": 1.5}
        for k, column in enumerate(agreement.reference_speeds.T):
            curve(axes, agreement.time, column, label="reference" if k == 0 else None, **grey)
        _mark_horizon(axes, agreement)
    draw_bands(axes, source.ensemble, dict.fromkeys(("slowest_bullet", "fastest_bullet"), BLACK))
    from_zero(axes)
    return finish(source, figure)


def area(source: FigureData) -> Figure | None:
    """Mouth area over the achievable one, mesh area over that of the reference configuration."""
    result, ensemble, net = source.result, source.ensemble, source.result.net
    run = source.run
    measures = metrics.deployment_from_area(run.time, run.area, run.centre, run.achievable_area)
    meshes = float(metrics.mesh_area(net, net.reference_position))
    if measures is None and meshes == 0.0:
        return None
    figure, (axes,) = stacked_axes(source, ["relative area [1]"], _HEIGHT)
    if measures is not None:
        achievable = measures.achievable_area
        label = f"mouth / achievable area ({number(achievable)} m²)"
        curve(axes, result.time, run.area / achievable, label=label, color=BLUE, linewidth=1.8)
        draw_bands(axes, ensemble, {"area": BLUE}, scale=achievable)
    if meshes:
        values = over_blocks(partial(metrics.mesh_area, net), result.position) / meshes
        label = "meshes / reference configuration (folds count twice)"
        curve(axes, result.time, values, label=label, color=RED, linewidth=1.3, linestyle="--")
    if measures is not None:
        label = f"{100 * metrics.NEARLY_OPEN:.0f} % of the achievable area"
        axes.axhline(metrics.NEARLY_OPEN, color="0.5", linewidth=0.8, linestyle=":", zorder=1, label=label)
    if measures is not None and (
        measures.constant or measures.time_of_largest > result.time[0]
    ):  # not open yet
        largest = range_of(ensemble, "relative_area")
        when = range_of(ensemble, "time_of_largest_area_s")
        label = label_of_mark("largest", largest, when) + (" (the end)" if measures.at_end else "")
        label = f"constant: {number(measures.relative_area)}" if measures.constant else label
        mark = _MARK | {"clip_on": not result.complete}  # a failed run may leave the limits
        axes.plot(measures.time_of_largest, measures.relative_area, "o", label=label, **mark)
    top = max(1.0, float(axes.dataLim.y1))
    from_zero(axes, top if result.complete else min(top, 2.0))
    return finish(source, figure)


def distances(source: FigureData) -> Figure | None:
    """Distance of each two bodies over time, surface to surface; a circle marks the smallest.

    Of more than eight pairs those that come nearest at stored times.
    """
    result = source.result
    pairs = pairs_of(list(movers := movers_of(result)))
    if not pairs:
        return None
    gaps = gaps_of(result, pairs)
    figure, (axes,) = stacked_axes(source, ["distance of the surfaces [m]"], _HEIGHT)
    shown = np.argsort(gaps.min(axis=0), kind="stable")[:MAX_CURVES].tolist()
    for place, (k, style) in enumerate(zip(shown, curve_styles(len(shown)), strict=True)):
        curve(axes, result.time, gaps[:, k], place / len(shown), label=" and ".join(pairs[k]), **style)
    approaches = {pairs[k]: nearest(*(movers[name] for name in pairs[k])) for k in shown}
    pair = min(approaches, key=lambda pair: approaches[pair].distance)
    distance, time, _ = approaches[pair]
    key = f"bodies_{'+'.join(pair)}"
    smallest = range_of(source.ensemble, f"{key}_least_distance_m")
    when = range_of(source.ensemble, f"{key}_time_of_least_distance_s")
    label = label_of_mark("smallest", smallest, when) if distance else "overlap in this run"
    axes.plot(time, distance, "o", label=label, **_MARK)
    from_zero(axes)
    return finish(source, figure, _more(len(pairs) - len(shown), "more pairs, farther apart"))


def rotation(source: FigureData) -> Figure | None:
    """Angular velocity of each body over time, in body axes, with bands of perturbed runs.

    Of more than four bodies those that rotate fastest.
    """
    result = source.result
    velocities = {
        name: np.asarray(body.angular_velocity)
        for name, body in result.bodies.items()
        if np.any(body.angular_velocity)
    }
    if not velocities:
        return None
    figure, (axes,) = stacked_axes(source, ["angular velocity\nin body axes [rad/s]"], _HEIGHT)
    fastest = sorted(velocities, key=lambda name: -float(np.abs(velocities[name]).max()))[: len(_BODY_LINES)]
    shown = [name for name in velocities if name in fastest]
    for name, line in zip(shown, _BODY_LINES, strict=False):
        styles = zip("xyz", _OF_AXES, (2.4, 1.6, 1.0), "os^", strict=True)
        for column, (axis, color, width, marker) in enumerate(styles):
            style: dict[str, Any] = {"color": color, "linewidth": width, "linestyle": line, "marker": marker}
            values = velocities[name][:, column]
            curve(axes, result.time, values, column / 3, label=f"{name}, {axis}", **style)
    colors = {
        spin_name(name, axis): color for name in shown for axis, color in zip("xyz", _OF_AXES, strict=True)
    }
    draw_bands(axes, source.ensemble, colors, max_bands=_MAX_SPINS)
    return finish(source, figure, _more(len(velocities) - len(shown), "more, which rotate more slowly"))


def control(source: FigureData) -> Figure | None:
    """Thrust of each corner unit, its mean between stored times, with bands of perturbed runs."""
    result, units = source.result, source.result.run.units
    spent = source.run.spent
    if spent is None or len(result.time) < 2 or not np.any(np.diff(spent, axis=0)):
        return None
    thrust = np.diff(spent, axis=0) / np.diff(result.time)[:, None]
    count, middle = thrust.shape[1], 0.5 * (result.time[1:] + result.time[:-1])
    figure, (axes,) = stacked_axes(source, ["mean thrust between\nstored times [N]"], _HEIGHT)
    styles = curve_styles(count) if count <= MAX_CURVES else [{"color": BLACK}] * count
    if count <= MAX_CURVES:
        for k, style in enumerate(styles):
            label = f"bullet {units.bullets[k]}" if units else f"unit {k}"
            curve(axes, middle, thrust[:, k], k / count, label=label, **style)
    else:
        many_curves(axes, middle, thrust, f"{count} units (dark to light)")
    colors = {thrust_name(k): style["color"] for k, style in enumerate(styles)}
    draw_bands(axes, source.ensemble, colors, means=True)
    from_zero(axes)
    return finish(source, figure)


def agreement(source: FigureData) -> Figure | None:
    """Differences from the reference over time, on logarithmic scales; zeros are left out."""
    found = source.agreement
    if found is None or not (np.any(found.position_difference) or np.any(found.speed_difference)):
        return None
    labels = ["largest difference of\npositions [m]", "largest difference of\nspeeds [m/s]"]
    figure, panels = stacked_axes(source, labels, 105.0)
    differences = (
        (found.position_difference, found.allowed_position, "m", BLUE),
        (found.speed_difference, found.allowed, "m/s", RED),
    )
    for axes, (values, allowed, unit, color) in zip(panels, differences, strict=True):
        axes.set_yscale("log")
        shown = np.where((values > 0) & np.isfinite(values), values, np.nan)
        if not np.isfinite(shown).any():
            axes.set_ylim(0.1 * (allowed or 1.0), 10.0 * (allowed or 1.0))
        curve(axes, found.time, shown, linewidth=1.2, color=color)
        if allowed > 0:
            label = f"allowed: {number(allowed)} {unit}"
            axes.axhline(allowed, color=color, linewidth=1.0, linestyle=(0, (1, 1.5)), label=label)
        _mark_horizon(axes, found)
    return finish(source, figure)


def _mark_horizon(axes: Axes, found: Agreement) -> None:
    if found.agrees_until is not None:
        label = f"agree until {number(found.agrees_until)} s"
        axes.axvline(found.agrees_until, color=BLACK, linewidth=0.9, linestyle=(0, (5, 3)), label=label)


def _more(count: int, words: str) -> list[str]:
    """Return the remark on curves that are left out."""
    return [f"{count} {words}"] if count else []


_COMPARED = {"area": "mouth area [m²]", "tension": "largest tension [N]", "mouth": "mouth diameter [m]"}
_PANEL = 42.0  # mm
_DESIGNS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linewidth": 1.4},
    {"color": RED, "linewidth": 1.2, "linestyle": (0, (4, 1.5))},
)


def compared(designs: Sequence[tuple[str, Observables | Ensemble, Ensemble | None]]) -> Figure | None:
    """Mouth area, largest tension and mouth diameter of two designs, also of different nets, over time.

    Each has a name, a run or an ensemble, whose median is the curve, and perturbed runs for a band.
    """
    found = [_compared_series(source) for _, source, _ in designs]
    shown = [name for name in _COMPARED if any(np.any(series[name][1]) for series in found if name in series)]
    if not shown:
        return None
    figure = blank(WIDTHS[1] / INCH, _PANEL * (len(shown) + 0.4) / INCH)
    figure.set_layout_engine("constrained")
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    handles: dict[str, Any] = {}
    for axes, name in zip(panels, shown, strict=True):
        axes.set_ylabel(_COMPARED[name])
        for k, (series, style, (label, _, ensemble)) in enumerate(zip(found, _DESIGNS, designs, strict=True)):
            if name in series:
                curve(axes, *series[name], label=f"{'AB'[k]}: {label}", **style)
            draw_bands(axes, ensemble, {name: style["color"]})
        from_zero(axes)
        handles |= dict(reversed(pair) for pair in zip(*axes.get_legend_handles_labels(), strict=True))
    panels[-1].set_xlabel(TIME)
    legend_above(figure, list(handles.values()), list(handles))
    for _, source, _ in designs:
        mark_incomplete(figure, source if isinstance(source, Ensemble) else source.result)
    return figure


def _compared_series(source: Observables | Ensemble) -> dict[str, tuple[Floats, Floats]]:
    """Return times and values of what is compared, by name."""
    if isinstance(source, Ensemble):
        middle, known = list(source.levels).index(0.5), source.quantiles
        return {name: (source.time, known[name][middle]) for name in _COMPARED if name in known}
    values = {"area": source.area, "tension": source.tension, "mouth": source.mouth}
    return {name: (source.time, series) for name, series in values.items() if series is not None}
