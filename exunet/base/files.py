"""Files that are either whole or absent, and named arrays in such a file."""

from __future__ import annotations

import json
import math
import os
import secrets
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import shown
from exunet.base.errors import InputError

_MAGIC = b"\x89EXU\r\n"  # a transfer as text changes it


def path_of(given: object, what: str, needed: str = "the name of a file") -> Path:
    """Return a path given by a script; InputError, which begins with `what`, for other values."""
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


def pack_arrays(
    kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> bytes:
    """Pack numbers and a JSON-like header: a checksum, a JSON text, and the arrays in C order; no pickle.

    Parameters
    ----------
    kind, version : purpose and version of the content; a reader requires both
    header : JSON-like, without NaN and infinity
    arrays : numbers or truth values of any shape, by name

    Raises
    ------
    InputError : the header is not JSON-like, or an array contains something else.
    """
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf":
            raise InputError(f"{kind}: {name} has the type {values.dtype}, which cannot be stored")
    table = [[name, values.dtype.str, values.shape] for name, values in arrays.items()]
    content = {"kind": kind, "version": version, "header": dict(header), "arrays": table}
    try:
        text = json.dumps(content, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{kind}: the header cannot be written as JSON: {error}") from error
    numbers = (np.ascontiguousarray(values).tobytes() for values in arrays.values())
    body = len(text).to_bytes(8, "little") + text + b"".join(numbers)
    return _MAGIC + zlib.crc32(body).to_bytes(4, "little") + body


def unpack_arrays(
    content: bytes, kind: str, version: int, where: str | Path = ""
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return header and arrays of what `pack_arrays` packed.

    where : name of the file in messages; "": the kind

    Raises InputError if the content is damaged, or of another kind or version.
    """
    where, start = where or kind, len(_MAGIC) + 12
    crc, size = content[len(_MAGIC) : start - 8], int.from_bytes(content[start - 8 : start], "little")
    if content[: len(_MAGIC)] != _MAGIC or int.from_bytes(crc, "little") != zlib.crc32(content[start - 8 :]):
        raise InputError(f"{where}: not a file of exunet, or damaged")
    stored = json.loads(content[start : start + size])
    if (stored["kind"], stored["version"]) != (kind, version):
        found = f"{stored['kind']!r} of version {stored['version']}"
        raise InputError(f"{where}: requires {kind!r} of version {version}, got {found}")
    arrays, at = {}, start + size
    for name, dtype, shape in stored["arrays"]:
        count = math.prod(shape)
        arrays[name] = np.frombuffer(content, dtype, count, at).reshape(shape).copy()
        at += arrays[name].nbytes
    return stored["header"], arrays


def write_arrays(
    path: str | Path, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write what `pack_arrays` returns to a file, whole or not at all; raises InputError."""
    content = pack_arrays(kind, version, header, arrays)
    with replacing(path) as part:
        part.write_bytes(content)


def read_arrays(path: str | Path, kind: str, version: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `write_arrays` wrote; raises InputError as `unpack_arrays`, or if the file cannot be read."""
    try:
        content = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    return unpack_arrays(content, kind, version, path)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, an empty one last."""
    escaped = ([cell.replace("|", "\\|") for cell in row] for row in rows)
    return [*(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *escaped)), ""]


def grouped(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Names of arrays with their group before them."""
    return {f"{group}:{name}": values for name, values in arrays.items()}


def group_of(group: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of a group by their own names."""
    start = f"{group}:"
    return {name[len(start) :]: values for name, values in arrays.items() if name.startswith(start)}
