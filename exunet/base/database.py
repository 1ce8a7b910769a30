"""SQLite files that one process writes and others read."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from exunet.base.errors import InputError
from exunet.base.interrupt import postponed


class Database:
    """An open SQLite file, whose errors are InputErrors.

    path     : of the file, which must exist
    contents : of the file, in messages: "the rows of a study"
    timeout  : wait for a transaction of another process [s]
    test     : called with the connection; an OperationalError is one of a file system without locks
    """

    def __init__(
        self,
        path: Path,
        contents: str,
        timeout: float,
        test: Callable[[sqlite3.Connection], Any],
        *,
        read_only: bool = False,
    ) -> None:
        self.path, self._contents = path, contents
        uri = f"{path.resolve().as_uri()}?mode={'ro' if read_only else 'rw'}"
        options: dict[str, Any] = {"uri": True, "isolation_level": None, "check_same_thread": False}
        with self._errors("cannot be read"):
            self._db = sqlite3.connect(uri, timeout=timeout, **options)
            try:
                test(self._db)
            except sqlite3.OperationalError:
                self._db.close()
                if os.name != "posix":
                    raise
                self._db = sqlite3.connect(f"{uri}&vfs=unix-none", **options)

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def _errors(self, failed: str) -> Iterator[None]:
        """Turn errors of SQLite, and of contents that are not those of such a file, into InputError."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise InputError(f"{self.path}: {failed}: {error}") from error
        except (sqlite3.Error, TypeError, ValueError, KeyError) as error:
            raise InputError(f"{self.path}: not {self._contents}, or damaged: {error}") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Commit all or nothing of a block; Ctrl-C acts after it."""
        with postponed(), self._errors("cannot be written"):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):  # where SQLite has rolled back by itself
                    self._db.execute("ROLLBACK")
                raise
