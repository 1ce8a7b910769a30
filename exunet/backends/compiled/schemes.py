"""Single steps of the compiled loop: velocity Verlet, the classical Runge-Kutta method, Dormand-Prince 5(4).

The text of these functions is copied into a kernel's module (see `exunet.codegen.generate`), beside
`add_forces`. A step starts from the state x, v of a `Motion` m at time t [s], is h long, and
leaves its result in x1 and v1 of its stages. `exunet.forces.blocks` says what stands where in them: m.c,
which v moves, comes first in x, and m.z, what is of first order, behind it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from exunet.backends.compiled.work_space import Stages
from exunet.codegen.force_table import Takes

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    BODIES = True
    FIRST_ORDER = True

    from exunet.codegen.sums import add_forces


def stages_of(work: Any) -> Any:
    """The rows of a work space by name."""
    return Stages(
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8],
        work[9], work[10], work[11], work[12], work[13], work[14], work[15], work[16],
    )  # fmt: skip


def accelerate(t: float, x: Any, v: Any, m: Any, a: Any) -> Any:
    """Accelerations a [m/s2], eq. (16), of the bodies' rotation by Euler's equations [rad/s2], and rates.

    Returns what `add_forces` does: the elastic energy [J] at x, and the power [W] that it tells.
    """
    n = m.push.size
    for c in range(n):
        a[c] = m.push[c]
    # Slices cost, and without bodies and states all rows have one length.
    told = add_forces(t, x, v[: m.v.size], m.data, a[:n]) if FIRST_ORDER else add_forces(t, x, v, m.data, a)
    if BODIES:
        add_gyroscopic(v, m.inertia, m.c.size, a)
    for c in range(n):
        a[c] *= m.inverse[c]
    return told


def accelerate_without_spin(t: float, x: Any, v: Any, m: Any, a: Any) -> Any:
    """As `accelerate`, without the gyroscopic torque of free rotation."""
    n = m.push.size
    for c in range(n):
        a[c] = m.push[c]
    # Slices cost, and without bodies and states all rows have one length.
    told = add_forces(t, x, v[: m.v.size], m.data, a[:n]) if FIRST_ORDER else add_forces(t, x, v, m.data, a)
    for c in range(n):
        a[c] *= m.inverse[c]
    return told


def add_gyroscopic(v: Any, inertia: Any, first: int, torque: Any) -> None:
    """-omega x (I omega) of each body, in its axes; its angular velocity begins at v[first]."""
    for b in range(inertia.shape[0]):
        k = first + 3 * b
        torque[k] += (inertia[b, 1] - inertia[b, 2]) * v[k + 1] * v[k + 2]
        torque[k + 1] += (inertia[b, 2] - inertia[b, 0]) * v[k + 2] * v[k]
        torque[k + 2] += (inertia[b, 0] - inertia[b, 1]) * v[k] * v[k + 1]


def turn(v: Any, z: Any, m: Any, rate: Any) -> None:
    """Rates of the attitudes in z: half the quaternion product with the angular velocity in body axes."""
    for b in range(m.inertia.shape[0]):
        k = m.c.size + 3 * b
        q = 4 * b
        rate[q] = -0.5 * (z[q + 1] * v[k] + z[q + 2] * v[k + 1] + z[q + 3] * v[k + 2])
        rate[q + 1] = 0.5 * (z[q] * v[k] + z[q + 2] * v[k + 2] - z[q + 3] * v[k + 1])
        rate[q + 2] = 0.5 * (z[q] * v[k + 1] + z[q + 3] * v[k] - z[q + 1] * v[k + 2])
        rate[q + 3] = 0.5 * (z[q] * v[k + 2] + z[q + 1] * v[k + 1] - z[q + 2] * v[k])


def first_order_rates(v: Any, z: Any, a: Any, m: Any, rate: Any) -> None:
    """Rates of all that is of first order: of attitudes, and those of terms that `accelerate` left in a."""
    turn(v, z, m, rate)
    first = 4 * m.inertia.shape[0]
    for k in range(first, z.size):
        rate[k] = a[m.v.size + k - first]


def stage(t: float, h: float, x: Any, v: Any, m: Any, a: Any, rate: Any, weights: Any) -> float:
    """What is of first order, m.z + h (c1 k1 + ... + c6 k6), into m.z1; accelerations a there, and its rate.

    rate : the row of m.rates for it, not its number: of a literal number, each would be compiled anew
    Returns the elastic energy [J].
    """
    if FIRST_ORDER:
        advance_first_order(h, m, weights)
    held, _ = accelerate(t, x, v, m, a)
    if FIRST_ORDER:
        first_order_rates(v, m.z1, a, m, rate)
    return held


def advance_first_order(h: float, m: Any, weights: Any) -> None:
    """m.z + h (c1 k1 + ... + c6 k6) into m.z1."""
    c1, c2, c3, c4, c5, c6 = weights
    k = m.rates
    for c in range(m.z.size):
        m.z1[c] = m.z[c] + h * (
            c1 * k[0, c] + c2 * k[1, c] + c3 * k[2, c] + c4 * k[3, c] + c5 * k[4, c] + c6 * k[5, c]
        )


def unit_attitudes(m: Any) -> None:
    """Make quaternions of length one again; a step leaves them so but for its error."""
    z = m.z
    for b in range(m.inertia.shape[0]):
        q = 4 * b
        square = z[q] * z[q] + z[q + 1] * z[q + 1] + z[q + 2] * z[q + 2] + z[q + 3] * z[q + 3]
        for c in range(4):
            z[q + c] /= np.sqrt(square)


def rotate_freely(h: float, m: Any) -> None:
    """The bodies' rotation without torque over h, from v1 and z into v1 and z1, by one step of order 4."""
    s = stages_of(m.work)
    first = m.c.size
    n = m.inertia.shape[0]
    for k in range(3 * n):  # entries before `first` are not used
        s.v2[first + k] = s.v1[first + k]
        s.v3[first + k] = s.v1[first + k]
    for part in range(4):
        after = 0.5 if part < 2 else 1.0
        weight = 1.0 if part == 0 or part == 3 else 2.0
        for c in range(4 * n):
            before = 0.0 if part == 0 else (0.5 if part < 3 else 1.0)
            m.z1[c] = m.z[c] + (before * h * m.rates[part - 1, c] if part > 0 else 0.0)
        turn(s.v2, m.z1, m, m.rates[part])
        for k in range(3 * n):
            s.v4[first + k] = 0.0
        add_gyroscopic(s.v2, m.inertia, first, s.v4)
        for k in range(first, first + 3 * n):
            rate = s.v4[k] * m.inverse[k]
            s.v3[k] += h / 6.0 * weight * rate
            s.v2[k] = s.v1[k] + after * h * rate
    for k in range(first, first + 3 * n):
        s.v1[k] = s.v3[k]
    for c in range(4 * n):
        m.z1[c] = m.z[c] + h / 6.0 * (m.rates[0, c] + 2.0 * (m.rates[1, c] + m.rates[2, c]) + m.rates[3, c])


