"""The forces as scalar loops, in the subset of Python that Numba compiles.

Each function adds its force to `force`; x, v, force are flat (3 n_nodes,) arrays [m], [m/s], [N]. The text of
each is copied into the module of its kind of force (`exunet.kernels.kernel`), so it uses no global name.
They take the elements' law by squared lengths, for speed.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.forces.law import pull_of, weight_of
from exunet.net.arrays import NO_TABLE

Index = np.uint32  # unsigned, so that the compiled code need not look for negative (wrapped) indexes


class Elements(NamedTuple):
    """Elements as the loops take them.

    first, second : (m,) 3 i and 3 j of the end nodes i, j
    square        : (m,) L0^2 [m2]
    factor        : (m,) EA / (2 L0^3) [N/m3]
    law, table    : number of their law, rows of the tables of laws: `exunet.forces.law`
    """

    first: NDArray[Index]
    second: NDArray[Index]
    square: Floats
    factor: Floats
    law: int = 0
    table: Floats = NO_TABLE


class ViscousElements(NamedTuple):
    """The same with the viscous stress of material damping.

    twice_time : (m,) 2 tau [s], tau the relaxation time
    viscous    : (m,) viscous part of L^2 - L0^2 + 2 tau d . dv [m2] at the evaluation before; 0.0: slack
    sums       : (2,) of that evaluation, see `viscous_work_of_verlet` [W], [W/s]
    """

    first: NDArray[Index]
    second: NDArray[Index]
    square: Floats
    factor: Floats
    law: int
    table: Floats
    twice_time: Floats
    viscous: Floats
    sums: Floats


class Limits(NamedTuple):
    """Lengths beyond which elements break.

    first, second : (m,) 3 i and 3 j of the end nodes i, j
    square        : (m,) from which L^2 on an element may have broken [m2]
    length        : (m,) limit of L [m]
    far           : (m,) L [m] at the end of a step that goes far beyond the limit
    """

    first: NDArray[Index]
    second: NDArray[Index]
    square: Floats
    length: Floats
    far: Floats


class SparseRows(NamedTuple):
    """A sparse matrix by rows: row k has value[start[k]:start[k + 1]] in the columns `column` there."""

    start: NDArray[Index]
    column: NDArray[Index]
    value: Floats


class Load(NamedTuple):
    """value : (3 n_points,) [N]."""

    value: Floats


def add_tension(t: float, x: Any, v: Any, elements: Any, force: Any) -> float:
    """Eqs. (3) and (6)-(8): EA / (2 L0^3) (L^2 - L0^2) d on the taut elements, d = x_j - x_i.

    elements : `Elements` of law 0. Returns the elastic energy [J], EA / (8 L0^3) (L^2 - L0^2)^2 of each:
    eq. (19).
    """
    first, second, square, factor, _, _ = elements
    held = 0.0
    for e in range(factor.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        s = dx * dx + dy * dy + dz * dz - square[e]
        if s > 0.0:
            s = max(s, 0.0)  # of many runs at once, some may be slack here
            held += factor[e] * s * s
            s *= factor[e]
            dx *= s
            dy *= s
            dz *= s
            force[i] += dx
            force[i + 1] += dy
            force[i + 2] += dz
            force[j] -= dx
            force[j + 1] -= dy
            force[j + 2] -= dz
    return 0.25 * held


def add_tension_of_law(t: float, x: Any, v: Any, elements: Any, force: Any) -> float:
    """As `add_tension`, of another law, whose measures stand in place of L^2 - L0^2; not for many runs."""
    first, second, square, factor, law, table = elements
    held = 0.0
    for e in range(factor.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        s = dx * dx + dy * dy + dz * dz - square[e]
        if s > 0.0:
            s, root = pull_of(law, table, s, square[e])
            held += factor[e] * root * root
            s *= factor[e]
            force[i] += s * dx
            force[i + 1] += s * dy
            force[i + 2] += s * dz
            force[j] -= s * dx
            force[j + 1] -= s * dy
            force[j + 2] -= s * dz
    return 0.25 * held


def add_viscous_tension(t: float, x: Any, v: Any, elements: Any, force: Any) -> float:
    """As `add_tension`, with the viscous stress of material damping; elements : `ViscousElements`."""
    first, second, square, factor, law, table, twice_time, viscous, sums = elements
    held = 0.0
    watts = 0.0
    change = 0.0
    for e in range(factor.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        s = dx * dx + dy * dy + dz * dz - square[e]
        before = viscous[e]
        if s > 0.0 or before != 0.0:
            wx = v[j] - v[i]
            wy = v[j + 1] - v[i + 1]
            wz = v[j + 2] - v[i + 2]
            rate = dx * wx + dy * wy + dz * wz
            now = 0.0
            if s > 0.0:
                now = twice_time[e] * rate
                if law == 0:
                    held += factor[e] * s * s
                else:
                    now *= weight_of(law, table, s, square[e])
                    s, root = pull_of(law, table, s, square[e])
                    held += factor[e] * root * root
                now = max(now, -s)
                s += now
                if now == 0.0:
                    now = 1e-300  # taut all the same
            viscous[e] = now
            watts += factor[e] * (before + now) * rate
            change += factor[e] * before * (wx * wx + wy * wy + wz * wz)
            if s > 0.0:
                s *= factor[e]
                dx *= s
                dy *= s
                dz *= s
                force[i] += dx
                force[i + 1] += dy
                force[i + 2] += dz
                force[j] -= dx
                force[j + 1] -= dy
                force[j + 2] -= dz
    sums[0] = watts
    sums[1] = change
    return 0.25 * held


def viscous_work_of_verlet(h: float, elements: Any) -> float:
    """Energy [J] that the viscous stress takes out in the step of velocity Verlet at whose end it was added.

    h / 2 (F0 + F1) . v with the forces at both ends and the velocity of the half step, which is the work that
    this method does: its energy balance is as good as without viscous stress. The distance d0 at the start is
    d1 - h dv, so (q0 d0 + q1 d1) . dv = (q0 + q1) d1 . dv - h q0 dv . dv.
    """
    return float(0.5 * h * (elements.sums[0] - h * elements.sums[1]))


def add_no_force(t: float, x: Any, v: Any, data: Any, force: Any) -> None:
    """Nothing: the term has events alone."""


def beyond_limit(t: float, x: Any, v: Any, limits: Any) -> float:
    """L^2 less its limit [m2] of the first element that may have broken, else -1; limits : `Limits`."""
    first, second, square, _, _ = limits
    for e in range(square.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        s = dx * dx + dy * dy + dz * dz
        if s >= square[e]:
            return s - square[e]
    return -1.0


def step_to_limit(step: float, least: float, x: Any, v: Any, limits: Any) -> float:
    """A step [s], halved until no element goes far beyond its limit on a straight path; see `Breaking`."""
    first, second, _, length, far = limits
    for e in range(length.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        rx = v[j] - v[i]
        ry = v[j + 1] - v[i + 1]
        rz = v[j + 2] - v[i + 2]
        now = math.sqrt(dx * dx + dy * dy + dz * dz)
        if now > length[e] or now + step * math.sqrt(rx * rx + ry * ry + rz * rz) <= far[e]:
            continue
        while step > least:
            ex = dx + step * rx
            ey = dy + step * ry
            ez = dz + step * rz
            if ex * ex + ey * ey + ez * ez <= far[e] * far[e]:
                break
            step *= 0.5
    return step


def viscous_work(h: float, begin: Any, end: Any, elements: Any) -> float:
    """Energy [J] that the viscous part of `add_viscous_tension` takes out in a step of length h [s].

    begin, end : positions and velocities (x, v)

    Simpson's rule on the viscous power, with the state in the middle of the cubic Hermite polynomial through
    both ends. Where an element's stress begins or ends within a step, or is cut off (S11 = 0 while E11 > 0),
    on the power of the whole stress instead, less the change of the elastic energy: an element that pulls no
    longer may lose all of its elastic energy in one long step of free flight.
    """
    first, second, square, factor, law, table, twice_time, _, _ = elements
    most = largest_change(begin[1], end[1])
    # In the middle an element is longer than at both ends by b = h / 8 |w0 - w1| at most, w0 and w1 the rates
    # of its span. It is slack there too if L^2 - L0^2 is below -(2 b L0 + b^2) at both ends, and this is not
    # more than L0^2 / 10^4 + (10^4 + 1) b^2.
    beyond = 10001.0 * 3.0 * (0.25 * h * most) * (0.25 * h * most)
    total = 0.0
    for e in range(factor.size):
        i = first[e]
        j = second[e]
        s0 = excess(begin[0], i, j, square[e])
        s2 = excess(end[0], i, j, square[e])
        if max(s0, s2) + 1e-4 * square[e] + beyond < 0.0:
            continue
        s1, r1 = halfway(h, begin, end, i, j)
        s1 -= square[e]
        if s0 <= 0.0 and s1 <= 0.0 and s2 <= 0.0:
            continue
        r0 = parting(begin, i, j)
        r2 = parting(end, i, j)
        s0, e0, q0 = stresses(law, table, s0, twice_time[e] * r0, square[e])
        s1, _, q1 = stresses(law, table, s1, twice_time[e] * r1, square[e])
        s2, e2, q2 = stresses(law, table, s2, twice_time[e] * r2, square[e])
        if q0 > 0.0 and q1 > 0.0 and q2 > 0.0:
            work = h / 6.0 * ((q0 - s0) * r0 + 4.0 * (q1 - s1) * r1 + (q2 - s2) * r2)
        else:
            stored = 0.25 * (e2**2 - e0**2)
            work = h / 6.0 * (q0 * r0 + 4.0 * q1 * r1 + q2 * r2) - stored
        total += factor[e] * work
    return total


def stresses(law: int, table: Any, s: float, viscous: float, square: float) -> Any:
    """Measures of elastic force and energy, and of the whole force, of an excess [m2]; zero where slack."""
    if s <= 0.0:
        return s, 0.0, 0.0
    if law == 0:
        return s, s, max(s + viscous, 0.0)
    weight = weight_of(law, table, s, square)
    elastic, root = pull_of(law, table, s, square)
    return elastic, root, max(elastic + viscous * weight, 0.0)


def largest_change(begin: Any, end: Any) -> float:
    """The largest absolute difference, by four maxima that the processor can make side by side."""
    a = 0.0
    b = 0.0
    c = 0.0
    d = 0.0
    whole = end.size - end.size % 4
    for k in range(0, whole, 4):
        a = max(a, abs(end[k] - begin[k]))
        b = max(b, abs(end[k + 1] - begin[k + 1]))
        c = max(c, abs(end[k + 2] - begin[k + 2]))
        d = max(d, abs(end[k + 3] - begin[k + 3]))
    for k in range(whole, end.size):
        a = max(a, abs(end[k] - begin[k]))
    return max(max(a, b), max(c, d))


def halfway(h: float, begin: Any, end: Any, i: int, j: int) -> Any:
    """d . d [m2] and d . dv [m2/s] of two nodes in the middle of a step, see `viscous_work`."""
    x0, v0 = begin
    x1, v1 = end
    square = 0.0
    rate = 0.0
    for c in range(3):
        p = 0.5 * (x0[i + c] + x1[i + c]) + 0.125 * h * (v0[i + c] - v1[i + c])
        q = 0.5 * (x0[j + c] + x1[j + c]) + 0.125 * h * (v0[j + c] - v1[j + c])
        u = 1.5 * (x1[i + c] - x0[i + c]) / h - 0.25 * (v0[i + c] + v1[i + c])
        w = 1.5 * (x1[j + c] - x0[j + c]) / h - 0.25 * (v0[j + c] + v1[j + c])
        square += (q - p) * (q - p)
        rate += (q - p) * (w - u)
    return square, rate


def excess(x: Any, i: int, j: int, square: float) -> float:
    """d . d - square [m2] of the nodes whose coordinates begin at i and j."""
    dx = x[j] - x[i]
    dy = x[j + 1] - x[i + 1]
    dz = x[j + 2] - x[i + 2]
    return dx * dx + dy * dy + dz * dz - square


def parting(state: Any, i: int, j: int) -> float:
    """d . dv [m2/s] of these nodes."""
    x, v = state
    dx = x[j] - x[i]
    dy = x[j + 1] - x[i + 1]
    dz = x[j + 2] - x[i + 2]
    return dx * (v[j] - v[i]) + dy * (v[j + 1] - v[i + 1]) + dz * (v[j + 2] - v[i + 2])


def add_velocity_product(t: float, x: Any, v: Any, rows: Any, force: Any) -> float:
    """-D v, D as `SparseRows`; returns `velocity_product_power`, which is at hand."""
    start, column, value = rows
    power = 0.0
    for row in range(start.size - 1):
        total = 0.0
        for k in range(start[row], start[row + 1]):
            total += value[k] * v[column[k]]
        force[row] -= total
        power += total * v[row]
    return power


def velocity_product_power(t: float, x: Any, v: Any, rows: Any) -> float:
    """Power v . D v [W] that is taken out; the antisymmetric part of D does no work."""
    start, column, value = rows
    power = 0.0
    for row in range(start.size - 1):
        total = 0.0
        for k in range(start[row], start[row + 1]):
            total += value[k] * v[column[k]]
        power += total * v[row]
    return power


def add_position_product(t: float, x: Any, v: Any, rows: Any, force: Any) -> None:
    """-K x, K as `SparseRows`."""
    start, column, value = rows
    for row in range(start.size - 1):
        total = 0.0
        for k in range(start[row], start[row + 1]):
            total += value[k] * x[column[k]]
        force[row] -= total


def add_load(t: float, x: Any, v: Any, load: Any, force: Any) -> None:
    """A constant force; load : `Load`."""
    for k in range(load.value.size):
        force[k] += load.value[k]


def in_scene_axes(x: Any, q: int, a: float, b: float, c: float) -> Any:
    """A vector of a body's axes in the scene's; its unit quaternion begins at x[q].

    r + 2 w (u x r) + 2 u x (u x r): Schwab and Meijaard, DETC2006-99307, eq. (8).
    """
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    d = 2.0 * (j * c - k * b)
    e = 2.0 * (k * a - i * c)
    f = 2.0 * (i * b - j * a)
    return a + w * d + j * f - k * e, b + w * e + k * d - i * f, c + w * f + i * e - j * d


def in_body_axes(x: Any, q: int, a: float, b: float, c: float) -> Any:
    """A vector of the scene's axes in a body's."""
    w, i, j, k = x[q], x[q + 1], x[q + 2], x[q + 3]
    d = 2.0 * (j * c - k * b)
    e = 2.0 * (k * a - i * c)
    f = 2.0 * (i * b - j * a)
    return a - w * d + j * f - k * e, b - w * e + k * d - i * f, c - w * f + i * e - j * d
