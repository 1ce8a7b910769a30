"""Energy and momentum of states: eqs. (18) and (19), potential of constant loads, power of damping."""

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


def elastic(net: Net, position: Floats) -> Floats:
    """U_el of eq. (19) [J]; position (..., n_nodes, 3) -> (...)."""
    return cable.elastic_energy(net, cable.lengths(net, position))


def potential(terms: Terms, position: Floats) -> Floats:
    """Potential energy of the constant loads, -load . x [J]; (..., n_nodes, 3) -> (...)."""
    if terms.load is None:
        return np.zeros(position.shape[:-2])
    return -(position.reshape(*position.shape[:-2], -1) @ terms.load)


def damping_power(terms: Terms, velocity: Floats) -> Floats:
    """Power v^T D v that damping takes out [W]; velocity (k, n_nodes, 3) -> (k,)."""
    flat = velocity.reshape(len(velocity), -1)
    if terms.damping is None:
        return np.zeros(len(velocity))
    return np.einsum("ki,ki->k", flat, (terms.damping @ flat.T).T)


def momentum(net: Net, velocity: Floats) -> Floats:
    """Linear momentum [kg m/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, velocity)


def angular_momentum(net: Net, position: Floats, velocity: Floats) -> Floats:
    """Angular momentum about the origin [kg m2/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, np.cross(position, velocity))
