"""Cost study of a scene: its settings run within a budget of wall time, and compared.

Up to the horizon of predictability, trajectories of a deployment are compared with a converged solution.
Beyond the horizon, and in a capture soon after the first contact, two runs differ, however fine. There,
distributions of metrics over perturbed runs are compared with those of the finest setting.
"""

from __future__ import annotations

import math
import os
import time as clock
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial

import numpy as np

from exunet.base.errors import CaseError, ExunetError, InputError, RunStopped
from exunet.kernels.compile import numba_installed
from exunet.methods.method import METHODS, Backend, Kind, Method
from exunet.results.metrics import STEP, STORED, Metric
from exunet.scene.casefile import Case
from exunet.scene.script import may_end_a_run
from exunet.studies.both_codes import Floats, both_of
from exunet.studies.cost.runs import WATCHED, Run, Sample, Subject, perturbed_runs, run, warm_up
from exunet.studies.cost.settings import (
    INTEGRATION,
    Setting,
    Varied,
    changed,
    is_capture,
    setting_of,
    settings_of_distribution,
    settings_of_trajectory,
)
from exunet.studies.ensemble import FEW_RUNS, RUNS, SMALL_MOVE, perturbation_for_medians
from exunet.studies.samples import CHANCE, SettingComparison, compare, rank_test

LEVELS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # errors whose wall times are reported
INSTANTS = 100  # stored times at which solutions are compared to find the horizon
PREDICTABLE = 1e-2  # uncertainty of a speed, relative to the launch speed, up to which it is predictable
REPEATS = 10  # integrations at most that are timed for a setting
REPEATED = 0.4  # wall time of these [s] from which on none follows
FEWEST = 4  # perturbed runs that a verdict needs
RESOLVED = 3.0  # times the uncertainty of the converged solution, from which on an error is known
CHEAPER = 0.9  # of the wall time; a smaller difference is within the scatter of single runs
SHARE = 0.4  # of the time left, for the converged solution, and for trajectories if metrics follow
_OWN = (1e-10, 1e-11)  # relative tolerances of DOPRI5; round-off takes over below
_REFERENCE = (1e-11, 1e-12)  # relative tolerances of the reference's DOP853
_DEAR = {Backend.COMPILED: 1.0, Backend.EXUDYN: 40.0, None: 100.0}  # an evaluation, as long as none was timed
_LOOSER = 0.1  # power of the tolerance by which a looser one needs fewer evaluations, at the least
_ITERATED = 30.0  # times an evaluation, a step of an implicit method, as long as none was timed
_ADAPTIVE = 10.0  # times the wall time of fixed steps, as long as no adaptive ones ran

TimeLeft = Callable[[], float]  # remaining wall time [s]
Say = Callable[[str], None]  # called with what is running


class BudgetSpent(RunStopped):
    """A run that does not fit into the wall time left; `seconds`: what the whole run would take."""

    def __init__(self, message: str, seconds: float) -> None:
        super().__init__(message)
        self.seconds = seconds


Passed = list[tuple[float, float]]  # simulated times of a run, and wall times [s]


def _within(limit: float, end: float, passed: Passed | None = None) -> Callable[[float], None]:
    """Return a function of the simulated time that stops a run which exceeds a wall time [s], or will."""
    began, passed = clock.perf_counter(), [] if passed is None else passed

    def watch(time: float) -> None:
        spent = clock.perf_counter() - began
        passed.append((time, spent))
        at, before = passed[0]  # a model is built before
        whole = before + (spent - before) * (end - at) / (time - at) if time - at > 0.01 * end else 0.0
        if spent > limit or (spent > 0.1 * limit and whole > 1.5 * limit):
            raise BudgetSpent(f"stopped at t = {time:.3g} s: exceeds the wall time left", max(spent, whole))

    return watch


