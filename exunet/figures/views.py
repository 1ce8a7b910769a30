"""Where to look at a net from: planes and limits; and the net drawn there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from exunet.figures.style import BLACK
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

FLAT = 0.01  # of the net's size: what moves less than this across a plane is drawn in that plane
FARTHEST = 5.0  # sizes of the scene: what a failed run has thrown farther than this is out of the limits
FREE: dict[str, Any] = {
    "color": "0.35",
    "linestyle": "",
    "marker": "o",
    "markersize": 4,
    "markerfacecolor": "white",
}


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


def best_view(
    net: Net, certain: Sequence[Floats], others: Sequence[Floats] = (), margin: float = 0.06
) -> View:
    """The view that shows all points, each array (n, 3) [m]: one plane if they are flat, otherwise two.

    certain : shown wherever they are
    others  : shown unless they are farther from those than a run that has not failed brings them
    States that are flat in more than one direction are drawn in the x-y plane. Two planes are the net's front
    (x, y) and its side (z, y).
    """
    size = net_size(net)
    points = np.concatenate(certain)
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    far = FARTHEST * max(size, float(np.ptp(points, axis=0).max()))
    points = np.concatenate([points, *(np.clip(one, middle - far, middle + far) for one in others)])
    low, high = points.min(axis=0), points.max(axis=0)
    flat = high - low < FLAT * size
    planes = {(True, False): ((1, 2),), (False, True): ((0, 2),)}.get(
        (bool(flat[0]), bool(flat[1])), ((0, 1),) if flat[2] else ((0, 1), (2, 1))
    )
    if flat[2]:
        planes = ((0, 1),)
    spread = high - low
    half = np.maximum(spread / 2, 0.15 * spread.max() or 0.5) + margin * (spread.max() or 1.0)
    return View(planes, (low + high) / 2 - half, (low + high) / 2 + half)


def broadness(net: Net) -> float:
    """How broad the elements of a net are drawn, relative to one of few elements."""
    return float(np.clip(12 / np.sqrt(max(1, net.n_elements)), 0.25, 1.0))


def draw_net(
    axes: Axes, net: Net, position: Floats, plane: tuple[int, int], color: str, width: float
) -> None:
    """The elements of a net without tethers (a border broader, strings twice as broad), bullets as dots.

    position : (n_nodes, 3) [m]
    """
    points = _seen(net, position, plane)
    broad = width * broadness(net)
    border = of_border(net)
    for chosen, factor in ((~net.is_string & ~border, 1.0), (border, 1.6), (net.is_string, 2.0)):
        if chosen.any():
            _draw(axes, points[net.element_nodes[chosen]], color, factor * broad)
    dots = points[net.bullet_nodes]
    if len(dots):
        axes.scatter(dots[:, 0], dots[:, 1], s=16 * width, color=color, zorder=3, linewidths=0)


def draw_tethers(axes: Axes, net: Net, position: Floats, plane: tuple[int, int], width: float) -> None:
    """The tethers beside a net, over it; position (n_nodes, 3) [m]."""
    if net.tethers:
        ends = net.element_nodes[net.n_net_elements :]
        _draw(axes, _seen(net, position, plane)[ends], BLACK, 1.2 * width, zorder=2.5)


def _seen(net: Net, position: Floats, plane: tuple[int, int]) -> Floats:
    """(n_nodes, 2) [m] in a plane, no farther away than can be drawn."""
    return np.clip(position[:, plane], *(np.array([-1e3, 1e3]) * net_size(net)))


def _draw(axes: Axes, segments: Floats, color: str, width: float, zorder: float = 2.0) -> None:
    style: dict[str, Any] = {"colors": color, "linewidths": width, "capstyle": "round", "zorder": zorder}
    axes.add_collection(LineCollection(_bundles(segments), **style), autolim=False)


def of_border(net: Net) -> NDArray[np.bool_]:
    """(n_elements,) which elements of the sides are of another cross section than the first: of a border."""
    woven = np.arange(net.n_elements) < net.n_net_elements
    return np.asarray(woven & ~net.is_string & (net.area != net.area[:1]))


def _bundles(segments: Floats, most: int = 256) -> list[Floats]:
    """Segments (n, 2, 2) as few lines with NaN between the segments: much quicker to draw than each alone."""
    broken = np.full((len(segments), 3, 2), np.nan)
    broken[:, :2] = segments
    return [broken[k : k + most].reshape(-1, 2) for k in range(0, len(broken), most)]
