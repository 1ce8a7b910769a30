"""Stored states in files that survive the end of their process: complete segments and an index of them.

A store is a folder with

- ``run.exu``: columns, net, bodies and provenance, written once;
- ``segment-NNNNNN.exu``: rows of every column, never changed after they were written;
- ``index.exu``: which segments count, how many rows of each, and the same of the last checkpoint.

All are containers with checksums (`exunet.base.blob`) that appear whole or not at all. A segment that the
index does not name does not count, so a process may be killed at any moment: what was last indexed is there.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from exunet.base.blob import read_arrays, write_arrays
from exunet.base.errors import InputError
from exunet.base.files import cannot_write, sweep
from exunet.base.interrupt import postponed
from exunet.net.arrays import Net
from exunet.results.columns import CONSTANTS, BodyConstants, Column, body_constants
from exunet.results.net_arrays import from_arrays, to_arrays
from exunet.results.store import Block, count_rows

Floats = NDArray[np.float64]

VERSION = 1
RUN, INDEX, LOCK = "run.exu", "index.exu", "lock"
_OWN = re.compile(r"run\.exu|(segment|checkpoint)-\d+\.exu")
SEGMENT_BYTES = 8 << 20  # rows in memory before they are written


@dataclass(frozen=True)
class Segment:
    """A file of rows, of which the first `rows` count."""

    file: str
    rows: int


class Segments:
    """The rows in a store's folder, to be read.

    columns    : what a row is made of
    net        : in its reference configuration
    bodies     : what does not change of each body, by name
    provenance : as far as it was known when the run began
    checkpoint : name that was given with the last checkpoint, None if there was none
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        header, arrays = read_arrays(folder / RUN, "exunet run", VERSION)
        index, _ = read_arrays(folder / INDEX, "exunet index", VERSION)
        with _as_written(folder / RUN):
            self._identity = _text(header["identity"])
            self.columns = tuple(_column(one) for one in header["columns"])
            self.bodies = {
                _text(name): _constants(mass, arrays, _text(name)) for name, mass in header["bodies"].items()
            }
            self.provenance: dict[str, Any] = dict(header["provenance"].items())
        self.net = from_arrays(arrays, str(folder / RUN))
        with _as_written(folder / INDEX):
            if _text(index["identity"]) != self._identity:
                raise InputError(f"{folder}: {INDEX} and {RUN} are of different runs")
            self._segments = [_segment(one) for one in index["segments"]]
            self._of_checkpoint = [_segment(one) for one in index["of_checkpoint"]]
            self._number = _count(index["written"])  # segments written so far
            named = index["checkpoint"]
            self.checkpoint: str | None = None if named is None else _text(named)
        self._read: dict[str, tuple[str, Floats]] = {}  # the last rows that were read of each column

    def __len__(self) -> int:
        return sum(segment.rows for segment in self._segments)

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Rows `start` to `stop` (not included) of a column, as far as there are; InputError if damaged."""
        column = next(one for one in self.columns if one.path == path)
        found = [np.empty((0, *column.row))]
        first = 0
        for segment in self._segments:
            a, b = max(start - first, 0), min(stop - first, segment.rows)
            if a < b:
                found.append(self._rows(segment, path)[a:b])
            first += segment.rows
        return np.concatenate(found)

    def _rows(self, segment: Segment, path: str) -> Floats:
        """All rows that a segment keeps of a column."""
        file, rows = self._read.get(path, ("", np.empty(0)))
        if file != segment.file:
            where = self.folder / segment.file
            header, arrays = read_arrays(where, "exunet segment", VERSION, only=(path,))
            rows, column = arrays[path], next(one for one in self.columns if one.path == path)
            whole = rows.shape[1:] == column.row and rows.dtype.kind == "f" and len(rows) >= segment.rows
            if header.get("identity") != self._identity or not whole:
                raise InputError(f"{where}: it is not the segment that the index names")
            self._read[path] = segment.file, rows
        return rows


@contextmanager
def _as_written(path: Path) -> Iterator[None]:
    """A file whose header has not what `SegmentStore` writes raises InputError."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        words = f"there is no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path}: damaged: {words}") from error


def _text(value: Any) -> str:
    if type(value) is not str:
        raise TypeError(f"{value!r} is no text")
    return value


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise TypeError(f"{value!r} is not a number of rows or files")
    return value


