"""Mechanics of the net: strain, stress, stiffness, damping, loads, acceleration.  Section 2 of the paper.

x is the array (n, 3) of nodal positions [m], v that of velocities [m/s]; d_e = x_j - x_i.  In matrices
(3n, 3n) degree of freedom 3 i + c is component c of node i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array

from reference_impl import mirror
from reference_impl.effects import Effects
from reference_impl.hill import orbital_acceleration
from reference_impl.read import Case
from reference_impl.weave import Floats, Ints, Net

NOTHING = Effects()


@dataclass(frozen=True, eq=False)
class System:
    """A net with what acts on it: eq. (10), and the arithmetic that evaluates it."""

    net: Net
    effects: Effects = NOTHING
    symmetric: bool = False  # exactly mirror-symmetric arithmetic, see `mirror`
    assembled: bool = False  # S(x) x + D v with assembled matrices, as eq. (16) is printed

    def __post_init__(self) -> None:
        if self.symmetric and self.assembled:
            raise ValueError("the arithmetic must be symmetric or assembled, not both")

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
        i, j = self.ends
        position = self.net.reference_position
        return np.asarray((position[j] - position[i]) / self.net.reference_length[:, None])

    @cached_property
    def compliance_of_inertia(self) -> Floats:
        """1/m of each node (n, 1) [1/kg]; zero for fixed nodes, which therefore never accelerate."""
        inverse = 1.0 / self.net.mass
        inverse[self.net.fixed_nodes] = 0.0
        return inverse[:, None]

    @cached_property
    def drag(self) -> Floats:
        """Mass-proportional damping of each node (n, 1) [N s/m]: of Rayleigh's kind and mass_damping."""
        return np.asarray(((self.effects.alpha + self.effects.mass_damping) * self.net.mass)[:, None])

    @cached_property
    def weight(self) -> Floats:
        """Force of gravity (n, 3) [N]."""
        return np.asarray(self.net.mass[:, None] * np.array(self.effects.gravity))

    @cached_property
    def damping(self) -> csr_array:
        """The constant damping matrix, see the function of this name."""
        return damping(self)

    @cached_property
    def graph(self) -> tuple[csr_array, csr_array]:
        """Pattern (n, n) of the secant stiffness, and the map (nnz, m) from S11 A/L to its entries."""
        i, j = self.ends
        m, n = len(i), len(self.net.mass)
        slot = np.concatenate((i, j, i, j)) * n + np.concatenate((i, j, j, i))
        filled, place = np.unique(slot, return_inverse=True)
        sign, column = np.repeat([1.0, 1.0, -1.0, -1.0], m), np.tile(np.arange(m), 4)
        pattern = csr_array((np.ones(len(filled)), np.divmod(filled, n)), shape=(n, n))
        return pattern, csr_array(coo_array((sign, (place, column)), shape=(len(filled), m)))

    @cached_property
    def incidence(self) -> csr_array:
        """(n, m): +1 where an element ends, -1 where it begins; gathers element forces, eq. (12)."""
        i, j = self.ends
        m = len(i)
        sign, columns = np.repeat([1.0, -1.0], m), np.tile(np.arange(m), 2)
        return csr_array(coo_array((sign, (np.concatenate((j, i)), columns)), shape=(len(self.net.mass), m)))

    @cached_property
    def leaves(self) -> Ints:
        """Order of additions of the symmetric arithmetic."""
        return mirror.leaves(self.net)


def assemble(case: Case, net: Net, symmetric: bool = False, assembled: bool = False) -> System:
    """The system of a case."""
    return System(net, case.effects, symmetric, assembled)


