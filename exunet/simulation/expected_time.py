"""Cost of a run before it begins: wall time at the pace of its first steps, disk and memory."""

from __future__ import annotations

import time as clock
from contextlib import suppress
from pathlib import Path

from exunet.base.errors import ExunetError, InputError, Interrupted
from exunet.base.interrupt import TimeIsUp, limited
from exunet.base.machine import MEMORY_VARIABLE, disk_left, memory_left
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import columns_of
from exunet.simulation.simulation import Simulation

STEPS, LEAST, MOST = 300, 0.1, 1.0  # steps that are timed, for at least and at most so long [s]
DISK_COPIES = 2  # of the stored states, while they are written into the result at the end of a run


def expected_time(start: Start) -> float | None:
    """Estimate the wall time of a run by timing some hundred steps of its scene.

    The timed steps are repeated to the end of the run. A net that snaps taut or touches a body later on takes
    shorter or dearer steps than at the start, so a run may take several times as long.

    Returns
    -------
    float or None
        Wall time of the steps [s], without compiling, starting and drawing; None if the timed steps fail.
    """
    end, first, started = start.scene.time.end, 0.0, 0.0
    try:
        simulation = Simulation(start)
        with suppress(TimeIsUp), limited(MOST):
            simulation.attempt(1e-5 * end)  # compiles
            first, started = simulation.time, clock.perf_counter()
            while simulation.time < end and not simulation.stopped:
                if simulation.counts.steps > STEPS and clock.perf_counter() - started > LEAST:
                    break
                simulation.attempt(min(end, 2.0 * simulation.time))
        seconds, simulated = clock.perf_counter() - started, simulation.time - first
    except Interrupted:
        raise KeyboardInterrupt from None
    except ExunetError:  # the run itself reports it
        return None
    return seconds / simulated * end if simulated > 0.0 else None


def stored_bytes(start: Start) -> int:
    """Return the bytes of all states that a run stores."""
    row = sum(column.row_bytes for column in columns_of(start.system))
    return len(start.scene.time.stored_times) * row


def validate_disk(start: Start, folder: Path) -> None:
    """Raise InputError if the states of a run do not fit on the disk of its folder."""
    needed, free = DISK_COPIES * stored_bytes(start), disk_left(folder)
    if free is not None and needed > free:
        states = len(start.scene.time.stored_times)
        raise InputError(
            f"{folder}: {states} stored states need {needed / 1e9:.3g} GB of disk, {free / 1e9:.3g} GB are "
            "free: use a larger time.output_step, or another folder (--out)"
        )


def validate_memory(what: str, needed: int) -> None:
    """Raise InputError if some bytes exceed the free memory; what : begins the message."""
    free = memory_left()
    if free is not None and needed > free:
        needs = f"{what} need {needed / 1e9:.3g} GB of memory, {free / 1e9:.3g} GB are free"
        raise InputError(f"{needs}: use fewer, or set {MEMORY_VARIABLE}")
