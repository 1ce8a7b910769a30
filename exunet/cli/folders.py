"""Folders of the commands: named after the case, made, checked, and removed again if nothing is in them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from exunet.base.errors import InputError
from exunet.base.files import cannot_write, sweep
from exunet.results.run_folder import new_folder
from exunet.scene.casefile import Case

RESULTS = Path("results")
_VALUE = 24  # characters of a value
_NAME = 150  # bytes of a name; file systems take 255, of which numbers and temporary names need some
_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")


def folder_of(case: Case, *more: str) -> Path:
    """Return results/CASE--net.size=2--solver.method=RK44, from the case and its overrides.

    more : further parts of the name, for what is not a run
    """
    name = "--".join([case.name, *map(_short, case.overrides), *more])
    code = name.encode("utf-8", "surrogateescape")
    if len(code) > _NAME:
        kept = code[:_NAME].decode("utf-8", "ignore")
        name = f"{kept}-{_hash(case.name, *case.overrides, *more)}"
    return RESULTS / name


def _short(override: str) -> str:
    """Return a key with its value; a value that is long or has special characters ends in a hash."""
    key, _, value = (part.strip() for part in override.partition("="))
    plain = value.strip("\"'")
    safe = _UNSAFE.sub("_", plain)
    if safe != plain or len(safe) > _VALUE:
        safe = f"{safe[:_VALUE]}-{_hash(value)}"
    return f"{_UNSAFE.sub('_', key)}={safe}"


def _hash(*text: str) -> str:
    return hashlib.sha256("\n".join(text).encode("utf-8", "surrogateescape")).hexdigest()[:8]


@contextmanager
def opened(wanted: Path, *, own: bool) -> Iterator[Path]:
    """Make the folder of a command: `wanted`, or if it is its `own` default the next that is free.

    New folders that are empty at the end of the block are removed.
    """
    try:
        missing = [parent for parent in wanted.parents if not parent.exists()]
        folder, made = wanted, own or not wanted.exists()
        if own:
            folder = new_folder(wanted)
        else:
            folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise cannot_write(wanted, error) from error
    try:
        yield folder
    finally:
        for empty in (folder, *missing) if made else ():
            with suppress(OSError):  # not empty: a part of the run is kept
                empty.rmdir()


def ready(folder: Path, names: Sequence[str]) -> None:
    """Raise InputError if files of these names cannot be written; existing files stay."""
    try:
        sweep(folder)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise cannot_write(folder, error) from error
    for name in names:
        if (folder / name).exists() and not (folder / name).is_file():
            raise InputError(f"{folder / name}: cannot be written: it is not an ordinary file")
