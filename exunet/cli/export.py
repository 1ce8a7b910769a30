"""`exunet export`: write a result for other programs."""

from __future__ import annotations

import os
from pathlib import Path

from exunet.base.errors import InputError
from exunet.cli.output import report
from exunet.results.export import export
from exunet.results.io import RESULT_FILE, load_result
from exunet.results.run_folder import EXPORTS, unfinished


def export_result(path: Path, kind: str, out: Path | None, *, overwrite: bool) -> Path:
    """Write a result as VTKHDF or CSV; return the path of the file.

    Parameters
    ----------
    path : Path
        The result, or its folder.
    kind : str
        One of `EXPORTS`.
    out : Path or None
        File; None: beside the result.
    overwrite : bool
        Replace a file of that name.

    Raises
    ------
    InputError
        For a result that cannot be read, another kind, or a file that exists or cannot be written.
    """
    if kind not in EXPORTS:
        raise InputError(f"--to: must be one of {', '.join(EXPORTS)}, got {kind!r}")
    file = path / RESULT_FILE if path.is_dir() else path
    out = file.parent / EXPORTS[kind] if out is None else out
    if out.suffix != f".{kind}":
        raise InputError(f"--out: must end in .{kind}, got {out}")
    if os.path.lexists(out) and not overwrite:
        raise InputError(f"{out}: exists: choose another --out, or --overwrite")
    if words := unfinished(path):
        report(words)
    export(load_result(path), out)
    return out
