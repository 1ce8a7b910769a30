"""Pictures of the net: the reference configuration, and six snapshots (the paper's Figs. 3 and 4)."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from numpy.typing import NDArray

from exunet.bodies.rigid import rotation_matrix
from exunet.figures.dimensions import dimensions, draw_dimension
from exunet.figures.page import Page, line_scale
from exunet.figures.panels import AXES, framed
from exunet.figures.style import BLACK, BLUE, GREY, RED, SMALL, number
from exunet.figures.views import best_view, draw_net, net_size, of_border
from exunet.net.arrays import Net
from exunet.results.measures import centre_of_mass
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]

SNAPSHOTS = 6
MOST_LABELS = 24


def reference_net(result: Result, page: Page) -> Figure | None:
    """The net in its reference configuration, with node numbers and, if it has openings, its dimensions.

    None for a scene of bodies and tethers alone, whose net has no element.
    """
    net = result.net.alone
    if not net.n_elements:
        return None
    shown = dimensions(net)
    arrows = [
        np.append(end + a.offset, net.reference_position[0, 2]) for a in shown for end in (a.start, a.end)
    ]
    view = best_view(net, [net.reference_position, *np.reshape(arrows, (-1, 1, 3))], margin=0.14)
    title = f"Reference configuration: {net.n_nodes} nodes, {net.n_elements} elements"
    entries = _entries(net)
    figure, (axes,) = framed(result, page, view, 1, title, entries, 0.0, 120.0)
    scale = line_scale(figure)
    for ax, plane in zip(axes, view.planes, strict=True):
        draw_net(ax, net, net.reference_position, plane, BLUE, 1.3 * scale)
    words = [draw_dimension(axes[0], line) for line in shown]
    _number_nodes(axes[0], net, view.planes[0], words)
    return figure


def snapshots(result: Result, page: Page) -> Figure:
    """Up to six configurations from the first to the last time, over the reference configuration in grey.

    A net whose centre of mass travels by more than half the net's size is drawn relative to that centre.
    """
    net, alone = result.net, result.net.alone
    chosen = snapshot_indices(result.time, SNAPSHOTS)
    centre = centre_of_mass(result)
    follows = bool(np.linalg.norm(centre - centre[0], axis=1).max() > 0.5 * net_size(net))
    reference = alone.reference_position
    states = [result.position[k] for k in chosen]
    if follows:
        reference = reference - alone.mass @ reference / alone.mass.sum()
        states = [state - centre[k] for state, k in zip(states, chosen, strict=True)]
    moved = centre[chosen] if follows else np.zeros((len(chosen), 3))
    view = best_view(net, [reference, *states, *(_places(result, chosen) - moved[:, None])])
    entries = [Line2D([], [], color=BLUE, linewidth=1.2, label="net")]
    if net.tethers:
        entries.append(Line2D([], [], color=BLUE, linewidth=2.4, label="tether"))
    if alone.n_elements:
        entries.append(Line2D([], [], color=GREY, linewidth=1.2, label="reference configuration"))
    if result.bodies:
        style: dict[str, Any] = {"linewidth": 1.2, "marker": "D", "markersize": 3.5}
        label = "bodies" if len(result.bodies) > 1 else next(iter(result.bodies))
        entries.append(Line2D([], [], color=RED, label=label, **style))
    names = [f"{name[:-1]} - {name[1]}_c$" for name in AXES] if follows else AXES
    count = len(chosen)
    figure, grid = framed(
        result,
        page,
        view,
        count,
        "Snapshots",
        entries,
        0.32 if follows else 0.2,
        170.0 if count > 1 else 120.0,
        names,
    )
    scale, told = line_scale(figure), _plane_of_names(result, chosen, view.planes)
    for k, state, panel in zip(chosen, states, grid, strict=True):
        for ax, plane in zip(panel, view.planes, strict=True):
            draw_net(ax, alone, reference, plane, GREY, 0.8 * scale)
            draw_net(ax, net, state, plane, BLUE, scale)
            named = len(result.bodies) > 1 and plane == told
            _draw_bodies(ax, result, k, centre[k] if follows else np.zeros(3), plane, named)
        text = f"$t$ = {number(result.time[k])} s"
        if follows:
            text += "\n$c$ = ({}) m".format(", ".join(f"{c + 0.0:.3g}" for c in np.round(centre[k], 2)))
        panel[0].set_title(text.replace("-", "\N{MINUS SIGN}"), loc="left", fontsize=SMALL, pad=3)
    return figure


def _plane_of_names(
    result: Result, chosen: list[int], planes: tuple[tuple[int, int], ...]
) -> tuple[int, int]:
    """The plane in which the bodies are seen farthest apart, at the worst of the chosen stored times."""
    places = [np.asarray(body.position[chosen]) for body in result.bodies.values()]
    apart = np.array([one - other for one, other in combinations(places, 2)] or [np.zeros((1, 3))])

    def least(plane: tuple[int, int]) -> float:
        return float(np.linalg.norm(apart[..., list(plane)], axis=-1).min())

    return max(planes, key=least)


def _places(result: Result, chosen: list[int]) -> Floats:
    """(k, n, 3) [m] of the bodies' centres of mass and the lines of their shapes, at chosen stored times."""
    places = [np.zeros((len(chosen), 0, 3))]
    for body in result.bodies.values():
        places.append(np.asarray(body.position[chosen])[:, None])
        if body.wireframe is not None:
            places.append(np.stack([_lines(body, k).reshape(-1, 3) for k in chosen]))
    return np.concatenate(places, axis=1)


