"""Cost study of a scene: its settings run within a budget of wall time, and compared.

A deployment is compared by its trajectory with a converged solution, as long as that is predictable. Beyond
the horizon of predictability, and in a capture soon after the first contact, two runs differ, however fine.
There, distributions of measures over perturbed starts are compared with those of the finest setting.
"""

from __future__ import annotations

import math
import os
import statistics
import time as clock
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from exunet.base.errors import CaseError, ExunetError, InputError, RunStopped
from exunet.kernels.compile import numba_installed
from exunet.methods.method import Backend, Method
from exunet.results.metrics import STEP, STORED, Metric
from exunet.scene.casefile import Case
from exunet.scene.script import may_end_a_run
from exunet.studies.both_codes import Floats, both_of
from exunet.studies.cost.runs import Run, Sample, Subject, perturbed_runs, run, warm_up
from exunet.studies.cost.settings import (
    Setting,
    Varied,
    changed,
    is_capture,
    setting_of,
    settings_of_distribution,
    settings_of_trajectory,
)
from exunet.studies.ensemble import FEW_RUNS, RUNS, SMALL_MOVE, perturbation_for_medians
from exunet.studies.samples import CHANCE, PART, around_one_more, is_shifted, rank_test, shift_of

INSTANTS = 100  # stored times at which solutions are compared to find the horizon
PREDICTABLE = 1e-2  # uncertainty of a speed, relative to the launch speed, up to which it is predictable
REPEATS = 3  # timed runs of a setting whose trajectory is compared
RESOLVED = 3.0  # times the uncertainty of the converged solution, from which on an error is known
CHEAPER = 0.9  # of the wall time; a smaller difference is within the scatter of single runs
_OWN = (1e-10, 1e-11)  # relative tolerances of DOPRI5; round-off takes over below
_REFERENCE = (1e-11, 1e-12)  # relative tolerances of the reference's DOP853

TimeLeft = Callable[[], float]  # remaining wall time [s]
Say = Callable[[str], None]  # called with what is running


@dataclass(frozen=True)
class Converged:
    """Converged solution of a deployment; errors are relative to the launch speed.

    speeds      : (k,) compared numbers at the end [m/s], see `runs.tracked`
    uncertainty : largest difference of one of them between any two solutions
    sensitivity : change of one of them by a perturbation of the start
    horizon     : time [s] from which on the solutions differ by more than PREDICTABLE; None: never
    notes       : how it was computed, with the differences
    """

    speeds: Floats
    uncertainty: float
    sensitivity: float
    horizon: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def predicts(self) -> bool:
        """False beyond the horizon of predictability."""
        return self.uncertainty <= PREDICTABLE


def converge(subject: Subject) -> Converged:
    """Compute the converged solution: two methods or codes, each at two tolerances, and a perturbed start.

    Raises RunStopped if not even a tight tolerance reaches the end.
    """
    began, scale, times = clock.perf_counter(), subject.speed, np.linspace(0.0, subject.end, INSTANTS + 1)
    fine = subject.at(times.tolist())
    backend = Backend.COMPILED if numba_installed() else Backend.EXUDYN
    settings = [setting_of(backend, Method.DOPRI5, tolerance=t * scale) for t in _OWN]
    if subject.both is not None:
        settings += [setting_of(None, "DOP853", tolerance=t * scale) for t in _REFERENCE]
    elif backend == Backend.COMPILED:
        settings.append(setting_of(Backend.EXUDYN, Method.DOPRI5, tolerance=_OWN[-1] * scale))
    solutions = np.array([run(fine, setting).tracked for setting in settings])
    nearby, best = run(fine, settings[1], nearby=True).tracked[-1], solutions[1, -1]
    difference = np.ptp(solutions, axis=0).max(axis=-1) / scale  # (t,)
    sensitivity = float(np.abs(nearby - best).max()) / scale
    # The last agreement before the differences stay: single passes are instants inside a snap.
    lost = int(np.flatnonzero(difference <= PREDICTABLE)[-1]) + 1
    seconds, move = clock.perf_counter() - began, SMALL_MOVE * subject.start.net.size
    notes = (
        f"{', '.join(map(str, settings))}: speeds differ by {difference[-1]:.1e}; took {seconds:.3g} s",
        f"start perturbed by {move:.0e} m: speeds change by {sensitivity:.1e}",
    )
    horizon = float(times[lost]) if lost < len(times) else None
    return Converged(best, float(difference[-1]), sensitivity, horizon, notes)


