"""What a run will take, in words, and whether the machine has it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from exunet.base.errors import InputError
from exunet.base.machine import MEMORY_VARIABLE, disk_left, memory_left
from exunet.codegen.compile import numba_installed
from exunet.interfaces.commands.waiting import waiting
from exunet.methods.method import METHODS, Kind
from exunet.results.course import INTERVALS
from exunet.results.spread import COVERING
from exunet.simulation.expected_cost import (
    COMPILING,
    GUESSED,
    ExpectedCheck,
    ExpectedCost,
    cost_of_a_course,
    courses_in_a_run,
    expected_check,
    expected_cost,
    in_the_compiled_loop,
)
from exunet.simulation.preparation import Start
from exunet.simulation.trial import Trial, is_compiled, try_out, try_out_adaptive
from exunet.studies.ensemble import way_of
from exunet.studies.measured import course_bytes
from exunet.studies.spread import (
    BESIDE,
    MOVE,
    NO_NUMBA,
    move_of,
    rounds,
    runs_within,
    start_of_runs,
)

LONG = 10.0  # [s] from which on a run says what would be cheaper
_BUDGET = 1.0  # [s] of a trial
_FREE = 24.0  # right-hand sides for each stored state, from which on at most one of four steps is due to it
_SHORT = (
    1.0  # [s]: a run that is expected to be shorter is not tried out, nor is it worth a trial's compiling
)


@dataclass(frozen=True)
class ExpectedSpread:
    """How many moved starts a run is followed by, and what they are expected to take.

    runs     : their number
    move     : by up to which each coordinate of a start is moved [m]
    seconds  : wall time on all cores [s]
    compiles : their forces are to be compiled first, which takes some seconds more
    refused  : why there are none; "" if there are some, or none was asked for
    fewer    : wall time of 32 of them [s], where many more were asked for and take long; else None
    known    : the time was estimated; else it is that of runs that go on as a trial ended
    factor   : of uncertainty of the time
    each     : bytes of memory that one of them takes
    """

    runs: int
    move: float = MOVE
    seconds: float = 0.0
    compiles: bool = False
    refused: str = ""
    fewer: float | None = None
    known: bool = True
    factor: float = 1.0
    each: int = 0

    @property
    def memory(self) -> int:
        """Bytes that the runs take until they are judged."""
        return (self.runs + BESIDE) * self.each if self.runs else 0

    def words(self) -> str:
        """For the table of estimates."""
        if self.refused:
            return f"none: {self.refused}"
        if not self.runs:
            return "none asked for: the numbers will be those of one run"
        more = ", and some seconds to compile the scene's forces, once" if self.compiles else ""
        moved = f"{self.runs} runs from starts moved by up to {self.move:.2g} m"
        which = f"{moved} and {BESIDE} from the start itself"
        if not self.known:
            return f"{which}, after the run, not known how long{more}"
        return f"{which}, after the run, {_about(self.seconds, self.factor)}){more}"


@dataclass(frozen=True)
class Expected:
    """The cost of a run with its spread and, if asked for, its check.

    other     : with `engine.loop = "auto"` where that is known to be less
    compiling : bytes of memory for what is compiled first
    """

    run: ExpectedCost
    other: ExpectedCost | None = None
    spread: ExpectedSpread = ExpectedSpread(0)
    check: ExpectedCheck | None = None
    compiling: int = 0

    @property
    def memory(self) -> int:
        """Bytes of the run, at most."""
        return self.run.memory + self.compiling

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, value): time, check, memory, disk, and for a long run what would be faster."""
        found = [("time", words_of_time(self.run)), *self._of_check(), *self.room(), *self.moved_starts()]
        if self.other is not None:
            words = f"about {duration(self.other.seconds)} with --set 'engine.loop=\"auto\"'"
            found.append(("faster", words))
        return found

    def room(self) -> list[tuple[str, str]]:
        """The rows of memory, with that of moved starts, and of disk."""
        run = self.run
        return [
            ("memory", f"up to {size(self.memory + self.spread.memory)}"),
            ("disk", f"up to {size(run.disk)}, of which {size(run.kept)} stay; {run.states} stored states"),
        ]

    def moved_starts(self) -> list[tuple[str, str]]:
        """Their row, and one of fewer where many take long; none where none was asked for."""
        found = []
        if self.spread.runs or self.spread.refused:
            found.append(("spread", self.spread.words()))
        if self.spread.fewer is not None:
            words = f"--spread {COVERING} takes about {duration(self.spread.fewer)} and "
            room = size((COVERING + BESIDE) * self.spread.each)
            words += f"{room} of memory; its ranges hold what 94 % of other "
            found.append(("cheaper", f"{words}starts give"))
        return found

    def _of_check(self) -> list[tuple[str, str]]:
        """The row of the reference, which takes a core of its own where there is one."""
        if self.check is None:
            return []
        seconds, beside = self.check.seconds, (os.cpu_count() or 1) > 1
        both = max(seconds, self.run.seconds) if beside else seconds + self.run.seconds
        words = f"{_about(seconds, self.check.factor)}) of the reference, with --check at the same time as"
        together = "" if self.run.least is not None else f": about {duration(both)} for both"
        return [("check", f"{words} the run{together}")]