def _lines(body: BodyStates, k: int) -> Floats:
    """(n, 2, 3) [m] of its shape at a stored time."""
    assert body.wireframe is not None
    assert body.attitude is not None
    turn = rotation_matrix(np.asarray(body.attitude[k]))
    return np.asarray(body.wireframe @ turn.T + body.position[k])


def _draw_bodies(
    axes: Axes, result: Result, k: int, origin: Floats, plane: tuple[int, int], named: bool
) -> None:
    """A mark of each body, its name if wanted, and its shape; of rigid ones without one their x and y axes.

    The y axis is thin.
    """
    reach = 0.12 * net_size(result.net)
    for body in result.bodies.values():
        at = (body.position[k] - origin)[list(plane)]
        if body.wireframe is not None:
            lines = (_lines(body, k) - origin)[..., list(plane)]
            axes.add_collection(LineCollection(list(lines), colors=RED, linewidths=0.6))
        elif body.attitude is not None:
            arms = reach * rotation_matrix(np.asarray(body.attitude[k]))[list(plane)]
            for axis, width in ((0, 2.2), (1, 1.0)):
                axes.plot(*np.stack([at, at + arms[:, axis]], axis=1), color=RED, linewidth=width)
        axes.plot(*at, marker="D", markersize=3.5, color=RED)
    if named:
        _name_bodies(
            axes, {name: body.position[k] - origin for name, body in result.bodies.items()}, plane, reach
        )


def _name_bodies(axes: Axes, places: dict[str, Floats], plane: tuple[int, int], reach: float) -> None:
    """Names below the marks; bodies that are seen nearly at one place share a line of names."""
    groups: list[tuple[Floats, list[str]]] = []
    for name, place in places.items():
        at = place[list(plane)]
        near = [names for where, names in groups if np.linalg.norm(at - where) < reach]
        if near:
            near[0].append(name)
        else:
            groups.append((at, [name]))
    offset: dict[str, Any] = {"xytext": (0, -11), "textcoords": "offset points", "ha": "center"}
    for at, names in groups:
        axes.annotate(
            ", ".join(names), (at[0], at[1]), fontsize=SMALL, color=RED, annotation_clip=True, **offset
        )


def snapshot_indices(time: Floats, count: int) -> list[int]:
    """Indices of the stored times nearest to `count` even times from the first to the last; each once."""
    wanted = np.linspace(time[0], time[-1], count)
    return sorted({int(np.argmin(np.abs(time - t))) for t in wanted})


