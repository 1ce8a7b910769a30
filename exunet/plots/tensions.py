"""Tensions over time, on the reference net and along tethers; forces of threads on bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from exunet.base.arrays import Floats
from exunet.plots.nets import best_view, framed, line_width
from exunet.plots.style import BLACK, BLUE, MAX_CURVES, RED, FigureData, curve_styles, legend_above
from exunet.plots.time_axes import (
    curve,
    draw_bands,
    finish,
    from_zero,
    label_of_runs,
    range_of,
    stacked_axes,
)
from exunet.results.ensemble import Range
from exunet.results.loads import PACKED, attached_nodes
from exunet.results.measures import peak_tensions
from exunet.results.observables import PULLS, pull_name
from exunet.results.result import Result

_ALONG = "unstretched length along the tether [m]"
_SLACK: dict[str, Any] = {"color": "0.45", "linestyle": ":", "linewidth": 0.9}


def largest_tension(source: FigureData) -> Figure | None:
    """Largest tension of all elements over time; a circle marks the largest of all steps.

    The curve has the stored times only: a snap between two of them shows in the mark alone.
    """
    result, ensemble = source.result, source.ensemble
    values = source.run.tension
    peak = result.run.largest_tension
    taut = peak is not None and peak.element >= 0
    if not np.any(values) and not taut:
        return None
    figure, (axes,) = stacked_axes(source, ["tension [N]"], 90.0)
    curve(axes, result.time, values, label="largest at each stored time", color=BLUE, linewidth=1.2)
    if peak is not None and taut:
        label = "largest of all steps of this run"
        style: dict[str, Any] = {"color": RED, "markersize": 6, "markerfacecolor": "none", "clip_on": False}
        axes.plot(peak.time, peak.tension, "o", label=label, **style)
    draw_bands(axes, ensemble, {"tension": BLACK})
    if ensemble is not None and "time_of_largest_tension_s" in ensemble.metrics:
        times, peaks = (ensemble.metrics[k] for k in ("time_of_largest_tension_s", "largest_tension_N"))
        largest = range_of(ensemble, "largest_tension_N")
        cross: dict[str, Any] = {"color": BLACK, "markersize": 2.5, "markeredgewidth": 0.6, "zorder": 3}
        axes.plot(times, peaks, "x", label=None if largest is None else label_of_runs(largest), **cross)
    from_zero(axes)
    return finish(source, figure)


def tensions(source: FigureData) -> Figure | None:
    """Largest tension of each element over all steps, on the reference net: the larger, the darker.

    Elements without tension are dotted. Tethers have no place in that configuration.
    """
    result, net = source.result, source.result.net.alone
    peaks = peak_tensions(result)[: net.n_elements]
    if not np.any(peaks):
        return None
    key = "net_largest_tension_N" if result.net.tethers else "largest_tension_N"
    largest = range_of(source.ensemble, key)
    ranged = None if largest is None or largest.known else largest
    top = max(float(peaks.max()), 0.0 if ranged is None else ranged.high)
    view = best_view(net, margin=0.08)
    figure, panel = framed(source, view, beside=25.0)
    colors = colormaps["cividis_r"](np.linspace(0.1, 1.0, 256))  # whose lightest shows on white
    shown = ScalarMappable(Normalize(0.0, top), ListedColormap(colors, "tensions"))
    widths = line_width(net) * (0.6 + 3.0 * peaks / top)
    for axes, plane in zip(panel, view.planes, strict=True):
        _draw_tensions(axes, net.reference_position[net.element_nodes][..., plane], peaks, shown, widths)
        dots = net.reference_position[net.bullet_nodes][:, plane]
        axes.scatter(dots[:, 0], dots[:, 1], s=14, color=BLACK, zorder=3, linewidths=0)
    label = f"largest tension\n{_steps(result, largest)} [N]"
    bar = figure.colorbar(shown, ax=panel, label=label, pad=0.02, aspect=30).ax
    if ranged is not None:
        _mark_range(bar, ranged)
    entries = []
    if len(net.bullet_nodes):
        entries.append(Line2D([], [], color=BLACK, linestyle="", marker="o", label="bullet"))
    if not peaks.all():
        entries.append(Line2D([], [], label="no tension", **_SLACK))
    if largest is not None:
        entries.append(Line2D([], [], color=BLACK, linewidth=1.1, label=label_of_runs(largest)))
    legend_above(figure, entries, [str(entry.get_label()) for entry in entries])
    return figure


def _draw_tensions(
    axes: Axes, segments: Floats, tension: Floats, shown: ScalarMappable, widths: Floats
) -> None:
    """Draw elements, segments (n, 2, 2), by their tension [N]: the largest on top, slack ones dotted."""
    order = np.argsort(tension, kind="stable")
    taut, slack = order[tension[order] > 0.0], order[tension[order] <= 0.0]
    drawn = LineCollection(list(segments[taut]), cmap=shown.cmap, norm=shown.norm, capstyle="round")
    drawn.set(array=tension[taut], linewidths=widths[taut])
    for collection in (LineCollection(list(segments[slack]), **_SLACK), drawn):
        axes.add_collection(collection, autolim=False)


def tethers(source: FigureData) -> Figure | None:
    """Largest tension over all steps of each element of the tethers, over the unstretched length.

    Of more than eight tethers those with the largest tension.
    """
    result, net = source.result, source.result.net
    peaks = peak_tensions(result)
    elements = {tether: np.array(net.tether_elements[tether.name]) for tether in net.tethers}
    order = sorted(elements, key=lambda tether: -float(peaks[elements[tether]].max()))
    if not any(np.any(peaks[chosen]) for chosen in elements.values()):
        return None
    shown = order[:MAX_CURVES]
    largest = [range_of(source.ensemble, f"tether_{tether.name}_largest_tension_N") for tether in shown]
    figure, (axes,) = stacked_axes(
        source, [f"largest tension\n{_steps(result, *largest)} [N]"], 90.0, x_label=_ALONG
    )
    for tether, style in zip(shown, curve_styles(len(shown)), strict=True):
        along = np.append(0.0, np.cumsum(net.reference_length[elements[tether]]))
        start, end = (_end(result, node) for node in (tether.nodes[0], tether.nodes[-1]))
        values = peaks[elements[tether]]
        label = f"{tether.name}, from {start} to {end}"
        axes.plot(along, np.append(values, values[-1]), drawstyle="steps-post", label=label, **style)
    from_zero(axes)
    remarks = [
        f"{tether.name}, {label_of_runs(metric)}"
        for tether, metric in zip(shown, largest, strict=True)
        if metric is not None
    ]
    more = [f"{len(order) - len(shown)} more, of smaller tension"] if len(order) > len(shown) else []
    return finish(source, figure, [*remarks, *more])


def loads_on_bodies(source: FigureData) -> Figure | None:
    """Magnitudes of force and torque of threads on bodies at the places where they are attached, over time.

    The torque is about the centre of mass of the body. Of more than eight places those with the largest
    force.
    """
    result = source.result
    sizes = source.run.attachments
    pulled = [place for place, values in sizes.items() if values.any()]
    if not pulled:
        return None
    labels = ["force [N]", "torque about the\ncentre of mass [N m]"]
    figure, axes = stacked_axes(source, labels, 115.0)
    shown = sorted(pulled, key=lambda place: -float(sizes[place][:, 0].max(initial=0.0)))[:MAX_CURVES]
    styles = dict(zip(shown, curve_styles(len(shown)), strict=True))
    for column, (panel, quantity) in enumerate(zip(axes, PULLS, strict=True)):
        for k, (place, style) in enumerate(styles.items()):
            where = "packed net" if place.node == PACKED else result.net.node_words(place.node)
            label = f"{place.body}, {where}" if column == 0 else None
            curve(panel, result.time, sizes[place][:, column], k / len(shown), label=label, **style)
        colors = {pull_name(place.name, quantity): style["color"] for place, style in styles.items()}
        draw_bands(panel, source.ensemble, colors)
        from_zero(panel)
    more = len(pulled) - len(shown)
    return finish(source, figure, [f"{more} more, with smaller forces"] if more else [])


def _steps(result: Result, *largest: Range | None) -> str:
    """Return which steps the largest tensions are of; values that are not certain are of this run."""
    steps = "at the stored times" if result.run.peak_tensions_N is None else "of all steps"
    certain = all(metric is not None and metric.known for metric in largest)
    return steps if certain else f"{steps} of this run"


def _mark_range(bar: Axes, largest: Range) -> None:
    """Mark the range of the largest tension of perturbed runs on the colour bar."""
    edge = [withStroke(linewidth=2.6, foreground="white")]  # on the dark end of the bar
    style: dict[str, Any] = {"color": BLACK, "marker": "_", "markersize": 7, "linewidth": 1.1}
    ends = [largest.low, largest.high]
    bar.plot([0.5, 0.5], ends, transform=bar.get_yaxis_transform(), clip_on=False, path_effects=edge, **style)


def _end(result: Result, node: int) -> str:
    """Return the name of the body, or of the node, at the end of a tether."""
    for name in result.bodies:
        if node in attached_nodes(result, name):
            return name
    return result.net.node_words(node)
