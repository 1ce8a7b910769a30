"""The study of a capture: every setting from the same moved starts, the dearest that fits as the measure.

The case as it is runs first, and tells what all others will take. Then come the finest setting, coarser ones,
those that change the contact and the net, and the forms of Exudyn's, as long as they fit into the budget. A
start that stops ends its setting, with the reason. What is done when the budget is spent, or the user
interrupts, is kept.
"""

from __future__ import annotations

import os
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from exunet.base.errors import ExunetError, InputError, Interrupted, RunStopped
from exunet.bodies.rigid import RigidStates
from exunet.case.casefile import Case
from exunet.case.script import may_end_a_run
from exunet.net.areas import achievable_area
from exunet.results.course import Course, course_of
from exunet.results.spread import COVERING, FEWEST
from exunet.simulation.expected_time import expected_time
from exunet.simulation.preparation import Start, prepare_case
from exunet.simulation.run import simulate
from exunet.studies.capture_cost.judging import Bias, Verdicts, biases, verdicts
from exunet.studies.capture_cost.settings import CaptureSetting, Knob, settings_of, the_case
from exunet.studies.ensemble import perturbed_bodies_of, perturbed_positions, run_ensemble

Say = Callable[[str], None]
TimeLeft = Callable[[], float]

CHEAPER = 0.9  # of the wall time: what is not below is as dear, as wall times of single runs scatter
_WARM_UP = 1e-3  # of the run: compiles what is to be compiled


class Judgement(StrEnum):
    """HOLDS : no bias matters, and the verdict is that of the finest
    OPEN  : a bias would matter, and is not told apart from what moved starts do
    FAILS : a bias matters and is told apart, or the verdict is another
    """

    HOLDS = "holds"
    OPEN = "open: more --runs would tell"
    FAILS = "does not hold"


@dataclass
class CaptureRow:
    """A setting, what it took, and its runs.

    seconds : wall time of the stepping of one run, alone [s]; nan: it has not run
    right_hand_sides : of this run
    steps   : their mean length [s]
    unmoved : the start as it is
    moved   : the moved starts
    reason  : why there are no runs, or not all; "" if there are
    failed  : it ran and stopped, or cannot be had
    """

    setting: CaptureSetting
    seconds: float = float("nan")
    right_hand_sides: int = 0
    step: float = 0.0
    unmoved: Course | None = None
    moved: list[Course] = field(default_factory=list)
    reason: str = ""
    failed: bool = False

    @property
    def courses(self) -> Sequence[Course]:
        """The runs that tell its distribution; of a form of Exudyn's the one that it has."""
        return [self.unmoved] if self.setting.alone and self.unmoved is not None else self.moved


@dataclass
class CaptureStudy:
    """All that was found.

    runs, move : number of moved starts of each setting, and by how much they are moved at most [m]
    rows       : in the order of `settings_of`
    """

    case: Case
    runs: int
    move: float
    rows: list[CaptureRow]
    interrupted: bool = False

    @property
    def finest(self) -> CaptureRow | None:
        """The shortest step, or tightest tolerance, of the case that all moved starts came through."""
        able = [row for row in self.rows if row.setting.knob == Knob.SIZE and self.complete(row)]
        return min(able, key=lambda row: row.setting.size, default=None)

    def complete(self, row: CaptureRow) -> bool:
        """True if all its moved starts are there."""
        return 0 < self.runs == len(row.moved) and not row.failed

    def biases(self, row: CaptureRow) -> tuple[Bias, ...]:
        """Of the quantities of a row, against the finest; without runs none."""
        if not row.courses:
            return ()
        return biases(row.courses, self._against(row), row.step, self._compared)

    def verdicts(self, row: CaptureRow) -> Verdicts | None:
        """Of a row, against the finest; None without runs."""
        return verdicts(row.courses, self._against(row), self._compared) if row.courses else None

    @property
    def _compared(self) -> int:
        """How many settings are compared with the finest by their distributions."""
        return max(1, sum(not row.setting.alone for row in self.rows) - 1)

    def _against(self, row: CaptureRow) -> Sequence[Course]:
        return [] if self.finest is None or self.finest is row else self.finest.moved

    def judged(self, row: CaptureRow) -> Judgement:
        """Of a row with runs, against the finest."""
        found = self.verdicts(row)
        mattering = [one for one in self.biases(row) if one.matters]
        if found is None or not found.same or any(one.told_apart for one in mattering):
            return Judgement.FAILS
        return Judgement.OPEN if mattering else Judgement.HOLDS

    @property
    def recommended(self) -> CaptureRow | None:
        """The cheapest complete setting that holds, the first of those that are as dear; None: none is known.

        The finest is one only where nothing coarser holds.
        """
        finest, best = self.finest, None
        for row in self.rows:
            able = self.complete(row) and not row.setting.alone and row is not finest
            if (
                able
                and self.judged(row) == Judgement.HOLDS
                and (best is None or row.seconds < CHEAPER * best.seconds)
            ):
                best = row
        return finest if best is None else best


