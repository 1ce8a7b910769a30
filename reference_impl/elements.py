"""The elements of a net: kinematics and the law of the cable, eqs. (6)-(8).

x is the array (n, 3) of nodal positions [m], v that of velocities [m/s]; d_e = x_j - x_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reference_impl.arrays import Bools, Floats, Ints, dot
from reference_impl.effects import Effects
from reference_impl.net import Net

NOTHING = Effects()


@dataclass(frozen=True, eq=False)
class Elements:
    """A net and the effects on it: what each element needs to know, worked out once."""

    net: Net
    effects: Effects = NOTHING

    @cached_property
    def ends(self) -> tuple[Ints, Ints]:
        """First and second node (m,) of each element."""
        i, j = np.ascontiguousarray(self.net.element_nodes.T)
        return i, j

    @cached_property
    def squared_reference_length(self) -> Floats:
        return self.net.reference_length * self.net.reference_length

    @cached_property
    def axial_stiffness(self) -> Floats:
        """E A / L of each undeformed element (m,) [N/m]."""
        return self.net.youngs_modulus * self.net.area / self.net.reference_length

    @cached_property
    def reference_direction(self) -> Floats:
        """Unit vectors (m, 3) from i to j in the reference configuration."""
        return self.net.direction

    @cached_property
    def free_strain(self) -> float:
        """Green-Lagrange strain e [-] at which an element is free of stress: 0 but for thermal_strain."""
        thermal = self.effects.thermal_strain
        return 0.0 if thermal is None else thermal.free_strain


def span(system: Elements, x: Floats) -> Floats:
    """d_e = x_j - x_i, (..., m, 3), of positions (or velocities) (..., n, 3)."""
    i, j = system.ends
    return np.asarray(x.take(j, axis=-2) - x.take(i, axis=-2))


def length(system: Elements, x: Floats) -> Floats:
    """Current lengths L_e (..., m) [m], eq. (7)."""
    d = span(system, x)
    return np.sqrt(dot(d, d))


def strain_of(system: Elements, d: Floats, reference_length: Floats | None = None) -> Floats:
    """E11 (..., m) [-], eq. (6), of element vectors d (..., m, 3) [m]; lengths: the net's if None."""
    reference = system.squared_reference_length if reference_length is None else reference_length**2
    return np.asarray(0.5 * (dot(d, d) - reference) / reference)


def strain(system: Elements, x: Floats, reference_length: Floats | None = None) -> Floats:
    """Green-Lagrange strain E11 (..., m) [-], eq. (6), against the reference configuration.

    An element is slack below the free strain e, which is 0 without thermal_strain.  Reference lengths
    (..., m) [m] are the net's where None are given.
    """
    return strain_of(system, span(system, x), reference_length)


def excess(system: Elements, e11: Floats) -> Floats:
    """E11 - e (..., m) [-]: what stretches the element, negative where it is slack."""
    return np.asarray(e11 - system.free_strain) if system.free_strain else e11


def stress(system: Elements, e11: Floats) -> Floats:
    """Second Piola-Kirchhoff stress S11 (..., m) [Pa] at strains E11, eq. (8): none in compression."""
    return np.asarray(system.net.youngs_modulus * np.maximum(excess(system, e11), 0.0))


def tension(
    system: Elements, x: Floats, intact: Bools | None = None, reference_length: Floats | None = None
) -> Floats:
    """Elastic axial force N = S11 A L / L_ref (..., m) [N]: of the deformed cable on its ends, eq. (8).

    Zero where an element is not `intact` (..., m); None: none is broken.  Reference lengths as in `strain`.
    """
    s11 = stress(system, strain(system, x, reference_length))
    reference = system.net.reference_length if reference_length is None else reference_length
    force = np.asarray(s11 * system.net.area * length(system, x) / reference)
    return force if intact is None else np.where(intact, force, 0.0)
