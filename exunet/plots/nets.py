"""Pictures of nets: the reference configuration in its plane, snapshots in three dimensions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.net.arrays import Net
from exunet.plots.scene_3d import draw, draw_scale, entries, prepare, scene_3d
from exunet.plots.style import BLUE, ROUND, SMALL, FigureData, legend_above, new_figure, number

Plane = tuple[int, int]  # horizontal and vertical axis

COORDINATES = ("x [m]", "y [m]", "z [m]")
_FLAT = 0.01  # extent relative to the net's size below which a direction is not drawn
_MAX_NUMBERS = 24  # of nodes
_MAX_HEIGHT = 160.0  # mm, of a figure of panels
_EDGE, _ROW = 24.0, 8.0  # mm, of legend and labels; of the title of a row of panels


@dataclass(frozen=True)
class View:
    """Planes of projection and limits of the coordinates.

    planes : pairs of a horizontal and a vertical axis; all have the same vertical axis
    low    : (3,) lower limits [m]
    high   : (3,) upper limits [m]
    """

    planes: tuple[Plane, ...]
    low: Floats
    high: Floats


def reference_net(source: FigureData) -> Figure | None:
    """The net in its reference configuration, with the numbers of bullets and corners."""
    net = source.result.net.alone
    if not net.n_elements:
        return None
    view = best_view(net, margin=0.1)
    figure, panel = framed(source, view)
    for axes, plane in zip(panel, view.planes, strict=True):
        draw_net(axes, net, net.reference_position, plane, BLUE, 1.3)
    _number_nodes(panel[0], net, view.planes[0])
    lengths = list(dict.fromkeys(map(number, (net.reference_length.min(), net.reference_length.max()))))
    shown = [_line(BLUE, 1.2, f"element, {' to '.join(lengths)} m long")]
    if of_border(net).any():
        shown.append(_line(BLUE, 2.0, "border"))
    if net.is_string.any():
        shown.append(_line(BLUE, 2.6, "corner string"))
    if len(net.bullet_nodes):
        shown.append(_dot(BLUE, "bullet"))
    _legend(figure, shown)
    return figure


def snapshots(source: FigureData) -> Figure:
    """Configurations from the first to the last stored time: six, or four in a column, numbered.

    Seen from the side, without perspective; a net that stays in a plane from the front. The views follow the
    net if the scene is larger than three times the net, or if the net travels alone.
    """
    result = source.result
    chosen = evenly_spaced(result.time, 4 if source.is_narrow else 6)
    scene = scene_3d(result, chosen)
    (x, y), columns = scene.camera.half, 2 if source.is_narrow else 3
    columns = min(columns, len(chosen))
    rows = math.ceil(len(chosen) / columns)
    width = (source.width - 4.0 * columns) / columns
    figure = new_figure(source, min(_MAX_HEIGHT, 8.0 + rows * (width * y / x + 4.0)), "compressed")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(chosen) :]:
        axes.remove()
    thin = 0.9 * line_width(result.net)
    for number_of, (k, axes) in enumerate(zip(chosen, grid.flat, strict=False), start=1):
        prepare(axes, scene)
        draw(axes, scene, k, width=thin)
        title = f"({number_of})  t = {number(result.time[k])} s"
        axes.set_title(title, loc="left", fontsize=SMALL, pad=3, y=1.0)
    draw_scale(grid.flat[0], scene.camera)
    _legend(figure, entries(scene))
    return figure


def framed(source: FigureData, view: View, beside: float = 0.0) -> tuple[Figure, list[Axes]]:
    """Return a figure with axes of equal scale for each plane of the view.

    beside : width of what stands beside the axes [mm]
    """
    widths = [float(view.high[a] - view.low[a]) for a, _ in view.planes]
    height = float(view.high[view.planes[0][1]] - view.low[view.planes[0][1]])
    across = (source.width - beside - 15.0 - 3.0 * len(widths)) / sum(widths)
    scale = min(across, (_MAX_HEIGHT - _EDGE - _ROW) / height)  # mm/m
    figure = new_figure(source, _EDGE + scale * height + _ROW, "compressed")
    panel = list(figure.subplots(1, len(widths), width_ratios=widths, squeeze=False)[0])
    for axes, (a, b) in zip(panel, view.planes, strict=True):
        axes.set(xlim=(view.low[a], view.high[a]), ylim=(view.low[b], view.high[b]), aspect="equal")
        axes.spines[:].set(visible=True, color="0.6")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator("auto", steps=ROUND, min_n_ticks=2))
        axes.tick_params(labelleft=axes is panel[0])
        axes.set_xlabel(COORDINATES[a])
        axes.set_ylabel(COORDINATES[b] if axes is panel[0] else "")
    return figure, panel


def best_view(net: Net, margin: float) -> View:
    """Return the view of the reference configuration: one plane if it is flat, else (x, y) and (z, y).

    margin : space around the points, relative to their extent
    """
    low, high = net.reference_position.min(axis=0), net.reference_position.max(axis=0)
    extent = high - low
    flat_x, flat_y, flat_z = (extent < _FLAT * (float(extent.max()) or 1.0)).tolist()
    planes: tuple[Plane, ...] = ((0, 1), (2, 1))
    if flat_z or (flat_x and flat_y):
        planes = ((0, 1),)
    elif flat_x or flat_y:
        planes = ((1, 2),) if flat_x else ((0, 2),)
    half = np.maximum(extent / 2, 0.15 * extent.max() or 0.5) + margin * (extent.max() or 1.0)
    return View(planes, (low + high) / 2 - half, (low + high) / 2 + half)


def line_width(net: Net) -> float:
    """Return the width of elements: thinner in a net of many."""
    return float(np.clip(12 / np.sqrt(max(1, net.n_elements)), 0.25, 1.0))


def draw_net(axes: Axes, net: Net, position: Floats, plane: Plane, color: str, width: float) -> None:
    """Draw the elements of a net without tethers (border and strings broader) and its bullets as dots.

    position : (n_nodes, 3) [m]
    """
    points = position[:, plane]
    border = of_border(net)
    for chosen, factor in ((~net.is_string & ~border, 1.0), (border, 1.6), (net.is_string, 2.0)):
        if chosen.any():
            _draw_lines(axes, points[net.element_nodes[chosen]], color, factor * width * line_width(net))
    dots = points[net.bullet_nodes]
    if len(dots):
        axes.scatter(dots[:, 0], dots[:, 1], s=12 * width, color=color, zorder=3, linewidths=0)


def evenly_spaced(time: Floats, count: int) -> list[int]:
    """Return the indices of the stored times nearest to `count` even times from first to last, each once."""
    even = np.linspace(time[0], time[-1], count)
    after = np.clip(np.searchsorted(time, even), 1, max(1, len(time) - 1))
    before = after - 1
    nearer = np.where(np.abs(time[before] - even) <= np.abs(time[after % len(time)] - even), before, after)
    return sorted({int(k) for k in nearer if k < len(time)})


def _legend(figure: Figure, entries: Sequence[Line2D]) -> None:
    if entries:
        legend_above(figure, entries, [str(entry.get_label()) for entry in entries])


def _line(color: str, width: float, label: str) -> Line2D:
    return Line2D([], [], color=color, linewidth=width, label=label)


def _dot(color: str, label: str) -> Line2D:
    return Line2D([], [], color=color, linestyle="", marker="o", label=label)


def _number_nodes(axes: Axes, net: Net, plane: Plane) -> None:
    """Write numbers beside bullets and corners of the mouth, or all nodes of a small net without any.

    Numbers of bullets stand outwards, those of corners inwards.
    """
    nodes = list(dict.fromkeys([*net.bullet_nodes.tolist(), *net.mouth]))
    if not nodes and net.n_nodes <= _MAX_NUMBERS:
        nodes = list(range(net.n_nodes))
    points = net.reference_position[:, plane]
    middle = points.mean(axis=0)
    bullets = set(net.bullet_nodes.tolist())
    for node in nodes[:: max(1, math.ceil(len(nodes) / _MAX_NUMBERS))]:
        away = points[node] - middle
        away = (
            away / (float(np.linalg.norm(away)) or 1.0) * (9.0 if node in bullets or not bullets else -11.0)
        )
        axes.annotate(
            str(node),
            points[node],
            xytext=tuple(away),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=SMALL,
            fontweight="bold" if node in bullets else "normal",
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=5,
        )


def _draw_lines(axes: Axes, segments: Floats, color: str, width: float, zorder: float = 2.0) -> None:
    """Draw segments (n, 2, 2), joined to lines of 256 with gaps: much faster than one by one."""
    broken = np.full((len(segments), 3, 2), np.nan)
    broken[:, :2] = segments
    lines = [broken[k : k + 256].reshape(-1, 2) for k in range(0, len(broken), 256)]
    style: dict[str, Any] = {"colors": color, "linewidths": width, "capstyle": "round", "zorder": zorder}
    axes.add_collection(LineCollection(lines, **style), autolim=False)


def of_border(net: Net) -> NDArray[np.bool_]:
    """Return the elements (n_elements,) of a border: their cross section is not that of the first element."""
    woven = np.arange(net.n_elements) < net.n_net_elements
    return np.asarray(woven & ~net.is_string & (net.area != net.area[:1]))
