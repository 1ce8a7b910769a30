"""Curves over time: bullet speeds and energies (the paper's Figs. 5, 6), areas, agreement of two codes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.style import BLACK, BLUE, CURVES, RED, YELLOW, blank, heading, number
from exunet.figures.thinning import thinned, thinned_band
from exunet.net.arrays import Net
from exunet.results import measures as metrics
from exunet.results.agreement import Agreement
from exunet.results.result import Result
from exunet.results.rows import over_blocks

Floats = NDArray[np.float64]

TWO_THIRDS = 2 / 3  # of the reference area, where the paper's net loses its symmetry (section 3.4)


def bullet_speeds(result: Result, agreement: Agreement | None = None) -> Figure | None:
    """Speed of each bullet over time, with the reference's if given; None without bullets."""
    speeds = metrics.bullet_speeds(result)
    count = speeds.shape[1]
    if count == 0:
        return None
    figure, axes = _curve_axes(result, "Speeds of the bullets", "speed [m/s]")
    nodes = result.net.bullet_nodes
    if count <= len(CURVES):
        for k in range(count):
            style = {"label": f"node {nodes[k]}", "markersize": 4.5, **CURVES[k]}
            _curve(axes, result.time, speeds[:, k], shift=k / count, **style)
    else:
        _many(axes, result.time, speeds, f"{count} bullets, nodes {nodes.min()} to {nodes.max()}")
    top = float(speeds.max())
    if agreement is not None:
        theirs = agreement.reference_speeds
        top = max(top, float(np.max(theirs, initial=0.0, where=np.isfinite(theirs))))
        # Thin over the broad curves of a few bullets, broad below the thin ones of many.
        grey: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "zorder": 4}
        if count > len(CURVES):
            grey = {"color": "0.75", "linewidth": 2.6, "zorder": 1.5}
        for k, column in enumerate(theirs.T):
            label = "reference" if k == 0 else None
            _curve(axes, agreement.time, column, label=label, **grey)
        _mark_horizon(axes, agreement)
    axes.set_ylim(0, 1.05 * top or 1.0)
    _legend(result, figure, axes)
    return figure


def energies(result: Result) -> Figure:
    """Kinetic and elastic energy, their sum and the dissipated work, relative to the total at the start.

    In joule if the net starts with (almost) no energy of its own, as one that falls from rest. Where known,
    bands reach from kinetic and elastic energy at the stored times to their extremes over the steps between.
    """
    total = result.kinetic + result.elastic
    parts: dict[str, tuple[Floats, dict[str, Any]]] = {
        "kinetic": (result.kinetic, {"color": BLUE, "linewidth": 1.6}),
        "elastic": (result.elastic, {"color": RED, "linewidth": 1.6, "linestyle": "-"}),
        "kinetic + elastic": (total, {"color": BLACK, "linewidth": 0.9, "linestyle": "--"}),
        "dissipated": (result.dissipated, {"color": YELLOW, "linewidth": 1.2, "linestyle": "-."}),
    }
    if np.any(result.potential != result.potential[0]):
        fallen = result.potential - result.potential[0]
        parts["potential, change"] = (fallen, {"color": "0.5", "linewidth": 0.9, "linestyle": ":"})
    start = float(total[0])
    relative = start > 1e-3 * max(float(np.abs(values).max()) for values, _ in parts.values())
    label = "energy / total energy at the start" if relative else "energy [J]"
    known = result.largest_elastic is not None and result.least_kinetic is not None
    more = "bands to the extremes of the steps between them" if known else "snaps between them do not show"
    figure, axes = _curve_axes(result, f"Energies at the stored times; {more}", label)
    unit = start if relative else 1.0
    for name, (values, style) in parts.items():
        _curve(axes, result.time, values / unit, label=name, **style)
    for extremes, name, color, words in (
        (result.least_kinetic, "kinetic", BLUE, "least kinetic of all steps"),
        (result.largest_elastic, "elastic", RED, "largest elastic of all steps"),
    ):
        if extremes is not None:
            _band(axes, result.time, parts[name][0] / unit, extremes / unit, color, words)
    _legend(result, figure, axes)
    return figure


