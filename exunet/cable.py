"""The cable element: eqs. (3) to (8) of the paper, once for NumPy and for the engine's expressions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from exunet.net.arrays import Net

Floats = NDArray[np.float64]


def green_lagrange_strain(length: Any, reference_length: Any) -> Any:
    """E11 of eq. (6): (L^2 - L0^2) / (2 L0^2), written in the stretch to keep all digits near L = L0."""
    stretch = length / reference_length
    return 0.5 * (stretch - 1.0) * (stretch + 1.0)


def tension(
    length: Any, reference_length: Any, axial_stiffness: Any, maximum: Callable[[Any, Any], Any] = np.maximum
) -> Any:
    """Axial force N = S11 A L / L0 [N], positive in tension, zero when slack: eqs. (3) and (8).

    The magnitude of S_e x_e of eq. (3): the second Piola-Kirchhoff stress times the reference area,
    carried along the current direction with the factor L / L0. `maximum` lets the same line serve
    floats, arrays (`numpy.maximum`) and the engine's symbolic reals.
    """
    strain = maximum(green_lagrange_strain(length, reference_length), 0.0)
    return axial_stiffness * strain * (length / reference_length)


def viscous_tension(
    length: Any,
    rate: Any,
    reference_length: Any,
    axial_stiffness: Any,
    relaxation_time: Any,
    maximum: Callable[[Any, Any], Any] = np.maximum,
    where: Callable[[Any, Any, Any], Any] = np.where,
) -> Any:
    """Axial force [N] with S11 = max(E (E11 + tau dE11/dt), 0) while E11 > 0, else zero; rate = dL/dt [m/s]."""
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


def lengths(net: Net, position: Floats) -> Floats:
    """Current element lengths [m], eq. (7); position (..., n_nodes, 3) -> (..., n_elements)."""
    i, j = net.element_nodes.T
    return np.linalg.norm(position[..., j, :] - position[..., i, :], axis=-1)


def elastic_energy(net: Net, length: Floats) -> Floats:
    """U_el of eq. (19) [J]; length (..., n_elements) -> (...)."""
    strain = np.maximum(green_lagrange_strain(length, net.reference_length), 0.0)
    return 0.5 * (strain**2) @ (net.axial_stiffness * net.reference_length)


def reference_tangent_stiffness(net: Net) -> csr_array:
    """T of eqs. (5) and (14) in the reference configuration, (3n, 3n) [N/m].

    S11 is zero there, so each element adds (EA / L0) n n^T to its two nodes, n its reference direction.
    """
    i, j = net.element_nodes.T
    span = net.reference_position[j] - net.reference_position[i]
    blocks = np.einsum("e,ea,eb->eab", net.axial_stiffness / net.reference_length**3, span, span)
    return assemble_pairs(net, blocks)


def assemble_pairs(net: Net, blocks: Floats) -> csr_array:
    """Sum of A_e^T [[B, -B], [-B, B]] A_e over the elements; blocks B (n_elements, 3, 3) -> (3n, 3n)."""
    i, j = net.element_nodes.T
    axis = np.arange(3)
    rows, cols, values = [], [], []
    for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
        rows.append(np.broadcast_to(3 * a[:, None, None] + axis[:, None], blocks.shape).ravel())
        cols.append(np.broadcast_to(3 * b[:, None, None] + axis, blocks.shape).ravel())
        values.append(sign * blocks.ravel())
    size = 3 * net.n_nodes
    matrix = coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(size, size)
    ).tocsr()
    matrix.eliminate_zeros()
    return csr_array(matrix)
