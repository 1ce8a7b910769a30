"""`exunet animate`: a moving picture of a result; a file that is there is not replaced unasked."""

from __future__ import annotations

import os
import sys
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from exunet.base.errors import InputError
from exunet.base.files import sweep
from exunet.figures.animation import save_animation
from exunet.figures.movie_files import check_movie
from exunet.interfaces.commands.lines import tell
from exunet.interfaces.commands.options import as_options
from exunet.interfaces.commands.progress import SELDOM
from exunet.results.reading import load_result
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
    with as_options("from, until"), _progress(quiet=quiet) as progress:
        save_animation(result, out, fps, span.begin, span.end, progress)
    return out


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """How many pictures are drawn: a bar on a terminal, a line a minute elsewhere, nothing if quiet."""
    if quiet:
        yield lambda done, total: None
        return
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("drawing"), BarColumn(bar_width=20), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("")
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines() -> Callable[[int, int], None]:
    told = clock.monotonic()

    def line(done: int, total: int) -> None:
        nonlocal told
        if done < total and clock.monotonic() - told >= SELDOM:
            told = clock.monotonic()
            tell(f"drawn {done} of {total} pictures")

    return line
