"""The work that terms without a potential take out in a step of the compiled loop.

The text of these functions is copied into a kernel's module, after those of `schemes`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from exunet.backends.compiled.schemes import first_order_rates, stages_of, turn

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    FIRST_ORDER = True

    from exunet.codegen.sums import extra_work, has_power, power


def work_of_step(t: float, h: float, power_at_start: float, a: Any, m: Any) -> float:
    """Add to m.taken what the step to x1, v1 took out, by Simpson's rule; returns the power at its end [W].

    The state in the middle is that of the cubic Hermite polynomial through both ends; a: what `accelerate`
    found at the end. Forces that tell their work have it from both ends.
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
    m.taken[0] += extra_work(h, (x, v), (s.x1, s.v1), m.data)
    return watts


def book_push(m: Any) -> None:
    """Add to m.taken the work of the forces from outside, constant in the step to x1, which is exact."""
    x1 = stages_of(m.work).x1
    given = 0.0
    for c in range(m.c.size):
        given += m.push[c] * (x1[c] - m.c[c])
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
