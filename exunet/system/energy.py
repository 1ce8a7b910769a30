"""Energy and momentum of states: eqs. (18) and (19), potential of the terms, work that they take out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.codegen.kernel import term_kernel
from exunet.forces import cable
from exunet.forces.cable_term import INTACT
from exunet.forces.total import Forces
from exunet.system.system import Memories

Floats = NDArray[np.float64]


def kinetic(mass: Floats, velocity: Floats) -> Floats:
    """K of eq. (18) [J]; mass (n,), velocity (..., n, 3) -> (...)."""
    return 0.5 * (np.einsum("...na,...na->...n", velocity, velocity) @ mass)


def law_of(forces: Forces, memory: Memories | None = None) -> cable.Law:
    """The law of the elements that are intact."""
    return forces.cable.law.of_intact((memory or {}).get(INTACT))


def elastic(forces: Forces, position: Floats, memory: Memories | None = None) -> Floats:
    """U_el of eq. (19) [J]; position (..., n_points, 3) -> (...)."""
    return cable.elastic_energy(law_of(forces, memory), cable.lengths(forces.cable.net, position))


def potential(forces: Forces, position: Floats, memory: Memories | None = None) -> Floats:
    """Energy [J] of loads, constant stiffness and conservative kernel terms; (k, n_points, 3) -> (k,)."""
    energy = np.zeros(len(position))
    if forces.linear is not None:
        energy += forces.linear.potential(position.reshape(len(position), -1))
    if any(term.has_potential for term in forces.kernels):
        energy += term_kernel(forces.kernels).potential(position, memory)
    return energy


def work_taken(
    forces: Forces, time: Floats, position: Floats, velocity: Floats, memory: Memories | None = None
) -> Floats:
    """Energy [J] that terms without a potential take out between states (negative: put in).

    time (k,) [s], position and velocity (k, n_points, 3) of successive steps -> (k - 1,)

    Simpson's rule in each step; the state in the middle is that of the cubic Hermite polynomial through both
    ends, (x0 + x1)/2 + h (v0 - v1)/8 and 3/2 (x1 - x0)/h - (v0 + v1)/4, so the sum is of fourth order.
    """
    step = np.diff(time)
    h = step[:, None, None]
    place = 0.5 * (position[:-1] + position[1:]) + 0.125 * h * (velocity[:-1] - velocity[1:])
    speed = 1.5 * np.diff(position, axis=0) / h - 0.25 * (velocity[:-1] + velocity[1:])
    ends = power_taken(forces, time, position, velocity, memory)
    middle = power_taken(forces, time[:-1] + 0.5 * step, place, speed, memory)
    work = step / 6.0 * (ends[:-1] + ends[1:] + 4.0 * middle)
    if forces.cable.viscous:
        states = ((position[:-1], velocity[:-1]), (place, speed), (position[1:], velocity[1:]))
        work += cable.viscous_work(forces.cable.net, law_of(forces, memory), step, states)
    return work


def power_taken(
    forces: Forces, time: Floats, position: Floats, velocity: Floats, memory: Memories | None = None
) -> Floats:
    """Power [W] that the damping matrix and the non-conservative kernel terms take out (negative: put in).

    time (k,) [s], position and velocity (k, n_points, 3) -> (k,)
    """
    power = np.zeros(len(velocity))
    if forces.linear is not None:
        power += forces.linear.power(velocity.reshape(len(velocity), -1))
    if any(term.dissipates for term in forces.kernels):
        power += term_kernel(forces.kernels).power(time, position, velocity, memory)
    return power


def momentum(mass: Floats, velocity: Floats) -> Floats:
    """Linear momentum [kg m/s]; mass (n,), velocity (..., n, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", mass, velocity)


def angular_momentum(mass: Floats, position: Floats, velocity: Floats) -> Floats:
    """Angular momentum about the origin [kg m2/s]; mass (n,), (..., n, 3) twice -> (..., 3)."""
    return np.einsum("n,...na->...a", mass, np.cross(position, velocity))
