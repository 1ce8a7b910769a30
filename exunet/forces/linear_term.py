"""The term of all forces that are linear in the state: constant matrices and loads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces import loops
from exunet.forces.terms import DiscreteStates, KernelCall, Term


@dataclass(frozen=True, eq=False)
class LinearTerm(Term):
    """Constant matrices and loads: the force load - (damping + gyroscopic) v - stiffness x.

    damping    : (n, n) [N s/m], symmetric positive semi-definite; takes out the power v . damping v
    gyroscopic : (n, n) [N s/m], antisymmetric; does no work
    stiffness  : (n, n) [N/m], symmetric, on absolute positions; potential energy x . stiffness x / 2
    load       : (n,) [N]; potential energy -load . x
    With n = 3 n_points; None: nothing of it exists.
    """

    damping: scipy.sparse.csr_array | None = None
    gyroscopic: scipy.sparse.csr_array | None = None
    stiffness: scipy.sparse.csr_array | None = None
    load: Floats | None = None

    def __add__(self, other: LinearTerm) -> LinearTerm:
        pairs = zip(self._parts(), other._parts(), strict=True)
        return LinearTerm(*(a if b is None else b if a is None else a + b for a, b in pairs))

    def _parts(self) -> tuple[Any, ...]:
        return self.damping, self.gyroscopic, self.stiffness, self.load

    @property
    def _size(self) -> int:
        """3 n_points."""
        return next(part.shape[0] for part in self._parts() if part is not None)

    def data_at(self, discrete: DiscreteStates) -> tuple[tuple[Any, ...], ...]:
        return tuple(call.data for call in self.calls)

    @property
    def on_velocity(self) -> scipy.sparse.csr_array | None:
        """damping + gyroscopic; None: neither."""
        if self.damping is None or self.gyroscopic is None:
            return self.gyroscopic if self.damping is None else self.damping
        return self.damping + self.gyroscopic

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        """A call for the velocities, one for the positions, one for the load; what is absent has none."""
        found = []
        if self.on_velocity is not None:
            damps = self.damping is not None
            taken = loops.velocity_product_power if damps else None
            rows = rows_of(self.on_velocity)
            found.append(
                KernelCall(loops.add_velocity_product, rows, power=taken, tells_power=damps, of_many=True)
            )
        if self.stiffness is not None:
            found.append(KernelCall(loops.add_position_product, rows_of(self.stiffness), of_many=True))
        if self.load is not None:
            load = loops.Load(np.asarray(self.load, dtype=float))
            found.append(KernelCall(loops.add_load, load, of_many=True))
        return tuple(found)

    @property
    def dissipates(self) -> bool:
        return self.damping is not None

    @property
    def has_potential(self) -> bool:
        return self.load is not None or self.stiffness is not None

    def potential(self, flat: Floats) -> Floats:
        """Potential energy [J] of states x (k, n_x) -> (k,)."""
        energy, flat = np.zeros(len(flat)), flat[:, : self._size]
        if self.load is not None:
            energy -= np.einsum("ki,i->k", flat, self.load)  # not `@`: its bits depend on how many states
        if self.stiffness is not None:
            energy += 0.5 * np.einsum("ki,ki->k", flat, (self.stiffness @ flat.T).T)
        return energy

    def power(self, flat: Floats) -> Floats:
        """Power [W] that the damping takes out at velocities v (k, n_v) -> (k,)."""
        if self.damping is None:
            return np.zeros(len(flat))
        flat = flat[:, : self._size]
        return np.einsum("ki,ki->k", flat, (self.damping @ flat.T).T)

    def numbers(self) -> Iterator[Any]:
        for matrix in (self.damping, self.gyroscopic, self.stiffness):
            if matrix is not None:
                yield matrix.data
        if self.load is not None:
            yield self.load


def rows_of(matrix: scipy.sparse.csr_array) -> loops.SparseRows:
    """A matrix as compiled loops take it."""
    matrix = scipy.sparse.csr_array(matrix)
    start, column = matrix.indptr.astype(loops.Index), matrix.indices.astype(loops.Index)
    return loops.SparseRows(start, column, np.asarray(matrix.data, dtype=float))


def each_node(mass: NDArray[np.float64], block: NDArray[np.float64]) -> scipy.sparse.csr_array:
    """(3n, 3n): m_i B on the diagonal for the nodes' masses (n,) [kg] and one block (3, 3)."""
    matrix = scipy.sparse.csr_array(scipy.sparse.kron(scipy.sparse.diags_array(mass), block))
    matrix.eliminate_zeros()
    return matrix
