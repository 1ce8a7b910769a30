"""Jacobian of the kernel terms of a scene, a sparse matrix with a fixed pattern, for implicit methods."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.codegen.kernel import term_kernel
from exunet.forces.blocks import Blocks
from exunet.forces.terms import KernelTerm
from exunet.forces.total import Forces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PUSH = 1e-4  # of the net's size, and of its speed: the step of the differences of kernel terms


class Linearised:
    """-(a df/dx + b df/dv) of kernel terms over the free coordinates of the points, for any a and b, as csr.

    Terms are differenced; each couples the points that it declares (`KernelTerm.couples`), and points whose
    columns share no row are displaced together.
    """

    def __init__(self, blocks: Blocks, forces: Forces) -> None:
        self._n = blocks.n_points
        # What only counts has no room for what it counts in forces of the points alone.
        self._kernels = tuple(term for term in forces.kernels if not term.only_states)
        self._size = blocks.net.size
        self._pairs = _coupled(self._kernels, self._n)
        self._groups = _groups(self._pairs, self._n)
        free = np.ones(self._n, dtype=bool)
        free[blocks.net.fixed_nodes] = False
        self._number = np.where(np.repeat(free, 3), np.cumsum(np.repeat(free, 3)) - 1, -1)
        (i, j), axis = 3 * self._pairs.T, np.arange(3)
        shape = (len(self._pairs), 3, 3)
        rows = np.broadcast_to(i[:, None, None] + axis[:, None], shape).ravel()
        columns = np.broadcast_to(j[:, None, None] + axis, shape).ravel()
        self._keep = (self._number[rows] >= 0) & (self._number[columns] >= 0)
        self._lay(self._number[rows[self._keep]], self._number[columns[self._keep]])

    def _lay(self, rows: Ints, columns: Ints) -> None:
        n = int(self._number.max(initial=-1)) + 1
        cells, self._cell = np.unique(rows * n + columns, return_inverse=True)
        starts = np.searchsorted(cells, np.arange(n + 1) * n)
        self._matrix = csr_array((np.zeros(len(cells)), cells % max(n, 1), starts), shape=(n, n))

    def __call__(
        self, time: float, x: Floats, v: Floats, of_position: float, of_velocity: float
    ) -> csr_array:
        """The matrix at positions x and velocities v, (3 n_points,); the next call uses its arrays again."""
        values = self._of_kernels(time, x, v, of_position, of_velocity).ravel()[self._keep]
        self._matrix.data[:] = np.bincount(self._cell, values, len(self._matrix.data))
        return self._matrix

    def _of_kernels(self, time: float, x: Floats, v: Floats, a: float, b: float) -> Floats:
        """(n_pairs, 3, 3) blocks of the kernel terms: rows of the first point, columns of the second."""
        blocks = np.zeros((len(self._pairs), 3, 3))
        if not self._kernels:
            return blocks
        kernel = term_kernel(self._kernels)
        place, speed = x.reshape(-1, 3), v.reshape(-1, 3)
        steps = (_PUSH * self._size, _PUSH * (float(np.abs(v).max(initial=0.0)) or 1.0))
        row, column = self._pairs.T
        for group in range(int(self._groups.max(initial=-1)) + 1):
            members = self._groups == group
            own = members[column]
            for axis in range(3):
                for factor, push, moves in ((a, steps[0], 1.0), (b, steps[1], 0.0)):
                    off = np.zeros((self._n, 3))
                    off[members, axis] = push
                    ahead, behind = (
                        kernel.forces(time, place + sign * moves * off, speed + sign * (1.0 - moves) * off)
                        for sign in (1.0, -1.0)
                    )
                    change = factor * (ahead - behind) / (2.0 * push)
                    blocks[own, :, axis] -= change[row[own]]
        return blocks


def _coupled(kernels: tuple[KernelTerm, ...], n: int) -> Ints:
    """(m, 2) pairs of points whose force (the first) kernel terms couple to the state of the second."""
    own = np.arange(n)
    found = [np.stack([own, own], axis=1)]
    for term in kernels:
        if term.couples is not None:
            sets = np.asarray(term.couples, dtype=np.int64)
            width = sets.shape[1]
            found.append(
                np.stack([np.repeat(sets, width, axis=1), np.tile(sets, (1, width))], -1).reshape(-1, 2)
            )
    return np.unique(np.concatenate(found), axis=0)


def _groups(pairs: Ints, n: int) -> Ints:
    """(n,) numbers such that two points of one number share no row, by greedy colouring.

    Curtis, Powell and Reid, J. Inst. Math. Appl. 13 (1974) 117, doi 10.1093/imamat/13.1.117.
    """
    pattern = csr_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n))
    shared = csr_array(pattern.T @ pattern)
    group = np.full(n, -1, dtype=np.int64)
    for point in range(n):
        taken = set(group[shared.indices[shared.indptr[point] : shared.indptr[point + 1]]].tolist())
        group[point] = next(k for k in range(n) if k not in taken)
    return group
