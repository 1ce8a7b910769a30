"""Pictures of a scene: reference configuration, snapshots; views, nets, tethers and bodies in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from exunet.bodies.rotations import rotation_matrix
from exunet.forces.contact.status import OF_BODY
from exunet.net.arrays import Net
from exunet.plots.page import ROUND, Source, legend_above, new_figure
from exunet.plots.style import BLACK, BLUE, GREY, RED, SMALL, number
from exunet.results.loads import attached_nodes
from exunet.results.measures import centre_of_mass
from exunet.results.result import BodyStates, Result, blocks
from exunet.results.touching import contact_places, contacts_at

Floats = NDArray[np.float64]
Plane = tuple[int, int]  # horizontal and vertical axis

COORDINATES = ("$x$ [m]", "$y$ [m]", "$z$ [m]")
RELATIVE = ("$x - x_c$ [m]", "$y - y_c$ [m]", "$z - z_c$ [m]")  # to the centre of mass
_FLAT = 0.01  # extent relative to the net's size below which a direction is not drawn
_FARTHEST = 5.0  # sizes of the scene; a failed run may have thrown nodes farther
_MAX_NUMBERS = 24  # of nodes
_MAX_HEIGHT = 160.0  # mm, of a figure of panels
_EDGE, _ROW = 24.0, 8.0  # mm, of legend and labels; of the title of a row of panels
_HALO = 4.0  # points by which a thread in contact is broader
_BODY_MARKS = "Ds^vpP*X"  # a round one is a bullet's
_AXES_WIDTHS = (2.2, 1.0)  # points, of the x and y axes of a rigid body without a shape
FREE_NODE: dict[str, Any] = {"color": "0.35", "linestyle": "", "marker": "o", "markerfacecolor": "white"}


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


def reference_net(source: Source) -> Figure | None:
    """The net in its reference configuration, with the numbers of bullets and corners."""
    net = source.result.net.alone
    if not net.n_elements:
        return None
    view = best_view(net, [net.reference_position], margin=0.1)
    figure, (panel,) = framed(source, view, 1)
    for axes, plane in zip(panel, view.planes, strict=True):
        draw_net(axes, net, net.reference_position, plane, BLUE, 1.3)
    _number_nodes(panel[0], net, view.planes[0])
    lengths = list(dict.fromkeys(map(number, (net.reference_length.min(), net.reference_length.max()))))
    entries = [_line(BLUE, 1.2, f"element, {' to '.join(lengths)} m long")]
    if of_border(net).any():
        entries.append(_line(BLUE, 2.0, "border"))
    if net.is_string.any():
        entries.append(_line(BLUE, 2.6, "corner string"))
    if len(net.bullet_nodes):
        entries.append(_dot(BLUE, "bullet"))
    _legend(figure, entries)
    return figure


def snapshots(source: Source) -> Figure:
    """Up to six configurations from the first to the last stored time, over the reference configuration.

    A net that travels by more than half its size is drawn relative to its centre of mass c. Threads in
    contact with bodies are marked.
    """
    result, net, alone = source.result, source.result.net, source.result.net.alone
    chosen = evenly_spaced(result.time, 4 if source.is_narrow else 6)
    centre = centre_of_mass(result)
    travelled = max(float(np.linalg.norm(block - centre[0], axis=1).max()) for block in blocks(centre))
    follows = travelled > 0.5 * net_size(net)
    centre = centre if follows else np.zeros_like(centre)
    reference = alone.reference_position
    if follows:
        reference = reference - alone.mass @ reference / alone.mass.sum()
    states = [result.position[k] - centre[k] for k in chosen]
    places = body_places(result, chosen) - centre[chosen][:, None]
    view = best_view(net, [reference, states[0], places[0]], [*states, *places])
    figure, panels = framed(source, view, len(chosen), RELATIVE if follows else COORDINATES)
    for k, state, panel in zip(chosen, states, panels, strict=True):
        title = f"$t$ = {number(result.time[k])} s"
        if follows:
            title += f"\n$c$ = ({', '.join(f'{c + 0.0:.3g}' for c in np.round(centre[k], 2))}) m"
        panel[0].set_title(title.replace("-", "\N{MINUS SIGN}"), loc="left", fontsize=SMALL, pad=3)
        touching = ~np.isnan(contact_places(result, [k])[0])
        for axes, plane in zip(panel, view.planes, strict=True):
            draw_net(axes, alone, reference, plane, GREY, 0.8)
            draw_touching(axes, state[net.element_nodes[touching]][..., plane], line_width(net))
            draw_net(axes, alone, state[: alone.n_nodes], plane, BLUE, 1.0)
            _draw_tethers(axes, net, state, plane)
            draw_free_nodes(axes, result, state, plane)
            draw_bodies(axes, result, k, centre[k], plane)
    entries = [_line(BLUE, 1.2, "net")] if net.n_net_elements else []
    entries += [_dot(BLUE, "bullet")] if len(net.bullet_nodes) else []
    entries += [_line(BLACK, 1.2, "tether")] if net.tethers else []
    entries += [_line(GREY, 1.2, "reference configuration")] if net.n_net_elements else []
    _legend(figure, [*entries, *scene_entries(result)])
    return figure


def framed(
    source: Source, view: View, count: int, names: Sequence[str] = COORDINATES, beside: float = 0.0
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure of panels with equal scales, and the axes of each: one for each plane of the view.

    names  : of the coordinates
    beside : width of what stands beside the panels [mm]
    """
    widths = [float(view.high[a] - view.low[a]) for a, _ in view.planes]
    height = float(view.high[view.planes[0][1]] - view.low[view.planes[0][1]])

    def scale(columns: int) -> float:  # mm/m
        rows = math.ceil(count / columns)
        across = (source.width - beside - 15.0 - 3.0 * columns * len(widths)) / (columns * sum(widths))
        return min(across, (_MAX_HEIGHT - _EDGE - _ROW * rows) / (rows * height))

    columns = max(range(1, min(count, 3) + 1), key=scale)
    rows = math.ceil(count / columns)
    figure = new_figure(source, _EDGE + rows * (scale(columns) * height + _ROW), "compressed")
    ratios = widths * columns
    grid = figure.subplots(rows, len(ratios), width_ratios=ratios, squeeze=False)
    panels = [
        [*grid[divmod(k, columns)[0]][k % columns * len(widths) :][: len(widths)]] for k in range(count)
    ]
    for axes in grid[-1, (count - (rows - 1) * columns) * len(widths) :]:
        axes.remove()
    for k, panel in enumerate(panels):
        for axes, (a, b) in zip(panel, view.planes, strict=True):
            axes.set(xlim=(view.low[a], view.high[a]), ylim=(view.low[b], view.high[b]), aspect="equal")
            axes.spines[:].set(visible=True, color="0.6")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(MaxNLocator("auto", steps=ROUND, min_n_ticks=2))
            left, lowest = axes is panel[0] and k % columns == 0, k + columns >= count
            axes.tick_params(labelleft=left, labelbottom=lowest)
            axes.set_xlabel(names[a] if lowest else "")
            axes.set_ylabel(names[b] if left else "")
    return figure, panels


