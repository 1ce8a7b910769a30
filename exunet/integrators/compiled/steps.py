"""Steps of the compiled loop: integration methods, work of forces, extremes, fixed and adaptive steps.

The text of these functions is copied into a kernel's module (see `exunet.kernels.source`), beside
`add_forces`. A single step starts from the state x, v of a `Motion` m at time t [s], is h long, and leaves
its result in x1 and v1 of its stages. `exunet.forces.blocks` defines the layout: m.c, which v moves, comes
first in x, and m.z, what is of first order, behind it.

Fixed-step and adaptive loops take a whole `StepInterval` with the room for the states that the guards check,
which is filled from `row` on: one step in `every`, the last, and those of so much elastic energy that an
element may be too long. `equal_steps` and `chosen_steps` return the number of rows that are filled; they
return when those are full, when `limit` steps have been tried, or at the end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from exunet.forces.law import energy_with, excess_over, pull_of, row_of, tension_by, weight_of
from exunet.integrators.compiled.workspace import EqualSteps, Stages
from exunet.kernels.kernel import Takes
from exunet.kernels.source import in_any_order

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.kernels.pointers import borrowed
    from exunet.kernels.source import add_forces, extra_work, has_power, is_due, power, remember, shortened

    BODIES = True
    FIRST_ORDER = True


def stages_of(work: Any) -> Any:
    """The rows of a work space by name."""
    return Stages(
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8],
        work[9], work[10], work[11], work[12], work[13], work[14], work[15], work[16],
    )  # fmt: skip


def accelerate(t: float, x: Any, v: Any, m: Any, a: Any) -> Any:
    """Accelerations a [m/s2], eq. (16), of the bodies' rotation by Euler's equations [rad/s2], and rates.

    Returns what `add_forces` does: the elastic energy [J] at x, and the power [W] that it reports.
    """
    n = m.external.size
    for c in range(n):
        a[c] = m.external[c]
    # Slices cost, and without bodies and states all rows have one length.
    reported = (
        add_forces(t, x, v[: m.v.size], m.data, a[:n]) if FIRST_ORDER else add_forces(t, x, v, m.data, a)
    )
    if BODIES:
        add_gyroscopic(v, m.inertia, m.c.size, a)
    for c in range(n):
        a[c] *= m.inverse[c]
    return reported


def accelerate_without_spin(t: float, x: Any, v: Any, m: Any, a: Any) -> Any:
    """As `accelerate`, without the gyroscopic torque of free rotation."""
    n = m.external.size
    for c in range(n):
        a[c] = m.external[c]
    # Slices cost, and without bodies and states all rows have one length.
    reported = (
        add_forces(t, x, v[: m.v.size], m.data, a[:n]) if FIRST_ORDER else add_forces(t, x, v, m.data, a)
    )
    for c in range(n):
        a[c] *= m.inverse[c]
    return reported


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
    """Compute first-order m.z1 = m.z + h (c1 k1 + ... + c6 k6); accelerations a there, and its rate.

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
    forces at the end: order 2, but for rates that depend on velocities. Where the forces report all power,
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
    if m.takes == Takes.REPORTED:
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
    if m.takes == Takes.REPORTED:
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


def work_of_step(t: float, h: float, power_at_start: float, a: Any, m: Any, verlet: bool) -> float:
    """Add to m.taken what the step to x1, v1 took out, by Simpson's rule; returns the power at its end [W].

    The state in the middle is that of the cubic Hermite polynomial through both ends; a: what `accelerate`
    found at the end. Forces that report their work have it from both ends, or from the Verlet step itself.
    """
    s = stages_of(m.work)
    x = m.c
    v = m.v
    n = v.size
    watts = power_at_start
    if has_power(m.data):
        for c in range(x.size):
            s.middle_x[c] = 0.5 * (x[c] + s.x1[c]) + 0.125 * h * (v[c] - s.v1[c])
            s.middle_v[c] = 1.5 * (s.x1[c] - x[c]) / h - 0.25 * (v[c] + s.v1[c])
        if FIRST_ORDER:
            middle_of_first_order(h, a, m)
        middle = power(t + 0.5 * h, s.middle_x, s.middle_v[:n], m.data, s.scratch)
        watts = power(t + h, s.x1, s.v1[:n], m.data, s.scratch)
        m.taken[0] += h / 6.0 * (power_at_start + 4.0 * middle + watts)
    m.taken[0] += extra_work(h, (x, v), (s.x1, s.v1), m.data, verlet)
    return watts