@dataclass
class Costs:
    """Wall times of settings before they run, from those that ran: settings, ends of the runs [s], runs.

    passed : progress of the runs of the converged solution
    """

    ran: list[tuple[Setting, float, Run]] = field(default_factory=list)
    passed: dict[str, Passed] = field(default_factory=dict)

    def of(self, setting: Setting, end: float) -> float:
        """Return the wall time [s] expected of a run; 0 as long as nothing ran."""

        def distance(entry: tuple[Setting, float, Run]) -> tuple[bool, bool, bool, float]:
            other, kinds = entry[0], (setting.step is None) != (entry[0].step is None)
            ratio = 0.0 if kinds else abs(math.log(setting.size / other.size))
            return other.name != setting.name, other.backend != setting.backend, kinds, ratio

        if not self.ran:
            return 0.0
        other, until, run = min(self.ran, key=distance)
        facts = METHODS.get(setting.method) if isinstance(setting.method, Method) else None
        more, finer = setting.elements / other.elements, other.size / setting.size
        seconds = run.seconds / until * end * more * _DEAR[setting.backend] / _DEAR[other.backend]
        if facts is not None and facts.kind == Kind.IMPLICIT and other.name != setting.name:
            seconds *= _ITERATED
        if setting.step is not None:  # whose evaluations are known
            stages = 1 if facts is None else facts.stages
            return seconds * stages / setting.step / max(1, run.work.right_hand_sides) * until
        if other.step is not None:
            return seconds * _ADAPTIVE
        order = 8 if facts is None else facts.order
        return seconds * more * finer ** (_LOOSER if finer < 1.0 else 1.0 / order)


@dataclass(frozen=True)
class Converged:
    """Converged solution of a deployment; errors are relative to the launch speed.

    speeds      : (k,) compared numbers at the end [m/s], see `runs.tracked`
    uncertainty : largest difference of one of them between any two solutions
    sensitivity : change of one of them by a perturbation of the start
    horizon     : time [s] from which on the solutions differ by more than PREDICTABLE; None: never
    notes       : how it was computed, with the differences
    end         : of the trajectory [s]
    """

    speeds: Floats
    uncertainty: float
    sensitivity: float
    horizon: float | None = None
    notes: tuple[str, ...] = ()
    end: float = 0.0


def converge(
    subject: Subject, limit: float = math.inf, costs: Costs | None = None, *, resolve: bool = False
) -> Converged:
    """Compute the converged solution: two methods or codes, each at two tolerances, and a perturbed start.

    limit   : wall time [s]; without the other code if that does not fit
    costs   : gets the runs
    resolve : up to the last time at which the smallest of LEVELS is resolved; else only if the end is not
              predictable
    Raises RunStopped if not even a tight tolerance reaches the end, BudgetSpent if exunet's own runs exceed
    the limit.
    """
    began, scale, costs = clock.perf_counter(), subject.speed, Costs() if costs is None else costs
    times = np.linspace(0.0, subject.end, INSTANTS + 1)
    backend = Backend.COMPILED if numba_installed() else Backend.EXUDYN
    settings = [setting_of(backend, Method.DOPRI5, tolerance=t * scale) for t in _OWN]
    others = [setting_of(Backend.EXUDYN, Method.DOPRI5, tolerance=_OWN[-1] * scale)]
    if subject.both is not None:
        others = [setting_of(None, "DOP853", tolerance=t * scale) for t in _REFERENCE]

    def solution(setting: Setting, until: int, runs: int = 1, *, nearby: bool = False) -> Floats:
        passed = costs.passed.setdefault(str(setting), [])
        watch = _within((limit - (clock.perf_counter() - began)) / runs, float(times[until]), passed)
        found = run(subject.at(times[: until + 1].tolist()), setting, watch, nearby=nearby)
        costs.ran.append((setting, float(times[until]), found))
        return found.tracked

    last = len(times) - 1
    solutions = [solution(setting, last, 3 - k) for k, setting in enumerate(settings)]  # as many of one cost
    nearby = solution(settings[1], last, nearby=True)
    difference = np.abs(solutions[0] - solutions[1]).max(axis=-1) / scale  # (t,)
    lost = _last_below(PREDICTABLE, difference) + 1
    with suppress(BudgetSpent):
        for setting in others:  # beyond the horizon they add nothing
            solutions.append(solution(setting, min(lost, last)))
            settings.append(setting)
    common = min(map(len, solutions))
    every = np.array([found[:common] for found in solutions])
    difference[:common] = np.ptp(every, axis=0).max(axis=-1) / scale
    lost = _last_below(PREDICTABLE, difference) + 1
    if resolve or lost < len(times):
        last = _last_below(LEVELS[-1] / RESOLVED, difference)
    sensitivity = float(np.abs(nearby - solutions[1])[last].max()) / scale
    seconds, move = clock.perf_counter() - began, SMALL_MOVE * subject.start.net.size
    notes = (
        f"{', '.join(map(str, settings))}: speeds differ by {difference[last]:.1e} at {times[last]:.3g} s; "
        f"took {seconds:.3g} s",
        f"start perturbed by {move:.0e} m: speeds change by {sensitivity:.1e}",
    )
    horizon = float(times[lost]) if lost < len(times) else None
    found_at = solutions[1][last], float(difference[last]), sensitivity
    return Converged(*found_at, horizon, notes, float(times[last]))