def _number_nodes(axes: Axes, net: Net, plane: tuple[int, int], words: list[Annotation]) -> None:
    """Numbers at the bullets and corners, clear of the cables; at all nodes of small nets without any.

    A corner whose number would touch another one, or one of the `words` that are there, goes without.
    """
    from matplotlib.patheffects import withStroke

    labelled = list(dict.fromkeys([*net.bullet_nodes.tolist(), *net.mouth]))
    if not labelled and net.n_nodes <= MOST_LABELS:
        labelled = list(range(net.n_nodes))
    points = net.reference_position[:, plane]
    bullets = set(net.bullet_nodes.tolist())
    figure = axes.get_figure(root=True)
    assert figure is not None
    to_points = 72.0 / figure.dpi
    placed = [one for text in words for one in _characters(text, to_points)]
    for node in labelled[:: max(1, -(-len(labelled) // MOST_LABELS))]:
        size = len(str(node))
        at = axes.transData.transform(points[node]) * to_points
        spots = [(8 + 2.5 * size) * away for away in _free_directions(net, points, node)]
        spot = next((one for one in spots if not _covers(at + one, size, placed)), None)
        if spot is None:
            if node not in bullets:
                continue
            spot = spots[0]
        placed.append((at + spot, size))
        axes.annotate(
            str(node),
            points[node],
            xytext=tuple(spot),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=SMALL,
            fontweight="bold" if node in bullets else "normal",
            color=BLACK,
            path_effects=[withStroke(linewidth=2, foreground="white")],
            zorder=5,
        )


def _characters(text: Annotation, to_points: float) -> list[tuple[Floats, int]]:
    """Places, in points of 1/72 inch, that words of a length and a unit cover, as of single digits."""
    box = text.get_window_extent()
    corners = to_points * np.array([[box.x0, box.y0], [box.x1, box.y1]])
    if box.height > box.width or text.get_rotation() % 180 > 90:
        corners[:, 0] = corners[::-1, 0]
    inset = np.clip(to_points * min(box.width, box.height) / 2, 3.0, 6.0) * np.sign(corners[1] - corners[0])
    first, last = corners[0] + inset, corners[1] - inset
    return [(first + part * (last - first), 1) for part in np.linspace(0.0, 1.0, 8)]


def _covers(at: Floats, digits: int, placed: list[tuple[Floats, int]]) -> bool:
    """True if a number there, in points of 1/72 inch, would touch one that is placed."""
    return any(
        abs(at[0] - other[0]) < 3.0 * (digits + count) + 2.0 and abs(at[1] - other[1]) < 11.0
        for other, count in placed
    )


def _free_directions(net: Net, points: Floats, node: int) -> Floats:
    """Unit vectors (k, 2) from a node into gaps of 60 degrees or more between elements, innermost first."""
    ends = net.element_nodes
    others = np.concatenate([ends[ends[:, 0] == node, 1], ends[ends[:, 1] == node, 0]])
    arms = points[others] - points[node]
    angles = np.sort(np.arctan2(arms[:, 1], arms[:, 0]))
    if len(angles) == 0:
        return np.array([[0.0, 1.0]])
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    middles = angles + gaps / 2
    directions = np.column_stack([np.cos(middles), np.sin(middles)])
    inwards = directions @ (points.mean(axis=0) - points[node])
    wide = gaps >= min(np.radians(59), gaps.max())
    return np.asarray(directions[wide][np.argsort(-inwards[wide], kind="stable")])


def _entries(net: Net) -> list[Line2D]:
    """What the picture of the reference configuration shows, for its legend."""
    entries = [Line2D([], [], color=BLUE, linewidth=1.2, label="cable")]
    if of_border(net).any():
        entries.append(Line2D([], [], color=BLUE, linewidth=2.0, label="border"))
    if net.is_string.any():
        entries.append(Line2D([], [], color=BLUE, linewidth=2.6, label="corner string"))
    if len(net.bullet_nodes):
        entries.append(Line2D([], [], color=BLUE, linestyle="", marker="o", markersize=5, label="bullet"))
    number_style: dict[str, Any] = {"linestyle": "", "marker": "$0$", "color": BLACK, "markersize": 5}
    entries.append(Line2D([], [], label="node number, from 0", **number_style))
    return entries