def add_external_work(m: Any) -> None:
    """Add to m.taken the work of the forces from outside, constant in the step to x1, which is exact."""
    x1 = stages_of(m.work).x1
    given = 0.0
    for c in range(m.c.size):
        given += m.external[c] * (x1[c] - m.c[c])
    m.taken[0] -= given


def middle_of_first_order(h: float, a: Any, m: Any) -> None:
    """Attitudes, angular velocities and first-order states in the middle of a step, as `work_of_step`."""
    s = stages_of(m.work)
    n_c = m.c.size
    begins = m.rates[0]
    ends = m.rates[6]
    turn(m.v, m.z, m, begins)
    first_order_rates(s.v1, m.z1, a, m, ends)
    for k in range(m.z.size):
        s.middle_x[n_c + k] = 0.5 * (m.z[k] + m.z1[k]) + 0.125 * h * (begins[k] - ends[k])
    for b in range(m.inertia.shape[0]):
        q = 4 * b
        for k in range(q, q + 4):
            ends[k] = 1.5 * (m.z1[k] - m.z[k]) / h - 0.25 * (begins[k] + ends[k])
        z = s.middle_x[n_c + q : n_c + q + 4]
        r = ends[q : q + 4]
        twice = 2.0 / (z[0] * z[0] + z[1] * z[1] + z[2] * z[2] + z[3] * z[3])
        w = n_c + 3 * b
        s.middle_v[w] = twice * (z[0] * r[1] - r[0] * z[1] - z[2] * r[3] + z[3] * r[2])
        s.middle_v[w + 1] = twice * (z[0] * r[2] - r[0] * z[2] - z[3] * r[1] + z[1] * r[3])
        s.middle_v[w + 2] = twice * (z[0] * r[3] - r[0] * z[3] - z[1] * r[2] + z[2] * r[1])


def see(t: float, elastic: float, kinetic: float, x: Any, v: Any, a: Any, seen: Any) -> None:
    """Take a step's end, whose elastic and kinetic energy [J] and accelerations are known, into `seen`."""
    peaks = seen.peaks[0]
    if elastic > peaks["elastic"]:
        peaks["elastic"] = elastic
    if kinetic < peaks["kinetic"]:
        peaks["kinetic"] = kinetic
    if elastic > peaks["look_above"]:
        observe_outlets(x, a, seen)
        observe_tensions(t, x, v, seen)


def observe_outlets(x: Any, a: Any, seen: Any) -> None:
    """Update the natural lengths of the outlets of reels."""
    for k in range(seen.outlets.size):
        outlet = seen.outlets[k]
        e = outlet["element"]
        length = outlet["ratio"] * max(outlet["base"] - x[outlet["wound"]], outlet["least"])
        seen.length[e] = length
        seen.highest[e] = 0.0 if seen.twice_time[e] > 0.0 else length**2
        seen.winding[e] = outlet["ratio"] * a[outlet["rate"]] / length


