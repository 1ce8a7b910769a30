"""How far a run, or many, are and how long they still take: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from exunet.interfaces.commands.estimates import duration
from exunet.interfaces.commands.lines import tell
from exunet.interfaces.commands.printing import status
from exunet.simulation.pace import Pace

SELDOM, OFTEN, PART = 60.0, 10.0, 0.1  # [s], [s] between two lines, part of the run


class Progress(Protocol):
    """What a run tells; `end` when its last state is there."""

    def __call__(self, time: float, right_hand_sides: int, phase: str) -> None: ...

    def end(self) -> None: ...


@contextmanager
def told_progress(end: float, expected: float | None, *, quiet: bool) -> Iterator[Progress]:
    """Tells on stderr how far a run is: a bar on a terminal, lines elsewhere, nothing if quiet.

    end      : simulated time at which the run ends [s]
    expected : right-hand sides that it is to take; None: not known
    """
    if quiet:
        yield _Silent()
    elif sys.stderr.isatty():
        with _bar(end, Pace(end, expected)) as bar:
            yield bar
    else:
        yield Lines(end, Pace(end, expected), tell)


@contextmanager
def told_runs(
    what: str, runs: int, *, quiet: bool, clock: Callable[[], float] = clock.monotonic
) -> Iterator[Callable[[int], None]]:
    """A function that is told how many of `runs` are done, and tells it on stderr unless quiet.

    what  : begins the words; "": nothing
    clock : wall time [s]
    On a terminal it is one line that changes, elsewhere a line every 10 s. What is left is told by the pace
    since the first run, for which code may have been compiled, once each core has done another.
    """
    last, cores = clock(), os.cpu_count() or 1
    first: tuple[float, int] | None = None
    lines = not quiet and not sys.stderr.isatty()
    with status(quiet=quiet) as show:

        def told(done: int) -> None:
            nonlocal last, first
            now = clock()
            begun, before = first = first or (now, done)
            words = f"{what}{done} of {runs} runs"
            if done - before >= cores:
                left = (now - begun) / (done - before) * (runs - done)
                words += f", about {duration(left)} left"
            show(words)
            if lines and now - last >= OFTEN:
                last = now
                tell(words)

        yield told


def remaining(pace: Pace) -> str:
    """What is left in words, as a range while it is uncertain; "" as long as nothing is known."""
    left = pace.left()
    if left is None:
        return ""
    low, likely, high = left
    if high < 1.0:
        return "less than 1 s left"
    if high < 1.5 * low:
        return f"about {duration(likely)} left"
    return f"{duration(low)} to {duration(high)} left" if low >= 1.0 else f"up to {duration(high)} left"


def after(phase: str) -> str:
    """The phase of a mission in words: the entry of the script that has happened last."""
    return f'after "{phase}"' if phase else ""


class _Silent:
    def __call__(self, time: float, right_hand_sides: int, phase: str) -> None:
        """Nothing is told."""

    def end(self) -> None:
        """Nothing is told."""


class Lines:
    """A line at the start, every 10 s at most and every minute at least after a tenth more, and at the end.

    end   : of the run [s]
    pace  : of it
    say   : takes each line
    clock : wall time [s]
    """

    def __init__(
        self,
        end: float,
        pace: Pace,
        say: Callable[[str], None],
        clock: Callable[[], float] = clock.monotonic,
    ) -> None:
        self._end, self._pace, self._say, self._clock = end, pace, say, clock
        self._begun = self._told = self._at = 0.0
        self._running = False

    def __call__(self, time: float, right_hand_sides: int, phase: str) -> None:
        now = self._clock()
        if not self._running:
            self._running, self._begun, self._told, self._at = True, now, now, time
            self._say(f"simulating {self._end:g} s" + (f", from {time:.4g} s on" if time else ""))
        self._pace.look(now - self._begun, time, right_hand_sides)
        since, part = now - self._told, (time - self._at) / self._end
        if time < self._end and since >= OFTEN and (part >= PART or since >= SELDOM):
            self._told, self._at = now, time
            words = f"simulated {time:.4g} of {self._end:g} s in {duration(now - self._begun)}"
            self._say(", ".join(one for one in (words, remaining(self._pace), after(phase)) if one))

    def end(self) -> None:
        if self._running:
            self._running = False
            self._say(f"simulated in {duration(self._clock() - self._begun)}")


@contextmanager
def _bar(end: float, pace: Pace) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("simulated"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:.3f} of {task.total:g} s"),
        TextColumn("{task.description}"),
    )
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("", total=end)

        class Bar:
            def __init__(self) -> None:
                self._begun = clock.monotonic()

            def __call__(self, time: float, right_hand_sides: int, phase: str) -> None:
                pace.look(clock.monotonic() - self._begun, time, right_hand_sides)
                words = ", ".join(one for one in (remaining(pace), after(phase)) if one)
                bars.update(task, completed=time, description=words)

            def end(self) -> None:
                bars.stop()

        yield Bar()
