"""A moving picture of a result: the net, bodies, threads that touch, time, and what is going on."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.figures.bodies import body_entries, body_places, draw_bodies
from exunet.figures.movie_files import Picture, check_movie, write_movie
from exunet.figures.nets import free_nodes, snapshot_indices
from exunet.figures.page import Page, fitted, line_scale
from exunet.figures.panels import AXES, Panels, framed
from exunet.figures.style import BLACK, GREY, SMALL, drawing
from exunet.figures.tensions import BAR, colour_bar, tension_colors
from exunet.figures.touching import draw_touching, touching_entries
from exunet.figures.views import FREE, View, best_view, broadness, net_size
from exunet.forces.contact.status import OF_BODY
from exunet.results.course import BULLETS, CONTACT, NODES, THREADS
from exunet.results.measures import centre_of_mass
from exunet.results.result import Result, row_ranges
from exunet.results.touching import contacts_at, touching_threads

Floats = NDArray[np.float64]

MOST_PICTURES = 2000  # of more stored times those nearest to as many even ones
DOTS = 150  # per inch
_ROWS = 64  # states that are looked at in one go
_WORDS = 0.2  # [inch] over a picture, of time and contact


def save_animation(
    result: Result,
    path: Path,
    fps: float,
    begin: float | None = None,
    end: float | None = None,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> int:
    """Write an MP4 or a GIF with a picture for each stored time; the number of pictures.

    path       : ends in .mp4 or .gif
    fps        : pictures a second
    begin, end : of the stored times that are shown [s]; None: the first, the last
    progress   : is told how many pictures of how many are drawn
    Raises InputError for times that are not stored, and as `exunet.figures.movie_files.write_movie`.
    """
    check_movie(path, fps)
    chosen = chosen_states(result.time, begin, end)
    with drawing():
        picture = film(result, chosen)

        def pictures(count: int) -> Picture:
            with drawing():
                made = picture(chosen[count])
            progress(count + 1, len(chosen))
            return made

        write_movie(path, map(pictures, range(len(chosen))), fps)
    return len(chosen)


def chosen_states(time: Floats, begin: float | None, end: float | None) -> list[int]:
    """The stored times from `begin` to `end` [s] that are shown. Raises InputError if there is none."""
    low = -math.inf if begin is None else begin
    high = math.inf if end is None else end
    rows = np.flatnonzero((time >= low) & (time <= high))
    if not len(rows):
        stored = f"stored are {len(time)} times from {time[0]:g} s to {time[-1]:g} s"
        raise InputError(f"from, until: no time is stored from {low:g} s to {high:g} s: {stored}")
    return [int(rows[k]) for k in snapshot_indices(time[rows], min(len(rows), MOST_PICTURES))]


def film(result: Result, chosen: list[int]) -> Callable[[int], Picture]:
    """What draws one of the chosen stored times: (height, width, 3), both even.

    A net alone that travels by more than half its size is drawn relative to its centre of mass.
    """
    net = result.net
    centre = centre_of_mass(result)
    way = np.linalg.norm(centre[chosen] - centre[chosen[0]], axis=1).max()
    follows = bool(way > 0.5 * net_size(net)) and not result.bodies
    centre = centre if follows else np.zeros_like(centre)
    names = [f"{name[:2]} - {name[1]}_c$ [m]" for name in AXES] if follows else AXES
    view = _view(result, chosen, centre)
    top = max(float(np.max(result.tension[k], initial=0.0)) for k in chosen)
    above = _WORDS + (BAR if top else 0.0)
    panels = Panels([""], _entries(result), above, 170.0, names)
    figure, (axes,) = framed(result, Page(), view, panels, "")
    figure.set_dpi(DOTS)
    canvas = FigureCanvasAgg(figure)
    shown = ScalarMappable(Normalize(0.0, top or 1.0), tension_colors())
    if top:
        colour_bar(figure, axes, shown, "tension [N]", over=_WORDS)
    wide = 72.0 * (sum(one.get_position().width for one in axes) * figure.get_figwidth())
    decimals = _decimals(result.time[chosen])
    first = min((one for one in _first_touches(result) if one >= 0.0), default=math.inf)
    canvas.draw()
    ground, standing = canvas.copy_from_bbox(figure.bbox), [set(one.get_children()) for one in axes]

    def picture(k: int) -> Picture:
        """Only what changes is drawn, over what stays."""
        canvas.restore_region(ground)
        touch = touching_threads(result, k)
        for one, plane in zip(axes, view.planes, strict=True):
            _draw_state(one, result, k, centre[k], plane, shown, touch)
        words = f"t = {result.time[k]:.{decimals}f} s{_going_on(result, k, first)}"
        _write_over(axes[0], fitted(words, wide, SMALL))
        for one, before in zip(axes, standing, strict=True):
            changing = [artist for artist in one.get_children() if artist not in before]
            for artist in sorted(changing, key=Artist.get_zorder):
                one.draw_artist(artist)
                artist.remove()
        seen = np.asarray(canvas.buffer_rgba())[..., :3]
        height, width = (side - side % 2 for side in seen.shape[:2])
        return np.ascontiguousarray(seen[:height, :width])

    return picture


def _view(result: Result, chosen: list[int], centre: Floats) -> View:
    """The view of all chosen states, whose extremes are sought some states at a time."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start, stop in row_ranges(len(chosen), _ROWS):
        rows = chosen[start:stop]
        for places in (np.stack([result.position[k] for k in rows]), body_places(result, rows)):
            seen = (places - centre[rows][:, None]).reshape(-1, 3)
            low, high = (
                np.minimum(low, seen.min(axis=0, initial=np.inf)),
                np.maximum(high, seen.max(axis=0, initial=-np.inf)),
            )
    begun = [result.position[chosen[0]], body_places(result, chosen[:1])[0]]
    return best_view(result.net, [one - centre[chosen[0]] for one in begun], [np.stack([low, high])])


