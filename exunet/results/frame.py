"""Columns over time as a pandas table; pandas is an optional extra."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import MissingExtra

if TYPE_CHECKING:
    from pandas import DataFrame

Floats = NDArray[np.float64]


def frame(time: Floats, columns: Mapping[str, Floats]) -> DataFrame:
    """A table with the times (n,) [s] as its index and named columns (n,).

    Raises MissingExtra without pandas.
    """
    return table("time [s]", time, columns)


def table(name: str, index: NDArray[Any], columns: Mapping[str, NDArray[Any]]) -> DataFrame:
    """A table with a named index (n,) and named columns (n,); raises MissingExtra without pandas."""
    try:
        from pandas import DataFrame, Index
    except ImportError:
        raise MissingExtra("a table of a result needs pandas: pip install 'exunet[pandas]'") from None
    return DataFrame(dict(columns), index=Index(index, name=name))
