"""Where the force of a net jumps: viscous elements that become taut while they lengthen.

S11 = E (E11 + tau dE11/dt) where E11 > 0 begins with the force of the rate alone. No step across such a jump
is better than the jump times its length, however good the method is; so a step control that meets one goes
straight to it, and crosses it with a step that is short enough for the tolerance, or as short as round-off
allows. The compiled loop has the same rule (`exunet.backends.compiled.many_steps.jump_ahead`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.blocks import Blocks
from exunet.forces.cable import Law

Floats = NDArray[np.float64]

ROUND_OFF = 64.0 * float(np.finfo(float).eps)  # of places and times, by which a crossing is surely one
NEARER = 1e-2  # of the time to a jump: how far before it a step towards it ends, since its path is a parabola


@dataclass(frozen=True)
class Jump:
    """A jump ahead: time until then [s], jump of the accelerations [m/s2], step that may cross it [s]."""

    after: float
    size: float
    step: float

    @property
    def to_it(self) -> float:
        """The step [s] that ends just before it."""
        return self.after - max(0.5 * self.step, NEARER * self.after)


@np.errstate(all="ignore")  # a state that is beyond floating-point numbers is for the guards to tell
def jump_ahead(
    blocks: Blocks,
    law: Law,
    within: float,
    tolerance: float,
    time: float,
    state: tuple[Floats, Floats, Floats],
) -> Jump | None:
    """The next jump within a time [s] that would cost a step of that length more than the tolerance.

    law   : of the elements that are intact, with viscous stress
    state : position [m], velocity [m/s], acceleration [m/s2], (n_points, 3) each, at a time [s]; the way from
            there is taken as a parabola
    """
    net, length = blocks.net, law.natural_length
    assert law.relaxation_time is not None
    mobility = 1.0 / blocks.mass
    mobility[net.fixed_nodes] = 0.0
    gain = law.stiffness * law.relaxation_time / length * mobility[net.element_nodes].max(axis=1)  # [1/s]
    span, rate, bend = (cable.spans(net, nodal) for nodal in state)
    distance, speed = np.linalg.norm(span, axis=1), np.linalg.norm(rate, axis=1)
    reach = distance + within * (speed + 0.5 * within * np.linalg.norm(bend, axis=1))
    near = (gain > 0.0) & (distance <= length * (1.0 + 1e-15)) & (reach > length)
    if not near.any():
        return None
    length = length[near]
    after, parting = _crossing(span[near], rate[near], bend[near], length)
    size = gain[near] * parting
    matters = (after <= within) & (size * within > tolerance)
    if not matters.any():
        return None
    first = int(np.argmin(np.where(matters, after, np.inf)))
    places = np.abs(state[0][net.element_nodes[near][first]]).max() + length[first]
    surely = ROUND_OFF * max(time, places / parting[first])
    step = min(within, max(tolerance / size[first], surely))
    together = matters & (after <= after[first] + step)
    return Jump(float(after[first]), float(size[together].sum()), float(step))


def _crossing(span: Floats, rate: Floats, bend: Floats, length: Floats) -> tuple[Floats, Floats]:
    """Time [s] until elements no longer than `length` get so long, and dL/dt then [m/s]; inf where never.

    Newton's method on the squared length of span + t rate + t^2 bend / 2, begun on the straight way.
    """
    distance = np.linalg.norm(span, axis=1)
    square = np.einsum("ea,ea->e", rate, rate)
    c0 = (distance - length) * (distance + length)
    c1 = 2.0 * np.einsum("ea,ea->e", span, rate)
    c2 = square + np.einsum("ea,ea->e", span, bend)
    c3, c4 = np.einsum("ea,ea->e", rate, bend), 0.25 * np.einsum("ea,ea->e", bend, bend)

    def slope(t: Floats) -> Floats:
        return np.asarray(c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4)))

    below = np.minimum(c0, 0.0)
    root = np.sqrt(np.maximum(c1 * c1 - 4.0 * square * below, 0.0))
    straight = np.where(c1 > 0.0, -2.0 * below / (c1 + root), (root - c1) / (2.0 * square))
    t = straight
    for _ in range(6):
        t = t - (c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))) / slope(t)
    t = np.where(np.isfinite(t) & (t > 0.25 * straight) & (t < 4.0 * straight), t, straight)
    parting = slope(t) / (2.0 * length)
    good = np.isfinite(t) & (parting > 0.0)
    return np.where(good, t, np.inf), np.where(good, parting, 0.0)
