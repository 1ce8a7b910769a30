"""An earlier result is set aside while a run takes its place, and comes back if that run leaves none."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from exunet.base.files import cannot_write
from exunet.results.reading import RESULT_FILE, STORE_FOLDER

FIGURES = ("reference_net", "snapshots", "bullet_speeds", "energies", "area", "rotation", "agreement")
FILES = (RESULT_FILE, "summary.json", *(f"{figure}.png" for figure in FIGURES))
EARLIER = "earlier"  # in the folder of the unfinished run: a process that dies leaves it there


def set_aside(folder: Path) -> None:
    """Move an earlier result with its summary and figures away, so that it is not taken for the new one."""
    aside = folder / STORE_FOLDER / EARLIER
    try:
        for name in FILES:
            if (folder / name).exists():
                aside.mkdir(parents=True, exist_ok=True)
                os.replace(folder / name, aside / name)
    except OSError as error:
        raise cannot_write(aside, error) from error


@contextmanager
def giving_back(folder: Path) -> Iterator[None]:
    """What was set aside comes back if the block leaves no result in its place, else it is removed."""
    try:
        yield
    finally:
        aside = folder / STORE_FOLDER / EARLIER
        replaced = (folder / RESULT_FILE).exists()
        for name in FILES if aside.is_dir() else ():
            with suppress(OSError):  # there is no such file
                (aside / name).unlink() if replaced else os.replace(aside / name, folder / name)
        for left in (aside, aside.parent):
            with suppress(OSError):  # absent, or not empty
                left.rmdir()
