"""Largest tensions: on the reference net by shade and width, along tethers as curves."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from exunet.figures.known import known, words_of_runs
from exunet.figures.lines import from_zero
from exunet.figures.page import COLOR_BAR, INCH, Page, finish, line_scale, text_width
from exunet.figures.panels import LEFT, NARROWEST, Panels, framed
from exunet.figures.style import BLACK, MOST_CURVES, curve_styles
from exunet.figures.views import best_view, broadness
from exunet.results.attached import attached_nodes
from exunet.results.ensemble_result import EnsembleResult
from exunet.results.judged import Judged
from exunet.results.measures import has_peaks_of_all_steps, peak_tensions
from exunet.results.result import Result

Floats = NDArray[np.float64]

BAR = 0.52  # inch, for a colour bar with its numbers and its label
_LINE = 0.14  # inch, for a second line of the label
SLACK: dict[str, Any] = {"color": "0.45", "linestyle": ":", "linewidth": 0.9}


def tensions(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Largest tension of each element of the net, on the reference net; None without."""
    if not result.net.n_net_elements:
        return None
    of_net = "net_largest_tension_N" if result.net.tethers else "largest_tension_N"
    return tension_map(result, page, peak_tensions(result), known(spread, of_net))


def _of(result: Result, *largest: Judged | None) -> str:
    """Which steps the largest tensions are of; without a value that is known, these are of this run alone."""
    steps = "of all steps" if has_peaks_of_all_steps(result) else "at the stored times"
    return steps if all(one is not None and one.predictable for one in largest) else f"{steps} of this run"


def tension_map(result: Result, page: Page, peaks: Floats, largest: Judged | None = None) -> Figure:
    """Tensions (n_elements,) [N] on the reference net: the larger, the darker and the broader.

    Elements without tension are dotted. Tethers are left out: they have no place in that configuration.
    largest : of all, as far as it is known; where it is a range, a line on the colour bar shows it, and the
              label says that the elements are those of this run
    """
    net = result.net.alone
    peaks = peaks[: net.n_elements]
    view = best_view(net, [net.reference_position], margin=0.08)
    ranged = None if largest is None or largest.predictable else largest
    top = max(float(peaks.max()), 0.0 if ranged is None else ranged.largest) or 1.0
    entries = []
    if len(net.bullet_nodes):
        entries.append(Line2D([], [], color=BLACK, linestyle="", marker="o", markersize=4, label="bullet"))
    if not peaks.all():
        entries.append(Line2D([], [], label=f"no tension {_of(result, largest)}", **SLACK))
    if largest is not None:
        words = f"largest, {largest.runs} starts: {largest.words()}"
        width = 0.0 if ranged is None else 1.1  # as on the bar
        entries.append(Line2D([], [], color=BLACK, linewidth=width, label=words))
    label = _folded(f"largest tension {_of(result, largest)} [N]", page)
    above = BAR + _LINE * label.count("\n") if peaks.any() else 0.05
    panels = Panels([""], entries, above, width=120.0)
    figure, (axes,) = framed(result, page, view, panels, "Tensions")
    colors = tension_colors()
    broad = line_scale(figure) * broadness(net) * (0.6 + 3.0 * peaks / top)
    order = np.argsort(peaks, kind="stable")  # the largest on top
    for ax, plane in zip(axes, view.planes, strict=True):
        ends = net.reference_position[net.element_nodes[order]][..., plane]
        taut = peaks[order] > 0.0
        ax.add_collection(LineCollection(list(ends[~taut]), **SLACK), autolim=False)
        drawn = LineCollection(list(ends[taut]), cmap=colors, norm=Normalize(0.0, top), capstyle="round")
        drawn.set(array=peaks[order][taut], linewidths=broad[order][taut])
        ax.add_collection(drawn, autolim=False)
        dots = net.reference_position[net.bullet_nodes][:, plane]
        ax.scatter(dots[:, 0], dots[:, 1], s=14, color=BLACK, zorder=3, linewidths=0)
    if peaks.any():
        shown = ScalarMappable(Normalize(0.0, top), colors)
        bar = colour_bar(figure, axes, shown, label)
        if ranged is not None:
            _mark_range(bar, ranged)
    return figure


