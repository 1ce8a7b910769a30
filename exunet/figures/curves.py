"""Curves over time: bullet speeds, areas, tensions, loads, distances, rotations, agreement."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.bands import bands_behind
from exunet.figures.known import known, words_of_mark, words_of_runs
from exunet.figures.lines import curve, curve_axes, from_zero, many, spread_band
from exunet.figures.page import Page, finish
from exunet.figures.style import BLACK, BLUE, MOST_CURVES, RED, YELLOW, curve_styles, number
from exunet.forces.corner_units import NAME as UNITS
from exunet.results import measures as metrics
from exunet.results.agreement import Agreement
from exunet.results.clearance import gaps_of, movers_of, nearest, pairs_of
from exunet.results.corner_units import mean_thrust
from exunet.results.curves import PULLS, pull_name, spin_name, thrust_name
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.pulls import PACKED, pull_of
from exunet.results.result import Result, over_blocks

Floats = NDArray[np.float64]

_BODY_LINES = ("-", "--", ":", "-.")
_OF_AXES = (YELLOW, RED, BLUE)  # of a body
_MOST_TURNING = 6  # bands of angular velocities that can be told apart: those of two bodies


def bullet_speeds(
    result: Result, page: Page, agreement: Agreement | None = None, spread: EnsembleResult | None = None
) -> Figure | None:
    """Speed of each bullet over time, with the other run's if given; None without bullets.

    The bands of moved starts are those of their slowest and of their fastest bullet.
    """
    speeds = metrics.bullet_speeds(result)
    count = speeds.shape[1]
    if count == 0:
        return None
    figure, axes = curve_axes(result, page, "Speeds of the bullets", "speed [m/s]")
    nodes = result.net.bullet_nodes
    if count <= MOST_CURVES:
        for k, style in enumerate(curve_styles(count)):
            style |= {"label": f"node {nodes[k]}", "markersize": 4.5}
            curve(axes, result.time, speeds[:, k], shift=k / count, **style)
    else:
        many(
            axes,
            result.time,
            speeds,
            f"{count} bullets, nodes {nodes.min()} to {nodes.max()} (dark to light)",
        )
    top = float(speeds.max())
    if agreement is not None:
        theirs = agreement.reference_speeds
        top = max(top, float(np.max(theirs, initial=0.0, where=np.isfinite(theirs))))
        # Thin over the broad curves of a few bullets, broad below the thin ones of many.
        grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "zorder": 4}
        if count > MOST_CURVES:
            grey = {"color": "0.75", "linewidth": 2.6, "zorder": 1.5}
        for k, column in enumerate(theirs.T):
            label = "reference" if k == 0 else None
            curve(axes, agreement.time, column, label=label, **grey)
        _mark_horizon(axes, agreement)
    if spread is not None and "slowest_bullet" in spread.quantiles:
        words = f"{spread.runs} moved starts: slowest, fastest"
        for name, label in (("slowest_bullet", words), ("fastest_bullet", None)):
            spread_band(axes, spread, spread.band(name), BLACK, label)
        top = max(top, float(spread.band("fastest_bullet")[1].max()))
    from_zero(axes, top)
    finish(figure, axes)
    return figure


def area(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Mouth area over the achievable one, mesh area over that of the reference; None without either."""
    net = result.net
    measures = metrics.deployment(result)
    meshes = float(metrics.mesh_area(net, net.reference_position))
    if measures is None and meshes == 0.0:
        return None
    figure, axes = curve_axes(result, page, "Opened area", "relative area")
    top = 1.0
    if measures is not None:
        values = over_blocks(partial(metrics.mouth_area, net), result.position) / measures.achievable_area
        label = f"mouth / achievable area ({number(measures.achievable_area)} m²)"
        curve(axes, result.time, values, label=label, color=BLUE, linewidth=1.8)
        top = max(top, float(values.max()))
    if spread is not None and measures is not None and "area" in spread.quantiles:
        low, high = (side / measures.achievable_area for side in spread.band("area"))
        spread_band(axes, spread, (low, high), BLUE, f"mouth, range of {spread.runs} moved starts")
        top = max(top, float(high.max()))
    if meshes:
        values = over_blocks(partial(metrics.mesh_area, net), result.position) / meshes
        label = "meshes / reference configuration (folds count twice)"
        curve(axes, result.time, values, label=label, color=RED, linewidth=1.3, linestyle="--")
        top = max(top, float(values.max()))
    if measures is not None:
        axes.axhline(
            metrics.NEARLY_OPEN,
            color="0.5",
            linewidth=0.8,
            linestyle=":",
            zorder=1,
            label=f"{metrics.NEARLY_OPEN:.0%}".replace("%", " %") + " of the achievable area",
        )
        largest = known(spread, "largest_area_m2", measures.achievable_area)
        when = known(spread, "time_of_largest_area_s")
        text = words_of_mark("largest", largest, when) + (" (the end)" if measures.at_end else "")
        text = f"constant: {number(measures.relative_area)}" if measures.constant else text
        at = (measures.time_of_largest, measures.relative_area)
        axes.plot(*at, "o", color=BLACK, markersize=6, markerfacecolor="none", clip_on=False, label=text)
    from_zero(axes, top if result.complete else min(top, 2.0))
    finish(figure, axes)
    return figure


