"""What an effect adds to the equations of motion, as data that every form of the engine can take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array


@dataclass(frozen=True)
class Terms:
    """Constant terms on the nodal coordinates: force = load - damping @ v (n = 3 x nodes, node-wise x, y, z).

    damping : (n, n) [N s/m], symmetric positive semi-definite; None: no such term
    load    : (n,) [N], with the potential energy -load . x; None: no such term
    """

    damping: csr_array | None = None
    load: NDArray[np.float64] | None = None

    def __add__(self, other: Terms) -> Terms:
        return Terms(_add(self.damping, other.damping), _add(self.load, other.load))


def _add(a, b):  # type: ignore[no-untyped-def]
    if a is None or b is None:
        return a if b is None else b
    return a + b