def estimated(
    start: Start,
    *,
    thorough: bool = False,
    spread: int | None = None,
    check: bool = False,
    quiet: bool = False,
) -> Expected:
    """The cost of a run, from a trial where it is likely to be long enough for one.

    thorough : make a trial also where the compiled loop must be compiled for it first
    spread   : number of moved starts; None: what the run's own cost allows
    check    : the reference is to run beside it
    quiet    : nothing is shown while the trial runs
    """
    guess = expected_cost(start)
    trial, compiling = None, 0 if is_compiled(start) else COMPILING
    seconds = max(guess.seconds, expected_check(start).seconds if check else 0.0)
    may_be_long = guess.factor == GUESSED and seconds * guess.factor > LONG
    if may_be_long and (thorough or guess.seconds > LONG or is_compiled(start)):
        with waiting("estimating the time from a trial", quiet=quiet):
            trial = try_out(start, _BUDGET)
    run = guess if trial is None else expected_cost(start, trial)
    other = in_the_compiled_loop(start, trial) if run.seconds > LONG and run.least is None else None
    cheaper = other if other is not None and other.seconds < run.seconds else None
    of_check = _of_check(start, trial, thorough, quiet=quiet) if check else None
    of_courses = trial
    if trial is not None and spread != 0 and _stops_at_each(trial, run.states):
        with waiting("estimating the time of moved starts from a trial", quiet=quiet):
            of_courses = try_out(start_of_runs(start), _BUDGET)
    return Expected(run, cheaper, expected_spread(start, of_courses, spread), of_check, compiling)


def _of_check(start: Start, trial: Trial | None, thorough: bool, *, quiet: bool) -> ExpectedCheck:
    """What the reference takes; where the run's steps are equal, from a trial with adaptive ones."""
    found = expected_check(start, trial)
    equal = METHODS[start.plan.method].kind != Kind.ADAPTIVE
    if not equal or found.seconds * found.factor < LONG:
        return found
    if not (thorough or found.seconds > LONG or is_compiled(start)):
        return found
    with waiting("estimating the time of the check from a trial", quiet=quiet):
        return expected_check(start, try_out_adaptive(start, _BUDGET))


def _stops_at_each(trial: Trial, states: int) -> bool:
    """True if a run takes its steps for the sake of its stored states, which moved starts have not."""
    return states > INTERVALS and trial.right_hand_sides < _FREE * states


def not_counted(*, error: bool) -> list[tuple[str, str]]:
    """Rows (name, value) of what the time of a run leaves out, since nothing foretells how long it takes.

    error : two more runs with a finer setting are asked for
    """
    return [("error", "not in this time: two more runs, at least one of them longer")] if error else []


def expected_spread(start: Start, trial: Trial | None, asked: int | None) -> ExpectedSpread:
    """Number and cost of the moved starts of a run; asked: their number, or None."""
    if asked == 0:
        return ExpectedSpread(0)
    if not numba_installed():
        return ExpectedSpread(0, refused=NO_NUMBA)
    cores = os.cpu_count() or 1
    course = cost_of_a_course(start, trial)
    each = course.seconds
    runs = runs_within(courses_in_a_run(start)) if asked is None else asked
    gain, compiles = way_of(start, runs + 1)
    seconds = each * rounds(runs, cores, gain)
    fewer = None
    if runs > COVERING and seconds > LONG:
        fewer = each * rounds(COVERING, cores, way_of(start, COVERING + 1)[0])
    known = trial is None or trial.least is None
    return ExpectedSpread(
        runs,
        move_of(start),
        seconds,
        compiles,
        fewer=fewer if known else None,
        known=known,
        factor=course.factor,
        each=course_bytes(start),
    )


def refuse_beyond(cost: Expected, start: Start, folder: Path) -> None:
    """Raise InputError if the machine has not the memory, or the folder's disk not the room."""
    run = cost.run
    less = "a larger time.output_step or an earlier time.end stores fewer than its "
    less += f"{run.states} states"
    disk, memory = disk_left(folder), memory_left()
    if disk is not None and run.disk > disk:
        words = f"the run needs up to {size(run.disk)} on disk, and {size(disk)} are free"
        raise InputError(f"{folder}: {words}; {less}, --out writes elsewhere")
    if memory is not None and cost.memory > memory:
        words = f"the run needs up to {size(cost.memory)} of memory, and {size(memory)} are free"
        words += f"; a net of fewer than {start.net.n_elements} elements needs less"
        raise InputError(f"{words}, or set {MEMORY_VARIABLE}")
    refuse_spread_beyond(cost.spread)


def refuse_spread_beyond(spread: ExpectedSpread) -> None:
    """Raise InputError if the machine has not the memory for so many moved starts."""
    memory = memory_left()
    if memory is not None and spread.memory > memory:
        words = (
            f"{spread.runs} moved starts need up to {size(spread.memory)} of memory, and {size(memory)} are "
        )
        raise InputError(f"--spread: {words}free; give fewer, or set {MEMORY_VARIABLE}")


def words_of_time(cost: ExpectedCost) -> str:
    """How long a run takes, with its range and how that was found; or what is known of it."""
    if cost.least is None:
        return f"{_about(cost.seconds, cost.factor)}; {cost.counted})"
    words = f"at least {duration(cost.least)}, more is not known: {cost.counted} was cut short"
    if not math.isfinite(cost.seconds):
        return words
    return f"{words}; if the run goes on with steps as short as there, {duration(cost.seconds)}"


def _about(seconds: float, factor: float) -> str:
    """A time and its range; a bracket stays open for what else there is to say."""
    return f"about {duration(seconds)} ({duration(seconds / factor)} to {duration(seconds * factor)}"


def duration(seconds: float) -> str:
    """A time in words: two digits, in the unit that suits."""
    for unit, name in ((86400.0 * 365.25, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit:
            return f"{_digits(seconds / unit)} {name}"
    return f"{_digits(seconds)} s"


def size(count: float) -> str:
    """A number of bytes in words: two digits, in the unit that suits."""
    for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if count >= unit:
            return f"{_digits(count / unit)} {name}"
    return f"{_digits(count / 1e3)} kB"


def _digits(value: float) -> str:
    """Two digits, without an exponent as far as that can be read."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if 10.0 <= rounded < 1e6 else f"{rounded:g}"