def net_size(net: Net) -> float:
    """Return the largest extent of the reference configuration along an axis [m]; 1 for a single point."""
    return float(np.ptp(net.reference_position, axis=0).max()) or 1.0


def best_view(
    net: Net, certain: Sequence[Floats], others: Sequence[Floats] = (), margin: float = 0.06
) -> View:
    """Return the view of points (n, 3) [m]: one plane if they are flat, else front (x, y) and side (z, y).

    Parameters
    ----------
    net : Net
        Its size decides what is flat.
    certain : sequence of array
        Points that are inside the limits in any case.
    others : sequence of array
        Points that are inside the limits unless a failed run has brought them far away.
    margin : float
        Space around the points, relative to their extent.
    """
    size = net_size(net)
    points = np.concatenate(certain)
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    far = _FARTHEST * max(size, float(np.ptp(points, axis=0).max()))
    points = np.concatenate([points, *(np.clip(other, middle - far, middle + far) for other in others)])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = high - low
    flat_x, flat_y, flat_z = (extent < _FLAT * size).tolist()
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
    points = _projected(net, position, plane)
    border = of_border(net)
    for chosen, factor in ((~net.is_string & ~border, 1.0), (border, 1.6), (net.is_string, 2.0)):
        if chosen.any():
            _draw_lines(axes, points[net.element_nodes[chosen]], color, factor * width * line_width(net))
    dots = points[net.bullet_nodes]
    if len(dots):
        axes.scatter(dots[:, 0], dots[:, 1], s=12 * width, color=color, zorder=3, linewidths=0)


def draw_touching(axes: Axes, segments: Floats, width: float) -> list[Artist]:
    """Mark threads in contact, segments (n, 2, 2), under lines of a width."""
    if not len(segments):
        return []
    lines = LineCollection(list(segments), colors=RED, linewidths=width + _HALO, alpha=0.5, zorder=1.8)
    return [axes.add_collection(lines, autolim=False)]


def draw_free_nodes(axes: Axes, result: Result, position: Floats, plane: Plane) -> list[Artist]:
    """Draw the free nodes at positions (n_nodes, 3) [m]."""
    free = free_nodes(result)
    return list(axes.plot(*position[free][:, plane].T, **FREE_NODE)) if len(free) else []


def free_nodes(result: Result) -> NDArray[np.int64]:
    """Return the nodes to which no thread, no bullet and no body is attached."""
    held = [attached_nodes(result, name) for name in result.bodies]
    used = np.concatenate([result.net.element_nodes.ravel(), result.net.bullet_nodes, *held])
    return np.setdiff1d(np.arange(result.net.n_nodes), used)


