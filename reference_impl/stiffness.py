"""Stiffness and damping matrices, eqs. (3)-(5), (12)-(14).

In matrices (3n, 3n) degree of freedom 3 i + c is component c of node i.  They are those of the cables' law,
with its free strain; the springs of `bending` are not in them.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from reference_impl.arrays import Floats
from reference_impl.elements import Elements, excess, span, strain, stress


def secant_element(system: Elements, x: Floats) -> Floats:
    """Secant stiffness S_e (m, 6, 6) [N/m], eqs. (3), (4)."""
    s = stress(system, strain(system, x)) * system.net.area / system.net.reference_length
    delta = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.eye(3))
    return np.asarray(s[:, None, None] * delta)


def tangent_element(system: Elements, x: Floats) -> Floats:
    """Tangent stiffness T_e (m, 6, 6) [N/m], eq. (5)."""
    taut = excess(system, strain(system, x)) >= 0.0
    return secant_element(system, x) + _stretching(system, span(system, x), np.where(taut, 1.0, 0.0))


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
        pulled = excess(system, strain(system, x)) > 0.0
        taut = np.where(pulled, system.effects.relaxation_time, 0.0)
        blocks += _stretching(system, span(system, x), taut)
    viscous = assembled(system, blocks)
    mass = np.repeat(mass_proportional(system)[:, 0], 3)
    diagonal = np.arange(len(mass))
    return csr_array(viscous + coo_array((mass, (diagonal, diagonal)), shape=viscous.shape))


def mass_proportional(system: Elements) -> Floats:
    """Damping of each node (n, 1) [N s/m] in proportion to its mass: of Rayleigh's kind and mass_damping."""
    effects = system.effects
    return np.asarray(((effects.alpha + effects.mass_damping) * system.net.own_mass)[:, None])
