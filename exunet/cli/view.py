"""`exunet view`: write a page that shows a result in 3-D, or two beside each other."""

from __future__ import annotations

import os
from pathlib import Path

from exunet.base.errors import InputError
from exunet.cli.output import report
from exunet.cli.run import summary_at
from exunet.plots.view import save_view, write_page
from exunet.results.io import load_result
from exunet.results.run_folder import SUMMARY, VIEW, unfinished
from exunet.results.table import report as report_of


def view(path: Path, other: Path | None, out: Path | None, *, overwrite: bool) -> Path:
    """Write the page of a result; return its path.

    Parameters
    ----------
    path, other : Path, Path or None
        The result, or its folder; a second result under the same time bar.
    out : Path or None
        File; None: `VIEW` beside the first result, which is replaced.
    overwrite : bool
        Replace a file given as `out`.

    Raises
    ------
    InputError
        For a result that cannot be read, or a file that exists or cannot be written.
    """
    if out is not None and os.path.lexists(out) and not overwrite:
        raise InputError(f"{out}: exists: choose another --out, or --overwrite")
    place = out or (path if path.is_dir() else path.parent) / VIEW
    if words := unfinished(path):
        report(words)
    result, folder = load_result(path), path if path.is_dir() else path.parent
    if other is None and (folder / SUMMARY).is_file():
        write_page(place, [result], report_of(summary_at(path), result.run.case.text))
    else:
        save_view(result, place, None if other is None else load_result(other))
    return place