def observe_tensions(t: float, x: Any, v: Any, seen: Any) -> None:
    """Take the largest tension of each group, and the least elastic energy with which there may be a larger.

    Viscous stress needs no energy: there each taut state is looked at.
    """
    first = seen.first
    second = seen.second
    highest = seen.highest
    peaks = seen.peaks[0]
    found = False
    for g in range(seen.largest.size):
        largest = seen.largest[g]["tension"]
        element = -1
        for e in range(seen.bounds[g], seen.bounds[g + 1]):
            if seen.taut[e] == 0.0 and seen.jumps[e] > 0.0:
                continue
            i = first[e]
            j = second[e]
            dx = x[j] - x[i]
            dy = x[j + 1] - x[i + 1]
            dz = x[j + 2] - x[i + 2]
            square = dx * dx + dy * dy + dz * dz
            length = seen.length[e]
            excess = excess_over(square, length)
            measure = square
            if seen.twice_time[e] > 0.0:
                if excess <= 0.0:
                    continue
                along = dx * (v[j] - v[i]) + dy * (v[j + 1] - v[i + 1]) + dz * (v[j + 2] - v[i + 2])
                drag = seen.twice_time[e] * (along + square * seen.winding[e])
                drag *= weight_of(seen.law[e], seen.table, excess, length * length)
                excess = pull_of(seen.law[e], seen.table, excess, length * length)[0] + drag
                measure = excess * abs(excess) * square
            if measure > highest[e]:
                highest[e] = measure
                if not seen.twice_time[e] > 0.0:
                    excess = pull_of(seen.law[e], seen.table, excess, length * length)[0]
                tension = tension_by(excess, square, length, seen.stiffness[e])
                if tension > seen.of_elements[e]:
                    seen.of_elements[e] = tension
                if tension > largest:
                    largest = tension
                    element = e
        if element >= 0:
            found = True
            seen.largest[g]["tension"] = largest
            seen.largest[g]["time"] = t
            seen.largest[g]["element"] = element
    if found and peaks["look_above"] >= 0.0:
        least = np.inf
        for g in range(seen.largest.size):
            for e in range(seen.bounds[g], seen.bounds[g + 1]):
                if seen.twice_time[e] > 0.0:
                    return
                if seen.stiffness[e] > 0.0:
                    tension = seen.largest[g]["tension"]
                    law, length, stiffness = seen.law[e], seen.length[e], seen.stiffness[e]
                    least = min(least, energy_with(law, seen.table, tension, length, stiffness))
        peaks["look_above"] = least


def keep(row: int, t: float, m: Any, kept: Any) -> int:
    """Copy the state into a row of `kept`; returns the next row."""
    kept.time[row] = t
    kept.taken[row] = m.taken[0]
    for c in range(m.x.size):
        kept.x[row, c] = m.x[c]
    for c in range(m.v.size):
        kept.v[row, c] = m.v[c]
    return row + 1


def look(t: float, m: Any, looks: Any) -> bool:
    """Copy what is watched of the state into `looks`; true if the stretch of steps ends there."""
    row = looks.at[0]
    looks.time[row] = t
    for k in range(looks.of_x.size):
        looks.x[looks.of_x[k], row] = m.x[looks.of_x[k]]
    for k in range(looks.of_v.size):
        looks.v[looks.of_v[k], row] = m.v[looks.of_v[k]]
    for k in range(looks.of_discrete.size):
        looks.reported[row, k] = looks.discrete[looks.of_discrete[k]]
    if looks.weights.size > 0:
        for axis in range(3):
            place = 0.0
            speed = 0.0
            for k in range(looks.weights.size):
                place += looks.weights[k] * m.x[3 * k + axis]
                speed += looks.weights[k] * m.v[3 * k + axis]
            looks.mean[row, axis] = place
            looks.mean[row, 3 + axis] = speed
    looks.at[0] = row + 1
    return looks.at[0] == looks.at[1]


SEEING = (
    excess_over,
    row_of,
    pull_of,
    weight_of,
    tension_by,
    energy_with,
    observe_outlets,
    observe_tensions,
    see,
    look,
)


TINY_IN_A_ROW = 200.0  # steps of the least length, one after the other, that count as a collapse


def begin(t: float, verlet: bool, m: Any) -> None:
    """Compute the acceleration at the state, where a step before has not left it."""
    own = borrowed(m)
    a1 = stages_of(own.work).a1
    if BODIES and verlet:
        accelerate_without_spin(t, own.x, own.v, own, a1)
    else:
        accelerate(t, own.x, own.v, own, a1)