def verlet_step(t: float, h: float, m: Any) -> float:
    """Verlet, Phys. Rev. 159 (1967) 98, doi 10.1103/PhysRev.159.98.

    Forces that depend on the velocity are taken with that of the half step, as the engine does; a1 goes from
    step to step. Bodies rotate freely between two half steps of the torque, so that rotation is of order 2
    too (the engine's is of order 1). First-order states go by Heun's method, whose second rate is that of the
    forces at the end: order 2, but for rates that depend on velocities. Where the forces tell all power,
    m.taken gets that at the velocity of the half step, by the midpoint rule. Returns the elastic energy at
    the end [J].
    """
    s = stages_of(m.work)
    states = 4 * m.inertia.shape[0]
    for c in range(m.v.size):
        s.v1[c] = m.v[c] + 0.5 * h * s.a1[c]
    for c in range(m.c.size):
        s.x1[c] = m.c[c] + h * s.v1[c]
    if BODIES:
        rotate_freely(h, m)
    if FIRST_ORDER:
        for k in range(states, m.z.size):
            m.rates[0, k] = s.a1[m.v.size + k - states]
            m.z1[k] = m.z[k] + h * m.rates[0, k]
    if BODIES:
        held, watts = accelerate_without_spin(t + h, s.x1, s.v1, m, s.a1)
    else:
        held, watts = accelerate(t + h, s.x1, s.v1, m, s.a1)
    if m.takes == Takes.TOLD:
        m.taken[0] += h * watts
    for c in range(m.v.size):
        s.v1[c] += 0.5 * h * s.a1[c]
    if FIRST_ORDER:
        for k in range(states, m.z.size):
            m.z1[k] = m.z[k] + 0.5 * h * (m.rates[0, k] + s.a1[m.v.size + k - states])
    return held


