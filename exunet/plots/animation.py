"""Animation of a result: the net coloured by tension, bodies, threads in contact, time."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import cast

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import replacing
from exunet.plots.nets import (
    COORDINATES,
    RELATIVE,
    Plane,
    View,
    best_view,
    body_places,
    draw_bodies,
    draw_free_nodes,
    draw_touching,
    evenly_spaced,
    framed,
    line_width,
    net_size,
    scene_entries,
)
from exunet.plots.page import Source, legend_above
from exunet.plots.style import BLACK, SMALL, drawing
from exunet.plots.tensions import draw_tensions, tension_colors
from exunet.results.measures import centre_of_mass
from exunet.results.result import Result, row_ranges
from exunet.results.touching import contact_places, contacts_at

Floats = NDArray[np.float64]

MAX_FPS = {".gif": 50.0, ".mp4": 120.0}  # [1/s]; players slow a faster GIF down to ten
MAX_FRAMES = {".gif": 300, ".mp4": 2000}  # Pillow keeps all frames of a GIF in memory, 2 MB each
_DPI = 120
_ROWS = 64  # states that are read at a time


def save_animation(
    result: Result,
    path: Path,
    fps: float,
    begin: float | None = None,
    end: float | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write an animation with a frame for each stored time.

    Parameters
    ----------
    result : Result
        The run.
    path : Path
        Ends in .mp4 or .gif. The file appears when it is complete.
    fps : float
        Frames per second.
    begin, end : float, optional
        Stored times that are shown [s]; default: the first, the last.
    progress : callable, optional
        Called after each frame with the number of frames drawn, and of all.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    InputError
        For another ending, a rate out of range, no stored time in the interval, or a file that cannot be
        written.
    MissingExtra
        For an MP4 without ffmpeg.
    """
    check_animation(path, fps)
    kind = path.suffix.lower()
    chosen = stored_times(result.time, begin, end, MAX_FRAMES[kind])
    with drawing(), replacing(path) as part:
        writer = _writer(kind, fps)
        frame = _Frame(result, chosen)
        target = part.with_suffix(kind)  # from which the writers take the format
        try:
            with writer.saving(frame.figure, str(target), _DPI):
                for count, k in enumerate(chosen):
                    frame.draw(k)
                    writer.grab_frame()
                    progress(count + 1, len(chosen))
            target.replace(part)
        except subprocess.CalledProcessError as error:
            raise InputError(f"{path}: ffmpeg failed: {' '.join((error.stderr or '').split())}") from error
        finally:
            target.unlink(missing_ok=True)
    return len(chosen)


def check_animation(path: Path, fps: float) -> None:
    """Raise InputError or MissingExtra for a name, a rate or a format that cannot be written."""
    kind = path.suffix.lower()
    if kind not in MAX_FPS:
        raise InputError(f"{path}: the name must end in {' or '.join(MAX_FPS)}")
    if not 0.0 < fps <= MAX_FPS[kind]:
        raise InputError(f"fps: must be above 0 and at most {MAX_FPS[kind]:g} for {kind}, got {fps:g}")
    if kind == ".mp4":
        _ffmpeg()


def stored_times(time: Floats, begin: float | None, end: float | None, count: int) -> list[int]:
    """Return the indices of stored times from `begin` to `end` [s]; of more than `count`, even ones."""
    low = -math.inf if begin is None else begin
    high = math.inf if end is None else end
    rows = np.flatnonzero((time >= low) & (time <= high))
    if not len(rows):
        stored = f"{len(time)} times from {time[0]:g} s to {time[-1]:g} s"
        raise InputError(f"from, until: no stored time from {low:g} s to {high:g} s (stored: {stored})")
    return [int(rows[k]) for k in evenly_spaced(time[rows], min(len(rows), count))]


