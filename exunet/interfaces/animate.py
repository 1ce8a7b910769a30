"""`exunet animate`: a moving picture of a result; a file that is there is not replaced unasked."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from exunet.base.errors import InputError
from exunet.base.files import sweep
from exunet.figures.animation import save_animation
from exunet.figures.movie_files import check_movie
from exunet.interfaces.options import as_options
from exunet.interfaces.output import ProgressBar, Update
from exunet.results.io import load_result
from exunet.results.run_folder import ANIMATION


class Span(NamedTuple):
    """From when until when [s]; None: from the first, until the last stored time."""

    begin: float | None = None
    end: float | None = None


def animate(path: Path, out: Path | None, fps: float, span: Span, *, overwrite: bool, quiet: bool) -> Path:
    """Write it and return its path.

    path      : of the result, or its folder
    out       : file, .gif or .mp4; None: `ANIMATION` beside the result
    fps       : pictures a second
    overwrite : replace a file of that name
    Raises InputError, and writes nothing, for a result that cannot be read, a name, a rate or times that
    cannot be, or if there is such a file and it is not to be replaced; MissingExtra for an MP4 without
    ffmpeg.
    """
    if out is None:
        out = (path if path.is_dir() else path.parent) / ANIMATION
    with as_options("fps"):
        check_movie(out, fps)
    if os.path.lexists(out) and not overwrite:
        raise InputError(f"{out}: there is a file of that name: give another --out, or --overwrite")
    result = load_result(path)
    if out.parent.is_dir():
        sweep(out.parent)
    with as_options("from, until"), ProgressBar(quiet=quiet) as bar:
        begun: list[Update] = []

        def update(done: int, total: int) -> None:
            if not begun:
                begun.append(bar.begin("drawn", total, "pictures"))
            begun[0](done)

        save_animation(result, out, fps, span.begin, span.end, update)
    return out
