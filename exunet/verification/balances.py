"""Balances of a run with bodies: momentum, angular momentum and energy, of one formula for both codes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from exunet.studies.both_codes import BothCodes, Floats, Trajectory
from exunet.verification.check import Check
from exunet.verification.tolerances import Tolerance
from reference_impl import energy


@dataclass(frozen=True, eq=False)
class Balance:
    """A quantity that stays what it is.

    values  : (t, 1) or (t, 3)
    scale   : what its changes are parts of: the largest sum of the parts' shares
    allowed : of the change
    """

    name: str
    unit: str
    values: Floats
    scale: float
    allowed: Tolerance


def momenta(case: BothCodes, motion: Trajectory, linear: Tolerance, angular: Tolerance) -> list[Balance]:
    """Linear and angular momentum about the origin, of net and bodies, less what guided bodies have given.

    By the reference's formulas, which rung 8 compares with exunet's at random states. Their scales are the
    largest sums over nodes and bodies of |m v|, and of |m x x v| and |J w|, as in the books of a run
    (`exunet.results.measures.MomentumBook`).
    """
    system, seen = case.theirs.system, motion.seen
    (x, v), bodies = seen.particles, seen.bodies
    mass = np.append(system.net.own_mass, system.bodies.free * system.bodies.mass)
    shares = mass[:, None] * v
    free = system.bodies.free[:, None, None] * system.bodies.inertia
    spin = np.einsum("bij,tbj->tbi", free, bodies.angular_velocity)
    turning = np.concatenate([np.cross(x, shares), spin], axis=1)
    scales = (float(np.linalg.norm(parts, axis=2).sum(axis=1).max()) for parts in (shares, turning))
    total = energy.momentum(system, seen.v, bodies)
    turned = energy.angular_momentum(system, seen.x, seen.v, bodies)
    if motion.given is not None:
        total, turned = total - motion.given[:, :3], turned - motion.given[:, 3:]
    return [
        Balance("momentum", "N s", total, next(scales), linear),
        Balance("angular momentum", "N m s", turned, next(scales), angular),
    ]


def energies(case: BothCodes, motion: Trajectory, allowed: Tolerance) -> Balance:
    """Kinetic, elastic and potential energy and what was dissipated, of a run that booked it.

    Changes are parts of the largest kinetic energy.
    """
    system, seen = case.theirs.system, motion.seen
    intact = np.ones((len(motion.time), case.start.net.n_elements), dtype=bool)
    for one in motion.breaks:
        intact[motion.time >= one.time, case.reference_elements[one.element]] = False
    inside, outlets = energy.at_outlets(system, seen.x, motion.reels)
    others, closing = energy.of_closing(system, seen.x, motion.drawn)
    for some in (inside, others):
        if some is not None:
            intact &= some
    kinetic = energy.kinetic(system, seen.v, seen.bodies)
    total = kinetic + energy.elastic(system, seen.x, intact) + outlets + closing
    total = total + energy.potential(system, seen.x, seen.bodies)
    if motion.dissipated is not None:
        total = total + motion.dissipated
    return Balance("energy", "J", total[:, None], float(kinetic.max()), allowed)


def changes(balances: list[Balance], times: Floats, of: str) -> Iterator[Check]:
    """The largest change of each at the first times; of : what runs, such as a code."""
    for one in balances:
        change = np.linalg.norm(one.values[: len(times)] - one.values[0], axis=1)
        at = int(np.argmax(np.where(np.isnan(change), np.inf, change)))
        words = f"t = {times[at]:.4g} s: {one.values[at]} {one.unit}, at first {one.values[0]}"
        yield Check(f"{one.name}, {of}: relative change", float(change[at]) / one.scale, one.allowed, words)
