"""The words for a run that went wrong: which element and node, in what state, why, and what to change."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.methods.method import METHODS, Kind
from exunet.methods.plan import Plan
from exunet.system import energy
from exunet.system.system import State, System

Floats = NDArray[np.float64]


def state_of_worst(system: System, state: State) -> str:
    """The most stretched element, where there are any, and the fastest node of a finite state."""
    position, velocity = state.position, state.velocity
    node = int(np.argmax(np.abs(velocity).max(axis=1)))
    place = ", ".join(f"{x:.3g}" for x in position[node])
    return (
        f"at t = {state.time:.6g} s {_most_stretched(system, state)}the fastest node is {node} "
        f"at ({place}) m, {math.hypot(*velocity[node]):.3g} m/s"
    )


def _most_stretched(system: System, state: State) -> str:
    net, position = system.net, state.position
    if not net.n_elements:
        return ""
    law = energy.law_of(system.forces, state.memory)
    length = cable.lengths(net, position)
    element = int(np.argmax(length / law.natural_length))
    i, j = net.element_nodes[element]
    with np.errstate(over="ignore"):  # the largest finite numbers have no square
        force = cable.element_tension(net, law, position, state.velocity)[element]
    stretch = length[element] / law.natural_length[element]
    words = f"the most stretched element is {element} between nodes {i} and {j}, "
    return f"{words}stretch {stretch:.6g}, force {force:.3g} N; "


SNAPPING, TURNING = "where cables snap taut", "for a body that turns so fast"


def step_advice(plan: Plan | None, where: str) -> str:
    """Likely cause and remedy where the steps are to blame; where: `SNAPPING` or `TURNING`."""
    if plan is None:
        return "Likely cause: steps too long. Give a smaller solver.step or an adaptive method (DOPRI5)"
    if plan.tolerance is not None:
        return (
            f"Likely cause: the tolerance {plan.tolerance:.2g} is too loose: steps may skip a snap. "
            "Give a smaller solver.accuracy (or solver.tolerance)"
        )
    kind = "an adaptive method" if METHODS[plan.method].kind == Kind.EXPLICIT else "an explicit method"
    return (
        f"Likely cause: the step {plan.step:.3g} s is too long for {plan.method} {where}. "
        f"Give a smaller solver.step (`exunet check` shows the stable one) or {kind} (solver.method = DOPRI5)"
    )


LOAD_ADVICE = (
    "Likely cause: not the steps, the energy balance holds; the cables are too soft for this motion. "
    "Change youngs_modulus, the diameters, the launch speeds, the masses or the forces"
)

COLLAPSE_ADVICE = (
    "Likely cause: a motion or a damping too fast or a force too large for any step, or a tolerance below "
    "the round-off of the numbers. Change the launch speeds, initial, the damping or the forces that are "
    "set; or give a larger solver.accuracy (or solver.tolerance)"
)
