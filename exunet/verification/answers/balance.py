"""What a free, undamped net keeps: momentum, angular momentum, energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from exunet.case.stored_times import stored_times
from exunet.studies.both_codes import BothCodes
from exunet.system import energy
from exunet.verification.answers.both import best
from exunet.verification.check import Check
from exunet.verification.tolerances import ANGULAR, ENERGY, MOMENTUM, Tolerance


def free_net(case: BothCodes) -> Iterator[Check]:
    """Largest change of each over the stored times."""
    net = case.start.net
    shares = net.mass[:, None] * case.start.velocity
    turning = np.cross(case.start.position, shares)
    for code, motion in best(case, stored_times(case.start.scene.time)):
        total = energy.kinetic(net.mass, motion.velocity)
        total = total + energy.elastic(case.start.system.forces, motion.position)
        kept: tuple[tuple[str, np.ndarray, float, Tolerance], ...] = (
            ("momentum", energy.momentum(net.mass, motion.velocity), _size(shares), MOMENTUM),
            (
                "angular momentum",
                energy.angular_momentum(net.mass, motion.position, motion.velocity),
                _size(turning),
                ANGULAR,
            ),
            ("energy", total[:, None], float(total[0]), ENERGY),
        )
        for name, values, scale, allowed in kept:
            change = np.linalg.norm(values - values[0], axis=1)
            at = int(np.argmax(change))
            words = f"t = {motion.time[at]:.4g} s: {values[at]} at first: {values[0]}"
            yield Check(f"{name}, {code}: relative change", float(change[at]) / scale, allowed, words)


def _size(shares: np.ndarray) -> float:
    return float(np.linalg.norm(shares, axis=1).sum())
