"""Arrays with a JSON header in one checked file: written whole or not at all, read back bit for bit.

The file is a magic number (8 bytes), the length of the text (8 bytes, little-endian), the SHA-256 digest of
length and text (32 bytes), the text itself (JSON: kind, version, header, and of each array its name, type,
shape and digest), and the arrays one after another in C order. Every byte is under a digest, or fixed. There
is no pickle; floating-point values may be NaN or infinite, in the arrays though not in the header.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Collection, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import InputError
from exunet.base.files import replacing

MAGIC = b"\x89EXU\r\n\x1a\n"  # like PNG's: a transfer as text, or of seven bits, is noticed
_DIGEST = 32
_FIXED = len(MAGIC) + 8 + _DIGEST
_TYPES = ("<f8", "<i8", "|b1", "|u1")


def write_arrays(
    path: str | Path, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write `arrays` (float64, int64, bool, uint8; any shape) and a JSON-like `header`; an older file goes.

    kind, version : what the file is for, and which form of that; a reader names both

    Raises InputError, and leaves an older file as it was, if the header is not JSON-like (NaN and infinity
    are not), if an array has another type, or if the file cannot be written.
    """
    with replacing(path) as part, part.open("wb") as stream:
        _write(stream, path, kind, version, header, arrays)


def pack_arrays(
    kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> bytes:
    """What `write_arrays` would write; raises InputError as that does."""
    stream = BytesIO()
    _write(stream, kind, kind, version, header, arrays)
    return stream.getvalue()


def unpack_arrays(content: bytes, kind: str, version: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """What `pack_arrays` packed; raises InputError as `read_arrays`."""
    return _read(BytesIO(content), kind, kind, version, None)


def _write(
    stream: BinaryIO,
    path: str | Path,
    kind: str,
    version: int,
    header: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
) -> None:
    stored = {name: _plain(path, name, values) for name, values in arrays.items()}
    table = [
        {
            "name": name,
            "type": values.dtype.str,
            "shape": list(values.shape),
            "sha256": hashlib.sha256(_bytes(values)).hexdigest(),
        }
        for name, values in stored.items()
    ]
    content = {"kind": kind, "version": version, "header": dict(header), "arrays": table}
    try:
        text = json.dumps(content, allow_nan=False).encode("utf-8")
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: the header cannot be written as JSON: {error}") from error
    head = len(text).to_bytes(8, "little")
    stream.write(MAGIC + head + hashlib.sha256(head + text).digest() + text)
    for values in stored.values():
        stream.write(_bytes(values))


def read_arrays(
    path: str | Path, kind: str, version: int, only: Collection[str] | None = None
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of a file that `write_arrays` wrote with this kind and version.

    only : names of the arrays to read, others are passed over unread; None: all

    Raises InputError, which says what is wrong, if there is no such file, if it is another kind or version,
    or if a byte of what is read is not what was written.
    """
    try:
        with Path(path).open("rb") as stream:
            return _read(stream, path, kind, version, only)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read: {reason}") from error


def _read(
    stream: BinaryIO, path: str | Path, kind: str, version: int, only: Collection[str] | None
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    content = _content(stream, size, path)
    if content["kind"] != kind:
        raise InputError(f"{path}: it is a file of another kind ({content['kind']!r}, not {kind!r})")
    if content["version"] != version:
        newer = "; a newer exunet wrote it" if content["version"] > version else ""
        raise InputError(f"{path}: its version is {content['version']}, this exunet reads {version}{newer}")
    at = stream.tell()
    found: dict[str, NDArray[Any]] = {}
    for entry in content["arrays"]:
        name, dtype, shape = entry["name"], np.dtype(entry["type"]), tuple(entry["shape"])
        length = math.prod(shape) * dtype.itemsize
        if at + length > size:
            _damaged(path, f"it ends within {name}")
        if only is None or name in only:
            stream.seek(at)
            raw = bytearray(stream.read(length))
            if hashlib.sha256(raw).hexdigest() != entry["sha256"]:
                _damaged(path, f"the checksum of {name} does not match")
            found[name] = np.frombuffer(raw, dtype).reshape(shape)
        at += length
    if at != size:
        _damaged(path, "it is longer than its contents")
    if only is not None and (missing := set(only) - set(found)):
        _damaged(path, f"it has no array {min(missing)}")
    return content["header"], found


def _content(stream: BinaryIO, size: int, path: str | Path) -> dict[str, Any]:
    """The text at the start, parsed, once its digest is found to match."""
    start = stream.read(_FIXED)
    if start[: len(MAGIC)] != MAGIC:
        raise InputError(f"{path}: it is not a file of exunet, or damaged at its beginning")
    head, digest = start[len(MAGIC) : len(MAGIC) + 8], start[len(MAGIC) + 8 :]
    length = int.from_bytes(head, "little")
    if len(start) < _FIXED or _FIXED + length > size:
        _damaged(path, "it ends within its header")
    text = stream.read(length)
    if hashlib.sha256(head + text).digest() != digest:
        _damaged(path, "the checksum of its header does not match")
    try:
        content = json.loads(text)
        tables = content["arrays"]
        shapes = [one for entry in tables for one in entry["shape"]]
        sound = (
            type(content["kind"]) is str
            and type(content["version"]) is int
            and type(content["header"]) is dict
            and all(entry["type"] in _TYPES and type(entry["name"]) is str for entry in tables)
            and all(type(one) is int and one >= 0 for one in shapes)
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        sound = False
    if not sound:
        _damaged(path, "its header does not describe its contents")
    return dict(content)


def _plain(path: str | Path, name: str, values: NDArray[Any]) -> NDArray[Any]:
    """The array in C order and little-endian."""
    values = np.asarray(values, order="C")
    stored = values.astype(values.dtype.newbyteorder("<"), copy=False)
    if stored.dtype.str not in _TYPES:
        raise InputError(f"{path}: {name} is of type {values.dtype}, which is not kept in such a file")
    return stored


def _bytes(values: NDArray[Any]) -> memoryview:
    """The array's memory as bytes, without a copy."""
    return values.reshape(-1).view(np.uint8).data


def _damaged(path: str | Path, reason: str) -> NoReturn:
    raise InputError(f"{path}: damaged or cut short: {reason}")
