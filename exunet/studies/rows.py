"""Rows of a study in an SQLite file: a table `runs` with a column for each input and each metric.

A transaction adds the rows of a portion of runs, so that a killed process loses none that was complete. Each
shard of a study has a file of its own in the same folder. The table `study` has the texts of the study and of
its cases, hashes and versions, as JSON by name.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Ints
from exunet.base.errors import InputError
from exunet.base.files import replacing
from exunet.base.interrupt import postponed

ROWS_FILE = "study.sqlite"
VERSION = 1
# Of each row: its number, the number of its case, its replicate (0: unperturbed), its design, its status, the
# capture outcome, the wall time of the run, and why it is not ok or undetermined.
FIXED = {
    "id": "INTEGER PRIMARY KEY",
    "run": "INTEGER",
    "replicate": "INTEGER",
    "design": "TEXT",
    "status": "TEXT",
    "outcome": "TEXT",
    "seconds": "REAL",
    "note": "TEXT",
}
OK, STOPPED, INVALID, FAILED = "ok", "stopped", "invalid", "failed"  # status of a row
_PATIENCE = 30.0  # [s] for a transaction of another process


@dataclass
class Row:
    """A row: its run, and the metrics of that.

    inputs : value by column
    about  : words and unit of each metric, by key; of the first row of a portion that has it
    result : content of result.h5, if it is kept
    """

    id: int
    run: int
    replicate: int
    design: str
    inputs: Mapping[str, Any]
    status: str = OK
    outcome: str | None = None
    seconds: float = math.nan
    note: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    about: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    result: bytes | None = None


def file_of(shard: tuple[int, int] | None) -> str:
    """Return the name of the file of a shard k of n, or of a whole study."""
    return ROWS_FILE if shard is None else f"study-{shard[0]}-of-{shard[1]}.sqlite"


def has_study(folder: Path) -> bool:
    """True if a study has written into a folder."""
    return any(folder.glob("study*.sqlite"))


class RowFile:
    """The file of a study or a shard; one process writes, others may read.

    Parameters
    ----------
    path : file that `create` made

    Raises
    ------
    InputError : there is no such file, or it is damaged or of another version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise InputError(f"{path}: there is no study")
        with self._errors("cannot be read"):
            self._db = sqlite3.connect(path, timeout=_PATIENCE, isolation_level=None)
            try:
                self._columns = self._read_columns()
            except sqlite3.OperationalError:  # file systems without locks
                self._db.close()
                if os.name != "posix":
                    raise
                uri = f"{path.resolve().as_uri()}?vfs=unix-none"
                self._db = sqlite3.connect(uri, uri=True, isolation_level=None)
                self._columns = self._read_columns()
            if not self._columns or (version := self.about("version")) != VERSION:
                found = version if self._columns else "none"
                raise InputError(f"{path}: requires version {VERSION}, got {found}")

    @classmethod
    def create(cls, path: Path, about: Mapping[str, Any], inputs: Mapping[str, str]) -> RowFile:
        """Make a file without rows, which appears whole or not at all.

        inputs : type of the columns of inputs, REAL or TEXT
        """
        kinds = FIXED | dict(inputs)
        columns = ", ".join(f"{_quoted(name)} {kind}" for name, kind in kinds.items())
        with closing(sqlite3.connect(":memory:", isolation_level=None)) as db:
            db.execute(f"CREATE TABLE runs ({columns})")
            db.execute("CREATE TABLE study (name TEXT PRIMARY KEY, value TEXT)")
            stored = {"version": VERSION, "metrics": {}, **about}
            db.executemany("INSERT INTO study VALUES (?, ?)", ((k, json.dumps(v)) for k, v in stored.items()))
            content = db.serialize()
        with replacing(path) as part:
            part.write_bytes(content)
        return cls(path)

    def _read_columns(self) -> list[str]:
        return [name for _, name, *_ in self._db.execute("PRAGMA table_info(runs)")]

    @property
    def columns(self) -> list[str]:
        """Names of all columns."""
        return self._columns

    def about(self, name: str, default: Any = None) -> Any:
        """Return a value of the table `study`."""
        row = self._db.execute("SELECT value FROM study WHERE name = ?", (name,)).fetchone()
        return default if row is None else json.loads(row[0])

    @postponed()
    def note(self, **about: Any) -> None:
        """Set values of the table `study`."""
        with self._transaction() as db:
            self._put(db, about)

    def _put(self, db: sqlite3.Connection, about: Mapping[str, Any]) -> None:
        rows = ((name, json.dumps(value)) for name, value in about.items())
        db.executemany("INSERT OR REPLACE INTO study VALUES (?, ?)", rows)

    @postponed()
    def add(self, rows: Sequence[Row]) -> None:
        """Add rows, all or none; raises InputError if the disk is full."""
        with self._transaction() as db:
            about = {key: item for row in rows for key, item in row.about.items()}
            known = self.about("metrics")
            if new := {key: item for key, item in about.items() if key not in known}:
                for key in new:
                    db.execute(f"ALTER TABLE runs ADD COLUMN {_quoted(key)} REAL")
                self._put(db, {"metrics": known | new})
            for row in rows:
                fixed = {name: getattr(row, name) for name in FIXED}
                values = fixed | {name: _stored(value) for name, value in row.inputs.items()}
                values |= row.metrics
                names, marks = ", ".join(map(_quoted, values)), ", ".join("?" * len(values))
                db.execute(f"INSERT OR REPLACE INTO runs ({names}) VALUES ({marks})", tuple(values.values()))
        self._columns = self._read_columns()

    def select(self, column: str, where: str = "1", *values: Any) -> list[tuple[int, Any]]:
        """Return pairs of a row's number and its value of a column, in the order of the rows."""
        with self._errors("cannot be read"):
            query = f"SELECT id, {_quoted(column)} FROM runs WHERE {where} ORDER BY id"
            return self._db.execute(query, values).fetchall()

    def rows(self, names: Sequence[str]) -> Iterator[tuple[Any, ...]]:
        """Yield the values of columns of each row; None where there is none."""
        listed = ", ".join(_quoted(name) if name in self._columns else "NULL" for name in names)
        with self._errors("cannot be read"):
            yield from self._db.execute(f"SELECT {listed} FROM runs ORDER BY id")

    def row(self, number: int) -> dict[str, Any] | None:
        """Return all columns of a row; None if it is not there yet."""
        with self._errors("cannot be read"):
            cursor = self._db.execute("SELECT * FROM runs WHERE id = ?", (number,))
            row = cursor.fetchone()
            return (
                None if row is None else dict(zip((item[0] for item in cursor.description), row, strict=True))
            )

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _errors(self, failed: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            raise InputError(f"{self.path}: {failed}: {error}") from error
        except (sqlite3.Error, ValueError) as error:
            raise InputError(f"{self.path}: not the rows of a study, or damaged: {error}") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._errors("cannot be written"):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):  # where SQLite has rolled back by itself
                    self._db.execute("ROLLBACK")
                raise


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _stored(value: Any) -> Any:
    return value if isinstance(value, int | float | str) else json.dumps(value)


