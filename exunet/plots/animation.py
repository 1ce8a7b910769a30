"""Animation of a result: a 3-D view with threads coloured by tension, and the time."""

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
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, PowerNorm, to_rgba
from matplotlib.lines import Line2D

from exunet.base.arrays import Floats
from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import replacing
from exunet.base.times import reached
from exunet.plots.nets import evenly_spaced, line_width
from exunet.plots.scene_3d import draw, draw_scale, entries, prepare, scene_3d
from exunet.plots.style import SMALL, Source, drawing, legend_above, new_figure
from exunet.results.penetration import contacts_at
from exunet.results.result import Result

MIN_FPS = 0.01  # [1/s]; formats count the time of a frame up to some minutes
MAX_FPS = {".gif": 50.0, ".mp4": 120.0}  # [1/s]; players slow a faster GIF down to ten
FRAMES = 300
_DPI = 120
_VIEWED = 40  # states from which the view is chosen
_SLACK = "0.72"
# The scale of the page on white: its lightness falls all the way, so that it can be read in grey.
_STOPS = ("#8fb3dd", "#5e8fc7", "#8a5aa8", "#b5294e", "#4d0a17")
_COLORS = LinearSegmentedColormap.from_list("tensions", _STOPS)


def save_animation(
    result: Result,
    path: Path,
    fps: float,
    begin: float | None = None,
    end: float | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write an animation with a frame for each stored time; of more than 300, 300 even ones.

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
    chosen = stored_times(result.time, begin, end, FRAMES)
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
    if not MIN_FPS <= fps <= MAX_FPS[kind]:
        raise InputError(f"fps: must be from {MIN_FPS:g} to {MAX_FPS[kind]:g} for {kind}, got {fps:g}")
    if kind == ".mp4":
        _ffmpeg()


def stored_times(time: Floats, begin: float | None, end: float | None, count: int) -> list[int]:
    """Return the indices of stored times from `begin` to `end` [s]; of more than `count`, even ones."""
    low = -math.inf if begin is None else begin
    high = math.inf if end is None else end
    rows = [k for k, shown in enumerate(time.tolist()) if reached(shown, low) and reached(high, shown)]
    if not rows:
        stored = f"{len(time)} times from {time[0]:g} s to {time[-1]:g} s"
        raise InputError(f"from, until: no stored time from {low:g} s to {high:g} s (stored: {stored})")
    return [rows[k] for k in evenly_spaced(time[rows], min(len(rows), count))]


class _Frame:
    """The figure of an animation, and what changes in it."""

    def __init__(self, result: Result, chosen: list[int]) -> None:
        self._result = result
        sample = [chosen[k] for k in evenly_spaced(result.time[chosen], min(len(chosen), _VIEWED))]
        self._scene = scene_3d(result, sample)
        (x, y), width = self._scene.camera.half, 170.0
        self.figure = new_figure(Source(result), min(150.0, 12.0 + (width - 25.0) * y / x), "compressed")
        self._axes = self.figure.subplots()
        prepare(self._axes, self._scene)
        top = max(float(np.max(result.tension[k], initial=0.0)) for k in chosen)
        self._shown = ScalarMappable(PowerNorm(0.5, 0.0, top or 1.0), _COLORS)
        if top:
            self.figure.colorbar(self._shown, ax=self._axes, label="tension [N]", pad=0.02, aspect=30)
        shown = [Line2D([], [], color=_SLACK, linewidth=0.8, label="slack"), *entries(self._scene, None)]
        legend_above(self.figure, shown, [str(entry.get_label()) for entry in shown])
        draw_scale(self._axes, self._scene.camera)
        step = float(np.diff(result.time[chosen]).min()) if len(chosen) > 1 else 1.0
        self._decimals = int(np.clip(1 - math.floor(math.log10(1.0001 * step)), 0, 9))
        self._axes.set_title(" ", loc="left", fontsize=SMALL, pad=3)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # all frames have the layout of the first
        self._drawn: list[Artist] = []

    def draw(self, k: int) -> None:
        """Show a stored time."""
        result = self._result
        for artist in self._drawn:
            artist.remove()
        tension = np.asarray(result.tension[k])
        colors = np.where(tension[:, None] > 0.0, self._shown.to_rgba(tension), to_rgba(_SLACK))
        self._drawn = draw(self._axes, self._scene, k, colors, 1.6 * line_width(result.net))
        bodies = [body for body, counts in contacts_at(result, k).items() if any(counts.values())]
        contact = f", contact with {', '.join(bodies)}" if bodies else ""
        title = f"t = {result.time[k]:.{self._decimals}f} s{contact}"
        self._axes.set_title(title, loc="left", fontsize=SMALL, pad=3, parse_math=False)


def _writer(kind: str, fps: float) -> AbstractMovieWriter:
    if kind == ".gif":
        return PillowWriter(fps=cast(int, fps))
    matplotlib.rcParams["animation.ffmpeg_path"] = _ffmpeg()
    return FFMpegWriter(
        fps=cast(int, fps), codec="h264", extra_args=["-crf", "18", "-movflags", "+faststart"]
    )


def has_ffmpeg() -> bool:
    """True if MP4 can be written: ffmpeg is on the PATH, or the extra is installed."""
    return shutil.which("ffmpeg") is not None or find_spec("imageio_ffmpeg") is not None


def _ffmpeg() -> str:
    """Return the path of ffmpeg: on the PATH, or of the extra."""
    if not has_ffmpeg():
        raise MissingExtra("MP4 requires ffmpeg: pip install 'exunet[movie]', or write a .gif")
    if (program := shutil.which("ffmpeg")) is not None:
        return program
    import imageio_ffmpeg

    return str(imageio_ffmpeg.get_ffmpeg_exe())
