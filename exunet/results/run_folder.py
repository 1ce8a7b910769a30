"""The folder of a run: what is in it, who may write there, and what takes the place of what.

A run stores its states in "unfinished.sqlite" (see `exunet.results.store`). A result that the folder already
has stays as it is, bit for bit, until the new one is complete: until then what the new run leaves is put into
the folder ".exunet-replacement", and from there into its place.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from shlex import quote

from exunet.base.errors import InputError
from exunet.base.files import cannot_write
from exunet.results.io import ENSEMBLE_FILE, RESULT_FILE
from exunet.results.store import STORE_FILE

# What stands beside a result and describes it: it goes when the result is replaced.
SUMMARY = "summary.json"
FIGURES = (
    *("reference_net", "snapshots", "bullet_speeds", "energies", "area", "tensions", "tethers"),
    *("largest_tension", "loads", "distances", "rotation", "contacts"),
    *("closing", "capture", "control", "agreement"),
)
ANIMATIONS = ("animation.mp4", "animation.gif")
REPORT, VIEW = "report.html", "view.html"
EXPORTS = {"vtkhdf": "result.vtkhdf", "csv": "series.csv"}  # by format
DESCRIPTIONS = (
    SUMMARY,
    ENSEMBLE_FILE,
    *ANIMATIONS,
    REPORT,
    VIEW,
    *EXPORTS.values(),
    *(f"{figure}.png" for figure in FIGURES),
)

_LISTED = 3  # names in a message

REPLACEMENT = ".exunet-replacement"  # folder of what waits to take the place of an earlier result


def has_result(folder: Path) -> bool:
    """True if there is a result in the folder, whatever it is worth."""
    return os.path.lexists(folder / RESULT_FILE)


def has_unfinished(folder: Path) -> bool:
    """True if there is a run in the folder that `resume` may continue, or that is still going on."""
    return (folder / STORE_FILE).is_file()


def unfinished(path: Path) -> str:
    """Name the unfinished run in the folder of a result, and how to continue it; "" without one."""
    folder = path if path.is_dir() else path.parent
    remedy = f"continue it (exunet resume {quote(str(folder))})"
    return f"{folder}: there is an unfinished run in this folder: {remedy}" if has_unfinished(folder) else ""


def new_folder(wanted: Path) -> Path:
    """Make the folder `wanted`, or if there is something of that name, wanted-2, -3, ...: the one made.

    Two processes never get the same. Raises InputError if no folder can be made there.
    """
    try:
        wanted.parent.mkdir(parents=True, exist_ok=True)
        for number in count(1):
            folder = wanted if number == 1 else wanted.with_name(f"{wanted.name}-{number}")
            with suppress(FileExistsError):
                folder.mkdir()
                return folder
    except (OSError, ValueError) as error:
        raise cannot_write(wanted, error) from error
    raise AssertionError("whole numbers do not end")


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Reserve a folder for this run, until the block ends or the process does.

    Raises InputError if another run has it. File systems without locks leave this to the user.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:  # Windows does not open folders
        yield
        return
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        try:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"{folder}: another process is writing there: give another --out") from error
        except (ImportError, OSError):
            pass
        yield
    finally:
        os.close(descriptor)


def refuse_taken(folder: Path) -> None:
    """Raise InputError if a new run in the folder would cost what is there."""
    if words := unfinished(folder):
        raise InputError(f"{words}, put it aside (--overwrite), or give another --out")
    if has_result(folder):
        raise InputError(
            f"{folder}: there is a result in this folder: replace it (--overwrite), or give another --out"
        )
    refuse_replacing(folder, DESCRIPTIONS)


def refuse_replacing(folder: Path, names: Iterable[str]) -> None:
    """Raise InputError if there is a file of one of these names, whoever wrote it, in the folder."""
    there = [name for name in names if os.path.lexists(folder / name)]
    if there:
        more = f" and {len(there) - _LISTED} more" if len(there) > _LISTED else ""
        listed = ", ".join(there[:_LISTED]) + more
        words = "allow that (--overwrite), or give another --out"
        raise InputError(f"{folder}: {listed} in this folder would be replaced: {words}")


def put_unfinished_aside(folder: Path) -> Path | None:
    """Move an unfinished run into a new folder beside, where it can be resumed; None without one."""
    if not has_unfinished(folder):
        return None
    aside = new_folder(_beside(folder))
    try:
        for suffix in ("-wal", "-shm", ""):  # what SQLite has not yet moved into the file goes first
            with suppress(FileNotFoundError):
                os.rename(folder / (STORE_FILE + suffix), aside / (STORE_FILE + suffix))
    except OSError as error:
        aside.rmdir()
        raise cannot_write(aside, error) from error
    return aside


def waiting_place(folder: Path) -> Path:
    """The empty folder for a result and what describes it, until they take the place of earlier ones."""
    place = folder / REPLACEMENT
    try:
        remove_waiting(folder)
        place.mkdir()
    except OSError as error:
        raise cannot_write(place, error) from error
    return place


def remove_waiting(folder: Path) -> None:
    """Remove what a process that was killed has left there."""
    shutil.rmtree(folder / REPLACEMENT, ignore_errors=True)


def take_place(folder: Path) -> Path:
    """Put what waits in the place of the earlier result, the result first; what described that goes."""
    place = folder / REPLACEMENT
    try:
        names = sorted((path.name for path in place.iterdir()), key=lambda name: name != RESULT_FILE)
        for name in names:
            os.replace(place / name, folder / name)
        remove_descriptions(folder, but=names)
        place.rmdir()
    except OSError as error:
        raise cannot_write(folder, error) from error
    return folder


def remove_descriptions(folder: Path, but: list[str] | tuple[str, ...] = ()) -> None:
    """Remove what described an earlier result, so that it is not taken for the description of another."""
    for name in DESCRIPTIONS:
        if name not in but:
            (folder / name).unlink(missing_ok=True)


def put_waiting_aside(folder: Path) -> Path:
    """Move what waits, which is not to replace the earlier result, into a new folder beside: that folder.

    Where none can be made it stays where it is, and that is the folder.
    """
    place = folder / REPLACEMENT
    try:
        aside = new_folder(_beside(folder))
        for path in list(place.iterdir()):
            shutil.move(path, aside / path.name)
        place.rmdir()
    except (InputError, OSError):
        return place
    return aside


def _beside(folder: Path) -> Path:
    """The folder's own name, which `new_folder` gives a number; in full where it is not its last part."""
    return folder.resolve() if folder.is_symlink() or folder.name in ("", "..") else folder
