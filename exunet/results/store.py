"""Stored states of a run while it goes on: in memory, or in an SQLite file that survives the process.

The file is "unfinished.sqlite" in the run's folder. A transaction adds a batch of rows, drops rows, or
replaces the checkpoint. A process that is killed leaves what was last committed, and another process may read
it at any time. `exunet.results.io` writes the result file from the rows at the end of the run.
"""

from __future__ import annotations

import json
import math
import sqlite3
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from pydantic import TypeAdapter

from exunet.base.arrays import Floats
from exunet.base.database import Database
from exunet.base.errors import InputError
from exunet.base.files import replacing
from exunet.base.interrupt import postponed
from exunet.results.result import Column

STORE_FILE = "unfinished.sqlite"
VERSION = 1

_TABLES = """
CREATE TABLE run (version INTEGER, columns TEXT, request TEXT, head BLOB);
CREATE TABLE batch (id INTEGER PRIMARY KEY, first INTEGER, count INTEGER, stop INTEGER);
CREATE TABLE numbers (id INTEGER PRIMARY KEY, crc INTEGER, data BLOB);
CREATE TABLE checkpoint (batch INTEGER, crc INTEGER, data BLOB);
"""
_COLUMNS = TypeAdapter(tuple[Column, ...])
_COUNT = "SELECT coalesce(max(stop), 0) FROM batch WHERE stop > first"  # others were dropped


class RowSource(Protocol):
    """Rows that can be read: of every column one row for each stored state."""

    @property
    def columns(self) -> tuple[Column, ...]: ...

    def __len__(self) -> int:
        """Return the number of rows."""
        ...

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Return rows `start` to `stop` (not included) of a column: (stop - start, *row), that last."""
        ...


class RowStore(RowSource, Protocol):
    """Rows that grow during a run."""

    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path. They are copied."""
        ...

    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only: the run goes back."""
        ...


class MemoryStore:
    """Rows in memory; see `RowStore`. expected: their number, about."""

    def __init__(self, columns: tuple[Column, ...], expected: int = 16) -> None:
        self.columns = columns
        self._count, self._lent = 0, False
        self._arrays = {column.path: np.empty((expected, *column.row)) for column in columns}

    def __len__(self) -> int:
        return self._count

    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path. They are copied."""
        end = self._count + count_rows(self.columns, rows)
        for path, values in self._arrays.items():
            if self._lent or end > len(values):
                room = len(values) if end <= len(values) else max(end, 2 * len(values))
                longer = np.empty((room, *values.shape[1:]))
                longer[: self._count] = values[: self._count]
                self._arrays[path] = values = longer
            values[self._count : end] = rows[path]
        self._count, self._lent = end, False

    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only."""
        self._count = min(count, self._count)

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Return rows `start` to `stop` (not included) of a column; if these are all, without a copy."""
        rows = self._arrays[path][start : min(stop, self._count)]
        whole = 0 < len(rows) == self._count
        self._lent |= whole
        return rows if whole else rows.copy()


