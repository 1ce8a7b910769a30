"""Files that are either whole or absent, whatever happens to the process that writes them."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from exunet.base.arguments import shown
from exunet.base.errors import InputError


def path_of(given: object, what: str, needed: str = "the name of a file") -> Path:
    """A path that a script gave; InputError, which begins with `what`, if it is none."""
    if not isinstance(given, str | os.PathLike):
        raise InputError(f"{what}: needs {needed}, got {shown(given)}")
    return Path(os.fsdecode(given))


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A new, empty file beside `path` to write to; it takes the place of `path` when the block ends.

    The data reach the disk before the name does, so that a reader sees the old file or the whole new one.
    A block that raises leaves `path` as it was. Raises InputError if `path` cannot be written (its folder is
    missing or read-only, it is a folder or a device, the disk is full).
    """
    try:
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: cannot be written: it is not an ordinary file")
        part = target.with_name(f".exunet-{os.getpid()}-{secrets.token_hex(4)}.part")
        part.open("xb").close()
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from error
    try:
        yield part
        _flush(part)
        os.replace(part, target)
        _flush(target.parent)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def sweep(folder: Path) -> None:
    """Remove what `replacing` left unfinished in a folder when its process was killed on this machine."""
    for part in folder.glob(".exunet-*.part"):
        with suppress(ValueError, OSError):
            if not _alive(int(part.name.split("-")[1])):
                part.unlink()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it exists and is another user's
        return True
    return True


def cannot_write(path: str | Path, error: Exception) -> InputError:
    """The error for a file that the system refuses to write: one line with the system's reason."""
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    if isinstance(error, FileExistsError):
        reason = "there is a file of that name, where a folder is needed"
    elif isinstance(error, NotADirectoryError):
        reason = "a part of this path is a file, and no folder"
    return InputError(f"{path}: cannot be written: {reason}")


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with suppress(OSError):  # some file systems refuse to synchronise a folder
            os.fsync(descriptor)
    finally:
        os.close(descriptor)
