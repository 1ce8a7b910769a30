"""Cable elements of a net: their lengths, tensions, energy and matrices, eqs. (3) to (8) of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.law import (
    STRETCH_BOUND,
    energy,
    green_lagrange_strain,
    longest_stretch,
    response,
    steepest_slope,
    stretch_of,
    stretch_with,
    tension,
)
from exunet.net.arrays import NO_TABLE, Net

# Part of a tether's length up to which its ends are at one place: the line between them is round-off.
NO_WAY = 1e-9

_AT_ONCE = 2**14  # elements times states, for arrays that stay in the processor's cache


def hooke_viscous_tension(
    length: Any,
    rate: Any,
    reference_length: Any,
    axial_stiffness: Any,
    relaxation_time: Any,
    maximum: Callable[[Any, Any], Any] = np.maximum,
    where: Callable[[Any, Any, Any], Any] = np.where,
) -> Any:
    """Axial force [N] of max(EA (s - 1 + tau ds/dt), 0) where the stretch s > 1, else zero."""
    strain = length / reference_length - 1.0
    viscous = relaxation_time * (rate / reference_length)
    return axial_stiffness * where(strain > 0.0, maximum(strain + viscous, 0.0), 0.0)


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
class AxialLaw:
    """The constants of the elements' axial law, a free strain taken in; arrays of (n_elements,).

    natural_length  : length that is free of stress [m]
    stiffness       : axial stiffness [N] that goes with the strain relative to natural_length
    relaxation_time : tau of the viscous stress [s], None without it
    number, table   : laws as in `exunet.forces.law`, and the rows of their tables; None: law 0 everywhere

    With a free strain e, E11 - e = (L1 / L0)^2 (L^2 - L1^2) / (2 L1^2) where L1 = L0 sqrt(1 + 2 e): the
    law is that of an element of length L1 and stiffness EA (L1 / L0)^3, in force and in energy. Of other laws
    only the length is another.
    """

    natural_length: Floats
    stiffness: Floats
    relaxation_time: Floats | None = None
    number: Ints | None = None
    table: Floats = field(default_factory=lambda: NO_TABLE)

    @classmethod
    def of(
        cls, net: Net, free_strain: Floats | None = None, relaxation_time: Floats | None = None
    ) -> AxialLaw:
        """The law of a net's elements."""
        length, stiffness, number = net.reference_length, net.axial_stiffness, net.law_number
        if free_strain is not None:
            ratio = np.sqrt(1.0 + 2.0 * free_strain)
            length = length * ratio
            stiffness = stiffness * (ratio**3 if number is None else np.where(number == 0, ratio**3, 1.0))
        return cls(length, stiffness, relaxation_time, number, net.law_table)

    def of_intact(self, intact: Floats | None) -> AxialLaw:
        """The law where elements with intact (n_elements,) = 0 carry nothing; None: all are whole."""
        return self if intact is None else replace(self, stiffness=self.stiffness * intact)

    def of_elements(self, chosen: Ints | slice) -> AxialLaw:
        """Return the law of some of the elements."""
        time, number = self.relaxation_time, self.number
        return replace(
            self,
            natural_length=self.natural_length[chosen],
            stiffness=self.stiffness[chosen],
            relaxation_time=None if time is None else time[chosen],
            number=None if number is None else number[chosen],
        )

    @cached_property
    def kinds(self) -> tuple[tuple[int, NDArray[np.bool_] | None], ...]:
        """Number of each law, and its elements (n_elements,); None: all."""
        if self.number is None:
            return ((0, None),)
        return tuple((int(number), self.number == number) for number in np.unique(self.number))

    def by_law(self, of_law: Callable[[int, Floats, Floats], Floats], values: Floats) -> Floats:
        """Return f(number, table, values) of each law for its elements, the last axis of the values."""
        found = np.empty_like(values)
        for number, own in self.kinds:
            chosen = slice(None) if own is None else own
            found[..., chosen] = of_law(number, self.table, values[..., chosen])
        return found

    def strain(self, length: Floats) -> Floats:
        """Compute the strain e with the energy EA L1 e^2 / 2; length (..., n_elements) [m]."""
        if self.number is None:
            return np.asarray(green_lagrange_strain(length, self.natural_length))
        held = self.by_law(lambda *of: response(*of)[2], length / self.natural_length)
        return np.asarray(np.sqrt(2.0 * held))

    def tension(self, length: Floats, rate: Floats | None = None) -> Floats:
        """Compute axial forces [N]; length, and its rate [m/s] with viscous stress: (..., n_elements)."""
        natural, time = self.natural_length, self.relaxation_time
        if self.number is None:
            if time is None or rate is None:
                return np.asarray(tension(length, natural, self.stiffness))
            return np.asarray(viscous_tension(length, rate, natural, self.stiffness, time))
        stretch = length / natural
        force = self.by_law(lambda *of: response(*of)[0], stretch)
        if time is not None and rate is not None:
            slope = self.by_law(lambda *of: response(*of)[1], stretch)
            force = np.where(force > 0.0, np.maximum(force + time * slope * (rate / natural), 0.0), 0.0)
        return np.asarray(self.stiffness * force)

    def length_with(self, force: Floats) -> Floats:
        """Compute the lengths [m] at which the elastic tensions are these [N], (n_elements,)."""
        if self.number is None:
            return self.natural_length * stretch_with(force, self.stiffness)
        return self.natural_length * self.by_law(stretch_of, force / self.stiffness)

    @property
    def longest(self) -> Floats:
        """(n_elements,) largest lengths [m] for which the laws are meant."""
        if self.number is None:
            return STRETCH_BOUND * self.natural_length
        return self.by_law(longest_stretch, self.natural_length) * self.natural_length

    @cached_property
    def steepest(self) -> Floats:
        """(n_elements,) largest tangents over those of just taut elements, of law 0 the latter."""
        return self.by_law(steepest_slope, self.natural_length)


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
    net: Net, law: AxialLaw, position: Floats, velocity: Floats, length: Floats | None = None
) -> Floats:
    """Axial forces [N]; position, velocity (..., n_nodes, 3) -> (..., n_elements).

    length : (..., n_elements) [m] where it is known already
    """
    length = lengths(net, position) if length is None else length
    if law.relaxation_time is None:
        return law.tension(length)
    along = np.einsum("...a,...a->...", spans(net, position), spans(net, velocity))
    rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    return law.tension(length, rate)


