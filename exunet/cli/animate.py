"""`exunet animate`: write an animation of a result."""

from __future__ import annotations

import os
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.files import sweep
from exunet.cli.output import ProgressBar, Update, as_options, report
from exunet.plots.animation import check_animation, has_ffmpeg, save_animation
from exunet.results.io import load_result
from exunet.results.run_folder import ANIMATIONS, unfinished


def animate(
    path: Path,
    out: Path | None,
    fps: float,
    begin: float | None,
    end: float | None,
    *,
    overwrite: bool,
    quiet: bool,
) -> Path:
    """Write an animation of a result; return its path.

    Parameters
    ----------
    path : Path
        The result, or its folder.
    out : Path or None
        File, .gif or .mp4; None: the first of `ANIMATIONS` beside the result, the second without ffmpeg.
    fps : float
        Frames per second.
    begin, end : float or None
        Interval of stored times [s]; None: from the first, to the last.
    overwrite : bool
        Replace a file of that name.
    quiet : bool
        Without a progress bar.

    Raises
    ------
    InputError
        For a result that cannot be read, a name, a rate or times out of range, or a file that exists.
    MissingExtra
        For an MP4 without ffmpeg.
    """
    if out is None:
        out = (path if path.is_dir() else path.parent) / ANIMATIONS[0 if has_ffmpeg() else 1]
    with as_options("fps"):
        check_animation(out, fps)
    if os.path.lexists(out) and not overwrite:
        raise InputError(f"{out}: exists: choose another --out, or --overwrite")
    if words := unfinished(path):
        report(words)
    result = load_result(path)
    if out.parent.is_dir():
        sweep(out.parent)
    with as_options("from, until"), ProgressBar(quiet=quiet) as bar:
        started: list[Update] = []

        def update(done: int, total: int) -> None:
            if not started:
                started.append(bar.begin("drawn", total, "frames"))
            started[0](done)

        save_animation(result, out, fps, begin, end, update)
    return out