def _last_below(bound: float, difference: Floats) -> int:
    """Last agreement before the differences stay: single passes are instants inside a snap."""
    return int(np.flatnonzero(difference <= bound)[-1])


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
    seconds     : wall times of integrations with few stored times, from this start [s]
    error       : largest difference of a speed at the end from the converged one, over the launch speed
    samples     : of the perturbed runs
    comparisons : with the finest setting, by key of the quantity
    expected    : wall time of a run [s] before it runs
    """

    setting: Setting
    status: Status = Status.NOT_RUN
    reason: str = ""
    run: Run | None = None
    seconds: list[float] = field(default_factory=list)
    error: float = math.nan
    samples: list[Sample] = field(default_factory=list)
    comparisons: dict[str, SettingComparison] = field(default_factory=dict)
    same_outcome: bool = True
    expected: float = 0.0

    @property
    def wall(self) -> float:
        """Wall time [s] of the fastest integration; nan without runs. Other programs only slow it down."""
        return min(self.seconds, default=math.nan)

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
        """Whether the setting gives the distributions of the finest; OPEN with too few perturbed runs."""
        if len(self.samples) < FEWEST and self.setting.varied != Varied.BACKEND:
            return Verdict.OPEN
        mattering = [comparison for comparison in self.comparisons.values() if comparison.matters]
        if not self.same_outcome or any(comparison.significant for comparison in mattering):
            return Verdict.FAILS
        return Verdict.OPEN if mattering else Verdict.HOLDS


@dataclass
class CostStudy:
    """One part of the cost study of a scene: its trajectories, or its distributions.

    rows         : settings
    converged    : solution of a deployment; None: distributions are compared
    runs         : number of perturbed runs of each setting
    perturbation : largest one of a coordinate [m]
    quantities   : whose distributions are compared
    few          : perturbed runs of a setting before the next setting runs
    overhead     : wall time of a perturbed run beside its integration [s]
    """

    subject: Subject
    rows: list[Row]
    converged: Converged | None = None
    runs: int = 0
    perturbation: float = 0.0
    quantities: tuple[Metric, ...] = ()
    costs: Costs = field(default_factory=Costs)
    few: int = FEW_RUNS
    overhead: float = 0.0

    @property
    def by_trajectory(self) -> bool:
        """True if trajectories are compared, False if distributions."""
        return self.converged is not None

    @property
    def uncertainty(self) -> float:
        """Error that is not resolved."""
        return 0.0 if self.converged is None else self.converged.uncertainty

    @property
    def front(self) -> list[Row]:
        """Rows of trajectories that no other one beats in both wall time and error, the cheapest first."""
        front: list[Row] = []
        for row in sorted((row for row in self.rows if row.seconds), key=lambda row: (row.wall, row.error)):
            if not front or row.error < front[-1].error:
                front.append(row)
        return front

    def wall_of(self, row: Row) -> float:
        """Wall time expected of a setting with its perturbed runs [s]."""
        perturbed = 0 if row.setting.varied == Varied.BACKEND else min(self.runs, self.few)
        single = row.wall if row.seconds else row.expected
        return single + (single + self.overhead) * math.ceil(perturbed / (os.cpu_count() or 1))

    def finer(self, row: Row) -> list[Row]:
        """Rows of the same name with finer settings that ran or failed."""
        name, size, ended = row.setting.name, row.setting.size, (Status.RAN, Status.FAILED)
        same = (other for other in self.rows if other.setting.name == name and other.status in ended)
        return [other for other in same if other.setting.size < size]

    def cheapest(self, level: float, name: str | None = None) -> Row | None:
        """Cheapest setting with an error, and that of all finer ones of its name, within a level.

        So neither one fortunate crossing of zero nor a method whose finer setting fails counts as accurate.
        """
        bound = max(level, RESOLVED * self.uncertainty)
        codes = [row for row in self.rows if name or row.setting.backend]  # the reference is not offered
        named = [row for row in codes if name in (None, row.setting.name)]
        able = [row for row in named if not row.setting.forced and row.error <= level]
        sure = [row for row in able if all(finer.error <= bound for finer in self.finer(row))]
        return min(sure, key=lambda row: row.wall, default=None)

    def complete(self, row: Row) -> bool:
        """True if a row has all its perturbed runs, or as many as a verdict needs."""
        return row.status == Status.RAN and 0 < min(self.runs, FEWEST) <= len(row.samples)

    @property
    def finest(self) -> Row | None:
        """Complete row of the case with the tightest tolerance or, without any, the shortest step."""
        able = [row for row in self.rows if row.setting.varied == Varied.SIZE and self.complete(row)]
        return min(able, key=lambda row: (row.setting.tolerance is None, row.setting.size), default=None)

    @property
    def recommended(self) -> Row | None:
        """Cheapest complete row whose distributions hold; the finest only if no other one does.

        It differs from the case in the integration only. An accuracy is preferred, as it is easily given.
        """
        best = finest = self.finest
        varied = [row for row in self.rows if row.setting.varied in INTEGRATION]
        for row in sorted(varied, key=lambda row: row.setting.accuracy is None):
            finer = [other for other in self.finer(row) if self.complete(other)]
            holds = all(other.verdict == Verdict.HOLDS for other in (row, *finer))
            if self.complete(row) and row is not finest and holds:
                best = row if best is finest or best is None or row.wall < CHEAPER * best.wall else best
        return best


def studies_of(
    case: Case, until: float | None = None, runs: int | None = None, left: TimeLeft = lambda: math.inf
) -> tuple[list[CostStudy], tuple[str, ...]]:
    """Prepare the parts of the study of a case, and notes; compute the converged solution of a deployment.

    until : end of the runs [s]; None: that of the case
    runs  : perturbed runs of each setting, where distributions are compared; None: 32
    Raises InputError if the script may end a run, as runs of different ends are not comparable; RunStopped if
    the converged solution stops.
    """
    end, costs = case.scene.time.end if until is None else until, Costs()
    parts, notes = list[CostStudy](), tuple[str, ...]()
    if not is_capture(case):
        subject = Subject.of(case, (0.0, end))
        try:
            subject = Subject.of(case, (0.0, end), both_of(case))
        except InputError as error:
            notes = (f"without the reference: {error}",)
        try:
            converged = converge(subject, SHARE * left(), costs, resolve=until is None)
            notes += converged.notes
            if converged.end > 0.0:
                subject = subject.until(converged.end)
                settings = settings_of_trajectory(subject.start, reference=subject.both is not None)
                rows = [Row(setting) for setting in settings]
                for row in (row for row in rows if row.setting.backend is None):
                    times, walls = np.array([*costs.passed.get(str(row.setting), []), (0.0, 0.0)]).T
                    if times.max() >= converged.end:  # ran for the converged solution
                        row.seconds = [float(np.interp(converged.end, times[:-1], walls[:-1]))]
                        row.status, row.error = Status.RAN, converged.uncertainty
                parts.append(CostStudy(subject, rows, converged, costs=costs))
            if converged.end >= end:
                return parts, notes
        except BudgetSpent as spent:
            words = f"not compared: a converged solution takes some {3.0 * spent.seconds:.2g} s"
            notes += (f"trajectories: {words}, give a larger --budget or an earlier --until",)
        if parts and not numba_installed():
            return parts, notes
    case = case if until is None else changed(case, f"time.end={until!r}")
    subject = Subject.of(case)
    if may_end_a_run(subject.start.scene.script):
        raise InputError("script: a cost study requires runs of the same end: remove the entries that stop")
    rows = [Row(setting) for setting in settings_of_distribution(case)]
    perturbation = perturbation_for_medians(subject.prepare(rows[0].setting))
    parts.append(CostStudy(subject, rows, None, runs or RUNS, perturbation, costs=costs))
    return parts, notes


def run_studies(parts: list[CostStudy], left: TimeLeft, say: Say) -> bool:
    """Run settings, the cheapest first, until none fits into the wall time left; False: interrupted."""
    complete = True
    try:
        for part, share in [*zip(parts, (SHARE, 1.0)[-len(parts) :], strict=True), (parts[0], 1.0)]:
            run_study(part, partial(lambda kept: left() - kept, (1.0 - share) * left()), say)
    except KeyboardInterrupt:
        complete = False
    for part in parts:
        if not part.by_trajectory:
            compare_distributions(part)
    return complete


def run_study(study: CostStudy, left: TimeLeft, say: Say) -> None:
    """Run settings, the cheapest first, as long as one fits.

    A setting runs from the start as it is, timed, and, where distributions are compared, from FEW_RUNS
    perturbed starts; from FEWEST if otherwise not all steps fit into the time left, from half of
    that if a setting does not fit. What remains goes to further perturbed runs.
    """
    like = study.rows[0].setting.method
    waiting = [row for row in study.rows if row.status == Status.NOT_RUN]
    while waiting:
        for row in waiting:
            stopped = row.expected if row.reason else 0.0
            row.expected = max(stopped, study.costs.of(row.setting, study.subject.end))
        walls = [(study.wall_of(row), row.setting.method != like, -row.setting.size) for row in waiting]
        row = waiting[walls.index(min(walls))]
        if study.wall_of(row) > left():
            if study.by_trajectory or study.few < FEWEST:
                break
            study.few //= 2
            continue
        waiting.remove(row)
        _run_once(study, row, left, say)
        steps = (study.wall_of(other) for other in (row, *waiting) if other.setting.varied == Varied.SIZE)
        if sum(steps) > left():
            study.few = min(FEWEST, study.few)
        _run_perturbed(study, row, min(study.runs, study.few), left, say)
        same = [other for other in waiting if other.setting.name == row.setting.name]
        if row.status in (Status.REFUSED, Status.NOT_RUN):
            waiting = [other for other in waiting if other not in same]
        for other in same if row.status == Status.REFUSED else ():
            other.status, other.reason = row.status, row.reason
    ran = [row for row in sorted(study.rows, key=study.wall_of) if row.samples]
    for goal in (FEWEST, *range(FEW_RUNS, study.runs + FEW_RUNS, FEW_RUNS)):
        for row in ran:
            _run_perturbed(study, row, min(study.runs, goal), left, say)
        if any(row.status == Status.RAN and len(row.samples) < min(study.runs, goal) for row in ran):
            break  # more runs of the others alone decide nothing


def _run_once(study: CostStudy, row: Row, left: TimeLeft, say: Say) -> None:
    """Run the start as it is, timed with few stored times; repeat a short run, as its times are noise."""
    subject, setting = study.subject, row.setting
    if not subject.times and setting.varied != Varied.BACKEND:  # whose single run has the metrics
        subject = subject.at(np.linspace(0.0, subject.end, WATCHED + 1).tolist())
    say(str(setting))
    try:
        same = (other.seconds for other in study.rows if other.setting.name == setting.name)
        if setting.backend is not None and not any(same):
            warm_up(subject, setting)
        row.run = run(subject, setting, _within(left(), subject.end))
    except Exception as error:  # noqa: BLE001 - a setting that cannot run stays in the table
        _ended(row, error)
        return
    row.status = Status.RAN
    row.seconds.append(row.run.seconds)
    study.costs.ran.append((setting, subject.end, row.run))
    if study.converged is not None:
        difference = float(np.abs(row.run.tracked[-1] - study.converged.speeds).max())
        row.error = max(difference / subject.speed, study.uncertainty)
    while len(row.seconds) < REPEATS and sum(row.seconds) < REPEATED and row.wall < left():
        row.seconds.append(run(subject, setting).seconds)


def _run_perturbed(study: CostStudy, row: Row, goal: int, left: TimeLeft, say: Say) -> None:
    """Run perturbed starts up to a number, in portions of a second, so that Ctrl-C loses little."""
    if row.status != Status.RAN or row.setting.varied == Varied.BACKEND or len(row.samples) >= goal:
        return
    start, cores = study.subject.prepare(row.setting), os.cpu_count() or 1
    margin = 1.0 if study.overhead else 2.0  # cores share memory
    while (done := len(row.samples)) < goal and margin * (each := row.wall + study.overhead) <= left():
        say(f"{row.setting.name}: perturbed run {done + 1} of {goal}")
        number, began = min(max(cores, int(cores / each)), goal - done), clock.perf_counter()
        try:
            row.samples += perturbed_runs(start, number, study.perturbation, done)
        except ExunetError as error:
            _ended(row, error)
            return
        seconds = (clock.perf_counter() - began) / math.ceil(number / cores)
        study.overhead = max(0.0, seconds - row.wall)


def _ended(row: Row, error: Exception) -> None:
    """Record why a setting did not run, or failed."""
    row.status, row.reason = Status.FAILED, str(error).split("\n", maxsplit=1)[0]
    if isinstance(error, BudgetSpent):
        row.status, row.expected = Status.NOT_RUN, error.seconds
    elif isinstance(error, CaseError):
        row.status = Status.REFUSED
        row.reason = "; ".join(dict.fromkeys(fault.reason for fault in error.faults))


def compare_distributions(study: CostStudy) -> None:
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
