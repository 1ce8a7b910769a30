"""Derivatives of a net's forces as one sparse matrix with a pattern found once: eq. (5) and the damping."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from exunet.codegen.kernel import term_kernel
from exunet.forces import cable
from exunet.forces.terms import Terms
from exunet.net.arrays import Net

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PUSH = 1e-4  # of the net's size, and of its speed: the step of the differences of kernel terms


class Linearised:
    """-(a df/dx + b df/dv) over the free coordinates of a net, for any a and b, as a csr matrix.

    The elements' part is exact. Of kernel terms only what a node's force owes to its own position and
    velocity is taken, by central differences: what is left out slows Newton's iteration, but does not change
    its result.
    """

    def __init__(self, net: Net, terms: Terms, *, elements: bool = True) -> None:
        self._net = net
        self._terms = terms
        self._law = terms.law(net) if elements else None
        self._size = net.size
        free = np.ones(net.n_nodes, dtype=bool)
        free[net.fixed_nodes] = False
        self._number = np.where(np.repeat(free, 3), np.cumsum(np.repeat(free, 3)) - 1, -1)
        rows, columns = (np.concatenate(part) for part in zip(*self._entries(), strict=True))
        self._keep = (self._number[rows] >= 0) & (self._number[columns] >= 0)
        self._lay(self._number[rows[self._keep]], self._number[columns[self._keep]])

    def _entries(self) -> Iterator[tuple[Ints, Ints]]:
        """Rows and columns of every contribution, in the order of `_values`."""
        axis = np.arange(3)
        nodes = 3 * np.arange(self._net.n_nodes)
        pairs = [(nodes, nodes)]
        if self._law is not None:
            i, j = 3 * self._net.element_nodes.T
            pairs += [(i, i), (j, j), (i, j), (j, i)]
        for a, b in pairs:
            shape = (len(a), 3, 3)
            yield (
                np.broadcast_to(a[:, None, None] + axis[:, None], shape).ravel(),
                np.broadcast_to(b[:, None, None] + axis, shape).ravel(),
            )
        for matrix in (self._terms.stiffness, self._terms.on_velocity):
            if matrix is not None:
                entries = coo_array(matrix)
                yield entries.row.astype(np.int64), entries.col.astype(np.int64)

    def _lay(self, rows: Ints, columns: Ints) -> None:
        n = int(self._number.max(initial=-1)) + 1
        cells, self._cell = np.unique(rows * n + columns, return_inverse=True)
        starts = np.searchsorted(cells, np.arange(n + 1) * n)
        self._matrix = csr_array((np.zeros(len(cells)), cells % max(n, 1), starts), shape=(n, n))

    def __call__(
        self, time: float, x: Floats, v: Floats, of_position: float, of_velocity: float
    ) -> csr_array:
        """The matrix at positions x and velocities v, (3 n_nodes,); the next call uses its arrays again."""
        values = np.concatenate(list(self._values(time, x, v, of_position, of_velocity)))[self._keep]
        self._matrix.data[:] = np.bincount(self._cell, values, len(self._matrix.data))
        return self._matrix

    def _values(self, time: float, x: Floats, v: Floats, a: float, b: float) -> Iterator[Floats]:
        yield self._of_kernels(time, x, v, a, b).ravel()
        if self._law is not None:
            span = cable.spans(self._net, x.reshape(-1, 3))
            rate = cable.spans(self._net, v.reshape(-1, 3))
            stiffness, damping = cable.tangent_blocks(self._law, span, rate)
            blocks = (a * stiffness if damping is None else a * stiffness + b * damping).ravel()
            for sign in (1.0, 1.0, -1.0, -1.0):
                yield sign * blocks
        for factor, matrix in ((a, self._terms.stiffness), (b, self._terms.on_velocity)):
            if matrix is not None:
                yield factor * coo_array(matrix).data

    def _of_kernels(self, time: float, x: Floats, v: Floats, a: float, b: float) -> Floats:
        """(n_nodes, 3, 3) blocks of the kernel terms on the diagonal."""
        blocks = np.zeros((self._net.n_nodes, 3, 3))
        if not self._terms.kernels:
            return blocks
        kernel = term_kernel(self._terms.kernels)
        place, speed = x.reshape(-1, 3), v.reshape(-1, 3)
        steps = (_PUSH * self._size, _PUSH * (float(np.abs(v).max(initial=0.0)) or 1.0))
        for axis in range(3):
            for factor, push, moves in ((a, steps[0], 1.0), (b, steps[1], 0.0)):
                off = np.zeros(3)
                off[axis] = push
                ahead, behind = (
                    kernel.forces(time, place + sign * moves * off, speed + sign * (1.0 - moves) * off)
                    for sign in (1.0, -1.0)
                )
                blocks[:, :, axis] -= factor * (ahead - behind) / (2.0 * push)
        return blocks