@in_any_order
def accept(m: Any, half: Any) -> float:
    """Make the step's result the state; returns its kinetic energy [J].

    half : (n_v,) half of the masses and inertias, as `ObservedSteps.half`
    """
    s = stages_of(m.work)
    total = 0.0
    for c in range(m.x.size):
        m.x[c] = s.x1[c]
    for c in range(m.v.size):
        speed = s.v1[c]
        m.v[c] = speed
        total += half[c] * speed * speed
    if BODIES:
        unit_attitudes(m)
    return total


@in_any_order
def kinetic_energy(v: Any, half: Any) -> float:
    """Kinetic energy [J]; half as that of `accept`."""
    total = 0.0
    for c in range(v.size):
        total += half[c] * v[c] * v[c]
    return total


def jump_ahead(within: float, tolerance: float, t: float, m: Any, seen: Any) -> Any:
    """Return the time until the next jump of the forces and the step across it [s] (see `cable_term`).

    Both infinite without a jump within a time [s] that matters.
    """
    x = m.x
    v = m.v
    a = stages_of(m.work).a1
    after = np.inf
    across = np.inf
    for e in range(seen.first.size):
        if seen.jumps[e] <= 0.0 or seen.stiffness[e] <= 0.0:
            continue
        i = seen.first[e]
        j = seen.second[e]
        dd = 0.0
        dw = 0.0
        ww = 0.0
        db = 0.0
        wb = 0.0
        bb = 0.0
        place = 0.0
        for c in range(3):
            d = x[j + c] - x[i + c]
            w = v[j + c] - v[i + c]
            b = a[j + c] - a[i + c]
            dd += d * d
            dw += d * w
            ww += w * w
            db += d * b
            wb += w * b
            bb += b * b
            place = max(place, abs(x[i + c]), abs(x[j + c]))
        length = seen.length[e]
        distance = math.sqrt(dd)
        reach = distance + within * (math.sqrt(ww) + 0.5 * within * math.sqrt(bb))
        if distance > length * (1.0 + 1e-15) or reach <= length or ww == 0.0:
            continue
        c0 = (distance - length) * (distance + length)
        below = min(c0, 0.0)
        root = math.sqrt(4.0 * dw * dw - 4.0 * ww * below)
        straight = -2.0 * below / (2.0 * dw + root) if dw > 0.0 else (root - 2.0 * dw) / (2.0 * ww)
        time = straight
        for _ in range(6):
            slope = 2.0 * dw + time * (2.0 * (ww + db) + time * (3.0 * wb + time * bb))
            if slope == 0.0:
                break
            time -= (c0 + time * (2.0 * dw + time * (ww + db + time * (wb + time * 0.25 * bb)))) / slope
        if not (0.25 * straight < time < 4.0 * straight):
            time = straight
        parting = (2.0 * dw + time * (2.0 * (ww + db) + time * (3.0 * wb + time * bb))) / (2.0 * length)
        mobility = max(m.inverse[i], m.inverse[j])
        size = 0.5 * seen.jumps[e] * seen.stiffness[e] / length * mobility * parting
        if parting > 0.0 and time <= within and size * within > tolerance and time < after:
            after = time
            surely = 64.0 * 2.220446049250313e-16 * max(t, (place + length) / parting)
            across = min(within, max(tolerance / size, surely))
    return after, across


