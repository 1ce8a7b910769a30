"""Where to look at a net from: planes, limits, and panels whose data units are equally long on all axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exunet.figures.style import blank
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

AXIS_NAMES = "xyz"
FLAT = 0.01  # of the net's size: what moves less than this across a plane is drawn in that plane
NARROWEST = 5.0  # inch; a figure with room for its legend
FARTHEST = 5.0  # net sizes: what a failed run has thrown farther than this is left out of the limits


@dataclass(frozen=True)
class View:
    """Planes to look at and the limits of each axis.

    planes : pairs of axes, (horizontal, vertical); all have the same vertical axis
    low    : (3,) lower limits [m]
    high   : (3,) upper limits [m]
    """

    planes: tuple[tuple[int, int], ...]
    low: Floats
    high: Floats


def net_size(net: Net) -> float:
    """Largest extent of the reference configuration along an axis [m]; 1 for a single point."""
    return float(np.ptp(net.reference_position, axis=0).max()) or 1.0


def best_view(net: Net, states: Sequence[Floats], margin: float = 0.06) -> View:
    """The view that shows all `states`, each (n_nodes, 3) [m]: one plane if they are flat, otherwise two.

    States that are flat in more than one direction are drawn in the x-y plane. Two planes are the net's front
    (x, y) and its side (z, y).
    """
    size = net_size(net)
    middle = (net.reference_position.max(axis=0) + net.reference_position.min(axis=0)) / 2
    near = np.clip(np.concatenate(states), middle - FARTHEST * size, middle + FARTHEST * size)
    low, high = near.min(axis=0), near.max(axis=0)
    flat = high - low < FLAT * size
    planes = {(True, False): ((1, 2),), (False, True): ((0, 2),)}.get(
        (bool(flat[0]), bool(flat[1])), ((0, 1),) if flat[2] else ((0, 1), (2, 1))
    )
    if flat[2]:
        planes = ((0, 1),)
    spread = high - low
    half = np.maximum(spread / 2, 0.15 * spread.max() or 0.5) + margin * (spread.max() or 1.0)
    return View(planes, (low + high) / 2 - half, (low + high) / 2 + half)


def panels(
    view: View, count: int, columns: int, head: float, title: float, width: float
) -> tuple[Figure, list[list[Axes]]]:
    """`count` panels in `columns`, each with one axes for each plane of `view`: (figure, axes by panel).

    `head` and `title` are the heights [inch] kept free above the whole and above each panel, `width` [inch]
    that of the figure (less where the panels would become too tall). All axes have the view's limits and
    equal scales; labels stand on the outer ones only.
    """
    rows = -(-count // columns)
    left, right, foot, gap, gap_in = 0.7, 0.15, 0.5, 0.3, 0.12
    span = view.high - view.low
    wide = sum(span[a] for a, _ in view.planes)
    tall = span[view.planes[0][1]]
    free = width - left - right - (columns - 1) * gap - columns * (len(view.planes) - 1) * gap_in
    scale = min(free / (columns * wide), 8.0 / (rows * tall))
    spare = max(0.0, width - max(NARROWEST, width - (free - scale * columns * wide)))
    left += (free - scale * columns * wide - spare) / 2
    width -= spare
    height = head + foot + rows * (scale * tall + title)
    figure = blank(width, height)
    made: list[list[Axes]] = []
    for k in range(count):
        row, column = divmod(k, columns)
        x = left + column * (scale * wide + gap + gap_in * (len(view.planes) - 1))
        y = foot + (rows - 1 - row) * (scale * tall + title)
        panel: list[Axes] = []
        for plane in view.planes:
            w = scale * span[plane[0]]
            axes = figure.add_axes((x / width, y / height, w / width, scale * tall / height))
            _set_axes(axes, view, plane, w, outer=(not panel and column == 0, k + columns >= count))
            panel.append(axes)
            x += w + gap_in
        made.append(panel)
    return figure, made


def _set_axes(axes: Axes, view: View, plane: tuple[int, int], width: float, outer: tuple[bool, bool]) -> None:
    """Limits, ticks to suit the `width` [inch], and labels on the (left, bottom) axes that are `outer`."""
    from matplotlib.ticker import MaxNLocator

    a, b = plane
    axes.set_xlim(view.low[a], view.high[a])
    axes.set_ylim(view.low[b], view.high[b])
    steps = [1, 2, 3, 5, 10]
    most = max(1 if width < 0.7 else 3, min(8, int(width / 0.45)))
    axes.xaxis.set_major_locator(MaxNLocator(most, steps=steps))
    axes.yaxis.set_major_locator(MaxNLocator(7, steps=steps))
    axes.tick_params(labelleft=outer[0], labelbottom=outer[1])
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)
    for spine in axes.spines.values():
        spine.set_color("0.6")
    if outer[0]:
        axes.set_ylabel(f"{AXIS_NAMES[b]} [m]")
    if outer[1]:
        axes.set_xlabel(f"{AXIS_NAMES[a]} [m]")


def draw_net(
    axes: Axes, net: Net, position: Floats, plane: tuple[int, int], color: str, width: float
) -> None:
    """The elements (strings twice as broad) and the bullets as dots; position (n_nodes, 3) [m]."""
    size = net_size(net)
    points = np.clip(position[:, plane], *(np.array([-1e3, 1e3]) * size))
    broad = width * np.clip(12 / np.sqrt(max(1, net.n_elements)), 0.25, 1.0)
    for chosen, factor in ((~net.is_string, 1.0), (net.is_string, 2.0)):
        if chosen.any():
            style: dict[str, Any] = {"colors": color, "linewidths": factor * broad, "capstyle": "round"}
            lines = LineCollection(_bundles(points[net.element_nodes[chosen]]), **style)
            axes.add_collection(lines, autolim=False)
    dots = points[net.bullet_nodes]
    if len(dots):
        axes.scatter(dots[:, 0], dots[:, 1], s=16 * width, color=color, zorder=3, linewidths=0)


def _bundles(segments: Floats, most: int = 256) -> list[Floats]:
    """Segments (n, 2, 2) as few lines with NaN between the segments: much quicker to draw than each alone."""
    broken = np.full((len(segments), 3, 2), np.nan)
    broken[:, :2] = segments
    return [broken[k : k + most].reshape(-1, 2) for k in range(0, len(broken), most)]
