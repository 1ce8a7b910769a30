"""Cable elements of a net: their lengths, tensions, energy and matrices, eqs. (3) to (8) of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from exunet.base.arrays import Floats
from exunet.forces.law import energy, green_lagrange_strain, tension
from exunet.net.arrays import Net

# Part of a tether's length up to which its ends are at one place: the line between them is round-off.
NO_WAY = 1e-9

_AT_ONCE = 2**14  # elements times states, for arrays that stay in the processor's cache


def viscous_tension(
    length: Any,
    rate: Any,
    reference_length: Any,
    axial_stiffness: Any,
    relaxation_time: Any,
    maximum: Callable[[Any, Any], Any] = np.maximum,
    where: Callable[[Any, Any, Any], Any] = np.where,
) -> Any:
    """Axial force [N] of S11 = max(E (E11 + tau dE11/dt), 0) where E11 > 0, else zero; rate = dL/dt [m/s]."""
    strain = green_lagrange_strain(length, reference_length)
    stretch = length / reference_length
    viscous = relaxation_time * stretch * (rate / reference_length)
    return axial_stiffness * where(strain > 0.0, maximum(strain + viscous, 0.0), 0.0) * stretch


@dataclass(frozen=True)
class Law:
    """The constants of the elements' axial law, a free strain taken in; arrays of (n_elements,).

    natural_length  : length that is free of stress [m]
    stiffness       : axial stiffness [N] that goes with the strain relative to natural_length
    relaxation_time : tau of the viscous stress [s], None without it

    With a free strain e, E11 - e = (L1 / L0)^2 (L^2 - L1^2) / (2 L1^2) where L1 = L0 sqrt(1 + 2 e): the
    law is that of an element of length L1 and stiffness EA (L1 / L0)^3, in force and in energy.
    """

    natural_length: Floats
    stiffness: Floats
    relaxation_time: Floats | None = None

    @classmethod
    def of(cls, net: Net, free_strain: Floats | None = None, relaxation_time: Floats | None = None) -> Law:
        """The law of a net's elements."""
        if free_strain is None:
            return cls(net.reference_length, net.axial_stiffness, relaxation_time)
        ratio = np.sqrt(1.0 + 2.0 * free_strain)
        return cls(net.reference_length * ratio, net.axial_stiffness * ratio**3, relaxation_time)

    def of_intact(self, intact: Floats | None) -> Law:
        """The law where elements with intact (n_elements,) = 0 carry nothing; None: all are whole."""
        return self if intact is None else replace(self, stiffness=self.stiffness * intact)


def lengths(net: Net, position: Floats) -> Floats:
    """Current element lengths [m], eq. (7); position (..., n_nodes, 3) -> (..., n_elements)."""
    states = position.reshape(-1, *position.shape[-2:])
    n_elements = len(net.element_nodes)
    length = np.empty((len(states), n_elements))
    many = max(1, _AT_ONCE // max(1, n_elements))
    for at in range(0, len(states), many):
        square = spans(net, states[at : at + many])
        square *= square  # a fifth of the time of np.linalg.norm
        np.sqrt(square[..., 0] + square[..., 1] + square[..., 2], out=length[at : at + many])
    return length.reshape(*position.shape[:-2], n_elements)


def spans(net: Net, nodal: Floats) -> Floats:
    """Differences x_j - x_i over the elements; (..., n_nodes, 3) -> (..., n_elements, 3)."""
    i, j = net.element_nodes.T
    difference = nodal.take(j, axis=-2)  # a quarter of the time of indexing
    difference -= nodal.take(i, axis=-2)
    return difference


def element_tension(
    net: Net, law: Law, position: Floats, velocity: Floats, length: Floats | None = None
) -> Floats:
    """Axial forces [N]; position, velocity (..., n_nodes, 3) -> (..., n_elements).

    length : (..., n_elements) [m] where it is known already
    """
    length = lengths(net, position) if length is None else length
    if law.relaxation_time is None:
        return tension(length, law.natural_length, law.stiffness)
    along = np.einsum("...a,...a->...", spans(net, position), spans(net, velocity))
    rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    return viscous_tension(length, rate, law.natural_length, law.stiffness, law.relaxation_time)


def elastic_energy(law: Law, length: Floats) -> Floats:
    """U_el of eq. (19) [J]; length (..., n_elements) -> (...)."""
    strain = green_lagrange_strain(length, law.natural_length)
    # Not `@`, by which the bits would depend on how many states there are.
    return np.asarray(np.einsum("...e,e->...", energy(strain), law.stiffness * law.natural_length))


def reference_spans(net: Net, position: Floats, axes: Floats) -> Floats:
    """(n_elements, 3) from end to end of the elements in the reference configuration [m].

    A tether has none of its own: its elements lie along the straight way between its ends at the start.
    Where that is no longer than `NO_WAY` of the tether, they have no direction: zeros.
    position : (at least n_nodes, 3) at the start [m]
    axes : (3, 3) from the axes in which the net starts to the scene's
    """
    i, j = net.element_nodes.T
    span = (net.reference_position[j] - net.reference_position[i]) @ axes.T
    for tether in net.tethers:
        elements = net.tether_elements[tether.name]
        length = net.reference_length[elements]
        way = position[tether.nodes[-1]] - position[tether.nodes[0]]
        apart = float(np.linalg.norm(way))
        has_direction = apart > NO_WAY * float(length.sum())
        span[elements] = np.outer(length, way / apart) if has_direction else 0.0
    return span


def reference_blocks(net: Net, span: Floats) -> Floats:
    """(n_elements, 3, 3) tangent blocks of just taut elements [N/m]: (EA / L0) n n^T, as S11 is zero."""
    return np.asarray(np.einsum("e,ea,eb->eab", net.axial_stiffness / net.reference_length**3, span, span))


def reference_tangent_stiffness(
    net: Net, position: Floats, axes: Floats, n_points: int | None = None
) -> scipy.sparse.csr_array:
    """T of eqs. (5) and (14) in the reference configuration, (3n, 3n) [N/m]; n_points: n, if not the nodes.

    position : (at least n_nodes, 3) at the start [m], from which tethers have their directions
    axes : (3, 3) from the axes in which the net starts to the scene's
    """
    return assemble_pairs(net, reference_blocks(net, reference_spans(net, position, axes)), n_points)


def assemble_pairs(net: Net, blocks: Floats, n_points: int | None = None) -> scipy.sparse.csr_array:
    """Sum of A_e^T [[B, -B], [-B, B]] A_e over the elements; blocks B (n_elements, 3, 3) -> (3n, 3n)."""
    i, j = net.element_nodes.T
    axis = np.arange(3)
    rows, cols, values = [], [], []
    for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
        rows.append(np.broadcast_to(3 * a[:, None, None] + axis[:, None], blocks.shape).ravel())
        cols.append(np.broadcast_to(3 * b[:, None, None] + axis, blocks.shape).ravel())
        values.append(sign * blocks.ravel())
    size = 3 * (net.n_nodes if n_points is None else n_points)
    matrix = scipy.sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(size, size)
    ).tocsr()
    matrix.eliminate_zeros()
    return scipy.sparse.csr_array(matrix)
