"""Constant matrices that act on each node by its mass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, kron


def each_node(mass: NDArray[np.float64], block: NDArray[np.float64]) -> csr_array:
    """(3n, 3n): m_i B on the diagonal for the nodes' masses (n,) [kg] and one block (3, 3)."""
    matrix = csr_array(kron(diags_array(mass), block))
    matrix.eliminate_zeros()
    return matrix
