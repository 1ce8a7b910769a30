"""Arrays over the stored times that may be larger than memory, and passes over them block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLOCK_BYTES = 16 << 20  # of an array that is looked at in one piece


class StoredRows(NDArrayOperatorsMixin):
    """An array whose rows stay where they are stored, and are read when they are asked for.

    Rows are chosen as in an array: `states[7]`, `states[100:200]`, `states[rows, 3]`; only the chosen ones
    are read. Anything else, such as `states.max()` or `states - 1`, reads the whole into memory first.

    read  : gives rows start to stop (not included) as an array
    shape : as of an array
    """

    def __init__(self, read: Callable[[int, int], Floats], shape: tuple[int, ...]) -> None:
        self._read = read
        self.shape = shape
        self.ndim = len(shape)
        self.dtype = np.dtype(np.float64)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        first, *others = key if isinstance(key, tuple) else (key,)
        if first is Ellipsis or first is None:
            return np.asarray(self)[key]
        if isinstance(first, slice):
            start, stop, step = first.indices(len(self))
            if step <= 0:
                return np.asarray(self)[key]
            rows = self._read(start, max(start, stop))[::step]
            return rows[(slice(None), *others)]
        chosen = np.arange(len(self))[first]
        if chosen.ndim == 0:
            row = self._read(int(chosen), int(chosen) + 1)[0]
            return row[tuple(others)] if others else row
        return self._some(chosen)[(slice(None), *others)]

    def _some(self, chosen: NDArray[np.int64]) -> Floats:
        """The rows of a vector of indexes: in one piece if they lie close together, else one by one."""
        low, high = int(chosen.min(initial=len(self))), int(chosen.max(initial=-1)) + 1
        if high - low <= 4 * len(chosen):
            return self._read(low, max(low, high))[chosen - low]
        return np.concatenate([self._read(k, k + 1) for k in chosen.tolist()])

    def __iter__(self) -> Iterator[Floats]:
        for block in blocks(self):
            yield from block

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self._read(0, len(self)), dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        whole = [np.asarray(one) if isinstance(one, StoredRows) else one for one in inputs]
        return getattr(ufunc, method)(*whole, **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)


def blocks(values: Any) -> Iterator[Floats]:
    """Consecutive rows of an array or of StoredRows, as arrays of at most 16 MB (or one row)."""
    per_row = 8 * int(np.prod(values.shape[1:], dtype=np.int64))
    yield from (values[a:b] for a, b in row_ranges(len(values), max(1, BLOCK_BYTES // max(1, per_row))))


def row_ranges(count: int, size: int) -> Iterator[tuple[int, int]]:
    """Start and stop of consecutive groups of at most `size` rows; one empty group for no rows."""
    for start in range(0, max(1, count), size):
        yield start, min(start + size, count)


def over_blocks(measure: Callable[[Floats], Floats], values: Any) -> Floats:
    """What `measure` makes of each row of `values`, found block by block."""
    return np.concatenate([measure(block) for block in blocks(values)])