def equal_steps(verlet: bool, steps: Any, row: int, every: int, run: Any) -> int:
    """Take the steps that an `EqualSteps` names."""
    m, clock, seen, kept, looks = borrowed(run)
    now = clock[0]
    start, until, number, first, limit = steps
    s = stages_of(m.work)
    h = (until - start) / number
    watts = 0.0
    has_external = m.has_external[0] > 0.0
    simpson = m.takes == Takes.INTEGRATED or (m.takes == Takes.REPORTED and not verlet)
    if simpson:
        watts = power(start + first * h, m.x, m.v, m.data, s.scratch)
    in_place = verlet and not (simpson or has_external or FIRST_ORDER)
    for step in range(first, min(number, first + limit)):
        t = start + step * h
        end = until if step + 1 == number else start + (step + 1) * h  # to the last bit the next step's t
        if in_place:
            held = verlet_step_in_place(t, h, m)
            kinetic = kinetic_energy(m.v, seen.half)
        else:
            if verlet:
                held = verlet_step(t, h, m)
            else:
                runge_kutta_4_step(t, h, m)
                held, _ = accelerate(end, s.x1, s.v1, m, s.a1)
            if simpson:
                watts = work_of_step(t, h, watts, s.a1, m, verlet)
            if has_external:
                add_external_work(m)
            kinetic = accept(m, seen.half)
        remember(end, m.x, m.v, m.data)
        see(end, held, kinetic, m.x, m.v, s.a1, seen)
        now["steps"] += 1
        now["time"] = end
        due = is_due(end, m.x, m.v, m.data)
        if due or (step + 1) % every == 0 or step + 1 == number or held > seen.peaks[0]["keep_above"]:
            row = keep(row, end, m, kept)
        ends = looks.at[1] > 0 and look(end, m, looks)
        if due or ends or row == kept.time.size:
            break
    return row


def chosen_steps(control: Any, until: float, limit: int, row: int, every: int, run: Any) -> int:
    """Dormand-Prince steps to `until`, the largest error estimate of each not above the tolerance.

    `until` is hit by shortened steps, the last two of a stretch made equal, and the length that the control
    had chosen continues after it: the stored states are of full order, which interpolated ones would not be.
    The control is that of Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", eq.
    (II.4.13), with growth by 2 at most: a slack net snaps taut within a step, and larger jumps get rejected.
    Where a rejected step had a jump of the forces in its way, steps go to just before it, one goes across it
    whatever its error estimate, and the control continues with the step that it had chosen before. If the way
    to the jump is itself too long a step, the control goes on by itself until it rejects another step.
    """
    m, clock, seen, kept, looks = borrowed(run)
    now = clock[0]
    s = stages_of(m.work)
    least = control.least
    has_external = m.has_external[0] > 0.0
    watts = 0.0
    if m.takes != Takes.NOTHING:
        watts = power(now["time"], m.x, m.v, m.data, s.scratch)
    for _ in range(limit):
        wanted = now["beyond"] if now["beyond"] > 0.0 else now["step"]
        step = min(wanted, control.longest, until - now["time"])
        shorter = shortened(step, 8.0 * least, m.x, m.v, m.data)
        if shorter < step:
            now["step"] = shorter
            now["beyond"] = min(now["beyond"], shorter)
        wanted = min(now["step"], control.longest)
        across = False
        if now["beyond"] > 0.0:
            after, over = jump_ahead(now["beyond"], control.tolerance, now["time"], m, seen)
            if after == np.inf:
                if now["rejected"] == 0.0:
                    wanted = now["beyond"]
                now["beyond"] = 0.0
                now["towards"] = 0.0
            elif now["rejected"] == 1.0 and now["towards"] == 1.0:
                now["beyond"] = now["towards"] = 0.0
            else:
                across = after <= over
                wanted = after + over if across else after - max(0.5 * over, 0.01 * after)
                now["towards"] = 1.0
        rest = until - now["time"]
        h = wanted
        if rest <= 1.0000001 * wanted:
            h = rest
        elif rest < 2.0 * wanted:
            h = 0.5 * rest
        error, held = dormand_prince_step(now["time"], h, m)
        error /= control.tolerance
        if not (error <= 1.0 or ((h <= least or across) and error < np.inf)):
            now["rejections"] += 1
            if now["beyond"] == 0.0:
                after, over = jump_ahead(h, control.tolerance, now["time"], m, seen)
                now["beyond"] = h if after < np.inf else 0.0
            now["rejected"] = 1.0
            shrink = 0.2 if error == np.inf else max(0.2, 0.9 * error**-0.2)
            now["step"] = max(least, h * shrink)
            if h <= least:
                now["tiny"] = np.inf
                break
            continue
        now["tiny"] = now["tiny"] + 1.0 if h <= 4.0 * least and not across else 0.0
        if m.takes != Takes.NOTHING:
            watts = work_of_step(now["time"], h, watts, s.a7, m, False)
        if has_external:
            add_external_work(m)
        kinetic = accept(m, seen.half)
        remember(until if h == rest else now["time"] + h, m.x, m.v, m.data)
        see(now["time"] + h, held, kinetic, m.x, m.v, s.a7, seen)
        for c in range(m.external.size):
            s.a1[c] = s.a7[c]
        now["steps"] += 1
        now["time"] = until if h == rest else now["time"] + h
        change = max(0.2, min(1.0 if now["rejected"] == 1.0 else 2.0, 0.9 * max(error, 1e-10) ** -0.2))
        now["rejected"] = 0.0
        now["step"] = max(least, h * change, wanted if h < wanted and error <= 1.0 else 0.0)
        due = is_due(now["time"], m.x, m.v, m.data)
        if due or now["steps"] % every == 0 or now["time"] == until or held > seen.peaks[0]["keep_above"]:
            row = keep(row, now["time"], m, kept)
        ends = looks.at[1] > 0 and look(now["time"], m, looks)
        if due or ends or row == kept.time.size or now["time"] == until:
            break
    return row