class Verdict(StrEnum):
    """OPEN: a shift would matter, but is not significant. FAILS: it is, or the capture outcome differs."""

    HOLDS = "holds"
    OPEN = "open: needs more runs"
    FAILS = "does not hold"


class Status(StrEnum):
    """State of a row; REFUSED: the scene does not allow the setting."""

    NOT_RUN = "not run"
    RAN = "ran"
    FAILED = "failed"
    REFUSED = "refused"


@dataclass
class Row:
    """A setting with its runs.

    run         : the first, from the start as it is
    seconds     : wall times of its repeats [s]
    error       : largest difference of a speed at the end from the converged one, over the launch speed
    samples     : of the perturbed runs
    comparisons : with the finest setting, by key of the quantity
    """

    setting: Setting
    status: Status = Status.NOT_RUN
    reason: str = ""
    run: Run | None = None
    seconds: list[float] = field(default_factory=list)
    error: float = math.nan
    samples: list[Sample] = field(default_factory=list)
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    same_outcome: bool = True

    @property
    def median(self) -> float:
        """Median wall time of a run [s]; nan without runs."""
        return statistics.median(self.seconds) if self.seconds else math.nan

    @property
    def evaluations(self) -> float:
        """Evaluations of the forces in a run; nan without runs."""
        return math.nan if self.run is None else float(max(self.run.work.right_hand_sides, 1))

    @property
    def distribution(self) -> list[Sample]:
        """Samples of the perturbed runs, else of the single run."""
        single = self.run.sample if self.run is not None else None
        return self.samples or ([single] if single is not None else [])

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of runs of each capture outcome, the most frequent first."""
        return dict(Counter(sample.outcome for sample in self.distribution if sample.outcome).most_common())

    def values(self, quantity: Metric) -> Floats:
        """Values of a quantity in the runs that have it."""
        measures = [sample.measures for sample in self.distribution]
        return np.array([found[quantity.key].value for found in measures if quantity.key in found])

    @property
    def verdict(self) -> Verdict:
        """Whether the setting gives the distributions of the finest."""
        mattering = [comparison for comparison in self.comparisons.values() if comparison.matters]
        if not self.same_outcome or any(comparison.significant for comparison in mattering):
            return Verdict.FAILS
        return Verdict.OPEN if mattering else Verdict.HOLDS


@dataclass(frozen=True)
class Comparison:
    """A quantity with a setting, compared with the finest.

    shift       : difference of the medians; nan of the finest itself
    low, high   : 90 % interval of the shift; nan of a single run
    allowed     : shift that matters: a third of the range of the finest runs, or the printed digits
    significant : the shift exceeds what perturbations of the start make
    """

    values: Floats
    shift: float = math.nan
    low: float = math.nan
    high: float = math.nan
    allowed: float = 0.0
    significant: bool = False

    @property
    def median(self) -> float:
        """Median of the values."""
        return float(np.median(self.values))

    @property
    def matters(self) -> bool:
        """True if the shift reaches what is allowed."""
        return abs(self.shift) >= self.allowed

    @property
    def shown_equal(self) -> bool:
        """True if there are enough runs to show that the shift does not matter: its interval lies within."""
        return max(abs(self.low), abs(self.high)) < self.allowed


def compare(
    quantity: Metric, values: Floats, finest: Floats, resolution: float = 0.0, level: float = CHANCE
) -> Comparison:
    """Compare the values of a setting with those of the finest; empty `finest`: it is the finest itself.

    resolution : of the values, by stored times or steps
    level      : probability of a significant shift without a shift
    """
    if not len(finest):
        return Comparison(values)
    median, center, width = float(np.median(values)), float(np.median(finest)), float(np.ptp(finest))
    shift, last = median - center, max(resolution, quantity.last_digit(center))
    allowed = max(PART * width, last)
    if len(values) == 1:  # tested as one more run of the finest
        around = float(around_one_more(finest)) if len(finest) > 1 else math.inf
        significant = abs(median - float(finest.mean())) > max(last, around)
        return Comparison(values, shift, allowed=allowed, significant=significant)
    interval = shift_of(finest, values, quantity.resolution)
    low, high = (shift, shift) if interval is None else (interval.low * width, interval.high * width)
    significant = abs(shift) > last and is_shifted(values.tolist(), finest.tolist(), last, level)
    return Comparison(values, shift, low, high, allowed, significant)


@dataclass
class Study:
    """Cost study of a scene.

    rows         : in the order of their runs
    converged    : solution of a deployment; None of a capture
    runs         : number of perturbed runs of each setting
    perturbation : largest one of a coordinate [m]
    quantities   : whose distributions are compared
    note         : why the reference takes no part in it; "": it does, or is not needed
    """

    subject: Subject
    rows: list[Row]
    converged: Converged | None = None
    runs: int = 0
    perturbation: float = 0.0
    quantities: tuple[Metric, ...] = ()
    note: str = ""
    interrupted: bool = False

    @property
    def by_trajectory(self) -> bool:
        """True if trajectories are compared, False if distributions."""
        return bool(self.subject.times)

    @property
    def uncertainty(self) -> float:
        """Error that is not resolved."""
        return 0.0 if self.converged is None else self.converged.uncertainty

    def pareto(self, effort: Callable[[Row], float]) -> list[Row]:
        """Rows of trajectories that no other one beats in both effort and error, the cheapest first."""
        front: list[Row] = []
        for row in sorted((row for row in self.rows if row.run), key=lambda row: (effort(row), row.error)):
            if not front or row.error < front[-1].error:
                front.append(row)
        return front

    def finer(self, row: Row) -> list[Row]:
        """Rows of the same name with finer settings that ran or failed."""
        name, size, ended = row.setting.name, row.setting.size, (Status.RAN, Status.FAILED)
        same = (other for other in self.rows if other.setting.name == name and other.status in ended)
        return [other for other in same if other.setting.size < size]

    def cheapest(self, level: float) -> Row | None:
        """Cheapest available setting with an error, and that of all finer ones of its name, within a level.

        So neither one fortunate crossing of zero nor a method whose finer setting fails counts as accurate.
        """
        bound = max(level, RESOLVED * self.uncertainty)
        able = [row for row in self.rows if not row.setting.forced and row.error <= level]
        sure = [row for row in able if all(finer.error <= bound for finer in self.finer(row))]
        return min(sure, key=lambda row: row.median, default=None)

    def complete(self, row: Row) -> bool:
        """True if a row has its perturbed runs, or as many as a range needs."""
        return row.status == Status.RAN and 0 < min(self.runs, FEW_RUNS) <= len(row.samples)

    @property
    def finest(self) -> Row | None:
        """Complete row of the case with the shortest step or tightest tolerance."""
        able = [row for row in self.rows if row.setting.varied == Varied.SIZE and self.complete(row)]
        return min(able, key=lambda row: row.setting.size, default=None)

    @property
    def recommended(self) -> Row | None:
        """Cheapest complete row whose distributions hold; the finest only if no other one does.

        It differs from the case in the integration only.
        """
        best = None
        for row in self.rows:
            able = self.complete(row) and row is not self.finest and row.verdict == Verdict.HOLDS
            if (
                able
                and row.setting.varied in (Varied.SIZE, Varied.METHOD)
                and (best is None or row.median < CHEAPER * best.median)
            ):
                best = row
        return self.finest if best is None else best


def study_of(case: Case, until: float | None = None, runs: int | None = None) -> Study:
    """Prepare the study of a case; the converged solution of a deployment is computed.

    until : end of the runs [s]; None: that of the case
    runs  : perturbed runs of each setting, where distributions are compared; None: 32
    Raises InputError if the script may end a run, as runs of different ends are not comparable; RunStopped if
    the converged solution stops.
    """
    end = case.scene.time.end if until is None else until
    converged, note = None, ""
    if not is_capture(case):
        subject = Subject.of(case, (0.0, end))
        try:
            subject = Subject.of(case, (0.0, end), both_of(case))
        except InputError as error:
            note = f"without the reference: {error}"
        converged = converge(subject)
        if converged.predicts:
            rows = [Row(setting) for setting in settings_of_trajectory(case, subject.start)]
            return Study(subject, rows, converged, note=note)
    case = case if until is None else changed(case, f"time.end={until!r}")
    subject = Subject.of(case)
    if may_end_a_run(subject.start.scene.script):
        raise InputError("script: a cost study requires runs of the same end: remove the entries that stop")
    rows = [Row(setting) for setting in settings_of_distribution(case)]
    perturbation = perturbation_for_medians(subject.prepare(rows[0].setting))
    return Study(subject, rows, converged, runs or RUNS, perturbation, note=note)


def run_study(study: Study, left: TimeLeft, say: Say) -> None:
    """Run the settings of a study until all are done, no wall time is left, or the user interrupts."""
    try:
        (_run_trajectories if study.by_trajectory else _run_distributions)(study, left, say)
    except KeyboardInterrupt:
        study.interrupted = True
    if not study.by_trajectory:
        compare_distributions(study)


def _run_trajectories(study: Study, left: TimeLeft, say: Say) -> None:
    """Run settings of each name from loose to fine, the cheapest next one first; all are repeated at last.

    A setting counts as dear as the last one of its name, or the cheapest one of its backend. What took more
    than is left is not refined.
    """
    waiting: dict[str, list[Row]] = {}
    for row in study.rows:
        waiting.setdefault(row.setting.name, []).append(row)
    last, of_backend = dict[str, float](), dict[Backend | None, float]()  # wall time [s]

    def next_cost(name: str) -> float:
        return last.get(name, of_backend.get(waiting[name][0].setting.backend, 0.0))

    while waiting and left() > 0.0:
        name = min(waiting, key=next_cost)
        if next_cost(name) > left():
            break
        row = waiting[name].pop(0)
        _run_once(study, row, left, say)
        if row.seconds:
            last[name] = row.median
            of_backend[row.setting.backend] = min(row.median, of_backend.get(row.setting.backend, math.inf))
        if row.status == Status.REFUSED:
            for other in waiting[name]:
                other.status, other.reason = row.status, row.reason
        if row.status == Status.REFUSED or not waiting[name]:
            del waiting[name]
    for _ in range(REPEATS - 1):
        for row in study.rows:
            if row.run is not None and row.median <= left():
                say(f"again {row.setting}")
                row.seconds.append(run(study.subject, row.setting).seconds)


def _run_distributions(study: Study, left: TimeLeft, say: Say) -> None:
    """Run each setting once and from FEW_RUNS perturbed starts; backends run once.

    What is left of the budget goes to further perturbed runs of all settings in turn.
    """
    compiled = [row for row in study.rows if row.setting.backend == Backend.COMPILED]
    for row in [*compiled, *(row for row in study.rows if row not in compiled)]:
        if left() <= 0.0:
            return
        _run_once(study, row, left, say)
        if row in compiled:
            _run_perturbed(study, row, min(study.runs, FEW_RUNS), left, say)
    for goal in range(2 * FEW_RUNS, study.runs + FEW_RUNS, FEW_RUNS):
        for row in compiled:
            _run_perturbed(study, row, min(study.runs, goal), left, say)


class _BudgetSpent(RunStopped):
    """No wall time is left."""


def _run_once(study: Study, row: Row, left: TimeLeft, say: Say) -> None:
    """Run the start as it is, timed, as long as wall time is left."""
    subject, setting = study.subject, row.setting

    def watch(time: float) -> None:
        if left() < 0.0:
            raise _BudgetSpent(f"stopped at t = {time:.3g} s: the budget was spent")

    say(str(setting))
    try:
        if not any(other.seconds for other in study.rows if other.setting.name == setting.name):
            warm_up(subject, setting)
        row.run = run(subject, setting, watch)
    except Exception as error:  # noqa: BLE001 - a setting that cannot run stays in the table
        _ended(row, error)
        return
    row.status = Status.RAN
    row.seconds.append(row.run.seconds)
    if study.converged is not None and study.by_trajectory:
        difference = float(np.abs(row.run.tracked[-1] - study.converged.speeds).max())
        row.error = max(difference / subject.speed, study.uncertainty)


def _run_perturbed(study: Study, row: Row, goal: int, left: TimeLeft, say: Say) -> None:
    """Run perturbed starts up to a number, in portions, so that what is done survives Ctrl-C."""
    if row.status != Status.RAN or len(row.samples) >= goal:
        return
    start = study.subject.prepare(row.setting)
    while (done := len(row.samples)) < goal and left() > 0.0:
        say(f"{row.setting.name}: perturbed run {done + 1} of {goal}")
        number = min(os.cpu_count() or 1, goal - done)
        try:
            row.samples += perturbed_runs(start, number, study.perturbation, done)
        except ExunetError as error:
            _ended(row, error)
            return


def _ended(row: Row, error: Exception) -> None:
    """Record why a setting did not run, or failed."""
    row.status, row.reason = Status.FAILED, str(error).split("\n", maxsplit=1)[0]
    if isinstance(error, _BudgetSpent):
        row.status = Status.NOT_RUN
    elif isinstance(error, CaseError):
        row.status, row.reason = (
            Status.REFUSED,
            "; ".join(dict.fromkeys(fault.reason for fault in error.faults)),
        )


def compare_distributions(study: Study) -> None:
    """Compare all rows with the finest, or only collect their values if there is no finest."""
    subject, finest = study.subject, study.finest
    samples = [sample for row in study.rows for sample in row.distribution]
    known = {key: metric for sample in samples for key, metric in sample.measures.items()}
    study.quantities = tuple(known.values())
    times = subject.start.scene.time.stored_times
    compared = max(1, sum(row.setting.varied != Varied.BACKEND for row in study.rows) - 1)
    level = CHANCE / (compared * max(1, len(study.quantities)))
    for row in study.rows:
        for quantity in study.quantities:
            resolution = float(np.diff(times).max()) if quantity.instant == STORED else 0.0
            if quantity.instant == STEP and row.run is not None:
                resolution = subject.end / max(1, row.run.work.steps)
            others = np.zeros(0) if finest is None or finest is row else finest.values(quantity)
            if len(values := row.values(quantity)):
                row.comparisons[quantity.key] = compare(quantity, values, others, resolution, level)
        row.same_outcome = _same_outcome(row, finest, CHANCE / compared)


def _same_outcome(row: Row, finest: Row | None, level: float) -> bool:
    """True if the most frequent outcome is that of the finest, and its share does not differ significantly.

    level : probability of a significant difference without a shift
    """
    if finest is None or finest is row or not row.outcomes or not finest.outcomes:
        return True
    expected, own = next(iter(finest.outcomes)), next(iter(row.outcomes))
    if not row.samples:  # a single run
        return own in finest.outcomes
    shares = ([float(sample.outcome == expected) for sample in some.samples] for some in (row, finest))
    return own == expected and rank_test(*shares) >= level