class FileStore(Database):
    """Rows in an SQLite file; see `RowStore`. One process writes, others may read.

    Parameters
    ----------
    path : of a file that `create` made
    read_only : show the rows as they are now, whatever another process adds

    Attributes
    ----------
    columns : what a row consists of
    request : what the run was requested with, JSON-like
    head    : what `exunet.results.io` has written of the run beside its rows

    Raises
    ------
    InputError : there is no such file, or it is damaged or of another version.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self._last: dict[str, tuple[int, Floats]] = {}  # the last numbers that were read of each column
        if not path.is_file():
            raise InputError(f"{path}: there are no stored states of an unfinished run")

        def test(db: sqlite3.Connection) -> None:
            if not read_only:
                db.execute("PRAGMA journal_mode=wal")
                db.execute("PRAGMA synchronous=normal")  # safe against the end of the process
            db.execute("SELECT version FROM run").fetchone()

        super().__init__(path, "the states of a run", 2.0, test, read_only=read_only)
        with self._errors("cannot be read"):
            if read_only:
                self._db.execute("BEGIN")
            version, columns, request, self.head = self._db.execute("SELECT * FROM run").fetchone()
            if version != VERSION:
                raise InputError(f"{path}: requires version {VERSION}, got {version}")
            self.columns = _COLUMNS.validate_json(columns)
            self.request: dict[str, Any] = json.loads(request)
            (self._count,) = self._db.execute(_COUNT).fetchone()
        self._number = {column.path: k for k, column in enumerate(self.columns)}

    @classmethod
    def create(
        cls, path: Path, columns: tuple[Column, ...], head: bytes, request: Mapping[str, Any]
    ) -> FileStore:
        """Make an empty store, whose file appears whole or not at all; InputError if it cannot be written."""
        about = _COLUMNS.dump_json(columns).decode(), json.dumps(dict(request))
        db = sqlite3.connect(":memory:", isolation_level=None)
        db.executescript(f"PRAGMA page_size=16384; {_TABLES}")
        db.execute("INSERT INTO run VALUES (?, ?, ?, ?)", (VERSION, *about, head))
        with replacing(path) as part:
            part.write_bytes(db.serialize())
        return cls(path)

    def __len__(self) -> int:
        return self._count

    @property
    def checkpoint(self) -> bytes | None:
        """Return the snapshot given to `keep_checkpoint` last; raises InputError if it is damaged."""
        with self._errors("cannot be read"):
            row = self._db.execute("SELECT crc, data FROM checkpoint").fetchone()
        return None if row is None else self._sound(*row)

    @postponed()  # an interrupt between commit and count would count rows twice
    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path; raises InputError if the disk is full."""
        count = count_rows(self.columns, rows)
        if not count:
            return
        with self._transaction() as db:
            end = self._count + count
            batch = db.execute(
                "INSERT INTO batch VALUES (NULL, ?, ?, ?)", (self._count, count, end)
            ).lastrowid
            assert batch is not None
            first = self._key(batch, 0)
            numbers = (np.asarray(rows[column.path], np.float64).tobytes() for column in self.columns)
            table = ((first + k, zlib.crc32(data), data) for k, data in enumerate(numbers))
            db.executemany("INSERT INTO numbers VALUES (?, ?, ?)", table)
        self._count = end

    @postponed()
    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only; `back_to_checkpoint` still returns to those of the checkpoint."""
        with self._transaction() as db:
            later = "first >= ? AND id > (SELECT coalesce(max(batch), 0) FROM checkpoint)"
            (first,) = db.execute(f"SELECT min(id) FROM batch WHERE {later}", (count,)).fetchone()
            self._remove(db, first)
            db.execute("UPDATE batch SET stop = max(first, ?) WHERE stop > ?", (count, count))
        self._last.clear()
        self._count = min(count, self._count)

    @postponed()
    def keep_checkpoint(self, snapshot: bytes) -> None:
        """Keep a snapshot that belongs to the rows as they are now, in place of an earlier one."""
        with self._transaction() as db:
            for (batch,) in db.execute("SELECT id FROM batch WHERE stop = first").fetchall():
                db.execute(
                    "DELETE FROM numbers WHERE id BETWEEN ? AND ?",
                    (self._key(batch, 0), self._key(batch + 1, -1)),
                )
                db.execute("DELETE FROM batch WHERE id = ?", (batch,))
            db.execute("UPDATE batch SET count = stop - first WHERE count <> stop - first")
            db.execute("DELETE FROM checkpoint")
            db.execute(
                "INSERT INTO checkpoint SELECT coalesce(max(id), 0), ?, ? FROM batch",
                (zlib.crc32(snapshot), snapshot),
            )

    @postponed()
    def back_to_checkpoint(self) -> bytes | None:
        """Go back to the rows of the checkpoint and return its snapshot; without one: no rows, and None."""
        snapshot = self.checkpoint
        with self._transaction() as db:
            (last,) = db.execute("SELECT coalesce(max(batch), 0) FROM checkpoint").fetchone()
            self._remove(db, last + 1)
            db.execute("UPDATE batch SET stop = first + count")
            (self._count,) = db.execute(_COUNT).fetchone()
        self._last.clear()
        return snapshot

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Return rows `start` to `stop` (not included) of a column; raises InputError if damaged."""
        with self._errors("cannot be read"):
            column = self.columns[self._number[path]]
            found = [np.empty((0, *column.row))]
            within = "stop > ? AND first < ? AND stop > first ORDER BY first"
            chosen = self._db.execute(
                f"SELECT id, count, first, stop FROM batch WHERE {within}", (start, stop)
            )
            for batch, count, first, end in chosen.fetchall():
                rows = self._rows(batch, count, column)
                found.append(rows[max(start - first, 0) : min(stop, end) - first])
        return np.concatenate(found)

    def discard(self) -> None:
        """Close the file and remove it."""
        self.close()
        for suffix in ("", "-wal", "-shm"):
            self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)

    def _rows(self, batch: int, count: int, column: Column) -> Floats:
        """Return all rows of a batch, `count`, of one column."""
        last, rows = self._last.get(column.path, (0, np.empty(0)))
        if last != batch:
            key = self._key(batch, self._number[column.path])
            crc, data = self._db.execute("SELECT crc, data FROM numbers WHERE id = ?", (key,)).fetchone()
            number = -1 if math.prod(column.row) else count  # of what is empty no number of rows follows
            rows = np.frombuffer(self._sound(crc, data)).reshape(number, *column.row)
            self._last[column.path] = batch, rows
        return rows

    def _key(self, batch: int, column: int) -> int:
        """Key of the numbers of a batch and a column."""
        return batch * len(self.columns) + column

    def _remove(self, db: sqlite3.Connection, first: int | None) -> None:
        """Remove the batches from a number on; None: no batch."""
        if first is not None:
            db.execute("DELETE FROM numbers WHERE id >= ?", (self._key(first, 0),))
            db.execute("DELETE FROM batch WHERE id >= ?", (first,))

    def _sound(self, crc: int, data: bytes) -> bytes:
        if zlib.crc32(data) != crc:
            raise InputError(f"{self.path}: damaged: a checksum does not match")
        return data


def count_rows(columns: tuple[Column, ...], rows: Mapping[str, Floats]) -> int:
    """Return the number of rows to be appended; raises ValueError if they do not fit the columns."""
    if set(rows) != {column.path for column in columns}:
        raise ValueError(f"columns {sorted(rows)} are not those of the store")
    count = len(rows[columns[0].path])
    for column in columns:
        if np.shape(rows[column.path]) != (count, *column.row):
            raise ValueError(f"{column.path} has shape {np.shape(rows[column.path])}, not {count} rows")
    return count
