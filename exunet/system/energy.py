"""Energy and momentum of states: eqs. (18) and (19), potential of the effects, power that they take out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.terms import Terms
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
        from exunet.codegen.kernel import term_kernel

        energy += term_kernel(terms.kernels).potential(position)
    return energy


def work_taken(net: Net, terms: Terms, time: Floats, position: Floats, velocity: Floats) -> Floats:
    """Energy [J] that terms without a potential take out between states (negative: put in).

    time (k,) [s], position and velocity (k, n_nodes, 3) of successive steps -> (k - 1,)

    Simpson's rule in each step; the state in the middle is that of the cubic Hermite polynomial through both
    ends, (x0 + x1)/2 + h (v0 - v1)/8 and 3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order.
    """
    step = np.diff(time)
    h = step[:, None, None]
    place = 0.5 * (position[:-1] + position[1:]) + 0.125 * h * (velocity[:-1] - velocity[1:])
    speed = 1.5 * np.diff(position, axis=0) / h - 0.25 * (velocity[:-1] + velocity[1:])
    ends = power_taken(terms, time, position, velocity)
    middle = power_taken(terms, time[:-1] + 0.5 * step, place, speed)
    work = step / 6.0 * (ends[:-1] + ends[1:] + 4.0 * middle)
    if terms.relaxation_time is not None:
        states = ((position[:-1], velocity[:-1]), (place, speed), (position[1:], velocity[1:]))
        work += cable.viscous_work(net, terms.law(net), step, states)
    return work


def power_taken(terms: Terms, time: Floats, position: Floats, velocity: Floats) -> Floats:
    """Power [W] that the damping matrix and the non-conservative kernel terms take out (negative: put in).

    time (k,) [s], position and velocity (k, n_nodes, 3) -> (k,)
    """
    flat = velocity.reshape(len(velocity), -1)
    power = np.zeros(len(velocity))
    if terms.damping is not None:
        power += np.einsum("ki,ki->k", flat, (terms.damping @ flat.T).T)
    if any(term.potential is None for term in terms.kernels):
        from exunet.codegen.kernel import term_kernel

        power += term_kernel(terms.kernels).power(time, position, velocity)
    return power


def momentum(net: Net, velocity: Floats) -> Floats:
    """Linear momentum [kg m/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, velocity)


def angular_momentum(net: Net, position: Floats, velocity: Floats) -> Floats:
    """Angular momentum about the origin [kg m2/s]; (..., n_nodes, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", net.mass, np.cross(position, velocity))
