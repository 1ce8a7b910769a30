"""Types of arrays, and the scalar product whose additions keep mirror symmetries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

Vector = tuple[float, float, float]


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products along the last axis (3).  x + y comes first: swapping x and y changes no bit of it."""
    c = a * b
    return np.asarray((c[..., 0] + c[..., 1]) + c[..., 2])