def verlet_step_in_place(t: float, h: float, m: Any) -> float:
    """`verlet_step` of points alone, which leaves its result in the state itself: no copies."""
    x = m.x
    v = m.v
    a1 = stages_of(m.work).a1
    for c in range(v.size):
        v[c] += 0.5 * h * a1[c]
    for c in range(x.size):
        x[c] += h * v[c]
    held, watts = accelerate(t + h, x, v, m, a1)
    if m.takes == Takes.TOLD:
        m.taken[0] += h * watts
    for c in range(v.size):
        v[c] += 0.5 * h * a1[c]
    return held


def runge_kutta_4_step(t: float, h: float, m: Any) -> None:
    """The classical method of order 4, as the engine's RK44.

    Its first stage is a1, which the caller renews at the step's end: as many evaluations as with four stages
    in the step, but the elastic energy at the end is known with them.
    """
    s = stages_of(m.work)
    x = m.c
    v = m.v
    if FIRST_ORDER:
        first_order_rates(v, m.z, s.a1, m, m.rates[0])
    for c in range(x.size):
        s.x1[c] = x[c] + 0.5 * h * v[c]
    for c in range(v.size):
        s.v2[c] = v[c] + 0.5 * h * s.a1[c]
    stage(t + 0.5 * h, h, s.x1, s.v2, m, s.a2, m.rates[1], (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    for c in range(x.size):
        s.x1[c] = x[c] + 0.5 * h * s.v2[c]
    for c in range(v.size):
        s.v3[c] = v[c] + 0.5 * h * s.a2[c]
    stage(t + 0.5 * h, h, s.x1, s.v3, m, s.a3, m.rates[2], (0.0, 0.5, 0.0, 0.0, 0.0, 0.0))
    for c in range(x.size):
        s.x1[c] = x[c] + h * s.v3[c]
    for c in range(v.size):
        s.v4[c] = v[c] + h * s.a3[c]
    stage(t + h, h, s.x1, s.v4, m, s.a4, m.rates[3], (0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    for c in range(x.size):
        s.x1[c] = x[c] + h / 6.0 * (v[c] + 2.0 * (s.v2[c] + s.v3[c]) + s.v4[c])
    for c in range(v.size):
        s.v1[c] = v[c] + h / 6.0 * (s.a1[c] + 2.0 * (s.a2[c] + s.a3[c]) + s.a4[c])
    if FIRST_ORDER:
        advance_first_order(h, m, (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 0.0, 0.0))


def largest(values: Any) -> float:
    """Largest absolute value; infinity if there is one that is not a number."""
    worst = 0.0
    for c in range(values.size):
        value = abs(values[c])
        if not value <= worst:
            if value != value:
                return np.inf
            worst = value
    return worst


def dormand_prince_step(t: float, h: float, m: Any) -> Any:
    """Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, doi 10.1016/0771-050X(80)90013-3: order 5(4).

    Written for x'' = a: the velocities of the stages are put into the positions, whose coefficients are then
    sum_k a_ik a_kj, so only accelerations are kept; the result is the same but for round-off. What is of
    first order is integrated as it is. a7 gets the acceleration at the end, which is that of the next
    step's start. Returns the largest error estimate over the coordinates, of the embedded method of order 4
    [m, m/s, rad/s, or of a quaternion], and the elastic energy at the end [J].
    """
    s = stages_of(m.work)
    x = m.c
    v = m.v
    x1 = s.x1
    v1 = s.v1
    a1 = s.a1
    a2 = s.a2
    a3 = s.a3
    a4 = s.a4
    a5 = s.a5
    a6 = s.a6
    a7 = s.a7
    n_x = x.size
    n = v.size
    hh = h * h
    if FIRST_ORDER:
        first_order_rates(v, m.z, a1, m, m.rates[0])
    for c in range(n_x):
        x1[c] = x[c] + h / 5.0 * v[c]
    for c in range(n):
        v1[c] = v[c] + h / 5.0 * a1[c]
    stage(t + 0.2 * h, h, x1, v1, m, a2, m.rates[1], (0.2, 0.0, 0.0, 0.0, 0.0, 0.0))
    for c in range(n_x):
        x1[c] = x[c] + 0.3 * h * v[c] + hh * (9.0 / 200.0) * a1[c]
    for c in range(n):
        v1[c] = v[c] + h * (3.0 / 40.0 * a1[c] + 9.0 / 40.0 * a2[c])
    stage(t + 0.3 * h, h, x1, v1, m, a3, m.rates[2], (3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0))
    for c in range(n_x):
        x1[c] = x[c] + 0.8 * h * v[c] + hh * (-12.0 / 25.0 * a1[c] + 4.0 / 5.0 * a2[c])
    for c in range(n):
        v1[c] = v[c] + h * (44.0 / 45.0 * a1[c] - 56.0 / 15.0 * a2[c] + 32.0 / 9.0 * a3[c])
    stage(t + 0.8 * h, h, x1, v1, m, a4, m.rates[3], (44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0))
    for c in range(n_x):
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
    c4 = -212.0 / 729.0
    stage(
        t + 8.0 / 9.0 * h,
        h,
        x1,
        v1,
        m,
        a5,
        m.rates[4],
        (19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, c4, 0.0, 0.0),
    )
    for c in range(n_x):
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
    c5 = -5103.0 / 18656.0
    stage(
        t + h,
        h,
        x1,
        v1,
        m,
        a6,
        m.rates[5],
        (9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, c5, 0.0),
    )
    for c in range(n_x):
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
    c5 = -2187.0 / 6784.0
    held = stage(
        t + h,
        h,
        x1,
        v1,
        m,
        a7,
        m.rates[6],
        (35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, c5, 11.0 / 84.0),
    )
    for c in range(n_x):
        s.of_x[c] = hh * (
            611.0 / 230400.0 * a1[c]
            - 514.0 / 83475.0 * a3[c]
            + 391.0 / 38400.0 * a4[c]
            - 4617.0 / 1356800.0 * a5[c]
            - 11.0 / 3360.0 * a6[c]
        )
    for c in range(n):
        s.of_v[c] = h * (
            71.0 / 57600.0 * a1[c]
            - 71.0 / 16695.0 * a3[c]
            + 71.0 / 1920.0 * a4[c]
            - 17253.0 / 339200.0 * a5[c]
            + 22.0 / 525.0 * a6[c]
            - 1.0 / 40.0 * a7[c]
        )
    error = max(largest(s.of_x), largest(s.of_v))
    if FIRST_ORDER:
        error = max(error, largest_of_first_order(h, m.rates))
    return error, held


def largest_of_first_order(h: float, k: Any) -> float:
    """Largest error estimate of what is of first order in a Dormand-Prince step."""
    worst = 0.0
    for c in range(k.shape[1]):
        estimate = abs(h * (
            71.0 / 57600.0 * k[0, c]
            - 71.0 / 16695.0 * k[2, c]
            + 71.0 / 1920.0 * k[3, c]
            - 17253.0 / 339200.0 * k[4, c]
            + 22.0 / 525.0 * k[5, c]
            - 1.0 / 40.0 * k[6, c]
        ))  # fmt: skip
        if not estimate <= worst:
            if estimate != estimate:
                return np.inf
            worst = estimate
    return worst
