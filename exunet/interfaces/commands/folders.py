"""The folder that a command writes into: made, proved, and taken away again if nothing is in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from exunet.base.errors import InputError
from exunet.base.files import cannot_write, sweep
from exunet.results.run_folder import new_folder


@contextmanager
def opened(wanted: Path, *, own: bool) -> Iterator[Path]:
    """The folder of a command, made if need be: `wanted`, or if it is its `own` one the next that is free.

    Folders that were made are taken away again if the command ended with nothing in them.
    """
    try:
        missing = [one for one in wanted.parents if not one.exists()]
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
        for one in (folder, *missing) if made else ():
            with suppress(OSError):  # not empty: a part of the run is kept
                one.rmdir()


def ready(folder: Path, names: Sequence[str]) -> None:
    """Prove that the files of these names can be written; what is there stays as it is."""
    try:
        sweep(folder)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise cannot_write(folder, error) from error
    for name in names:
        if (folder / name).exists() and not (folder / name).is_file():
            raise InputError(f"{folder / name}: cannot be written: it is not an ordinary file")