@dataclass(frozen=True)
class CaptureStudyOptions:
    """What is asked of a study: wall time [s], number of moved starts (None: what fits), their move [m]."""

    budget: float
    runs: int | None = None
    move: float = 1e-5


@dataclass(frozen=True)
class CaptureStudyPlan:
    """What is to come: settings and forms that fit into the budget, and what they take together [s]."""

    runs: int
    seconds: float
    settings: tuple[CaptureSetting, ...]
    left_out: tuple[CaptureSetting, ...]


def begun(case: Case, asked: CaptureStudyOptions) -> CaptureStudy:
    """The study before its first run.

    Raises what preparing the case raises, and InputError for a script that may end runs, whose moved starts
    cannot be compared.
    """
    if may_end_a_run(prepare_case(case).scene.script):
        words = "the script may end each run at another time, and settings are judged over the same times"
        raise InputError(f"script: {words}: remove the entry that stops")
    rows = [CaptureRow(one, reason=one.refused, failed=bool(one.refused)) for one in settings_of(case)]
    return CaptureStudy(case, asked.runs or 0, asked.move, rows)


def first_seconds(study: CaptureStudy) -> float:
    """Wall time [s] that the first run is expected to take; contact may make it several times as long."""
    return expected_time(_own(study).setting.start(study.case)) or 0.0


def _own(study: CaptureStudy) -> CaptureRow:
    own = the_case([row.setting for row in study.rows])
    return next(row for row in study.rows if row.setting is own)


def run(
    study: CaptureStudy,
    asked: CaptureStudyOptions,
    say: Say,
    expect: Callable[[CaptureStudyPlan], None],
    now: Callable[[], float] = clock.perf_counter,
) -> None:
    """Fill the rows until all is done, the budget is spent, or the user interrupts.

    say    : told what is running
    expect : told what is to come, once it can be known
    now    : wall time [s]
    """
    began = now()

    def left() -> float:
        return asked.budget - (now() - began)

    own = _own(study)
    try:
        say(f"{own.setting.name}: the start as it is")
        _alone(study, own, left)
        if own.reason:
            return
        rates = _Rates(own.seconds, own.seconds / _cores())
        plan = _planned(study, asked, rates, left())
        study.runs = plan.runs
        expect(plan)
        for row in _in_order(study):
            expected = _expected(study, row, rates)
            if row.failed:
                continue
            if expected > left():
                row.reason = f"left out: some {expected:.2g} s expected, {max(left(), 0.0):.2g} s left"
                continue
            if row.unmoved is None:
                say(f"{row.setting.name}: the start as it is")
                _alone(study, row, left)
            if not (row.reason or row.setting.alone):
                before = now()
                _moved(study, row, say, left)
                if row is own and row.moved:
                    rates.start = (now() - before) / len(row.moved)
    except KeyboardInterrupt:
        study.interrupted = True


@dataclass
class _Rates:
    """Wall time [s] of the case as it is: of one run alone, and of a moved start among many."""

    alone: float
    start: float


def _cores() -> int:
    return os.cpu_count() or 1


