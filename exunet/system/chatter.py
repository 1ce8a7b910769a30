"""Steps too long for friction that is smooth in the speed.

Its force grows with the speed by up to mu N / v_s, but is mu N at most. Where a step h cannot follow it,
speeds along the surface jump to and fro by some mu N h / m, and no further: the motion stays right. What such
friction is said to take is too large by up to (mu N)^2 h / m in each second, and the energy balance is off by
that.
"""

from __future__ import annotations

from collections.abc import Iterator

from exunet.methods.keys import SHORTEST_STEP
from exunet.methods.plan import Plan
from exunet.system.stability import largest_damping_rate, largest_frequency, stable_step
from exunet.system.system import System


def chatter(system: System, plan: Plan) -> Iterator[str]:
    """In words, for notes: equal steps that do not follow friction in an impact at the speed of the start."""
    kernels = system.forces.kernels
    term = max(kernels, key=lambda one: one.friction_rate, default=None)
    if plan.step is None or term is None or not term.friction_rate > 0.0:
        return
    rate = largest_damping_rate(system) + sum(one.friction_rate for one in kernels)
    enough = stable_step(plan.method, largest_frequency(system), min(rate, 1.0 / SHORTEST_STEP))
    if plan.step <= enough:
        return
    speed = term.friction_rate * term.data.slip_speed * plan.step  # type: ignore[attr-defined]
    yield (
        f"steps of {plan.step:.3g} s may be too long for the friction between {term.acts_on}: below some "
        f"{speed:.2g} m/s along the surface speeds jump to and fro, and what friction takes is told too "
        f"large. Give steps of {enough:.2g} s, a slip_speed of {speed:.2g} m/s, or friction_law = "
        '"sticking"'
    )