def _write_over(axes: Axes, words: str) -> None:
    """Words over the left end of axes."""
    style: dict[str, Any] = {"fontsize": SMALL, "parse_math": False, "annotation_clip": False}
    axes.annotate(words, (0.0, 1.0), (0.0, 3.0), "axes fraction", textcoords="offset points", **style)


def _draw_state(
    axes: Axes,
    result: Result,
    k: int,
    origin: Floats,
    plane: tuple[int, int],
    shown: ScalarMappable,
    touch: NDArray[np.bool_],
) -> None:
    """The threads by their tensions over marks of those that `touch`, bullets, free nodes and bodies."""
    net = result.net
    figure = axes.get_figure(root=True)
    assert figure is not None
    scale = line_scale(figure)
    broad = 1.6 * scale * broadness(net)
    position = np.asarray(result.position[k]) - origin
    segments = position[net.element_nodes][..., plane]
    tension = np.asarray(result.tension[k])
    add = partial(axes.add_collection, autolim=False)
    draw_touching(axes, segments[touch], broad)
    slack, taut = tension <= 0.0, np.flatnonzero(tension > 0.0)
    if slack.any():
        add(LineCollection(list(segments[slack]), colors=GREY, linewidths=0.6 * broad, zorder=2.0))
    order = taut[np.argsort(tension[taut], kind="stable")]  # the largest on top
    if len(order):
        lines = LineCollection(list(segments[order]), cmap=shown.cmap, norm=shown.norm, zorder=2.1)
        lines.set(array=tension[order], linewidths=broad, capstyle="round")
        add(lines)
    dots = position[net.bullet_nodes][:, plane]
    axes.scatter(dots[:, 0], dots[:, 1], s=14 * scale, color=BLACK, zorder=3, linewidths=0)
    if len(free := free_nodes(result)):
        axes.plot(*position[free][:, plane].T, **(FREE | {"markersize": scale * FREE["markersize"]}))
    draw_bodies(axes, result, k, origin, plane, 0.12 * net_size(net), scale)


def _entries(result: Result) -> list[Line2D]:
    """What is shown, for the legend."""
    net = result.net
    entries = []
    if net.n_elements:
        entries.append(Line2D([], [], color=GREY, linewidth=1.0, label="slack thread"))
    entries += touching_entries(result)
    if len(net.bullet_nodes):
        entries.append(Line2D([], [], color=BLACK, linestyle="", marker="o", markersize=4, label="bullet"))
    if len(free := free_nodes(result)):
        entries.append(Line2D([], [], label="free node" if len(free) == 1 else "free nodes", **FREE))
    return [*entries, *body_entries(result)]


def _first_touches(result: Result) -> list[float]:
    """When something first touched each body [s], as stored in the end; below 0: not yet."""
    return [
        float(one.values[len(result.time) - 1][0])
        for name, one in result.states.items()
        if name.startswith(CONTACT) and name.endswith("_first")
    ]


def _going_on(result: Result, k: int, first: float) -> str:
    """What follows the time in the words over a picture: flight, contact with what, or after it."""
    counts = contacts_at(result, k)
    if not counts:
        return ""
    touched = [
        f"{_counted(one)} on {body}" for body, one in counts.items() if any(number for number in one.values())
    ]
    if touched:
        return ", contact: " + "; ".join(touched)
    return ", apart after contact" if result.time[k] >= first else ", flight, nothing touched yet"


def _counted(counts: dict[str, int]) -> str:
    words = {
        THREADS: ("element", "elements"),
        NODES: ("node", "nodes"),
        BULLETS: ("bullet", "bullets"),
    }
    told = [
        what.removeprefix(OF_BODY) if what not in words else f"{number} {words[what][number != 1]}"
        for what, number in counts.items()
        if number
    ]
    return " and ".join(told)


def _decimals(time: Floats) -> int:
    """Of times [s], to a tenth of the least step between them."""
    step = float(np.diff(time).min()) if len(time) > 1 else 1.0
    return int(np.clip(1 - math.floor(math.log10(1.0001 * step)), 0, 9))
