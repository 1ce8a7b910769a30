"""The kernel of one net: which pieces it has, their data, and the compiled functions on them."""

from __future__ import annotations

from functools import cached_property, lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from exunet.codegen import drivers
from exunet.codegen.compile import compiled_module, interpreted_module, numba_installed
from exunet.codegen.generate import Function, Piece, data_of, module_source
from exunet.forces import kernels as pieces
from exunet.forces.terms import KernelTerm, Terms
from exunet.net.arrays import Net

Floats = NDArray[np.float64]
# Unsigned, so that the compiled code need not look for negative (wrapped) indexes.
Index = np.uint32
_FACTOR = 3  # in the data of `_elements`, which is a net's first piece


class Kernel:
    """The forces of some pieces on n_nodes nodes; `extra` functions join those of `drivers` in the module.

    data : the parameters of all pieces, to be handed to the functions of `module`
    """

    def __init__(self, parts: list[Piece], extra: tuple[Function, ...] = ()) -> None:
        self.data: tuple[Any, ...] = data_of(parts)
        self.source = module_source(parts, (*drivers.DRIVERS, *extra))

    @cached_property
    def module(self) -> ModuleType:
        """Compiled where Numba is installed, else interpreted."""
        return compiled_module(self.source) if numba_installed() else interpreted_module(self.source)

    def forces(self, time: float, position: Floats, velocity: Floats) -> Floats:
        """(n_nodes, 3) [N] from position and velocity (n_nodes, 3)."""
        force = np.empty(position.size)
        x, v = (np.array(a, dtype=float).ravel() for a in (position, velocity))
        self.module.forces(time, x, v, self.data, force)
        return force.reshape(-1, 3)

    def potential(self, position: Floats) -> Floats:
        """Potential energy of the pieces that have one [J]; (k, n_nodes, 3) -> (k,)."""
        energy = np.empty(len(position))
        flat = np.array(position, dtype=float).reshape(len(position), -1)
        self.module.potentials(flat, self.data, energy)
        return energy

    def power(self, time: Floats, position: Floats, velocity: Floats) -> Floats:
        """Power that the pieces without a potential take out [W]; (k,), (k, n_nodes, 3) twice -> (k,)."""
        taken = np.empty(len(time))
        x, v = (np.array(a, dtype=float).reshape(len(time), -1) for a in (position, velocity))
        self.module.powers(np.array(time, dtype=float), x, v, self.data, taken)
        return taken


def net_kernel(net: Net, terms: Terms, extra: tuple[Function, ...] = ()) -> Kernel:
    """All forces on the nodes of a net: the elements and every term of the effects."""
    return Kernel([_elements(net, terms), *_constant(terms), *map(_piece, terms.kernels)], extra)


@lru_cache(maxsize=8)
def term_kernel(kernels: tuple[KernelTerm, ...]) -> Kernel:
    """The nonlinear terms alone, for the forms that take the rest in another way."""
    return Kernel([_piece(term) for term in kernels])


def _elements(net: Net, terms: Terms) -> Piece:
    law = terms.law(net)
    first, second = (3 * net.element_nodes.T).astype(Index)
    length = law.natural_length
    data = (first, second, length**2, law.stiffness / (2.0 * length**3))
    if law.relaxation_time is None:
        return Piece(pieces.add_tension, data, elastic=True)
    return Piece(
        pieces.add_viscous_tension,
        (*data, 2.0 * law.relaxation_time),
        work=pieces.viscous_work,
        helpers=(pieces.excess_and_rate,),
        elastic=True,
    )


def sever(kernel: Kernel, elements: NDArray[np.int64]) -> None:
    """Let elements of a net's kernel carry nothing from now on."""
    kernel.data[_FACTOR][elements] = 0.0


def _constant(terms: Terms) -> list[Piece]:
    parts = []
    if terms.on_velocity is not None:
        taken = pieces.velocity_product_power if terms.damping is not None else None
        parts.append(Piece(pieces.add_velocity_product, _rows(terms.on_velocity), power=taken))
    if terms.stiffness is not None:
        parts.append(Piece(pieces.add_position_product, _rows(terms.stiffness)))
    if terms.load is not None:
        parts.append(Piece(pieces.add_load, (np.asarray(terms.load, dtype=float),)))
    return parts


def _rows(matrix: csr_array) -> tuple[Any, ...]:
    matrix = csr_array(matrix)
    return matrix.indptr.astype(Index), matrix.indices.astype(Index), np.asarray(matrix.data, dtype=float)


def _piece(term: KernelTerm) -> Piece:
    return Piece(
        term.add,
        term.parameters,
        potential=term.potential,
        helpers=term.helpers,
        works=term.potential is None,
    )
