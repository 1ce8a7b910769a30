"""The elements of a net: kinematics, the law of the cable and its matrices, eqs. (3)-(8), (12)-(14).

x is the array (n, 3) of nodal positions [m], v that of velocities [m/s]; d_e = x_j - x_i.

In matrices (3n, 3n) degree of freedom 3 i + c is component c of node i.  They are those of the cables' law,
with its free strain; the springs of `bending` are not in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

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


@dataclass(frozen=True, eq=False)
class Carried:
    """What elements (..., m) carry at a strain, each over E or E A.

    The stress S11, which is N/(A q) at the stretch q; its slope dS11/dE11 where taut; the energy U/(A L); and
    the viscous stress over tau dE11/dt.
    """

    stress: Floats
    slope: Floats
    energy: Floats
    viscous: Floats


def carried(system: Elements, e11: Floats, element: Ints | None = None) -> Carried:
    """Of elements at the strains E11 (..., m); those named, if not all.

    Eq. (8), or for the laws by curves: N = E A f(e), e = q - 1, U/(E A L) = the area under f, and the viscous
    tension tau E A f' dq/dt, in which dq/dt = dE11/dt / q.
    """
    taut = np.maximum(excess(system, e11), 0.0)
    found = Carried(taut, np.ones_like(taut), 0.5 * taut * taut, np.ones_like(taut))
    law = system.net.law if element is None else system.net.law[element]
    for number, points in enumerate(system.net.curves):
        own = law == number
        q = np.sqrt(1.0 + 2.0 * np.maximum(e11[..., own], 0.0))
        e = 2.0 * np.maximum(e11[..., own], 0.0) / (1.0 + q)
        at = np.clip(np.searchsorted(points[:, 0], e, side="right") - 1, 0, len(points) - 2)
        width, height = np.diff(points, axis=0).T
        below = np.concatenate(([0.0], np.cumsum(0.5 * width * (points[1:, 1] + points[:-1, 1]))))
        slope, over = (height / width)[at], e - points[at, 0]
        force = points[at, 1] + slope * over
        found.stress[..., own] = force / q
        found.slope[..., own] = slope / q**2 - force / q**3
        found.energy[..., own] = below[at] + 0.5 * over * (points[at, 1] + force)
        found.viscous[..., own] = slope / q**2
    return found


def stress(system: Elements, e11: Floats) -> Floats:
    """Second Piola-Kirchhoff stress S11 (..., m) [Pa] at strains E11, eq. (8): none in compression."""
    return np.asarray(system.net.youngs_modulus * carried(system, e11).stress)


def energy_density(system: Elements, e11: Floats) -> Floats:
    """U/(A L) (..., m) [J/m3] at strains E11: S11 (E11 - e)/2 for eq. (8)."""
    return np.asarray(system.net.youngs_modulus * carried(system, e11).energy)


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


def secant_element(system: Elements, x: Floats) -> Floats:
    """Secant stiffness S_e (m, 6, 6) [N/m], eqs. (3), (4)."""
    s = stress(system, strain(system, x)) * system.net.area / system.net.reference_length
    delta = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.eye(3))
    return np.asarray(s[:, None, None] * delta)


def tangent_element(system: Elements, x: Floats) -> Floats:
    """Tangent stiffness T_e (m, 6, 6) [N/m], eq. (5)."""
    e11 = strain(system, x)
    slope = np.where(excess(system, e11) >= 0.0, carried(system, e11).slope, 0.0)
    return secant_element(system, x) + _stretching(system, span(system, x), slope)


def _stretching(system: Elements, d: Floats, taut: Floats) -> Floats:
    """Second part of eq. (5), dS11/dE11 A / L_ref^3 (Delta x_e)(Delta x_e)^T, (m, 6, 6) [N/m]."""
    factor = taut * system.axial_stiffness / system.squared_reference_length
    column = np.concatenate((-d, d), axis=1)  # Delta x_e
    return np.asarray(factor[:, None, None] * column[:, :, None] * column[:, None, :])


def assembled(system: Elements, blocks: Floats) -> csr_array:
    """Sum of A_e^T K_e A_e over the elements, (3n, 3n) sparse, of blocks K_e (m, 6, 6): eqs. (12), (14)."""
    dofs = (3 * system.net.element_nodes[:, :, None] + np.arange(3)).reshape(-1, 6)
    rows, columns = np.repeat(dofs, 6, axis=1).ravel(), np.tile(dofs, 6).ravel()
    size = 3 * len(system.net.mass)
    return csr_array(coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)))


def secant(system: Elements, x: Floats) -> csr_array:
    """Secant stiffness S(x) (3n, 3n) [N/m], eq. (12)."""
    return assembled(system, secant_element(system, x))


def tangent(system: Elements, x: Floats) -> csr_array:
    """Tangent stiffness T(x) (3n, 3n) [N/m], eq. (14)."""
    return assembled(system, tangent_element(system, x))


def damping(system: Elements, x: Floats | None = None) -> csr_array:
    """Damping matrix (3n, 3n) [N s/m]: D = alpha M + beta T(x_ref) of eq. (13), and mass_damping's alpha M.

    In the reference configuration E11 = 0 by definition, which eq. (8) counts as taut; round-off must not
    decide it, nor does a free strain: D is the paper's constant matrix.  Given positions x (n, 3), the matrix
    of material_damping there, at zero velocity, is added.
    """
    d = system.reference_direction * system.net.reference_length[:, None]
    blocks = system.effects.beta * _stretching(system, d, np.ones(len(d)))
    if x is not None and system.effects.relaxation_time:
        e11 = strain(system, x)
        pulled = system.effects.relaxation_time * carried(system, e11).viscous
        taut = np.where(excess(system, e11) > 0.0, pulled, 0.0)
        blocks += _stretching(system, span(system, x), taut)
    viscous = assembled(system, blocks)
    mass = np.repeat(mass_proportional(system)[:, 0], 3)
    diagonal = np.arange(len(mass))
    return csr_array(viscous + coo_array((mass, (diagonal, diagonal)), shape=viscous.shape))


def mass_proportional(system: Elements) -> Floats:
    """Damping of each node (n, 1) [N s/m] in proportion to its mass: of Rayleigh's kind and mass_damping."""
    effects = system.effects
    return np.asarray(((effects.alpha + effects.mass_damping) * system.net.own_mass)[:, None])
