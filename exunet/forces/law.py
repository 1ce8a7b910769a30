"""Laws of threads: strain, tension, energy, tangent and inverse.

A taut thread of natural length L1 and length L, with the stretch s = L / L1, pulls by

    N = EA e de/ds,    stores    U = EA L1 e^2 / 2,

where the law's number says what the strain is:

    0   that of Green and Lagrange, e = (s^2 - 1) / 2, eqs. (3) and (6)-(8) of the paper: N = EA (s^3 - s) / 2
    1   Hooke's, e = s - 1: N = EA (s - 1)
    2+  N is straight between the points of a table over s - 1, whose first row is that of this number less 2

A slack thread carries nothing. Viscous stress is not part of the law: whoever has it adds tau de/dt to the
strain in the tension, or tau dN/dt for a table. For laws 1 and up that is tau times the tangent times ds/dt.

The first functions take lengths: floats, arrays, and the engine's symbolic numbers. The others are for
compiled loops, into whose modules their text is copied: they use no global name but each other's. Loops over
elements take the excess L^2 - L1^2 [m2] of squared lengths, in which force and energy of law 0 need no root:
EA / (2 L1^3) times the excess times d on the ends, d from end to end, and EA / (8 L1^3) times its square.
Other laws have measures of these units in its place (`pull_of`).

The rows of a table are strain, N / EA, its slope from there on, and U / (EA L1); EA [N] is its first slope.
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


def hooke_tension(
    length: Any, reference_length: Any, axial_stiffness: Any, maximum: Callable[[Any, Any], Any] = np.maximum
) -> Any:
    """Axial force [N] of law 1; arguments as of `tension`."""
    return axial_stiffness * maximum(length / reference_length - 1.0, 0.0)


def response(number: int, table: Floats, stretch: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute N / EA, its viscous part over tau ds/dt while taut, and U / (EA L1), of one law."""
    strain = np.maximum(stretch - 1.0, 0.0)
    if number == 0:
        strain = np.maximum(green_lagrange_strain(stretch, 1.0), 0.0)
        return strain * stretch, stretch * stretch, energy(strain)
    if number == 1:
        return strain, np.ones_like(stretch), energy(strain)
    rows = _rows(number, table)
    at = np.searchsorted(rows[:, 0], strain, side="right") - 1
    begin, force, slope, held = (rows[at, column] for column in range(4))
    beyond = strain - begin
    return force + slope * beyond, slope, held + (force + 0.5 * slope * beyond) * beyond


def stretch_of(number: int, table: Floats, force: Floats) -> Floats:
    """Compute the stretch at which N / EA of one law is the force; beyond a table along its last line."""
    if number == 0:
        return stretch_with(force, np.ones_like(force))
    if number == 1:
        return 1.0 + force
    rows = _rows(number, table)
    begin, held, slope, _ = rows[np.maximum(np.searchsorted(rows[:, 1], force, side="right") - 1, 0)].T
    return np.asarray(1.0 + begin + (force - held) / slope)


def _rows(number: int, table: Floats) -> Floats:
    """(k, 4) rows of the table of a law."""
    rows = table[number - 2 :]
    ends = np.flatnonzero(np.diff(rows[:, 0]) <= 0.0)  # each table begins at zero
    return rows[: int(ends[0]) + 1] if len(ends) else rows


def longest_stretch(number: int, table: Floats, like: Floats) -> Floats:
    """Return the largest stretch for which a law is meant, that at the end of a table, as an array."""
    bound = min(STRETCH_BOUND, 1.0 + float(_rows(number, table)[-1, 0])) if number > 1 else STRETCH_BOUND
    return np.full_like(like, bound)


def steepest_slope(number: int, table: Floats, like: Floats) -> Floats:
    """Return the largest tangent over that of a just taut thread, of law 0 the latter, as an array."""
    return np.full_like(like, float(_rows(number, table)[:, 2].max()) if number > 1 else 1.0)


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


def strain_between(law: int, square: float, natural: float) -> float:
    """Strain of law 0 or 1 by the squared length [m2] and the natural length [m]; zero where slack."""
    if law == 0:
        return max(0.0, 0.5 * (square / (natural * natural) - 1.0))
    return max(0.0, math.sqrt(square) / natural - 1.0)


def growth_at(law: int, stretch: float) -> float:
    """de/ds of law 0 or 1."""
    return stretch if law == 0 else 1.0


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


def row_of(law: int, table: Any, column: int, value: Any) -> int:
    """Row of a table from which on it is straight, at a value of one of its columns."""
    k = law - 2
    while k + 1 < table.shape[0] and table[k, 0] < table[k + 1, 0] and table[k + 1, column] <= value:
        k += 1
    return k


def pull_of(law: int, table: Any, excess: Any, square: float) -> Any:
    """Return the measures [m2] of force and energy of a taut element.

    With f = EA / (2 L1^3), the force on its ends is f times the first times d, the energy f / 4 times the
    second squared.

    Parameters
    ----------
    excess : L^2 - L1^2 [m2]
    square : L1^2 [m2]
    """
    if law == 0:
        return excess, excess
    natural = math.sqrt(square)
    length = math.sqrt(square + excess)
    beyond = excess / (length + natural)
    if law == 1:
        return 2.0 * square * beyond / length, 2.0 * natural * beyond
    strain = beyond / natural
    k = row_of(law, table, 0, strain)
    strain = strain - table[k, 0]
    force = table[k, 1] + table[k, 2] * strain
    held = table[k, 3] + (table[k, 1] + 0.5 * table[k, 2] * strain) * strain
    return 2.0 * square * natural * force / length, square * math.sqrt(8.0 * held)


def weight_of(law: int, table: Any, excess: float, square: float) -> float:
    """Return the factor of 2 tau d . dv in the first measure of `pull_of`."""
    if law == 0:
        return 1.0
    weight = square / (square + excess)
    if law == 1:
        return weight
    natural = math.sqrt(square)
    strain = excess / (math.sqrt(square + excess) + natural) / natural
    return table[row_of(law, table, 0, strain), 2] * weight


def tension_by(excess: float, square: float, natural: float, stiffness: float) -> float:
    """Tension [N] by the measure of force [m2], perhaps with a viscous part, and the squared length [m2]."""
    return stiffness * excess * math.sqrt(square) / (2.0 * natural**3)


def energy_with(law: int, table: Any, pull: float, natural: float, stiffness: float) -> float:
    """Least elastic energy [J] of a thread that pulls by so much [N].

    Of law 0, N = EA e sqrt(1 + 2 e) <= EA e (1 + e): at least that of the strain that makes the latter N.
    """
    strain = pull / stiffness
    if law == 0:
        strain = 0.5 * (math.sqrt(1.0 + 4.0 * pull / stiffness) - 1.0)
    elif law > 1:
        k = row_of(law, table, 1, strain)
        strain = (strain - table[k, 1]) / table[k, 2]
        held = table[k, 3] + (table[k, 1] + 0.5 * table[k, 2] * strain) * strain
        return stiffness * natural * held
    return 0.5 * stiffness * natural * strain * strain