def draw_bodies(axes: Axes, result: Result, k: int, origin: Floats, plane: Plane) -> list[Artist]:
    """Draw the bodies at a stored time, relative to an origin (3,) [m].

    Shapes as wireframes, or the body axes of a rigid body without a shape; a mark at the centre of mass.
    """
    drawn: list[Artist] = []
    length = 0.12 * net_size(result.net)
    for index, body in enumerate(result.bodies.values()):
        at = (body.position[k] - origin)[list(plane)]
        if body.wireframe is not None:
            lines = (_wireframe(body, k) - origin)[..., list(plane)]
            shape = LineCollection(list(lines), colors=RED, linewidths=0.6)
            drawn.append(axes.add_collection(shape, autolim=False))
        elif body.attitude is not None:
            arms = length * rotation_matrix(np.asarray(body.attitude[k]))[list(plane)]
            for axis, width in enumerate(_AXES_WIDTHS):
                drawn += axes.plot(*np.stack([at, at + arms[:, axis]], axis=1), color=RED, linewidth=width)
        mark = index if len(result.bodies) <= len(_BODY_MARKS) else 0
        drawn += axes.plot(*at, zorder=4, **_body_style(mark, body))
    return drawn


def body_places(result: Result, chosen: Sequence[int]) -> Floats:
    """Return centres of mass and lines of the shapes of the bodies at stored times: (k, n, 3) [m]."""
    places = [np.zeros((len(chosen), 0, 3))]
    for body in result.bodies.values():
        places.append(np.asarray(body.position[list(chosen)])[:, None])
        if body.wireframe is not None:
            places.append(np.stack([_wireframe(body, k).reshape(-1, 3) for k in chosen]))
    return np.concatenate(places, axis=1)


def scene_entries(result: Result) -> list[Line2D]:
    """Return entries of a legend: free nodes, threads in contact, bodies, of many only their number."""
    entries = []
    if free := len(free_nodes(result)):
        entries.append(Line2D([], [], label="free node" if free == 1 else "free nodes", **FREE_NODE))
    kinds = [kind for counts in contacts_at(result, 0).values() for kind in counts]
    if any(not kind.startswith(OF_BODY) for kind in kinds):
        entries.append(Line2D([], [], color=RED, linewidth=_HALO, alpha=0.5, label="in contact with a body"))
    names, bodies = list(result.bodies), list(result.bodies.values())
    if len(names) > len(_BODY_MARKS):
        names = [f"{len(names)} bodies"]
    entries += [Line2D([], [], label=name, **_body_style(k, bodies[k])) for k, name in enumerate(names)]
    if any(body.wireframe is None and body.attitude is not None for body in bodies):
        entries.append(_line(RED, _AXES_WIDTHS[0], "body axes: $x$ broad, $y$ thin"))
    return entries


def evenly_spaced(time: Floats, count: int) -> list[int]:
    """Return the indices of the stored times nearest to `count` even times from first to last, each once."""
    return sorted({int(np.argmin(np.abs(time - t))) for t in np.linspace(time[0], time[-1], count)})


def _legend(figure: Figure, entries: Sequence[Line2D]) -> None:
    if entries:
        legend_above(figure, entries, [str(entry.get_label()) for entry in entries])


def _line(color: str, width: float, label: str) -> Line2D:
    return Line2D([], [], color=color, linewidth=width, label=label)


def _dot(color: str, label: str) -> Line2D:
    return Line2D([], [], color=color, linestyle="", marker="o", label=label)


def _body_style(mark: int, body: BodyStates) -> dict[str, Any]:
    """Return the style of the mark of a body; on a shape it is open, so that it hides nothing."""
    style: dict[str, Any] = {"color": RED, "linestyle": "", "marker": _BODY_MARKS[mark]}
    if body.wireframe is None:
        return style | {"markersize": 5.5, "markeredgecolor": "white", "markeredgewidth": 0.4}
    return style | {"markersize": 4.0, "markerfacecolor": "none", "markeredgewidth": 0.7}


def _wireframe(body: BodyStates, k: int) -> Floats:
    """Return the lines (n, 2, 3) [m] of the shape of a body at a stored time."""
    assert body.wireframe is not None
    assert body.attitude is not None
    rotation = rotation_matrix(np.asarray(body.attitude[k]))
    return np.asarray(body.wireframe @ rotation.T + body.position[k])


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


def _draw_tethers(axes: Axes, net: Net, position: Floats, plane: Plane) -> None:
    """Draw the tethers over the net; position (n_nodes, 3) [m]."""
    if net.tethers:
        ends = net.element_nodes[net.n_net_elements :]
        _draw_lines(axes, _projected(net, position, plane)[ends], BLACK, 1.2, zorder=2.5)


def _projected(net: Net, position: Floats, plane: Plane) -> Floats:
    """Return the points (n_nodes, 2) [m] in a plane, no farther away than Matplotlib can draw."""
    return np.clip(position[:, plane], *(np.array([-1e3, 1e3]) * net_size(net)))


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
