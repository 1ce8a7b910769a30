"""Arguments of the step API, which may come as any type: the number in it, or None if there is none."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray


def finite_number(given: object) -> float | None:
    """A finite number, else None."""
    if type(given) is float:
        return given if math.isfinite(given) else None
    if isinstance(given, bool) or not isinstance(given, Real):
        return None
    try:
        number = float(given)
    except OverflowError:  # a whole number or a fraction beyond floating point
        return None
    return number if math.isfinite(number) else None


def whole_number(given: object) -> int | None:
    """A whole number of any type, else None."""
    if isinstance(given, bool):
        return None
    try:
        return operator.index(given)  # type: ignore[arg-type]
    except TypeError:
        return None


def finite_vector(given: ArrayLike, number: int) -> NDArray[np.float64] | None:
    """So many finite numbers, or a number alone where it is one, as (number,); else None."""
    if isinstance(given, Sequence) and any(isinstance(one, bool) for one in given):
        return None  # NumPy would take it for a number beside others
    try:
        vector = np.asarray(given)
    except (TypeError, ValueError):
        return None
    if number == 1 and vector.ndim == 0:
        vector = vector[None]
    if vector.shape != (number,) or vector.dtype.kind not in "iuf" or not np.isfinite(vector).all():
        return None
    return vector.astype(np.float64)