class RowFiles:
    """All files of a study in a folder, as one table; each method reads one column.

    Raises InputError if there is none, or if they are of different studies.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._paths = sorted(folder.glob("study*.sqlite"))
        if not self._paths:
            raise InputError(f"{folder}: there is no study in this folder")
        identities = {json.dumps(file.about("identity")) for file in self._files()}
        if len(identities) > 1:
            raise InputError(f"{folder}: has files of different studies: remove those that are not wanted")

    def _files(self) -> Iterator[RowFile]:
        for path in self._paths:
            with closing(RowFile(path)) as file:
                yield file

    def about(self, name: str, default: Any = None) -> Any:
        """Return a value of the table `study` of the first file."""
        with closing(RowFile(self._paths[0])) as file:
            return file.about(name, default)

    def abouts(self, name: str) -> list[Any]:
        """Return a value of the table `study` of each file."""
        return [file.about(name) for file in self._files()]

    @property
    def columns(self) -> list[str]:
        """Names of the columns of all files, each once."""
        return list(dict.fromkeys(name for file in self._files() for name in file.columns))

    def row(self, number: int) -> dict[str, Any] | None:
        """Return all columns of a row; None if it is not there yet."""
        return next((row for file in self._files() if (row := file.row(number)) is not None), None)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (rows,) in the order of the rows: numbers, NaN where there is none, or texts."""
        pairs: list[tuple[int, Any]] = []
        for file in self._files():
            if name in file.columns:
                pairs += file.select(name)
            else:
                pairs += [(number, None) for number, _ in file.select("id")]
        pairs.sort(key=lambda pair: pair[0])
        values = [value for _, value in pairs]
        if any(isinstance(value, str) for value in values):
            return np.array(values, dtype=object)
        if values and all(isinstance(value, int) for value in values):
            return np.array(values)
        return np.array([math.nan if value is None else value for value in values], dtype=np.float64)

    def rows(self, names: Sequence[str]) -> Iterator[tuple[Any, ...]]:
        """Yield the values of columns of each row, file by file."""
        for file in self._files():
            yield from file.rows(names)

    def numbers(self) -> Ints:
        """Return the numbers (rows,) of the rows that are there."""
        return np.array(sorted(k for file in self._files() for k, _ in file.select("id")), dtype=np.int64)
