"""Curves over time: bullet speeds and energies (the paper's Figs. 5, 6), areas, tensions, agreement."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.page import Page, legend_above, line_scale
from exunet.figures.style import BLACK, BLUE, MOST_CURVES, RED, YELLOW, curve_styles, number
from exunet.figures.thinning import thinned, thinned_band
from exunet.results import measures as metrics
from exunet.results.agreement import Agreement
from exunet.results.clearance import gaps_of, pairs_of, shapes_of
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.loads import loads
from exunet.results.result import Result
from exunet.results.rows import over_blocks

Floats = NDArray[np.float64]


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
    figure, axes = _curve_axes(result, page, "Speeds of the bullets", "speed [m/s]")
    nodes = result.net.bullet_nodes
    if count <= MOST_CURVES:
        for k, style in enumerate(curve_styles(count)):
            style |= {"label": f"node {nodes[k]}", "markersize": 4.5}
            _curve(axes, result.time, speeds[:, k], shift=k / count, **style)
    else:
        _many(
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
            _curve(axes, agreement.time, column, label=label, **grey)
        _mark_horizon(axes, agreement)
    if spread is not None and "slowest_bullet" in spread.quantiles:
        words = {"slowest_bullet": f"slowest, fastest bullet of {spread.runs} moved starts"}
        for name in ("slowest_bullet", "fastest_bullet"):
            # Matplotlib keeps labels that begin with "_" out of the legend.
            _spread_band(axes, spread, spread.band(name), BLACK, words.get(name, f"_{name}"))
        top = max(top, float(spread.band("fastest_bullet")[1].max()))
    axes.set_ylim(0, 1.05 * top or 1.0)
    _legend(figure, axes)
    return figure


def energies(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure:
    """Kinetic and elastic energy, their sum and the dissipated work, relative to the total at the start.

    With the work that drums, an ejection, and bodies whose motion is given have put in, if any.

    In joule if the net starts with (almost) no energy of its own, as one that falls from rest. Where known,
    bands reach from kinetic and elastic energy at the stored times to their extremes over the steps between.
    """
    total = result.kinetic + result.elastic
    taken = metrics.dissipation(result)
    parts: dict[str, tuple[Floats, dict[str, Any]]] = {
        "dissipated": (taken, {"color": YELLOW, "linewidth": 1.8, "marker": "s"}),
        "kinetic": (result.kinetic, {"color": BLUE, "linewidth": 1.4, "linestyle": "--"}),
        "elastic": (result.elastic, {"color": RED, "linewidth": 1.4, "linestyle": "-"}),
        "kinetic + elastic": (total, {"color": BLACK, "linewidth": 0.9, "linestyle": "-."}),
    }
    if np.any(result.potential != result.potential[0]):
        fallen = result.potential - result.potential[0]
        dotted = {"color": BLACK, "linewidth": 1.2, "linestyle": ":", "marker": "v"}
        parts["potential, change"] = (fallen, dotted)
    if np.any(put_in := taken - result.dissipated):
        parts["work put in"] = (put_in, {"color": "0.45", "linewidth": 1.2, "linestyle": ":", "marker": "^"})
    start = float(total[0])
    relative = start > 1e-3 * max(float(np.abs(values).max()) for values, _ in parts.values())
    label = "energy / initial energy" if relative else "energy [J]"
    figure, axes = _curve_axes(result, page, "Energies at the stored times", label)
    unit = start if relative else 1.0
    for name, (values, style) in parts.items():
        _curve(axes, result.time, values / unit, **style, label=name, markersize=4.0)
    for extremes, name, color, words in (
        (result.least_kinetic, "kinetic", BLUE, "least kinetic of all steps"),
        (result.largest_elastic, "elastic", RED, "largest elastic of all steps"),
    ):
        if extremes is not None:
            _band(axes, result.time, parts[name][0] / unit, extremes / unit, color, words)
    if spread is not None:
        for name, (_, style) in parts.items():
            if name in spread.quantiles:
                least, largest = spread.band(name)
                words = f"{name}, {spread.runs} moved starts"
                _spread_band(axes, spread, (least / unit, largest / unit), style["color"], words)
    _legend(figure, axes)
    return figure


def area(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Mouth area over the achievable one, mesh area over that of the reference; None without either."""
    net = result.net
    measures = metrics.deployment(result)
    meshes = float(metrics.mesh_area(net, net.reference_position))
    if measures is None and meshes == 0.0:
        return None
    figure, axes = _curve_axes(result, page, "Opened area", "relative area")
    top = 1.0
    if measures is not None:
        values = over_blocks(partial(metrics.mouth_area, net), result.position) / measures.achievable_area
        label = f"mouth / achievable area ({number(measures.achievable_area)} m²)"
        _curve(axes, result.time, values, label=label, color=BLUE, linewidth=1.8)
        top = max(top, float(values.max()))
    if spread is not None and measures is not None and "area" in spread.quantiles:
        least, largest = (side / measures.achievable_area for side in spread.band("area"))
        _spread_band(axes, spread, (least, largest), BLUE, f"mouth, {spread.runs} moved starts")
        top = max(top, float(largest.max()))
    if meshes:
        values = over_blocks(partial(metrics.mesh_area, net), result.position) / meshes
        label = "meshes / reference configuration (folds count twice)"
        _curve(axes, result.time, values, label=label, color=RED, linewidth=1.3, linestyle="--")
        top = max(top, float(values.max()))
    if measures is not None:
        axes.axhline(metrics.NEARLY_OPEN, color="0.5", linewidth=0.8, linestyle=":", zorder=1, label="80 %")
        text = f"largest: {number(measures.relative_area)} at {number(measures.time_of_largest)} s"
        text += " (the end)" if measures.at_end else ""
        text = f"constant: {number(measures.relative_area)}" if measures.constant else text
        at = (measures.time_of_largest, measures.relative_area)
        axes.plot(*at, "o", color=BLACK, markersize=6, markerfacecolor="none", clip_on=False, label=text)
    axes.set_ylim(0, 1.05 * (top if result.complete else min(top, 2.0)))
    _legend(figure, axes)
    return figure