def equal_stretch(verlet: bool, steps: Any, row: int, every: int, held: Any) -> int:
    """`equal_steps` of a `StepInterval` that is a `HeldTuple`: for many short calls from Python."""
    return equal_steps(verlet, steps, row, every, borrowed(held.value))


def chosen_stretch(control: Any, until: float, limit: int, row: int, every: int, held: Any) -> int:
    """`chosen_steps` of a `StepInterval` that is a `HeldTuple`."""
    return chosen_steps(control, until, limit, row, every, borrowed(held.value))


def through_chosen(times: Any, control: Any, most_tiny: float, most: int, run: Any) -> int:
    """`chosen_steps` from times[0] through all `times` [s], the state at each in its row of `kept`.

    most_tiny : steps of the least length, one after the other, before this gives up
    most      : attempted steps, about, before this gives up
    Returns the number of rows that were reached.
    """
    own = borrowed(run)
    m, clock, _, kept, _ = own
    # Not literals, for each of which the called functions would be compiled anew.
    first: Any = np.int64(0)
    never: Any = np.int64(2**62)
    limit: Any = np.int64(1000)
    row = keep(first, times[0], m, kept)
    for k in range(1, times.size):
        while clock[0]["time"] < times[k] and clock[0]["tiny"] <= most_tiny:
            if clock[0]["steps"] + clock[0]["rejections"] > most:
                break
            row = chosen_steps(control, times[k], limit, row, never, own)
        if row == k:
            break
    return row


def through_equal(verlet: bool, times: Any, step: float, run: Any) -> int:
    """As `through_chosen`: `equal_steps`, none longer than `step` [s]."""
    own = borrowed(run)
    m, clock, _, kept, _ = own
    first: Any = np.int64(0)  # not literals, as above
    never: Any = np.int64(2**62)
    row = keep(first, times[0], m, kept)
    for k in range(1, times.size):
        begins, ends = times[k - 1], times[k]
        number = max(1, math.ceil((ends - begins) / step * (1.0 - 1e-9)))
        steps = EqualSteps(begins, ends, number, first, number)
        row = equal_steps(verlet, steps, row, never, own)
        clock[0]["time"] = ends
    return row


IMPORTS = (
    "from exunet.integrators.compiled.workspace import EqualSteps, Stages",
    "from exunet.kernels.kernel import Takes",
)
STEPS = (
    stages_of,
    add_gyroscopic,
    accelerate,
    accelerate_without_spin,
    turn,
    first_order_rates,
    advance_first_order,
    stage,
    unit_attitudes,
    rotate_freely,
    verlet_step,
    verlet_step_in_place,
    runge_kutta_4_step,
    largest,
    largest_of_first_order,
    dormand_prince_step,
    middle_of_first_order,
    work_of_step,
    add_external_work,
    accept,
    kinetic_energy,
    *SEEING,
    keep,
    jump_ahead,
    equal_steps,
    chosen_steps,
)
LOOP = (begin, equal_stretch, chosen_stretch, through_chosen, through_equal)
