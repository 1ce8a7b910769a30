"""Law of a thread: strain, tension, energy, tangent and inverse.

A taut thread of natural length L1 and length L, with the stretch s = L / L1, pulls by

    N = EA e de/ds,    stores    U = EA L1 e^2 / 2,

with the strain e = (s^2 - 1) / 2 of Green and Lagrange, eqs. (3) and (6)-(8) of the paper, so that
N = EA (s^3 - s) / 2. Its tangent over EA is dN/ds = (3 s^2 - 1) / 2. A slack thread carries nothing. Viscous
stress is not part of the law: whoever has it adds tau de/dt to the strain in the tension.

The first functions take lengths: floats, arrays, and the engine's symbolic numbers. The others are for
compiled loops, into whose modules their text is copied: they use no global name but each other's. Loops over
elements take the excess L^2 - L1^2 [m2] of squared lengths, in which force and energy need no root:
EA / (2 L1^3) times the excess times d on the ends, d from end to end, and EA / (8 L1^3) times its square.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from exunet.base.arrays import Floats

# Largest stretch for which the law is meant. There its force N = EA E11 lambda is three times that of Hooke's
# law, EA (lambda - 1) (lambda + 1) lambda / 2: beyond, the choice of the law is all that one sees.
STRETCH_BOUND = 2.0


def green_lagrange_strain(length: Any, reference_length: Any) -> Any:
    """E11 of eq. (6): (L^2 - L0^2) / (2 L0^2), written in the stretch to keep all digits near L = L0."""
    stretch = length / reference_length
    return 0.5 * (stretch - 1.0) * (stretch + 1.0)


def tension(
    length: Any, reference_length: Any, axial_stiffness: Any, maximum: Callable[[Any, Any], Any] = np.maximum
) -> Any:
    """Axial force N = S11 A L / L0 [N], positive in tension, zero when slack: eqs. (3) and (8).

    The magnitude of S_e x_e of eq. (3): the second Piola-Kirchhoff stress times the reference area,
    carried along the current direction with the factor L / L0. `maximum` lets the same line serve
    floats, arrays (`numpy.maximum`) and the engine's symbolic reals.
    """
    strain = maximum(green_lagrange_strain(length, reference_length), 0.0)
    return axial_stiffness * strain * (length / reference_length)


def energy(strain: Any) -> Any:
    """Elastic energy over EA L1, of eq. (19)."""
    return 0.5 * np.maximum(strain, 0.0) ** 2


def stretch_with(force: Floats, stiffness: Floats) -> Floats:
    """Stretch at which the tension is the force [N], by Newton's method."""
    wanted = 2.0 * force / stiffness  # s^3 - s
    stretch = 1.0 + np.minimum(0.5 * wanted, np.cbrt(wanted))  # not below the root, where s^3 - s is convex
    for _ in range(60):
        stretch = stretch - (stretch**3 - stretch - wanted) / (3.0 * stretch**2 - 1.0)
    return np.asarray(stretch)


def slope_at(square: float) -> float:
    """Tangent over EA by the squared stretch; not below that of a just taut thread."""
    return max(1.0, 1.5 * square - 0.5)


def factor_of(length: Floats, stiffness: Floats) -> Floats:
    """EA / (2 L1^3) [N/m3], the factor of the excess."""
    return np.asarray(stiffness / (2.0 * length**3))


# Scalar loops, in the subset of Python that Numba compiles.


def strain_at(stretch: float) -> float:
    """Strain; zero where slack."""
    return max(0.0, 0.5 * (stretch - 1.0) * (stretch + 1.0))


def strain_between(square: float, natural: float) -> float:
    """Strain by the squared length [m2] and the natural length [m]; zero where slack."""
    return max(0.0, 0.5 * (square / (natural * natural) - 1.0))


def tangent_at(stretch: float) -> float:
    """Tangent over EA of a taut thread."""
    return 0.5 * (3.0 * stretch * stretch - 1.0)


def stretch_at(strain_force: float) -> float:
    """The stretch at which N / EA = (s^3 - s) / 2 is this; Newton's method from above the root."""
    q = 2.0 * strain_force
    s = 1.0 + min(0.5 * q, q ** (1.0 / 3.0))
    for _ in range(60):
        step = (s * s * s - s - q) / (3.0 * s * s - 1.0)
        s -= step
        if step <= 1e-15 * s:
            break
    return s


def excess_over(square: float, natural: float) -> float:
    """Excess [m2] of a squared length [m2] over that of the natural length [m]."""
    return square - natural * natural


def tension_by(excess: float, square: float, natural: float, stiffness: float) -> float:
    """Tension [N] by the excess [m2], which may have a viscous part, and the squared length [m2]."""
    return stiffness * excess * math.sqrt(square) / (2.0 * natural**3)


def energy_with(pull: float, natural: float, stiffness: float) -> float:
    """Least elastic energy [J] of a thread that pulls by so much [N].

    N = EA e sqrt(1 + 2 e) <= EA e (1 + e): it has at least the energy of the strain that makes the latter N.
    """
    strain = 0.5 * (math.sqrt(1.0 + 4.0 * pull / stiffness) - 1.0)
    return 0.5 * stiffness * natural * strain * strain
