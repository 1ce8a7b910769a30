"""A simulation taken through the stored times, with looks at the keyboard and checkpoints between them."""

from __future__ import annotations

import time as clock
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from exunet.base.interrupt import postponed
from exunet.simulation.recorder import Recorder
from exunet.simulation.simulation import Simulation

Floats = NDArray[np.float64]
# Simulated time [s], right-hand sides so far, the last entry of the script that has happened ("": none).
Progress = Callable[[float, int, str], None]

_SHOWN = 0.1  # [s] of wall time between two calls of `progress`


def drive(
    simulation: Simulation,
    recorder: Recorder,
    progress: Progress | None = None,
    checkpoint: Callable[[], None] | None = None,
) -> None:
    """Take a simulation through the times of its recorder that are still to come.

    checkpoint : called after each stored time
    Ctrl-C is taken up within the steps, so that it does not interrupt the storing of a state.
    """
    try:
        with postponed():
            _through(simulation, recorder.times, progress, checkpoint)
    except KeyboardInterrupt:  # after the last step, or out of `progress`
        raise simulation.interrupted() from None


def _through(
    simulation: Simulation, times: Floats, progress: Progress | None, checkpoint: Callable[[], None] | None
) -> None:
    def tell() -> None:
        if progress is not None:
            progress(simulation.time, simulation.counts.right_hand_sides, simulation.monitor.phase)

    tell()
    shown = 0.0
    while True:
        if simulation.stopped and simulation.finish():
            return
        ahead = int(times.searchsorted(simulation.time, side="right"))
        if ahead == len(times):
            if simulation.finish():
                return
            continue
        if not simulation.attempt(float(times[ahead])):
            continue
        if checkpoint is not None:
            checkpoint()
        if progress is not None and clock.monotonic() - shown > _SHOWN:
            tell()
            shown = clock.monotonic()
