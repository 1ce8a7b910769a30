"""Bullets that `launch_force` pushes along the barrels of a chaser: how far they are, and with what force."""

from __future__ import annotations

import numpy as np

from reference_impl.arrays import Floats
from reference_impl.mode import Mode
from reference_impl.system import System
from reference_impl.whole import Whole


def ways(system: System, x: Floats, attitude: Floats | None = None) -> Floats:
    """Ways s (..., k) [m] of the bullets along their barrels, relative to the chaser, since the start.

    x (..., N, 3) [m] are positions of nodes and bodies, `attitude` R (..., r, 3, 3) those of rigid bodies,
    needed where one of them is the chaser.
    """
    assert system.barrels is not None
    return system.barrels.ways(bullets_from_chaser(system, x), attitude)


def bullets_from_chaser(system: System, x: Floats) -> Floats:
    """The bullets (..., k, 3) [m] from the chaser's centre of mass."""
    return np.asarray(x.take(system.net.bullet_nodes, axis=-2) - x[..., system.chaser, None, :])


def pushes(system: System, whole: Whole, mode: Mode) -> Floats:
    """Forces (k, 3) [N] of launch_force on the bullets."""
    launch, barrels = system.effects.launch_force, system.barrels
    assert launch is not None
    assert barrels is not None
    s, pushed = ways(system, whole.x, whole.attitude), mode.pushed
    if pushed is None and mode.gone is not None:
        pushed = (s < launch.stroke) & ~mode.gone
    return np.asarray(launch.push(s, pushed)[:, None] * barrels.directions(whole.attitude))