def largest_tension(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Largest tension of all elements over time, and that of all steps if known; None without elements.

    The curve has the stored times only: a snap between two of them does not show in it, but the mark does.
    """
    if result.net.n_elements == 0:
        return None
    figure, axes = curve_axes(result, page, "Largest tension of all elements", "tension [N]")
    values = metrics.largest_tensions(result)
    curve(axes, result.time, values, label="largest at each stored time", color=BLUE, linewidth=1.2)
    top = float(values.max())
    largest = known(spread, "largest_tension_N")
    peak = result.provenance.get("largest_tension")
    if peak and peak["element"] >= 0:
        top = max(top, peak["tension_N"])
        words = "largest of all steps of this run"
        style: dict[str, Any] = {"color": RED, "markersize": 6, "markerfacecolor": "none", "clip_on": False}
        axes.plot(peak["time_s"], peak["tension_N"], "o", label=words, **style)
    if spread is not None:
        spread_band(axes, spread, spread.band("tension"), BLACK, f"range of {spread.runs} moved starts")
        peaks = spread.headlines["largest_tension_N"]
        times = spread.headlines.get("time_of_largest_tension_s")
        if times is not None:
            dots: dict[str, Any] = {"color": BLACK, "markersize": 2.5, "markeredgewidth": 0.6, "zorder": 3}
            told = None if largest is None else words_of_runs(largest)
            axes.plot(times, peaks, "x", label=told, **dots)
        top = max(top, float(peaks.max()))
    from_zero(axes, top)
    finish(figure, axes)
    return figure


def loads_on_bodies(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Sizes of force and torque where threads are tied to bodies, over the stored times; None if none is.

    The torque is about the centre of mass of the body. A packed net that no thread pulls on is left out.
    """
    places, sizes = pull_of(result)
    drawn = [k for k, one in enumerate(places) if one.node != PACKED or sizes[:, k].any()]
    if not drawn:
        return None
    figure, axes = page.stacked_axes(result, "Loads of the threads on the bodies", (1.0, 1.0), 125.0)
    largest = sorted(drawn, key=lambda k: -float(sizes[:, k, 0].max(initial=0.0)))[:MOST_CURVES]
    words = ("force [N]", "torque about the\ncentre of mass [N m]")
    styles = dict(zip(largest, curve_styles(len(largest)), strict=True))
    panels = [
        (one, {pull_name(places[k].name, quantity): style["color"] for k, style in styles.items()})
        for one, quantity in zip(axes, PULLS, strict=True)
    ]
    tops = bands_behind(panels, spread)
    for column, (one, label, top) in enumerate(zip(axes, words, tops, strict=True)):
        for place, (k, style) in enumerate(styles.items()):
            named = places[k].label if one is axes[0] else None
            values = sizes[:, k, column]
            curve(one, result.time, values, place / len(largest), label=named, markersize=4.5, **style)
        from_zero(one, max(top, float(sizes[:, largest, column].max(initial=0.0))))
        one.set_ylabel(label)
    if len(drawn) > len(largest):
        axes[0].plot([], [], " ", label=f"{len(drawn) - len(largest)} more, which pull less")
    axes[-1].set_xlabel("stored time [s]")
    finish(figure, *axes)
    return figure


def distances(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Distance of two bodies over time, surface to surface; None without two bodies with shapes.

    Of more than eight pairs those that come nearest at stored times. A circle marks the least of all, between
    stored times by interpolation.
    """
    pairs = pairs_of(list(movers := movers_of(result)))
    if not pairs:
        return None
    found = gaps_of(result, pairs)
    figure, axes = curve_axes(result, page, "Distance of the bodies", "distance of the surfaces [m]")
    shown = np.argsort(found.min(axis=0), kind="stable")[:MOST_CURVES].tolist()
    for place, (k, style) in enumerate(zip(shown, curve_styles(len(shown)), strict=True)):
        label = " and ".join(pairs[k])
        curve(axes, result.time, found[:, k], place / len(shown), label=label, markersize=4.5, **style)
    both = {pairs[k]: nearest(*(movers[name] for name in pairs[k])) for k in shown}
    one, other = min(both, key=lambda pair: both[pair].distance)
    least, time, _ = both[one, other]
    of_pair = f"bodies_{one}+{other}"
    nearby = known(spread, f"{of_pair}_least_distance_m")
    when = known(spread, f"{of_pair}_time_of_least_distance_s")
    words = words_of_mark("least", nearby, when) if least else "overlap in this run"
    style = {"color": BLACK, "markersize": 9, "markerfacecolor": "none", "clip_on": False}
    axes.plot(time, least, "o", label=words, **style)
    if len(pairs) > len(shown):
        axes.plot([], [], " ", label=f"{len(pairs) - len(shown)} more pairs, which stay farther apart")
    from_zero(axes, float(found[:, shown].max()))
    finish(figure, axes)
    return figure


def rotation(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Angular velocity of each rigid body over time, in body axes; None without rigid bodies.

    Of more than four bodies those that turn fastest. Behind the curves are their bands of moved starts, or
    one of all, where those of more than two bodies could be seen.
    """
    turning = {
        name: np.asarray(body.angular_velocity)
        for name, body in result.bodies.items()
        if body.angular_velocity is not None
    }
    if not turning:
        return None
    label = "angular velocity\nin body axes [rad/s]"
    figure, axes = curve_axes(result, page, "Rotation of the bodies", label)
    fastest = sorted(turning, key=lambda name: -float(np.abs(turning[name]).max()))[: len(_BODY_LINES)]
    shown = [name for name in turning if name in fastest]
    for name, line in zip(shown, _BODY_LINES, strict=False):
        styles = zip("xyz", _OF_AXES, (2.4, 1.6, 1.0), "os^", strict=True)
        for column, (axis, color, width, marker) in enumerate(styles):
            style: dict[str, Any] = {"color": color, "linewidth": width, "linestyle": line, "marker": marker}
            words = f"{name}, {axis}"
            curve(
                axes, result.time, turning[name][:, column], column / 3, label=words, markersize=4.0, **style
            )
    if len(turning) > len(shown):
        axes.plot([], [], " ", label=f"{len(turning) - len(shown)} more, which turn more slowly")
    colors = {
        spin_name(name, axis): color for name in shown for axis, color in zip("xyz", _OF_AXES, strict=True)
    }
    bands_behind([(axes, colors)], spread, most=_MOST_TURNING)
    finish(figure, axes)
    return figure


def control(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Magnitude of each corner unit's thrust, its mean between stored times; None of a case without units.

    Bands of moved starts (those of up to four units that can be seen, or one of all) are of means between the
    instants of the spread, which the legend tells where the stored times are others.
    """
    found = mean_thrust(result)
    if found is None:
        return None
    count, middle = found.shape[1], 0.5 * (result.time[1:] + result.time[:-1])
    figure, axes = curve_axes(result, page, "Thrust of the corner units", "thrust [N]")
    styles = curve_styles(count) if count <= MOST_CURVES else [{"color": BLACK}] * count
    if count <= MOST_CURVES:
        for k, style in enumerate(styles):
            label = f"bullet {result.provenance[UNITS]['bullets'][k]}"
            curve(axes, middle, found[:, k], shift=k / count, label=label, markersize=4.5, **style)
    else:
        many(axes, middle, found, f"{count} units (dark to light)")
    colors = {thrust_name(k): style["color"] for k, style in enumerate(styles)}
    (top,) = bands_behind([(axes, colors)], spread, means_between=result.time)
    from_zero(axes, max(top, float(found.max())))
    finish(figure, axes)
    return figure


def agreement(result: Result, page: Page, found: Agreement) -> Figure:
    """Differences between two codes over time, on a logarithmic scale (zeros are left out)."""
    figure, axes = curve_axes(result, page, "Difference from the reference", "largest difference [m], [m/s]")
    axes.set_yscale("log")
    styles: tuple[dict[str, Any], ...] = ({"color": BLUE}, {"color": RED, "linestyle": "--"})
    differences = (("position [m]", found.position_difference), ("speed [m/s]", found.speed_difference))
    for (name, values), style in zip(differences, styles, strict=True):
        seen = np.where((values > 0) & np.isfinite(values), values, np.nan)
        if np.isfinite(seen).any():
            curve(axes, found.time, seen, label=name, linewidth=1.2, **style)
        else:
            axes.plot([], [], label=f"{name}: none", **style)
    limits = (
        (found.allowed_position, "m", BLUE, (0, (1, 1.5))),
        (found.allowed, "m/s", RED, (0, (3, 1.5, 1, 1.5))),
    )
    for level, unit, color, line in limits:
        if level > 0:
            label = f"allowed {number(level)} {unit}"
            dotted: dict[str, Any] = {"color": color, "linewidth": 1.0, "linestyle": line}
            axes.plot((0, 1), (level, level), transform=axes.get_yaxis_transform(), label=label, **dotted)
    _mark_horizon(axes, found)
    finish(figure, axes)
    return figure


def _mark_horizon(axes: Axes, found: Agreement) -> None:
    if found.agrees_until is not None:
        label = f"agree until {number(found.agrees_until)} s"
        axes.axvline(found.agrees_until, color=BLACK, linewidth=0.9, linestyle=(0, (5, 3)), label=label)