def largest_tension(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Largest tension of all elements over time, and that of all steps if known; None without elements.

    The curve has the stored times only: a snap between two of them does not show in it, but the mark does.
    """
    if result.net.n_elements == 0:
        return None
    figure, axes = _curve_axes(result, page, "Largest tension of all elements", "tension [N]")
    values = metrics.largest_tensions(result)
    _curve(axes, result.time, values, label="largest at each stored time", color=BLUE, linewidth=1.2)
    top = float(values.max())
    peak = result.provenance.get("largest_tension")
    if peak and peak["element"] >= 0:
        top = max(top, peak["tension_N"])
        words = f"largest of all steps: {number(peak['tension_N'])} N, element {peak['element']}"
        style: dict[str, Any] = {"color": RED, "markersize": 6, "markerfacecolor": "none", "clip_on": False}
        axes.plot(peak["time_s"], peak["tension_N"], "o", label=words, **style)
    if spread is not None:
        _spread_band(axes, spread, spread.band("tension"), BLACK)
        peaks = spread.headlines["largest_tension_N"]
        times = spread.headlines.get("time_of_largest_tension_s")
        if times is not None:
            dots: dict[str, Any] = {"color": BLACK, "markersize": 2.5, "markeredgewidth": 0.6, "zorder": 3}
            words = f"largest of all steps, {spread.runs} moved starts"
            axes.plot(times, peaks, "x", label=words, **dots)
        top = max(top, float(peaks.max()))
    axes.set_ylim(0, 1.05 * top or 1.0)
    _legend(figure, axes)
    return figure


def loads_on_bodies(result: Result, page: Page) -> Figure | None:
    """Size of the pull at each node that is fixed to a body, over time; None if there is none."""
    found = {name: loads(result, name) for name, body in result.bodies.items() if body.nodes is not None}
    if not found:
        return None
    figure, axes = _curve_axes(result, page, "Pull of the threads on the bodies", "force [N]")
    drawn = [(name, k, node) for name, of in found.items() for k, node in enumerate(of.nodes.tolist())]
    sizes = {one: found[one[0]].size[:, one[1]] for one in drawn}
    largest = sorted(drawn, key=lambda one: -float(sizes[one].max(initial=0.0)))[:MOST_CURVES]
    for place, (one, style) in enumerate(zip(largest, curve_styles(len(largest)), strict=True)):
        label = f"{one[0]}, node {one[2]}"
        _curve(axes, result.time, sizes[one], place / len(largest), label=label, markersize=4.5, **style)
    if len(drawn) > len(largest):
        axes.plot([], [], " ", label=f"{len(drawn) - len(largest)} more, which pull less")
    top = max(float(sizes[one].max(initial=0.0)) for one in largest)
    axes.set_ylim(0.0, 1.05 * top or 1.0)
    _legend(figure, axes)
    return figure


def distances(result: Result, page: Page) -> Figure | None:
    """Distance of two bodies over time, surface to surface; None without two bodies with shapes.

    Of more than eight pairs those that come nearest. A circle marks the least of all.
    """
    pairs = pairs_of(list(shapes_of(result)))
    if not pairs:
        return None
    found = gaps_of(result, pairs)
    figure, axes = _curve_axes(result, page, "Distance of the bodies", "distance of the surfaces [m]")
    nearest = np.argsort(found.min(axis=0), kind="stable")[:MOST_CURVES].tolist()
    for place, (k, style) in enumerate(zip(nearest, curve_styles(len(nearest)), strict=True)):
        label = " and ".join(pairs[k])
        _curve(axes, result.time, found[:, k], place / len(nearest), label=label, markersize=4.5, **style)
    row = int(found[:, nearest[0]].argmin())
    least = float(found[row, nearest[0]])
    words = (
        f"least: {number(least)} m at {number(result.time[row])} s"
        if least
        else f"overlap at {number(result.time[row])} s"
    )
    style = {"color": BLACK, "markersize": 6, "markerfacecolor": "none", "clip_on": False}
    axes.plot(result.time[row], least, "o", label=words, **style)
    if len(pairs) > len(nearest):
        axes.plot([], [], " ", label=f"{len(pairs) - len(nearest)} more pairs, which stay farther apart")
    axes.set_ylim(0.0, 1.05 * float(found[:, nearest].max()) or 1.0)
    _legend(figure, axes)
    return figure


def rotation(result: Result, page: Page) -> Figure | None:
    """Angular velocity of each rigid body over time, in body axes; None without rigid bodies."""
    turning = {
        name: np.asarray(body.angular_velocity)
        for name, body in result.bodies.items()
        if body.angular_velocity is not None
    }
    if not turning:
        return None
    figure, axes = _curve_axes(
        result, page, "Rotation of the bodies, in body axes", "angular velocity [rad/s]"
    )
    for k, (name, values) in enumerate(turning.items()):
        line = ("-", "--", ":", "-.")[k % 4]
        styles = zip("xyz", (YELLOW, RED, BLUE), (2.4, 1.6, 1.0), "os^", strict=True)
        for axis, color, width, marker in styles:
            style: dict[str, Any] = {"color": color, "linewidth": width, "linestyle": line, "marker": marker}
            column, shift = values[:, "xyz".index(axis)], "xyz".index(axis) / 3
            _curve(axes, result.time, column, shift, label=f"{name}, {axis}", markersize=4.0, **style)
    _legend(figure, axes)
    return figure


def agreement(result: Result, page: Page, found: Agreement) -> Figure:
    """Differences between two codes over time, on a logarithmic scale (zeros are left out)."""
    figure, axes = _curve_axes(result, page, "Difference from the reference", "largest difference [m], [m/s]")
    axes.set_yscale("log")
    styles: tuple[dict[str, Any], ...] = ({"color": BLUE}, {"color": RED, "linestyle": "--"})
    differences = (("position [m]", found.position_difference), ("speed [m/s]", found.speed_difference))
    for (name, values), style in zip(differences, styles, strict=True):
        seen = np.where((values > 0) & np.isfinite(values), values, np.nan)
        if np.isfinite(seen).any():
            _curve(axes, found.time, seen, label=name, linewidth=1.2, **style)
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
    _legend(figure, axes)
    return figure


def _mark_horizon(axes: Axes, found: Agreement) -> None:
    if found.agrees_until is not None:
        label = f"agree until {number(found.agrees_until)} s"
        axes.axvline(found.agrees_until, color=BLACK, linewidth=0.9, linestyle=(0, (5, 3)), label=label)


def _curve(axes: Axes, time: Floats, values: Floats, shift: float = 0.0, **style: Any) -> None:
    """One curve; its markers stand at every tenth of it, moved by `shift` of that, and at a lone point."""
    time, values = thinned(time, values)
    step = max(1, len(time) // 10)
    if len(time) == 1:
        style.setdefault("marker", "o")
    axes.plot(time, values, markevery=(int(shift * step), step), **style)


def _band(axes: Axes, time: Floats, values: Floats, extremes: Floats, color: str, label: str) -> None:
    """From a curve to the extreme value of each interval, which ends with one of its times."""
    style: dict[str, Any] = {"color": color, "alpha": 0.5, "linewidth": 0.7, "zorder": 1.5}
    axes.fill_between(*thinned_band(time, values, extremes), step="pre", label=label, **style)


def _spread_band(
    axes: Axes, spread: EnsembleResult, ends: tuple[Floats, Floats], color: str, label: str = ""
) -> None:
    """From the least to the largest of moved starts, pale and behind all curves."""
    words = label or f"{spread.runs} moved starts"
    axes.fill_between(
        spread.time, *ends, color=color, alpha=0.22, linewidth=0, zorder=1, label=f"{words}, least to largest"
    )


def _many(axes: Axes, time: Floats, values: Floats, label: str) -> None:
    """More curves than styles: one colour scale from the first to the last."""
    from matplotlib import colormaps

    for k, color in enumerate(colormaps["cividis"](np.linspace(0, 0.9, values.shape[1]))):
        _curve(axes, time, values[:, k], color=color, linewidth=0.9, label=label if k == 0 else None)


def _curve_axes(result: Result, page: Page, title: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes for curves over time."""
    figure, axes = page.curve_axes(result, title)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(y_label)
    return figure, axes


def _legend(figure: Figure, axes: Axes) -> None:
    """The legend above the axes; lines and markers to suit the figure's size."""
    scale = line_scale(figure)
    for line in axes.get_lines():
        line.set_linewidth(scale * line.get_linewidth())
        line.set_markersize(scale * line.get_markersize())
    legend_above(figure, *axes.get_legend_handles_labels())
