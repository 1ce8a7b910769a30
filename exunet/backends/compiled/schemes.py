"""Single steps of the compiled loop: velocity Verlet, the classical Runge-Kutta method, Dormand-Prince 5(4).

The text of these functions is copied into a kernel's specialised module (see `exunet.codegen.generate`),
beside its `forces`. A step starts from x, v (n,) [m], [m/s] at time t [s], is h long, and leaves its result
in work[1], work[2]. inverse is 1 / mass (n,) [1/kg], zero for what is held still, data the kernel's data.
work (16, n): row 0 holds the acceleration at (x, v) that the step before has left, rows 13 to 15 are
scratch for the work of forces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # the generated module holds it beside the functions below

    def forces(t: float, x: Any, v: Any, data: Any, force: Any) -> float: ...


def accelerate(t: float, x: Any, v: Any, inverse: Any, data: Any, a: Any) -> float:
    """Accelerations a (n,) [m/s2], eq. (16); returns the elastic energy [J] at x."""
    held = forces(t, x, v, data, a)
    for c in range(a.size):
        a[c] *= inverse[c]
    return held


def verlet_step(t: float, h: float, x: Any, v: Any, inverse: Any, data: Any, work: Any) -> float:
    """Verlet, Phys. Rev. 159 (1967) 98, doi 10.1103/PhysRev.159.98.

    Forces that depend on the velocity are taken with that of the half step, as the engine does; row 0 goes
    from step to step. Returns the elastic energy at the end [J].
    """
    a = work[0]
    x1 = work[1]
    v1 = work[2]
    for c in range(x.size):
        v1[c] = v[c] + 0.5 * h * a[c]
        x1[c] = x[c] + h * v1[c]
    held = accelerate(t + h, x1, v1, inverse, data, a)
    for c in range(x.size):
        v1[c] += 0.5 * h * a[c]
    return held


def runge_kutta_4_step(t: float, h: float, x: Any, v: Any, inverse: Any, data: Any, work: Any) -> None:
    """The classical method of order 4 on (x, v), as the engine's RK44.

    Its first stage is row 0, which the caller renews at the step's end: as many evaluations as with four
    stages in the step, but the elastic energy at the end is known with them.
    """
    a1 = work[0]
    x1 = work[1]
    v1 = work[2]
    a2 = work[3]
    a3 = work[4]
    a4 = work[5]
    v2 = work[6]
    v3 = work[7]
    v4 = work[8]
    for c in range(x.size):
        x1[c] = x[c] + 0.5 * h * v[c]
        v2[c] = v[c] + 0.5 * h * a1[c]
    accelerate(t + 0.5 * h, x1, v2, inverse, data, a2)
    for c in range(x.size):
        x1[c] = x[c] + 0.5 * h * v2[c]
        v3[c] = v[c] + 0.5 * h * a2[c]
    accelerate(t + 0.5 * h, x1, v3, inverse, data, a3)
    for c in range(x.size):
        x1[c] = x[c] + h * v3[c]
        v4[c] = v[c] + h * a3[c]
    accelerate(t + h, x1, v4, inverse, data, a4)
    for c in range(x.size):
        x1[c] = x[c] + h / 6.0 * (v[c] + 2.0 * (v2[c] + v3[c]) + v4[c])
    for c in range(x.size):
        v1[c] = v[c] + h / 6.0 * (a1[c] + 2.0 * (a2[c] + a3[c]) + a4[c])


def largest(first: Any, second: Any) -> float:
    """Largest absolute value in two arrays; infinity if there is one that is not a number."""
    worst = 0.0
    for c in range(first.size):
        for value in (abs(first[c]), abs(second[c])):
            if not value <= worst:
                if value != value:
                    return np.inf
                worst = value
    return worst


def dormand_prince_step(t: float, h: float, x: Any, v: Any, inverse: Any, data: Any, work: Any) -> Any:
    """Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, doi 10.1016/0771-050X(80)90013-3: order 5(4).

    Written for x'' = a: the velocities of the stages are put into the positions, whose coefficients are then
    sum_k a_ik a_kj, so only accelerations are kept; the result is the same but for round-off. Row 9 gets the
    acceleration at the end, which is that of the next step's start. Returns the largest error estimate over
    the coordinates, of the embedded method of order 4 [m or m/s], and the elastic energy at the end [J].
    """
    x1 = work[1]
    v1 = work[2]
    a1 = work[0]
    a2 = work[4]
    a3 = work[5]
    a4 = work[6]
    a5 = work[7]
    a6 = work[8]
    a7 = work[9]
    of_x = work[10]
    of_v = work[11]
    n = x.size
    hh = h * h
    for c in range(n):
        x1[c] = x[c] + h / 5.0 * v[c]
        v1[c] = v[c] + h / 5.0 * a1[c]
    accelerate(t + 0.2 * h, x1, v1, inverse, data, a2)
    for c in range(n):
        x1[c] = x[c] + 0.3 * h * v[c] + hh * (9.0 / 200.0) * a1[c]
        v1[c] = v[c] + h * (3.0 / 40.0 * a1[c] + 9.0 / 40.0 * a2[c])
    accelerate(t + 0.3 * h, x1, v1, inverse, data, a3)
    for c in range(n):
        x1[c] = x[c] + 0.8 * h * v[c] + hh * (-12.0 / 25.0 * a1[c] + 4.0 / 5.0 * a2[c])
    for c in range(n):
        v1[c] = v[c] + h * (44.0 / 45.0 * a1[c] - 56.0 / 15.0 * a2[c] + 32.0 / 9.0 * a3[c])
    accelerate(t + 0.8 * h, x1, v1, inverse, data, a4)
    for c in range(n):
        x1[c] = (
            x[c]
            + h * (8.0 / 9.0) * v[c]
            + hh * (-12248.0 / 6561.0 * a1[c] + 7208.0 / 2187.0 * a2[c] - 6784.0 / 6561.0 * a3[c])
        )
    for c in range(n):
        v1[c] = v[c] + h * (
            19372.0 / 6561.0 * a1[c]
            - 25360.0 / 2187.0 * a2[c]
            + 64448.0 / 6561.0 * a3[c]
            - 212.0 / 729.0 * a4[c]
        )
    accelerate(t + 8.0 / 9.0 * h, x1, v1, inverse, data, a5)
    for c in range(n):
        x1[c] = (
            x[c]
            + h * v[c]
            + hh * (-533.0 / 264.0 * a1[c] + 91.0 / 22.0 * a2[c] - 56.0 / 33.0 * a3[c] + 7.0 / 88.0 * a4[c])
        )
    for c in range(n):
        v1[c] = v[c] + h * (
            9017.0 / 3168.0 * a1[c]
            - 355.0 / 33.0 * a2[c]
            + 46732.0 / 5247.0 * a3[c]
            + 49.0 / 176.0 * a4[c]
            - 5103.0 / 18656.0 * a5[c]
        )
    accelerate(t + h, x1, v1, inverse, data, a6)
    for c in range(n):
        x1[c] = (
            x[c]
            + h * v[c]
            + hh
            * (35.0 / 384.0 * a1[c] + 50.0 / 159.0 * a3[c] + 25.0 / 192.0 * a4[c] - 243.0 / 6784.0 * a5[c])
        )
    for c in range(n):
        v1[c] = v[c] + h * (
            35.0 / 384.0 * a1[c]
            + 500.0 / 1113.0 * a3[c]
            + 125.0 / 192.0 * a4[c]
            - 2187.0 / 6784.0 * a5[c]
            + 11.0 / 84.0 * a6[c]
        )
    held = accelerate(t + h, x1, v1, inverse, data, a7)
    for c in range(n):
        of_x[c] = hh * (
            611.0 / 230400.0 * a1[c]
            - 514.0 / 83475.0 * a3[c]
            + 391.0 / 38400.0 * a4[c]
            - 4617.0 / 1356800.0 * a5[c]
            - 11.0 / 3360.0 * a6[c]
        )
    for c in range(n):
        of_v[c] = h * (
            71.0 / 57600.0 * a1[c]
            - 71.0 / 16695.0 * a3[c]
            + 71.0 / 1920.0 * a4[c]
            - 17253.0 / 339200.0 * a5[c]
            + 22.0 / 525.0 * a6[c]
            - 1.0 / 40.0 * a7[c]
        )
    return largest(of_x, of_v), held