class _Frame:
    """The figure of an animation, and what changes in it.

    A net without bodies that travels by more than half its size is drawn relative to its centre of mass.
    """

    def __init__(self, result: Result, chosen: list[int]) -> None:
        self._result, net = result, result.net
        centre = centre_of_mass(result)
        travelled = np.linalg.norm(centre[chosen] - centre[chosen[0]], axis=1).max()
        follows = bool(travelled > 0.5 * net_size(net)) and not result.bodies
        self._centre = centre if follows else np.zeros_like(centre)
        self._view = _view_of(result, chosen, self._centre)
        source = Source(result)
        names = RELATIVE if follows else COORDINATES
        self.figure, (self._axes,) = framed(source, self._view, 1, names, beside=20.0)
        top = max(float(np.max(result.tension[k], initial=0.0)) for k in chosen)
        self._shown = ScalarMappable(Normalize(0.0, top or 1.0), tension_colors())
        if top:
            self.figure.colorbar(self._shown, ax=self._axes, label="tension [N]", pad=0.02, aspect=30)
        entries = scene_entries(result)
        if len(net.bullet_nodes):
            entries.append(Line2D([], [], color=BLACK, linestyle="", marker="o", label="bullet"))
        legend_above(self.figure, entries, [str(entry.get_label()) for entry in entries])
        step = float(np.diff(result.time[chosen]).min()) if len(chosen) > 1 else 1.0
        self._decimals = int(np.clip(1 - math.floor(math.log10(1.0001 * step)), 0, 9))
        self._axes[0].set_title(" ", loc="left", fontsize=SMALL, pad=3)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # all frames have the layout of the first
        self._drawn: list[Artist] = []

    def draw(self, k: int) -> None:
        """Show a stored time."""
        result = self._result
        for artist in self._drawn:
            artist.remove()
        touching = ~np.isnan(contact_places(result, [k])[0])
        self._drawn = []
        for axes, plane in zip(self._axes, self._view.planes, strict=True):
            self._draw_state(axes, plane, k, touching)
        bodies = [body for body, counts in contacts_at(result, k).items() if any(counts.values())]
        contact = f", contact with {', '.join(bodies)}" if bodies else ""
        title = f"t = {result.time[k]:.{self._decimals}f} s{contact}"
        self._axes[0].set_title(title, loc="left", fontsize=SMALL, pad=3, parse_math=False)

    def _draw_state(self, axes: Axes, plane: Plane, k: int, touching: NDArray[np.bool_]) -> None:
        result, net, origin = self._result, self._result.net, self._centre[k]
        position = np.asarray(result.position[k]) - origin
        segments = position[net.element_nodes][..., plane]
        width = 1.6 * line_width(net)
        widths = np.full(net.n_elements, width)
        dots = position[net.bullet_nodes][:, plane]
        self._drawn += [
            *draw_touching(axes, segments[touching], width),
            *draw_tensions(axes, segments, np.asarray(result.tension[k]), self._shown, widths),
            axes.scatter(dots[:, 0], dots[:, 1], s=14, color=BLACK, zorder=3, linewidths=0),
            *draw_free_nodes(axes, result, position, plane),
            *draw_bodies(axes, result, k, origin, plane),
        ]


def _view_of(result: Result, chosen: list[int], centre: Floats) -> View:
    """Return the view of all chosen states, which are read some at a time."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start, stop in row_ranges(len(chosen), _ROWS):
        rows = chosen[start:stop]
        for places in (np.stack([result.position[k] for k in rows]), body_places(result, rows)):
            relative = (places - centre[rows][:, None]).reshape(-1, 3)
            low = np.minimum(low, relative.min(axis=0, initial=np.inf))
            high = np.maximum(high, relative.max(axis=0, initial=-np.inf))
    first = [result.position[chosen[0]], body_places(result, chosen[:1])[0]]
    return best_view(result.net, [points - centre[chosen[0]] for points in first], [np.stack([low, high])])


def _writer(kind: str, fps: float) -> AbstractMovieWriter:
    if kind == ".gif":
        return PillowWriter(fps=cast(int, fps))
    matplotlib.rcParams["animation.ffmpeg_path"] = _ffmpeg()
    return FFMpegWriter(
        fps=cast(int, fps), codec="h264", extra_args=["-crf", "18", "-movflags", "+faststart"]
    )


def _ffmpeg() -> str:
    """Return the path of ffmpeg: on the PATH, or of the extra."""
    if (program := shutil.which("ffmpeg")) is not None:
        return program
    if find_spec("imageio_ffmpeg") is None:
        raise MissingExtra("MP4 requires ffmpeg: pip install 'exunet[movie]', or write a .gif")
    import imageio_ffmpeg

    return str(imageio_ffmpeg.get_ffmpeg_exe())
