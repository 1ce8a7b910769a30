"""`exunet plot`: draws the figures of a result; those of another result are not replaced unasked."""

from __future__ import annotations

from pathlib import Path

from exunet.base.errors import InputError
from exunet.figures import FIGURES, save_figures
from exunet.interfaces.folders import opened
from exunet.interfaces.options import as_options
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.run_folder import refuse_replacing


def plot(
    path: Path, out: Path | None, kind: str, size: str | None, *, title: bool, overwrite: bool
) -> list[Path]:
    """Draw a result, with the spread beside it; the paths of the figures.

    path      : of the result, or its folder
    out       : folder; None: that of the result
    kind      : "png", "pdf" or "svg"
    size      : width and height [mm] as "90x60"; None: each figure's own
    overwrite : replace figures in a folder that is not the result's own
    Raises InputError, and writes nothing, for a result that cannot be read, a kind or a size that is not
    known, or, without `overwrite`, if another folder than that of the result has figures.
    """
    own = path if path.is_dir() else path.parent
    folder, sides = out or own, None if size is None else _sides(size)
    result = load_result(path)
    # In the folder of a run the figures show its result.h5; beside another file they may show anything.
    its_own = (path.is_dir() or path.name == RESULT_FILE) and folder.resolve() == own.resolve()
    if not (its_own or overwrite):
        refuse_replacing(folder, [f"{name}.{kind}" for name in FIGURES])
    with opened(folder, own=False), as_options("format", "size"):
        return save_figures(result, folder, format=kind, size=sides, title=title, overwrite=True)


def _sides(text: str) -> tuple[float, float]:
    """Width and height [mm] of "90x60"."""
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        raise InputError(f"--size: give width x height in millimetres, as 90x60, got {text!r}") from None
    return width, height