def area(result: Result) -> Figure | None:
    """Mouth area and mesh area relative to the reference configuration; None if the net has neither."""
    net = result.net
    dashed = {"color": RED, "linewidth": 1.3, "linestyle": "--"}
    curves: dict[str, tuple[Callable[[Net, Floats], Floats], dict[str, Any]]] = {
        "mouth area": (metrics.mouth_area, {"color": BLUE, "linewidth": 1.8}),
        "mesh area (folds count twice)": (metrics.mesh_area, dashed),
    }
    full = {name: float(measure(net, net.reference_position)) for name, (measure, _) in curves.items()}
    if not any(full.values()):
        return None
    figure, axes = _curve_axes(result, "Opened area", "area / area in the reference configuration")
    top = 1.0
    for name, (measure, style) in curves.items():
        if full[name]:
            values = over_blocks(partial(measure, net), result.position) / full[name]
            _curve(axes, result.time, values, label=name, **style)
            top = max(top, float(values.max()))
    for level, text in ((metrics.NEARLY_OPEN, "80 %"), (TWO_THIRDS, "2/3")):
        axes.axhline(level, color="0.5", linewidth=0.9, linestyle=":" if text == "2/3" else "-", zorder=1)
        axes.text(1.01, level, text, transform=axes.get_yaxis_transform(), va="center", fontsize=8)
    measures = metrics.deployment(result)
    if measures:
        text = f"largest: {number(measures.relative_area)} at {number(measures.time_of_largest)} s"
        text += " (the end)" if measures.at_end else ""
        at = (measures.time_of_largest, measures.relative_area)
        axes.plot(*at, "o", color=BLACK, markersize=6, markerfacecolor="none", clip_on=False, label=text)
    axes.set_ylim(0, 1.05 * (top if result.complete else min(top, 2.0)))
    _legend(result, figure, axes)
    return figure


def rotation(result: Result) -> Figure | None:
    """Angular velocity of each rigid body over time, in body axes; None without rigid bodies."""
    turning = {
        name: np.asarray(body.angular_velocity)
        for name, body in result.bodies.items()
        if body.angular_velocity is not None
    }
    if not turning:
        return None
    figure, axes = _curve_axes(result, "Rotation of the bodies, in body axes", "angular velocity [rad/s]")
    for k, (name, values) in enumerate(turning.items()):
        line = ("-", "--", ":", "-.")[k % 4]
        for axis, color, width in zip("xyz", (YELLOW, RED, BLUE), (2.4, 1.6, 1.0), strict=True):
            style: dict[str, Any] = {"color": color, "linewidth": width, "linestyle": line}
            _curve(axes, result.time, values[:, "xyz".index(axis)], label=f"{name}, {axis}", **style)
    _legend(result, figure, axes)
    return figure


def agreement(result: Result, found: Agreement) -> Figure:
    """Differences between two codes over time, on a logarithmic scale (zeros are left out)."""
    figure, axes = _curve_axes(result, "Difference from the reference", "largest difference")
    axes.set_yscale("log")
    styles: tuple[dict[str, Any], ...] = ({"color": BLUE}, {"color": RED, "linestyle": "--"})
    differences = (("position [m]", found.position_difference), ("speed [m/s]", found.speed_difference))
    for (name, values), style in zip(differences, styles, strict=True):
        seen = np.where((values > 0) & np.isfinite(values), values, np.nan)
        if np.isfinite(seen).any():
            _curve(axes, found.time, seen, label=name, **style)
        else:
            axes.plot([], [], label=f"{name}: none", **style)
    for level, unit, color in ((found.allowed_position, "m", BLUE), (found.allowed, "m/s", RED)):
        if level > 0:
            label = f"allowed {number(level)} {unit}"
            dotted: dict[str, Any] = {"color": color, "linewidth": 1.0, "linestyle": (0, (1, 1.5))}
            axes.plot((0, 1), (level, level), transform=axes.get_yaxis_transform(), label=label, **dotted)
    _mark_horizon(axes, found)
    _legend(result, figure, axes)
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


def _many(axes: Axes, time: Floats, values: Floats, label: str) -> None:
    """More curves than styles: one colour scale from the first to the last."""
    from matplotlib import colormaps

    for k, color in enumerate(colormaps["cividis"](np.linspace(0, 0.9, values.shape[1]))):
        _curve(axes, time, values[:, k], color=color, linewidth=0.9, label=label if k == 0 else None)


def _curve_axes(result: Result, title: str, y_label: str) -> tuple[Figure, Axes]:
    """A figure with one pair of axes for curves over time."""
    figure = blank(6.4, 4.2)
    axes = figure.add_axes((0.11, 0.115, 0.82, 0.7))
    heading(figure, result, title)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(y_label)
    axes.grid(color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    start, end = float(result.time[0]), float(result.time[-1])
    if end > start:
        axes.set_xlim(start, end)
    return figure, axes


def _legend(result: Result, figure: Figure, axes: Axes) -> None:
    """The legend in one or two rows above the axes, where it hides nothing; the axes fill what is left."""
    handles, labels = axes.get_legend_handles_labels()
    rows = 1 if sum(len(label) + 7 for label in labels) < 105 else 2
    figure.legend(
        handles,
        labels,
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - (0.26 if result.complete else 0.43) / figure.get_figheight()),
        ncols=-(-len(handles) // rows),
        frameon=False,
        handlelength=2.6,
        columnspacing=1.4,
    )
    head = 0.4 + 0.17 * rows + (0.0 if result.complete else 0.17)
    left, foot, width, _ = axes.get_position().bounds
    axes.set_position((left, foot, width, 1 - head / figure.get_figheight() - foot))
