"""Energy and momentum of states: eqs. (18) and (19), potential and dissipated energy of the terms."""

from __future__ import annotations

import numpy as np

from exunet.base.arrays import Floats
from exunet.bodies import rotations
from exunet.forces import cable
from exunet.forces.total import Forces
from exunet.kernels.kernel import cable_kernel, term_kernel
from exunet.model.system import DiscreteStates, System


def kinetic(mass: Floats, velocity: Floats) -> Floats:
    """Compute K of eq. (18) [J]; mass (n,), velocity (..., n, 3) -> (...)."""
    return 0.5 * (np.einsum("...na,...na->...n", velocity, velocity) @ mass)


def law_of(forces: Forces, discrete: DiscreteStates | None = None) -> cable.AxialLaw:
    """Return the cable law of the intact elements."""
    return forces.cable.law.of_intact(forces.cable.carrying(discrete or {}))


def elastic(forces: Forces, position: Floats, discrete: DiscreteStates | None = None) -> Floats:
    """Compute U_el of eq. (19) [J]; position (..., n_points, 3) -> (...)."""
    return cable.elastic_energy(law_of(forces, discrete), cable.lengths(forces.cable.net, position))


def potential(forces: Forces, x: Floats, discrete: DiscreteStates | None = None) -> Floats:
    """Compute the potential [J] of loads, constant stiffness and conservative terms; (k, n_x) -> (k,)."""
    energy = np.zeros(len(x))
    if forces.linear is not None:
        energy += forces.linear.potential(x)
    if any(term.has_potential for term in forces.kernels):
        energy += term_kernel(forces.kernels).potential(x, discrete)
    return energy


def work_taken(
    system: System, time: Floats, x: Floats, v: Floats, discrete: DiscreteStates | None = None
) -> Floats:
    """Compute the energy [J] that terms without a potential dissipate in each step (negative: supply).

    Parameters
    ----------
    time, x, v : (k,) [s], (k, n_x), (k, n_v)
        Ends of successive steps.

    Returns
    -------
    (k - 1,) energies [J].

    Notes
    -----
    Simpson's rule in each step, with the midpoint of the cubic Hermite polynomial,
    (x0 + x1)/2 + h (x0' - x1')/8 and 3/2 (x1 - x0)/h - (x0' + x1')/4: of fourth order.
    """
    forces, step = system.forces, np.diff(time)
    place, speed = _middle(system, time, x, v, discrete)
    ends = power_taken(forces, time, x, v, discrete)
    middle = power_taken(forces, time[:-1] + 0.5 * step, place, speed, discrete)
    work = step / 6.0 * (ends[:-1] + ends[1:] + 4.0 * middle)
    if forces.cable.viscous:
        states = (x[:-1], v[:-1]), (x[1:], v[1:])
        work += cable_kernel(forces.cable).work(step, states, discrete)
    return work


def _middle(
    system: System, time: Floats, x: Floats, v: Floats, discrete: DiscreteStates | None
) -> tuple[Floats, Floats]:
    """Return x (k - 1, n_x) and v (k - 1, n_v) at the midpoints of the steps."""
    h, centres, bodies = np.diff(time)[:, None], system.blocks.centres, len(system.blocks.rigid)

    def halfway(value: Floats, rate: Floats) -> tuple[Floats, Floats]:
        return (
            0.5 * (value[:-1] + value[1:]) + 0.125 * h * (rate[:-1] - rate[1:]),
            1.5 * np.diff(value, axis=0) / h - 0.25 * (rate[:-1] + rate[1:]),
        )

    if x.shape[1] == centres:
        return halfway(x, v)
    place, speed = halfway(x[:, :centres], v[:, :centres])
    attitude = _one_way(x[:, centres : centres + 4 * bodies].reshape(len(x), bodies, 4))
    rate = rotations.turning(attitude, v[:, centres:].reshape(len(v), bodies, 3)).reshape(len(x), -1)
    turned, turns = halfway(attitude.reshape(len(x), -1), rate)
    shape = (len(turned), bodies, 4)
    spin = rotations.angular_velocity_of(turned.reshape(shape), turns.reshape(shape)).reshape(len(turned), -1)
    of_terms = x[:, centres + 4 * bodies :]
    if of_terms.shape[1]:
        rates = np.zeros_like(of_terms)  # of those integrated for bodies, which no force depends on
        if system.forces.kernels:
            kernel = term_kernel(system.forces.kernels)
            rates = kernel.all_forces(time, x, v, of_terms.shape[1], discrete)[:, v.shape[1] :]
        of_terms, _ = halfway(of_terms, rates)
    return np.concatenate([place, turned, of_terms[: len(place)]], axis=1), np.concatenate([speed, spin], 1)


def _one_way(attitude: Floats) -> Floats:
    """Choose the signs of attitudes (k, n_bodies, 4) so that each is close to the previous one."""
    same = np.einsum("kba,kba->kb", attitude[1:], attitude[:-1]) >= 0.0
    sign = np.cumprod(np.where(same, 1.0, -1.0), axis=0)
    return np.concatenate([attitude[:1], sign[:, :, None] * attitude[1:]])


def power_taken(
    forces: Forces, time: Floats, x: Floats, v: Floats, discrete: DiscreteStates | None = None
) -> Floats:
    """Compute the power [W] dissipated by the damping matrix and by terms without a potential.

    time (k,) [s], x (k, n_x), v (k, n_v) -> (k,)
    """
    power = np.zeros(len(v))
    if forces.linear is not None:
        power += forces.linear.power(v)
    if any(term.dissipates for term in forces.kernels):
        power += term_kernel(forces.kernels).power(time, x, v, discrete)
    return power


def total(system: System, time: float, x: Floats, v: Floats, discrete: DiscreteStates) -> float:
    """Compute the sum of kinetic, elastic and potential energy [J] of one state x (n_x,), v (n_v,)."""
    moving = system.layout.unpack(x, v).completed(system.kinematics, time, discrete)
    place, speed = system.layout.pack(moving)
    position = moving.position[: system.net.n_nodes]
    held = elastic(system.forces, position, discrete) + potential(system.forces, place[None], discrete)[0]
    return float(speed @ (system.layout.half_mass(system) * speed) + held)


def momentum(mass: Floats, velocity: Floats) -> Floats:
    """Compute the momentum [kg m/s]; mass (n,), velocity (..., n, 3) -> (..., 3)."""
    return np.einsum("n,...na->...a", mass, velocity)


def angular_momentum(mass: Floats, position: Floats, velocity: Floats) -> Floats:
    """Compute the angular momentum about the origin [kg m2/s]; mass (n,), (..., n, 3) twice -> (..., 3)."""
    return np.einsum("n,...na->...a", mass, np.cross(position, velocity))
