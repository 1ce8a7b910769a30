"""Effects by the mass on bodies: gravity, orbit, j2 and damping act on every element of their mass.

Each gives an element at X + l, which moves with V + w x l, an acceleration linear in l, A l with
A = G + C [w]x beside that of the centre: G the gradient of gravity and the turning frame, C what velocities
do (Coriolis, damping).  Its torque about the centre of mass is the sum of dm l x A l, which with the second
moments S = sum of dm l l^T = (tr J)/2 I - J of the mass is the axial vector of S A^T:

    t_i = e_ijk (S A^T)_jk.

The gravity gradient 3 n^2 r x J r, the gyroscopic torque of the turning frame and the damping of spin are all
of this form, and no formula for either is written down.  Of the two-body model the torque is that of its
linear gradient.  Potential of a field G in the attitude: -tr(G S)/2.
"""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.effects.orbit import coriolis, gradient, orbital_acceleration, orbital_potential
from reference_impl.system import System
from reference_impl.turns import skew


def act(system: System) -> bool:
    """Whether any effect acts by the mass on a body."""
    effects = system.effects
    by_mass = any(effects.gravity) or effects.orbit is not None or damping_rate(system) > 0.0
    return bool(len(system.bodies.names)) and by_mass


def turn(system: System) -> bool:
    """Whether any effect acts by the mass on the attitude of a body."""
    effects = system.effects
    return bool(len(system.bodies.rigid)) and (effects.orbit is not None or damping_rate(system) > 0.0)


def damping_rate(system: System) -> float:
    """alpha [1/s] of mass_damping and of Rayleigh's kind."""
    return system.effects.alpha + system.effects.mass_damping


def second_moments(inertia: Floats) -> Floats:
    """S (..., 3, 3) [kg m2] of matrices of inertia J (..., 3, 3)."""
    half_trace = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)
    return np.asarray(half_trace[..., None, None] * np.eye(3) - inertia)


def gradient_of(system: System) -> Floats:
    """G (3, 3) [1/s2] of the effects of a system."""
    effects = system.effects
    total = np.zeros((3, 3)) if effects.orbit is None else gradient(effects.orbit)
    return total if effects.j2 is None else total + system.oblate


def accelerations(system: System, x: Floats, v: Floats) -> Floats:
    """(b, 3) [m/s2] of bodies with centres of mass at x (b, 3) [m] that move with v (b, 3) [m/s]."""
    effects = system.effects
    total = np.broadcast_to(np.array(effects.gravity), x.shape) - damping_rate(system) * v
    if effects.orbit is not None:
        total = total + orbital_acceleration(effects.orbit, x, v)
    if effects.j2 is not None:
        total = total + x @ system.oblate.T
    return np.asarray(total)


def torques(system: System, attitude: Floats, turning: Floats) -> Floats:
    """(r, 3) [N m] on rigid bodies of attitudes (r, 3, 3) that turn with (r, 3) [rad/s], in scene axes."""
    effects = system.effects
    by_velocity = -damping_rate(system) * np.eye(3)
    if effects.orbit is not None:
        by_velocity = by_velocity + coriolis(effects.orbit)
    field = gradient_of(system) + by_velocity @ skew(turning)
    second = attitude @ second_moments(system.bodies.resistance) @ np.swapaxes(attitude, -1, -2)
    moment = second @ np.swapaxes(field, -1, -2)
    above, below = moment[:, [1, 2, 0], [2, 0, 1]], moment[:, [2, 0, 1], [1, 2, 0]]
    return np.asarray(above - below)


def taken(system: System, v: Floats, attitude: Floats, turning: Floats) -> float:
    """Power [W] that damping takes from bodies: twice alpha times their kinetic energy."""
    bodies = system.bodies
    carried = attitude @ bodies.resistance @ np.swapaxes(attitude, -1, -2) @ turning[..., None]
    moving = bodies.free * bodies.mass @ np.sum(v * v, axis=-1)
    spinning = np.sum(turning * carried[..., 0], axis=-1) @ bodies.free[bodies.rigid]
    return damping_rate(system) * float(moving + spinning)


def potential(system: System, x: Floats, attitude: Floats) -> Floats:
    """Potential (...) [J] of bodies at x (..., b, 3) [m] with attitudes (..., b, 3, 3)."""
    effects, bodies = system.effects, system.bodies
    mass = bodies.free * bodies.mass
    total = -(x @ np.array(effects.gravity)) @ mass
    if effects.orbit is not None:
        total = total + orbital_potential(effects.orbit, x) @ mass
    if effects.j2 is not None:
        total = total - 0.5 * np.einsum("...bc,cd,...bd->...b", x, system.oblate, x) @ mass
    second = bodies.free[:, None, None] * second_moments(bodies.inertia)
    turned = np.einsum("...bij,bjk,...blk->...il", attitude, second, attitude)
    return np.asarray(total - 0.5 * np.einsum("ij,...ji->...", gradient_of(system), turned))
