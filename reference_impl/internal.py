"""Forces of elements on their nodes, eqs. (3), (10), (12), (13), and the power that they take.

x is the array (n, 3) of nodal positions [m], v that of velocities [m/s]; d_e = x_j - x_i.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from reference_impl import mirror
from reference_impl.arrays import Floats, dot
from reference_impl.closing import Line
from reference_impl.elements import excess, span, strain_of
from reference_impl.mode import Mode
from reference_impl.reels import Outlets
from reference_impl.system import System


def gather(system: System, element_force: Floats) -> Floats:
    """Nodal sums (n, 3) of element forces (m, 3) acting with + on end j, - on end i."""
    if system.symmetric:
        return mirror.gather(element_force, -element_force, system.leaves)
    return np.asarray(system.incidence @ element_force)


def share(system: System, element_force: Floats) -> Floats:
    """Nodal sums (n, 3) of element forces (m, 3), half of each on either end."""
    half = 0.5 * element_force
    if system.symmetric:
        return mirror.gather(half, half, system.leaves)
    return np.asarray(system.touching @ half)


def elastic_forces(system: System, x: Floats) -> Floats:
    """Nodal forces S(x) x (n, 3) [N] of eqs. (10), (12), without forming the matrix."""
    d = span(system, x)
    per_length = system.axial_stiffness * np.maximum(excess(system, strain_of(system, d)), 0.0)
    return gather(system, per_length[:, None] * d)


def _pull(system: System, d: Floats, v: Floats, mode: Mode, changing: list[Outlets]) -> tuple[Floats, float]:
    """S11 A/L of eq. (3) (m,) [N/m] with the viscous part of material_damping, and the power it takes [W].

    S11 = E max(E11 + tau dE11/dt, 0) where E11 > 0: a cable cannot push.  Broken elements carry nothing.
    Elements of `changing` lengths have their own; those on drums are slack, their ends coincide.
    """
    e11 = excess(system, strain_of(system, d))
    if mode.intact is not None:
        e11 = np.where(mode.intact, e11, -1.0)
    elastic = system.axial_stiffness * np.maximum(e11, 0.0)
    tau = system.effects.relaxation_time
    if not tau:
        for some in changing:
            elastic[some.element] = some.per_length
        return np.asarray(elastic), 0.0
    rate = dot(d, span(system, v)) / system.squared_reference_length
    viscous = np.maximum(tau * system.axial_stiffness * np.where(e11 > 0.0, rate, 0.0), -elastic)
    taken = 0.0
    for some in changing:
        elastic[some.element], viscous[some.element] = some.per_length, 0.0
        taken += some.taken
    return np.asarray(elastic + viscous), taken + float(
        np.sum(viscous * rate * system.squared_reference_length)
    )


def _drag(system: System, v: Floats) -> tuple[Floats, float]:
    """Viscous element forces beta T_e(x_ref) v_e (m, 3) [N] and the power v^T beta T v they take [W]."""
    rate = dot(system.reference_direction, span(system, v))
    force = system.effects.beta * system.axial_stiffness * rate
    return np.asarray(force[:, None] * system.reference_direction), float(force @ rate)


def of_elements(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """-S(x) x - D v (n, 3) [N] and the power taken [W]; elements of `changing` lengths have their own."""
    way = _assembled_forces if system.assembled else _element_forces
    return way(system, x, v, mode, changing)


def _element_forces(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """-S(x) x - D v (n, 3) [N], element by element, and the power taken [W]."""
    d = span(system, x)
    per_length, power = _pull(system, d, v, mode, changing)
    element_force = per_length[:, None] * d
    if system.effects.bending is not None:
        element_force += system.hinges.pull(d)
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


def _assembled_forces(
    system: System, x: Floats, v: Floats, mode: Mode, changing: list[Outlets]
) -> tuple[Floats, float]:
    """The same with the matrices S(x) and D of eqs. (12), (13): other round-off, nothing else."""
    d = span(system, x)
    per_length, power = _pull(system, d, v, mode, changing)
    pattern, scatter = system.graph
    stiffness = csr_array((scatter @ per_length, pattern.indices, pattern.indptr), shape=pattern.shape)
    push = -(stiffness @ x)
    if system.effects.bending is not None:
        push -= gather(system, system.hinges.pull(d))
    if system.effects.alpha or system.effects.beta or system.effects.mass_damping:
        external = system.damping @ v.ravel()
        power += float(external @ v.ravel())
        push -= external.reshape(v.shape)
    return push, power


def greatest_frequency(system: System) -> float:
    """Upper estimate of the angular frequencies of the taut, unstrained net [rad/s] (Gershgorin on M^-1 T).

    Dividing 2.8 by it gives a step at which RK4 is stable while strains are small.  The springs of bending
    are counted at twice k/L^2 of their element, on each element that they bend.
    """
    stiffness = system.axial_stiffness
    if system.effects.bending is not None:
        hinges = system.hinges
        each = 2.0 * hinges.stiffness[:, None] * hinges.share**2
        stiffness = stiffness + np.bincount(hinges.pairs.ravel(), each.ravel(), minlength=len(stiffness))
    around = np.bincount(
        system.net.element_nodes.ravel(), np.repeat(stiffness, 2), minlength=len(system.net.mass)
    )
    squared = np.max(2.0 * around * system.compliance_of_inertia[:, 0], initial=0.0)
    if isinstance(line := system.closing, Line):  # one spring over all its nodes
        many = np.bincount(np.concatenate((line.nodes[:-1], line.nodes[1:])), minlength=len(around))
        squared += line.stiffness / line.length * np.sum(many**2 * system.compliance_of_inertia[:, 0])
    return float(np.sqrt(squared))