def _folded(label: str, page: Page) -> str:
    """The label of the colour bar, in two lines where its narrowest page has no room for one."""
    wide = page.size[0] / INCH if page.size else NARROWEST
    fits = text_width(label, 8.0) / 72 <= wide - LEFT
    return label if fits else label.replace("tension ", "tension\n", 1)


def _mark_range(bar: Axes, largest: Judged) -> None:
    """The range of the largest tension of moved starts, as a line with ends on the colour bar."""
    ends = [largest.least, largest.largest]
    edge = [withStroke(linewidth=2.6, foreground="white")]  # on the dark end of the bar
    style: dict[str, Any] = {"color": BLACK, "marker": "|", "markersize": 7, "linewidth": 1.1}
    bar.plot(ends, [0.5, 0.5], transform=bar.get_xaxis_transform(), clip_on=False, path_effects=edge, **style)


def tethers(result: Result, page: Page, spread: EnsembleResult | None = None) -> Figure | None:
    """Largest tension of each element of the tethers, over the length along them.

    Lengths are unstretched, from the start of a tether. Of more than eight those with the largest tension.
    None without tethers.
    """
    net = result.net
    if not net.tethers:
        return None
    peaks = peak_tensions(result)
    elements = {tether: np.array(net.tether_elements[tether.name]) for tether in net.tethers}
    order = sorted(elements, key=lambda tether: -float(peaks[elements[tether]].max()))
    figure, axes = page.curve_axes(result, "Tensions along the tethers")
    axes.set_xlabel("unstretched length along the tether [m]")
    shown = order[:MOST_CURVES]
    largest = [known(spread, f"tether_{tether.name}_largest_tension_N") for tether in shown]
    words = _of(result, *largest).replace(" of this run", "\nof this run")
    axes.set_ylabel(f"largest tension\n{words} [N]")
    for tether, style in zip(shown, curve_styles(len(shown)), strict=True):
        along = np.append(0.0, np.cumsum(net.reference_length[elements[tether]]))
        start, end = (_end(result, node) for node in (tether.nodes[0], tether.nodes[-1]))
        values = peaks[elements[tether]]
        style |= {"label": f"{tether.name}, from {start} to {end}", "markersize": 4.5}
        axes.plot(along, np.append(values, values[-1]), drawstyle="steps-post", **style)
    for tether, one in zip(shown, largest, strict=True):
        if one is not None:
            axes.plot([], [], " ", label=f"{tether.name}, {words_of_runs(one)}")
    if len(order) > len(shown):
        axes.plot([], [], " ", label=f"{len(order) - len(shown)} more, of less tension")
    from_zero(axes, float(peaks[elements[order[0]]].max()))
    finish(figure, axes)
    return figure


def _end(result: Result, node: int) -> str:
    """What a tether ends at."""
    for name in result.bodies:
        if node in attached_nodes(result, name):
            return name
    return f"{'bullet' if node in result.net.bullet_nodes else 'node'} {node}"


def tension_colors() -> Colormap:
    """From light to dark, evenly in lightness; its lightest still shows on white."""
    return ListedColormap(colormaps["cividis_r"](np.linspace(0.1, 1.0, 256)), "tensions")


def colour_bar(
    figure: Figure, axes: list[Axes], shown: ScalarMappable, label: str, over: float = 0.0
) -> Axes:
    """A bar above the panel, as wide as it; over : what stands between them [inch]."""
    boxes = [ax.get_position() for ax in axes]
    left, right = min(box.x0 for box in boxes), max(box.x1 for box in boxes)
    top, height = max(box.y1 for box in boxes), figure.get_figheight()
    place = (left, top + (0.07 + over) / height, right - left, 0.09 / height)
    bar = figure.colorbar(shown, cax=figure.add_axes(place, label=COLOR_BAR), orientation="horizontal")
    bar.ax.xaxis.set_ticks_position("top")
    bar.ax.xaxis.set_label_position("top")
    bar.set_label(label, labelpad=3)
    return bar.ax
