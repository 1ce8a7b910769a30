"""Where stored states are kept during a run: the protocol, and the store in memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exunet.results.columns import Column

Floats = NDArray[np.float64]


class RowSource(Protocol):
    """Rows that can be read, one row of every column for each stored state."""

    @property
    def columns(self) -> tuple[Column, ...]: ...

    def __len__(self) -> int:
        """Number of rows."""
        ...

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Rows `start` to `stop` (not included) of a column: (stop - start, *row), the caller's own."""
        ...


class RowStore(RowSource, Protocol):
    """Rows that grow during a run."""

    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path. They are copied."""
        ...

    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only: the run goes back."""
        ...

    def close(self) -> None:
        """Keep what was appended, and take no more rows."""
        ...


class Block:
    """Rows in memory, up to a capacity.

    columns  : what a row is made of
    capacity : number of rows that there is room for
    """

    def __init__(self, columns: tuple[Column, ...], capacity: int) -> None:
        self.capacity = capacity
        self.count = 0
        self._columns = columns
        self._arrays = {column.path: np.empty((capacity, *column.row)) for column in columns}

    def add(self, rows: Mapping[str, Floats], start: int, stop: int) -> None:
        """Copy rows `start` to `stop` of each of the arrays."""
        end = self.count + stop - start
        for path, values in self._arrays.items():
            values[self.count : end] = rows[path][start:stop]
        self.count = end

    def view(self, path: str, start: int, stop: int) -> Floats:
        """Rows of a column; not a copy."""
        return self._arrays[path][start : min(stop, self.count)]

    def enlarge(self, capacity: int) -> None:
        """Make room for more rows."""
        for column in self._columns:
            kept = self._arrays[column.path][: self.count]
            self._arrays[column.path] = np.empty((capacity, *column.row))
            self._arrays[column.path][: self.count] = kept
        self.capacity = capacity


def count_rows(columns: tuple[Column, ...], rows: Mapping[str, Floats]) -> int:
    """Number of rows in arrays that are to be appended; raises ValueError if they do not fit the columns."""
    if set(rows) != {column.path for column in columns}:
        raise ValueError(f"columns {sorted(rows)} are not those of the store")
    count = len(rows[columns[0].path])
    for column in columns:
        if np.shape(rows[column.path]) != (count, *column.row):
            raise ValueError(f"{column.path} has shape {np.shape(rows[column.path])}, not {count} rows")
    return count


class MemoryStore:
    """Rows in memory; see `RowStore`."""

    def __init__(self, columns: tuple[Column, ...]) -> None:
        self._columns = columns
        self._block = Block(columns, 16)

    @property
    def columns(self) -> tuple[Column, ...]:
        """What a row is made of."""
        return self._columns

    def __len__(self) -> int:
        return self._block.count

    def append(self, rows: Mapping[str, Floats]) -> None:
        """Add k rows: an array (k, *row) of each column, by path. They are copied."""
        more = count_rows(self._columns, rows)
        if len(self) + more > self._block.capacity:
            self._block.enlarge(max(2 * self._block.capacity, len(self) + more))
        self._block.add(rows, 0, more)

    def drop_after(self, count: int) -> None:
        """Keep the first `count` rows only."""
        if not 0 <= count <= len(self):
            raise ValueError(f"cannot keep {count} of {len(self)} rows")
        self._block.count = count

    def read(self, path: str, start: int, stop: int) -> Floats:
        """Rows `start` to `stop` (not included) of a column, copied."""
        return self._block.view(path, start, stop).copy()

    def close(self) -> None:
        """Nothing has to be done."""
