"""Energy and momentum of states: eqs. (18) and (19), potential of the effects, power that they take out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet import cable
from exunet.effects.terms import Terms
from exunet.net.arrays import Net

Floats = NDArray[np.float64]


def kinetic(net: Net, velocity: Floats) -> Floats:
    """K of eq. (18) [J]; velocity (..., n_nodes, 3) -> (...)."""
    return 0.5 * (np.einsum("...na,...na->...n", velocity, velocity) @ net.mass)


def elastic(net: Net, terms: Terms, position: Floats) -> Floats:
    """U_el of eq. (19) [J]; position (..., n_nodes, 3) -> (...)."""
    return cable.elastic_energy(terms.law(net), cable.lengths(net, position))


def potential(terms: Terms, position: Floats) -> Floats:
    """Energy [J] of loads, constant stiffness and conservative kernel terms; (k, n_nodes, 3) -> (k,)."""
    flat = position.reshape(len(position), -1)
    energy = np.zeros(len(position))
    if terms.load is not None:
        energy -= flat @ terms.load
    if terms.stiffness is not None:
        energy += 0.5 * np.einsum("ki,ki->k", flat, (terms.stiffness @ flat.T).T)
    if any(term.potential is not None for term in terms.kernels):
        from exunet.kernel.net import term_kernel

        energy += term_kernel(terms.kernels).potential(position)
    return energy


def power_taken(net: Net, terms: Terms, time: Floats, position: Floats, velocity: Floats) -> Floats:
    """Power [W] that damping, viscous stress and non-conservative kernel terms take out (negative: put in).

    time (k,) [s], position and velocity (k, n_nodes, 3) -> (k,)
    """
    flat = velocity.reshape(len(velocity), -1)
    power = np.zeros(len(velocity))
    if terms.damping is not None:
        power += np.einsum("ki,ki->k", flat, (terms.damping @ flat.T).T)
    if terms.relaxation_time is not None:
        power += cable.viscous_power(net, terms.law(net), position, velocity)
    if any(term.potential is None for term in terms.kernels):
        from exunet.kernel.net import term_kernel

        power += term_kernel(terms.kernels).power(time, position, velocity)
    return power


def momentum(net: Net, velocity: Floats) -> Floats:
    """Linear momentum [kg m/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, velocity)


def angular_momentum(net: Net, position: Floats, velocity: Floats) -> Floats:
    """Angular momentum about the origin [kg m2/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, np.cross(position, velocity))