def elastic_energy(law: AxialLaw, length: Floats) -> Floats:
    """U_el of eq. (19) [J]; length (..., n_elements) -> (...)."""
    strain = law.strain(length)
    # Not `@`, by which the bits would depend on how many states there are.
    return np.asarray(np.einsum("...e,e->...", energy(strain), law.stiffness * law.natural_length))


def reference_spans(net: Net, position: Floats, axes: Floats) -> Floats:
    """(n_elements, 3) from end to end of the elements in the reference configuration [m].

    A tether has none of its own: its elements lie along the straight way between its ends at the start.
    Where that is no longer than `NO_WAY` of the tether, they have no direction: zeros.
    position : (n_nodes, 3) at the start [m]
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


def reference_tangent_stiffness(net: Net, position: Floats, axes: Floats) -> scipy.sparse.csr_array:
    """T of eqs. (5) and (14) in the reference configuration, (3n, 3n) [N/m].

    position : (n_nodes, 3) at the start [m], from which tethers have their directions
    axes : (3, 3) from the axes in which the net starts to the scene's
    """
    return assemble_pairs(net, reference_blocks(net, reference_spans(net, position, axes)))


def assemble_pairs(net: Net, blocks: Floats) -> scipy.sparse.csr_array:
    """Sum of A_e^T [[B, -B], [-B, B]] A_e over the elements; blocks B (n_elements, 3, 3) -> (3n, 3n)."""
    i, j = net.element_nodes.T
    axis = np.arange(3)
    rows, cols, values = [], [], []
    for a, b, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
        rows.append(np.broadcast_to(3 * a[:, None, None] + axis[:, None], blocks.shape).ravel())
        cols.append(np.broadcast_to(3 * b[:, None, None] + axis, blocks.shape).ravel())
        values.append(sign * blocks.ravel())
    size = 3 * net.n_nodes
    matrix = scipy.sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), shape=(size, size)
    ).tocsr()
    matrix.eliminate_zeros()
    return scipy.sparse.csr_array(matrix)