def span(system: System, x: Floats) -> Floats:
    """d_e = x_j - x_i, (..., m, 3), of positions (or velocities) (..., n, 3)."""
    i, j = system.ends
    return np.asarray(x.take(j, axis=-2) - x.take(i, axis=-2))


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar products along the last axis (3).  x + y comes first: swapping x and y changes no bit of it."""
    c = a * b
    return np.asarray((c[..., 0] + c[..., 1]) + c[..., 2])


def length(system: System, x: Floats) -> Floats:
    """Current lengths L_e (..., m) [m], eq. (7)."""
    d = span(system, x)
    return np.sqrt(dot(d, d))


def _strain(system: System, d: Floats) -> Floats:
    reference = system.squared_reference_length
    return np.asarray(0.5 * (dot(d, d) - reference) / reference)


def strain(system: System, x: Floats) -> Floats:
    """Green-Lagrange strain E11 (..., m) [-], eq. (6); negative where an element is slack."""
    return _strain(system, span(system, x))


def stress(system: System, e11: Floats) -> Floats:
    """Second Piola-Kirchhoff stress S11 (..., m) [Pa], eq. (8): none in compression."""
    return np.asarray(system.net.youngs_modulus * np.maximum(e11, 0.0))


def tension(system: System, x: Floats) -> Floats:
    """Elastic axial force N = S11 A L / L_ref (..., m) [N]: of the deformed cable on its ends, eq. (8)."""
    s11 = stress(system, strain(system, x))
    return np.asarray(s11 * system.net.area * length(system, x) / system.net.reference_length)


def secant_element(system: System, x: Floats) -> Floats:
    """Secant stiffness S_e (m, 6, 6) [N/m], eqs. (3), (4)."""
    s = stress(system, strain(system, x)) * system.net.area / system.net.reference_length
    delta = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.eye(3))
    return np.asarray(s[:, None, None] * delta)


def tangent_element(system: System, x: Floats) -> Floats:
    """Tangent stiffness T_e (m, 6, 6) [N/m], eq. (5)."""
    taut = strain(system, x) >= 0.0
    return secant_element(system, x) + _stretching(system, span(system, x), np.where(taut, 1.0, 0.0))


def _stretching(system: System, d: Floats, taut: Floats) -> Floats:
    """Second part of eq. (5), dS11/dE11 A / L_ref^3 (Delta x_e)(Delta x_e)^T, (m, 6, 6) [N/m]."""
    factor = taut * system.axial_stiffness / system.squared_reference_length
    column = np.concatenate((-d, d), axis=1)  # Delta x_e
    return np.asarray(factor[:, None, None] * column[:, :, None] * column[:, None, :])


def assembled(system: System, blocks: Floats) -> csr_array:
    """Sum of A_e^T K_e A_e over the elements, (3n, 3n) sparse, of blocks K_e (m, 6, 6): eqs. (12), (14)."""
    dofs = (3 * system.net.element_nodes[:, :, None] + np.arange(3)).reshape(-1, 6)
    rows, columns = np.repeat(dofs, 6, axis=1).ravel(), np.tile(dofs, 6).ravel()
    size = 3 * len(system.net.mass)
    return csr_array(coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)))


def secant(system: System, x: Floats) -> csr_array:
    """Secant stiffness S(x) (3n, 3n) [N/m], eq. (12)."""
    return assembled(system, secant_element(system, x))


def tangent(system: System, x: Floats) -> csr_array:
    """Tangent stiffness T(x) (3n, 3n) [N/m], eq. (14)."""
    return assembled(system, tangent_element(system, x))


def damping(system: System, x: Floats | None = None) -> csr_array:
    """Damping matrix (3n, 3n) [N s/m]: D = alpha M + beta T(x_ref) of eq. (13), and mass_damping's alpha M.

    In the reference configuration E11 = 0 by definition, which eq. (8) counts as taut; round-off must not
    decide it.  Given positions x (n, 3), the matrix of material_damping there, at zero velocity, is added.
    """
    d = system.reference_direction * system.net.reference_length[:, None]
    blocks = system.effects.beta * _stretching(system, d, np.ones(len(d)))
    if x is not None and system.effects.relaxation_time:
        taut = np.where(strain(system, x) > 0.0, system.effects.relaxation_time, 0.0)
        blocks += _stretching(system, span(system, x), taut)
    viscous = assembled(system, blocks)
    mass = np.repeat(system.drag[:, 0], 3)
    diagonal = np.arange(len(mass))
    return csr_array(viscous + coo_array((mass, (diagonal, diagonal)), shape=viscous.shape))


def gather(system: System, element_force: Floats) -> Floats:
    """Nodal sums (n, 3) of element forces (m, 3) acting with + on end j, - on end i."""
    if system.symmetric:
        return mirror.gather(element_force, system.leaves)
    return np.asarray(system.incidence @ element_force)


def elastic_forces(system: System, x: Floats) -> Floats:
    """Nodal forces S(x) x (n, 3) [N] of eqs. (10), (12), without forming the matrix."""
    d = span(system, x)
    per_length = system.axial_stiffness * np.maximum(_strain(system, d), 0.0)
    return gather(system, per_length[:, None] * d)


def _pull(system: System, d: Floats, v: Floats) -> tuple[Floats, float]:
    """S11 A/L of eq. (3) (m,) [N/m] with the viscous part of material_damping, and the power it takes [W].

    S11 = E max(E11 + tau dE11/dt, 0) where E11 > 0: a cable cannot push.
    """
    e11 = _strain(system, d)
    elastic = system.axial_stiffness * np.maximum(e11, 0.0)
    tau = system.effects.relaxation_time
    if not tau:
        return np.asarray(elastic), 0.0
    rate = dot(d, span(system, v)) / system.squared_reference_length
    viscous = np.maximum(tau * system.axial_stiffness * np.where(e11 > 0.0, rate, 0.0), -elastic)
    return np.asarray(elastic + viscous), float(np.sum(viscous * rate * system.squared_reference_length))


def _drag(system: System, v: Floats) -> tuple[Floats, float]:
    """Viscous element forces beta T_e(x_ref) v_e (m, 3) [N] and the power v^T beta T v they take [W]."""
    rate = dot(system.reference_direction, span(system, v))
    force = system.effects.beta * system.axial_stiffness * rate
    return np.asarray(force[:, None] * system.reference_direction), float(force @ rate)


def acceleration(system: System, t: float, x: Floats, v: Floats) -> Floats:
    """dv/dt (n, 3) [m/s2], eq. (16), at any finite x, v (n, 3) [m, m/s]; zero at fixed nodes."""
    return motion(system, t, x, v)[0]


def motion(system: System, t: float, x: Floats, v: Floats) -> tuple[Floats, float]:
    """dv/dt of eq. (16) (n, 3) [m/s2], and the power v^T D v taken by damping [W].

    Nothing depends on t; an absent effect takes a comparison.
    """
    push, power = (_assembled_forces if system.assembled else _element_forces)(system, x, v)
    effects = system.effects
    if any(effects.gravity):
        push += system.weight
    result = system.compliance_of_inertia * push
    if effects.orbit is not None:
        result += np.where(system.compliance_of_inertia > 0.0, orbital_acceleration(effects.orbit, x, v), 0.0)
    return np.asarray(result), power


def _element_forces(system: System, x: Floats, v: Floats) -> tuple[Floats, float]:
    """-S(x) x - D v (n, 3) [N], element by element, and the power taken [W]."""
    d = span(system, x)
    per_length, power = _pull(system, d, v)
    element_force = per_length[:, None] * d
    if system.effects.beta:
        viscous, taken = _drag(system, v)
        element_force += viscous
        power += taken
    push = -gather(system, element_force)
    if system.effects.alpha or system.effects.mass_damping:
        external = system.drag * v
        power += float(np.vdot(external, v))
        push -= external
    return push, power


def _assembled_forces(system: System, x: Floats, v: Floats) -> tuple[Floats, float]:
    """The same with the matrices S(x) and D of eqs. (12), (13): other round-off, nothing else."""
    per_length, power = _pull(system, span(system, x), v)
    pattern, spread = system.graph
    stiffness = csr_array((spread @ per_length, pattern.indices, pattern.indptr), shape=pattern.shape)
    push = -(stiffness @ x)
    if system.effects.alpha or system.effects.beta or system.effects.mass_damping:
        external = system.damping @ v.ravel()
        power += float(external @ v.ravel())
        push -= external.reshape(v.shape)
    return push, power


def greatest_frequency(system: System) -> float:
    """Upper estimate of the angular frequencies of the taut, unstrained net [rad/s] (Gershgorin on M^-1 T).

    Dividing 2.8 by it gives a step at which RK4 is stable while strains are small.
    """
    around = np.bincount(
        system.net.element_nodes.ravel(), np.repeat(system.axial_stiffness, 2), minlength=len(system.net.mass)
    )
    return float(np.sqrt(np.max(2.0 * around * system.compliance_of_inertia[:, 0], initial=0.0)))
