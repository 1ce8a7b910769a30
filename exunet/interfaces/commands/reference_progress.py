"""How far the reference is, while a run that is done waits for it: a line on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time as clock

from exunet.interfaces.commands.lines import tell
from exunet.interfaces.commands.printing import status
from exunet.interfaces.commands.progress import SELDOM, remaining
from exunet.simulation.pace import Pace
from exunet.verification.reference_run import ReferenceRun

_LOOK = 0.1  # [s] between two looks at it
_TICKS = 1e6  # a second of its work: what the pace counts, since it does not tell its right-hand sides


def wait_for(reference: ReferenceRun, end: float, *, quiet: bool) -> None:
    """Return when the reference has ended; end: of its run [s]."""
    lines = not quiet and not sys.stderr.isatty()
    told = -SELDOM
    with status(quiet=quiet) as say:
        while reference.at_work:
            say(how_far(reference.looks, end))
            if lines and clock.monotonic() - told >= SELDOM:
                told = clock.monotonic()
                tell(how_far(reference.looks, end))
            clock.sleep(_LOOK)


def how_far(looks: list[tuple[float, float]], end: float) -> str:
    """In words, from its wall times and the simulated times reached then [s]."""
    pace, time = Pace(end), looks[-1][1]
    for wall, reached in list(looks):
        pace.look(wall, reached, int(_TICKS * wall))
    words = f"waiting for the reference: {time:.4g} of {end:g} s ({time / end:.0%})"
    left = remaining(pace) if len(looks) > 1 else ""
    return f"{words}, {left}" if left else words