def _in_order(study: CaptureStudy) -> list[CaptureRow]:
    """The case as it is, the finest, then as listed: coarser first, forms last."""
    own = _own(study)
    sizes = [row for row in study.rows if row.setting.knob == Knob.SIZE]
    first = list(dict.fromkeys(id(row) for row in (own, min(sizes, key=lambda row: row.setting.size))))
    ordered = {id(row): row for row in study.rows}
    return [ordered[key] for key in dict.fromkeys([*first, *ordered])]


def _expected(study: CaptureStudy, row: CaptureRow, rates: _Rates) -> float:
    """Wall time [s] of what is still to be run of a row."""
    if row.failed:
        return 0.0
    if row.setting.alone:
        return expected_time(row.setting.start(study.case)) or 0.0
    alone = 0.0 if row.unmoved is not None else rates.alone
    return row.setting.work * (alone + study.runs * rates.start)


def _planned(study: CaptureStudy, asked: CaptureStudyOptions, rates: _Rates, left: float) -> CaptureStudyPlan:
    """As many moved starts as the budget has room for, 8 to 32, unless their number is asked for."""
    able = [row for row in study.rows if not row.failed]
    work = sum(row.setting.work for row in able if not row.setting.alone)
    forms = sum(_expected(study, row, rates) for row in able if row.setting.alone)
    room = (left - (work - 1.0) * rates.alone) / (work * rates.start)
    beside = room - forms / (work * rates.start)
    runs = asked.runs or int(min(max(beside if beside >= FEWEST else room, FEWEST), COVERING))
    counted = replace(study, runs=runs)
    seconds, inside, outside = 0.0, list[CaptureSetting](), list[CaptureSetting]()
    for row in _in_order(counted):
        more = _expected(counted, row, rates)
        if row.failed:
            continue
        if seconds + more > left:
            outside.append(row.setting)
            continue
        seconds += more
        inside.append(row.setting)
    return CaptureStudyPlan(runs, seconds, tuple(inside), tuple(outside))


class _Spent(RunStopped):
    """Nothing is left of the budget."""


def _alone(study: CaptureStudy, row: CaptureRow, left: TimeLeft) -> None:
    """The start as it is, timed, as long as something is left of the budget."""

    def watch(time: float, *_: object) -> None:
        if left() < 0.0:
            raise _Spent(f"left out: the budget was spent at t = {time:.3g} s of its first run")

    try:
        start = row.setting.start(study.case)
        simulate(_briefly(start))
        found = simulate(start, progress=watch)
    except _Spent as spent:
        row.reason = str(spent)
        return
    except Interrupted:
        raise KeyboardInterrupt from None
    except ExunetError as error:
        row.reason, row.failed = _reason(error), True
        return
    story = found.provenance
    row.seconds, row.right_hand_sides = story["integration_seconds"], story["right_hand_sides"]
    row.step = float(found.time[-1]) / max(1, story["steps"])
    row.unmoved = course_of(found)


def _briefly(start: Start) -> Start:
    """A start that ends soon, so that no first use is timed."""
    keys = {"end": _WARM_UP * start.scene.time.end, "output_step": None, "output_times": ()}
    time = start.scene.time.model_copy(update=keys)
    return replace(start, scene=start.scene.model_copy(update={"time": time}))


def _moved(study: CaptureStudy, row: CaptureRow, say: Say, left: TimeLeft) -> None:
    """The moved starts, as many at once as there are cores, so that what is done survives Ctrl-C."""
    start = row.setting.start(study.case)
    achievable = achievable_area(start.net)
    seed = start.scene.seed
    while (done := len(row.moved)) < study.runs:
        if left() < 0.0:
            row.reason = f"the budget was spent after {done} of {study.runs} moved starts"
            return
        say(f"{row.setting.name}: moved start {done + 1} of {study.runs}")
        number = min(_cores(), study.runs - done)
        places = perturbed_positions(start, number, study.move, seed, first=done)
        bodies: RigidStates | None = perturbed_bodies_of(start, number, study.move, seed, first=done)
        try:
            found = run_ensemble(start, places, first=done, together=False, bodies=bodies)
        except ExunetError as error:
            row.reason, row.failed = _reason(error), True
            return
        row.moved += [found.course(k, achievable) for k in range(number)]


def _reason(error: Exception) -> str:
    return str(error).split("\n", maxsplit=1)[0]