def _segment(one: Any) -> Segment:
    if re.fullmatch(r"segment-\d{6,}\.exu", _text(one["file"])) is None:
        raise ValueError(f"{one['file']!r} is not the name of a segment")
    return Segment(one["file"], _count(one["rows"]))


def _column(one: Any) -> Column:
    row = tuple(_count(size) for size in one["row"])
    return Column(_text(one["path"]), row, _text(one["units"]), _text(one["description"]))


def _constants(mass: Any, arrays: dict[str, Floats], name: str) -> BodyConstants:
    """Of the body `name`, whose arrays are taken out of `arrays`."""
    if type(mass) is not float:
        raise TypeError(f"{mass!r} is no mass")
    there = [one for one in CONSTANTS if f"{one} of {name}" in arrays]
    return body_constants(mass, {one: arrays.pop(f"{one} of {name}") for one in there})


class SegmentStore(Segments):
    """Rows in files, and the last of them in memory; see `RowStore`. One process at a time writes there.

    Memory is bounded by two segments (each 8 MB, or one row if that is larger), whatever the number of rows.
    """

    def __init__(self, folder: str | Path) -> None:
        """Open the store that `create` has made in `folder`; what the index does not name is removed.

        Raises InputError if there is no store, if it is damaged, or if another process writes to it.
        """
        folder = Path(folder)
        if not is_store(folder):
            raise InputError(f"{folder}: there are no stored states of an unfinished run")
        self._unlock = finalize(self, os.close, _locked(folder))  # at the latest with the end of the store
        try:
            super().__init__(folder)
            self._tidy()
        except BaseException:
            self._unlock()
            raise
        row_bytes = sum(column.row_bytes for column in self.columns)
        self._block = Block(self.columns, max(1, SEGMENT_BYTES // max(1, row_bytes)))
        sweep(folder)

    @classmethod
    def create(
        cls,
        folder: str | Path,
        columns: tuple[Column, ...],
        net: Net,
        bodies: Mapping[str, BodyConstants],
        provenance: Mapping[str, Any],
    ) -> SegmentStore:
        """A new, empty store in `folder`, which is made; an earlier store in it is removed.

        Raises InputError if the folder cannot be written, if another process writes to a store in it, if the
        net is not in order, or if the provenance is not JSON-like.
        """
        folder = Path(folder)
        arrays = to_arrays(net, str(folder))
        identity = secrets.token_hex(16)
        header = {
            "identity": identity,
            "columns": [asdict(column) for column in columns],
            "bodies": {name: body.mass for name, body in bodies.items()},
            "provenance": dict(provenance),
        }
        for name, body in bodies.items():
            arrays |= {f"{one} of {name}": np.asarray(values) for one, values in body.arrays().items()}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock = _locked(folder)
            try:
                _remove(folder)
                write_arrays(folder / RUN, "exunet run", VERSION, header, arrays)
                _write_index(folder, identity, [], 0, None, [])
            except BaseException:  # such as a full disk: nothing is left of the attempt
                _remove_all(folder)
                raise
            finally:
                os.close(lock)
        except OSError as error:
            raise cannot_write(folder, error) from error
        return cls(folder)

    def __len__(self) -> int:
        return self.written + self._block.count

    @property
    def written(self) -> int:
        """Rows that survive the process."""
        return super().__len__()

    @postponed()  # Ctrl-C between the steps of one of these would count rows twice
    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path. They are copied.

        Raises InputError if a segment is full and cannot be written.
        """
        count, done = count_rows(self.columns, rows), 0
        while done < count:
            some = min(count - done, self._block.capacity - self._block.count)
            self._block.add(rows, done, done + some)
            done += some
            if self._block.count == self._block.capacity:
                self.flush()

    @postponed()
    def flush(self, checkpoint: str | None = None) -> None:
        """Write what is in memory, so that it survives the process.

        checkpoint : a name for the rows until here, kept in the same instant; `back_to_checkpoint` returns to
                     them in a later process, whatever was dropped and appended since. None: the last stays.

        Raises InputError if a file cannot be written; the rows are kept in memory then.
        """
        segments, number, of_checkpoint = self._segments, self._number, self._of_checkpoint
        if count := self._block.count:
            number += 1
            file = f"segment-{number:06d}.exu"
            rows = {column.path: self._block.view(column.path, 0, count) for column in self.columns}
            write_arrays(self.folder / file, "exunet segment", VERSION, {"identity": self._identity}, rows)
            segments = [*segments, Segment(file, count)]
        if checkpoint is not None:
            of_checkpoint = list(segments)
        named = self.checkpoint if checkpoint is None else checkpoint
        if count or checkpoint is not None:
            _write_index(self.folder, self._identity, segments, number, named, of_checkpoint)
        self._segments, self._number, self._of_checkpoint = segments, number, of_checkpoint
        self.checkpoint, self._block.count = named, 0

    @postponed()
    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only; those of the last checkpoint can still be returned to."""
        if not 0 <= count <= len(self):
            raise ValueError(f"cannot keep {count} of {len(self)} rows")
        written = self.written
        self._block.count = max(0, count - written)
        if count < written:
            self._segments = _first(self._segments, count)
            self._index()
            self._tidy()

    @postponed()
    def back_to_checkpoint(self) -> None:
        """Make the rows of the last checkpoint those of the store; ValueError if there was none."""
        if self.checkpoint is None:
            raise ValueError(f"{self.folder}: there was no checkpoint")
        self._block.count = 0
        self._segments = list(self._of_checkpoint)
        self._index()
        self._tidy()

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Rows `start` to `stop` (not included) of a column, copied; raises InputError if damaged."""
        written = self.written
        later = self._block.view(path, max(start - written, 0), max(stop - written, 0))
        return np.concatenate([super().read(path, start, min(stop, written)), later])

    def close(self) -> None:
        """Write what is in memory, and let other processes write to the folder."""
        if self._unlock.alive:
            try:
                self.flush()
            finally:
                self._unlock()

    def discard(self) -> None:
        """Remove the store's files, and its folder if nothing else is in it."""
        self._block.count = 0
        _remove_all(self.folder)
        self._unlock()

    def _index(self) -> None:
        _write_index(
            self.folder, self._identity, self._segments, self._number, self.checkpoint, self._of_checkpoint
        )

    def _tidy(self) -> None:
        """Remove the segments that the index does not name."""
        named = {segment.file for segment in (*self._segments, *self._of_checkpoint)}
        for path in _own_files(self.folder):
            if path.name.startswith("segment-") and path.name not in named:
                path.unlink(missing_ok=True)


def is_store(folder: Path) -> bool:
    """True if there is a store in the folder."""
    return (folder / INDEX).is_file()


def _first(segments: list[Segment], count: int) -> list[Segment]:
    """The segments as far as they hold the first `count` rows."""
    kept: list[Segment] = []
    for segment in segments:
        if count > 0:
            kept.append(Segment(segment.file, min(count, segment.rows)))
        count -= segment.rows
    return kept


def _write_index(
    folder: Path,
    identity: str,
    segments: list[Segment],
    written: int,
    checkpoint: str | None,
    of_checkpoint: list[Segment],
) -> None:
    header = {
        "identity": identity,
        "segments": [asdict(segment) for segment in segments],
        "written": written,
        "checkpoint": checkpoint,
        "of_checkpoint": [asdict(segment) for segment in of_checkpoint],
    }
    write_arrays(folder / INDEX, "exunet index", VERSION, header, {})


def _own_files(folder: Path) -> list[Path]:
    """The files of a store, those of checkpoints too; the index first, without which none counts.

    Raises InputError if something else has the name of one; other names are not the store's to judge.
    """
    found = [folder / INDEX, *(path for path in sorted(folder.glob("*.exu")) if _OWN.fullmatch(path.name))]
    for path in found:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: it is in the way of a run's own file: move it elsewhere")
    return found


def _remove(folder: Path) -> None:
    for path in _own_files(folder):
        path.unlink(missing_ok=True)


def _remove_all(folder: Path) -> None:
    """The containers, the lock, and the folder if nothing else is in it."""
    _remove(folder)
    (folder / LOCK).unlink(missing_ok=True)
    with suppress(OSError):  # not empty
        folder.rmdir()


def _locked(folder: Path) -> int:
    """A lock on the folder, released at the latest with the end of the process; InputError if it is taken."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise cannot_write(folder, error) from error
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise InputError(f"{folder}: another process is writing there") from error
    except (ImportError, OSError):  # Windows, or a file system without locks: it is left to the user
        pass
    return descriptor
