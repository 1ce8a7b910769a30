"""Pictures of the net: the reference configuration, and six snapshots (the paper's Figs. 3 and 4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.figures.bodies import body_entries, body_places, draw_bodies
from exunet.figures.dimensions import Dimension, dimensions, draw_dimension
from exunet.figures.numbers import number_nodes
from exunet.figures.page import Page, line_scale
from exunet.figures.panels import AXES, Panels, framed, grid_of
from exunet.figures.style import BLACK, BLUE, GREY, number
from exunet.figures.touching import draw_touching, touching_entries
from exunet.figures.views import FREE, View, best_view, broadness, draw_net, draw_tethers, net_size, of_border
from exunet.net.arrays import Net
from exunet.results.attached import attached_nodes
from exunet.results.measures import centre_of_mass
from exunet.results.result import Result, blocks
from exunet.results.touching import touching_threads

Floats = NDArray[np.float64]

SNAPSHOTS = (6, 4, 3, 2)  # the first number of them that can be read on the page


def reference_net(result: Result, page: Page) -> Figure | None:
    """The net in its reference configuration, with node numbers and, if it has openings, its dimensions.

    None for a scene of bodies and tethers alone, whose net has no element.
    """
    net = result.net.alone
    if not net.n_elements:
        return None
    title = f"Reference configuration: {net.n_nodes} nodes, {net.n_elements} elements"
    entries = _entries(net)
    view, shown = _with_dimensions(net, 0.0)
    panels = Panels([""], entries, above=0.0, width=120.0)
    view, shown = _with_dimensions(net, grid_of(result, page, view, panels).scale)
    figure, (axes,) = framed(result, page, view, panels, title)
    scale = line_scale(figure)
    for ax, plane in zip(axes, view.planes, strict=True):
        draw_net(ax, net, net.reference_position, plane, BLUE, 1.3 * scale)
    words = [draw_dimension(axes[0], line) for line in shown]
    number_nodes(axes[0], net, view.planes[0], shown, words)
    return figure


def _with_dimensions(net: Net, scale: float) -> tuple[View, list[Dimension]]:
    """The view, and the net's dimensions as far away as words need at a scale [inch/m]; 0: large."""
    size = net_size(net)
    point = 1.0 / (72.0 * scale) if scale else 0.0  # 1/72 inch [m]
    shown = dimensions(net, max(0.07 * size, 14.0 * point))
    height = net.reference_position[0, 2]
    arrows = [np.append(end + a.offset, height) for a in shown for end in (a.start, a.end)]
    shape = [net.reference_position, np.reshape(arrows, (-1, 3))]
    return best_view(net, shape, margin=max(0.14, 18.0 * point / size)), shown


def snapshots(result: Result, page: Page) -> Figure:
    """Up to six configurations from the first to the last time, over the reference configuration in grey.

    As many as are large enough to be read. A net whose centre of mass travels by more than half the net's
    size is drawn relative to that centre. Threads that touch bodies are marked.
    """
    net, alone = result.net, result.net.alone
    centre = centre_of_mass(result)
    travelled = max(float(np.linalg.norm(one - centre[0], axis=1).max()) for one in blocks(centre))
    follows = travelled > 0.5 * net_size(net)
    centre = centre if follows else np.zeros_like(centre)
    reference = alone.reference_position
    if follows:
        reference = reference - alone.mass @ reference / alone.mass.sum()
    free = free_nodes(result)
    entries = [*_parts(net, len(free)), *touching_entries(result), *body_entries(result)]
    names = [f"{name[:2]} - {name[1]}_c$ [m]" for name in AXES] if follows else AXES
    for count in SNAPSHOTS:
        chosen = snapshot_indices(result.time, count)
        states = [result.position[k] - centre[k] for k in chosen]
        places = body_places(result, chosen) - centre[chosen][:, None]
        view = best_view(net, [reference, states[0], places[0]], [*states, *places])
        told = [_time_and_centre(result.time[k], centre[k] if follows else None) for k in chosen]
        width = 170.0 if len(chosen) > 1 else 120.0
        panels = Panels(told, entries, 0.32 if follows else 0.2, width, names)
        if grid_of(result, page, view, panels).legible(view, panels):
            break
    figure, grid = framed(result, page, view, panels, "Snapshots")
    scale, arm = line_scale(figure), 0.12 * net_size(net)
    for k, state, panel in zip(chosen, states, grid, strict=True):
        touch = touching_threads(result, k)
        for ax, plane in zip(panel, view.planes, strict=True):
            draw_net(ax, alone, reference, plane, GREY, 0.8 * scale)
            draw_touching(ax, state[net.element_nodes[touch]][..., plane], scale * broadness(net))
            draw_net(ax, alone, state[: alone.n_nodes], plane, BLUE, scale)
            draw_tethers(ax, net, state, plane, scale)
            if len(free):
                ax.plot(*state[free][:, plane].T, **(FREE | {"markersize": scale * FREE["markersize"]}))
            draw_bodies(ax, result, k, centre[k], plane, arm, scale)
    return figure


def _time_and_centre(time: float, centre: Floats | None) -> str:
    """What stands over a snapshot: its time, and the centre (3,) [m] to which it is relative, if any."""
    text = f"$t$ = {number(time)} s"
    if centre is not None:
        text += "\n$c$ = ({}) m".format(", ".join(f"{c + 0.0:.3g}" for c in np.round(centre, 2)))
    return text.replace("-", "\N{MINUS SIGN}")


def free_nodes(result: Result) -> NDArray[np.int64]:
    """Nodes to which no thread, no bullet and no body is fixed."""
    held = [attached_nodes(result, name) for name in result.bodies]
    used = np.concatenate([result.net.element_nodes.ravel(), result.net.bullet_nodes, *held])
    return np.setdiff1d(np.arange(result.net.n_nodes), used)


def _parts(net: Net, free: int) -> list[Line2D]:
    """What snapshots show of net, tethers and `free` nodes, for the legend."""
    entries = []
    if net.n_net_elements:
        entries.append(Line2D([], [], color=BLUE, linewidth=1.2, label="net"))
    if len(net.bullet_nodes):
        entries.append(Line2D([], [], color=BLUE, linestyle="", marker="o", markersize=4, label="bullet"))
    if net.tethers:
        entries.append(Line2D([], [], color=BLACK, linewidth=1.2, label="tether"))
    if free:
        entries.append(Line2D([], [], label="free node" if free == 1 else "free nodes", **FREE))
    if net.n_net_elements:
        entries.append(Line2D([], [], color=GREY, linewidth=1.2, label="reference configuration"))
    return entries


def snapshot_indices(time: Floats, count: int) -> list[int]:
    """Indices of the stored times nearest to `count` even times from the first to the last; each once."""
    wanted = np.linspace(time[0], time[-1], count)
    return sorted({int(np.argmin(np.abs(time - t))) for t in wanted})


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
    number_style["markeredgewidth"] = 0.0  # as thin as a digit
    entries.append(Line2D([], [], label="node number, from 0", **number_style))
    return entries
