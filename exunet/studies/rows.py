"""Rows of a study in an SQLite file: a table `runs` with a column for each input and each metric.

A transaction adds the rows of a portion of runs, so that a killed process loses none that was complete. Each
shard of a study has a file of its own in the same folder. The table `study` has the texts of the study and of
its cases, hashes and versions, as JSON by name.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.database import Database
from exunet.base.errors import InputError
from exunet.base.files import replacing

ROWS_FILE = "study.sqlite"
VERSION = 1
# Columns of each row: its number, those of its case and replicate (0: unperturbed), its design, status and
# capture outcome, the wall time of the run, and why it is not ok.
FIXED = {"id": "INTEGER PRIMARY KEY", "run": "INTEGER", "replicate": "INTEGER", "design": "TEXT"}
FIXED |= {"status": "TEXT", "outcome": "TEXT", "seconds": "REAL", "note": "TEXT"}
OK, STOPPED, INVALID, FAILED = "ok", "stopped", "invalid", "failed"  # status of a row
_PATIENCE = 30.0  # [s] for a transaction of another process
_COLUMNS = "PRAGMA table_info(runs)"


def file_of(shard: tuple[int, int] | None) -> str:
    """Return the name of the file of a shard (k, n), or of a whole study."""
    return ROWS_FILE if shard is None else f"study-{shard[0]}-of-{shard[1]}.sqlite"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _stored(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | tuple) else value


class RowFile(Database):
    """The file of a study or a shard; one process writes, others may read.

    Raises InputError if there is no such file, or if it is damaged or of another version.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"{path}: there is no study")
        super().__init__(path, "the rows of a study", _PATIENCE, lambda db: db.execute(_COLUMNS).fetchone())
        with self._errors("cannot be read"):
            self._find_columns()
            version = self.about("version") if self.columns else None
        if version != VERSION:
            raise InputError(f"{path}: requires version {VERSION}, got {version}")

    @classmethod
    def create(cls, path: Path, about: Mapping[str, Any], inputs: Mapping[str, str]) -> RowFile:
        """Make a file without rows, which appears whole or not at all; inputs: SQLite types of columns."""
        columns = ", ".join(f"{_quoted(name)} {kind}" for name, kind in (FIXED | dict(inputs)).items())
        with closing(sqlite3.connect(":memory:", isolation_level=None)) as db:
            db.execute(f"CREATE TABLE runs ({columns})")
            db.execute("CREATE TABLE study (name TEXT PRIMARY KEY, value TEXT)")
            _put(db, {"version": VERSION, "metrics": {}, **about})
            content = db.serialize()
        with replacing(path) as part:
            part.write_bytes(content)
        return cls(path)

    def _find_columns(self) -> None:
        self.columns = [name for _, name, *_ in self._db.execute(_COLUMNS)]

    def about(self, name: str) -> Any:
        """Return a value of the table `study`; None if it is absent."""
        with self._errors("cannot be read"):
            row = self._db.execute("SELECT value FROM study WHERE name = ?", (name,)).fetchone()
        return None if row is None else json.loads(row[0])

    def note(self, **about: Any) -> None:
        """Set values of the table `study`."""
        with self._transaction() as db:
            _put(db, about)

    def add(self, rows: Sequence[Mapping[str, Any]], about: Mapping[str, Sequence[str]]) -> None:
        """Add rows, values by column, all or none; raises InputError if the disk is full.

        about : words and unit of metrics, by key
        """
        with self._transaction() as db:
            known = self.about("metrics")
            if new := {key: item for key, item in about.items() if key not in known}:
                for key in new:
                    db.execute(f"ALTER TABLE runs ADD COLUMN {_quoted(key)} REAL")
                _put(db, {"metrics": known | new})
            for names, group in groupby(rows, key=tuple):
                columns, marks = ", ".join(map(_quoted, names)), ", ".join("?" * len(names))
                values = ([_stored(item) for item in row.values()] for row in group)
                db.executemany(f"INSERT OR REPLACE INTO runs ({columns}) VALUES ({marks})", values)
        self._find_columns()

    def rows(self, names: Sequence[str], number: int | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield values of columns of each row, or of the row with a number; None where one is missing."""
        listed = ", ".join(_quoted(name) if name in self.columns else "NULL" for name in names)
        where = "" if number is None else f"WHERE id = {number:d}"
        with self._errors("cannot be read"):
            yield from self._db.execute(f"SELECT {listed} FROM runs {where} ORDER BY id")


def _put(db: sqlite3.Connection, about: Mapping[str, Any]) -> None:
    values = [(name, json.dumps(value)) for name, value in about.items()]
    db.executemany("INSERT OR REPLACE INTO study VALUES (?, ?)", values)


class RowFiles:
    """All files of a study in a folder, as one table that is read by columns.

    Raises InputError if the folder has no rows, or if they are of different studies.
    """

    def __init__(self, folder: Path) -> None:
        self._paths = sorted(folder.glob("study*.sqlite"))
        if not self._paths:
            raise InputError(f"{folder}: there is no study in this folder")
        if any(identity != self.about("identity") for identity in self.abouts("identity")):
            raise InputError(f"{folder}: has files of different studies: remove those that are not wanted")

    def _files(self) -> Iterator[RowFile]:
        for path in self._paths:
            with closing(RowFile(path)) as file:
                yield file

    def about(self, name: str) -> Any:
        """Return a value of the table `study` of the first file."""
        return self.abouts(name)[0]

    def abouts(self, name: str) -> list[Any]:
        """Return a value of the table `study` of each file."""
        return [file.about(name) for file in self._files()]

    @property
    def columns(self) -> list[str]:
        """Names of the columns of all files, each once."""
        return list(dict.fromkeys(name for file in self._files() for name in file.columns))

    def rows(self, names: Sequence[str], number: int | None = None) -> Iterator[tuple[Any, ...]]:
        """Yield the values of columns of each row, file by file, or of that with a number."""
        for file in self._files():
            yield from file.rows(names, number)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (rows,) in the order of the rows: numbers, NaN where one is missing, or texts."""
        pairs = sorted(self.rows(("id", name)), key=lambda pair: pair[0])
        values = [value for _, value in pairs]
        if any(isinstance(value, str) for value in values):
            return np.array(values, dtype=object)
        if values and all(isinstance(value, int) for value in values):
            return np.array(values)
        return np.array([math.nan if value is None else value for value in values], dtype=np.float64)
