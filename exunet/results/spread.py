"""The spread of a run: the headlines of moved starts beside those of a converged run, judged one by one.

A start that is moved by much less than anyone can place a net gives another run. Where the headlines of such
runs differ by no more than the digits that are printed, a headline is a value with an error. Where they
differ by more, the horizon of predictability is passed before the quantity is known: it is then a median with
a range, from the least to the largest of the runs.

Runs of one setting share its errors, which act as one move of all starts does: soon after the horizon they
lie close together, and off the runs of a finer setting. A quarter of the moved starts therefore runs with the
finer setting. The range holds both, and the start as it is with either; where the two samples differ by more
than chance makes them, the headline is called not converged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.convergence import CHANCE, is_shifted
from exunet.results.course import Course
from exunet.results.endings import endings, words_of_endings
from exunet.results.ensemble_result import EnsembleResult, ensemble_result
from exunet.results.headline import Headline
from exunet.results.headlines import headline, headlines_for
from exunet.results.judged import NOT_CONVERGED, Judged
from exunet.results.script_story import THIS_RUN, THIS_RUN_ALONE

Floats = NDArray[np.float64]

COVERING = 32  # runs from which on the range covers most of what other starts give
MOST_ERROR = 0.1  # of a value: with more not even its first digit is known
FEWEST = 8  # runs of which a range is told at all
SCATTER = 3.0  # units of the last digit: of one start with other steps and forms; peaks in Exudyn have 2.3
CONVERGED = "converged"  # in the story of a spread: value and error of headlines, by key
RANGES = "ranges"  # in the story of a spread: least, largest, and is it converged, by key


@dataclass(frozen=True, eq=False)
class Spread:
    """The courses of moved starts, of the unmoved one, and of that with a finer setting.

    courses : of the moved starts
    finer_courses : of further moved starts with a finer setting
    plain   : of the start as it is
    finer   : the same with the finer setting: the converged run
    seed    : of the moves
    move    : by up to which each coordinate is moved [m]
    method, tolerance, step : of the runs, in the compiled loop [m, m/s], [s]; the one that is not so is None
    finer_setting : tolerance or step of the finer ones
    mean_step : of the unmoved run [s], where the method chooses its steps
    run       : that whose spread it is, over its stored times; None: not known
    """

    courses: tuple[Course, ...]
    finer_courses: tuple[Course, ...]
    plain: Course
    finer: Course
    seed: int
    move: float
    method: str
    tolerance: float | None
    step: float | None
    finer_setting: float
    mean_step: float = 0.0
    run: Course | None = None

    @property
    def runs(self) -> int:
        """Number of moved starts."""
        return len(self.moved)

    @property
    def moved(self) -> tuple[Course, ...]:
        """The courses of all moved starts."""
        return (*self.courses, *self.finer_courses)

    @property
    def time(self) -> Floats:
        """(t,) instants of the courses [s]."""
        return self.plain.time

    @cached_property
    def judged(self) -> dict[str, Judged]:
        """The headlines that the runs have, by key."""
        found = [one for each in headlines_for(self.plain) if (one := self._judge(each)) is not None]
        level = CHANCE / max(1, sum(not entry.predictable for entry in found))
        return {item.headline.key: self._compared(item, level) for item in found}

    @property
    def predictable(self) -> bool:
        """True if no headline is beyond the horizon of predictability."""
        return all(item.predictable for item in self.judged.values())

    def as_ensemble(self) -> EnsembleResult:
        """What is kept of it in a file, and drawn."""
        names = ("seed", "move", "method", "tolerance", "step")
        story = {"move_m" if name == "move" else name: getattr(self, name) for name in names}
        known = {key: [one.value, one.error] for key, one in self.judged.items() if one.predictable}
        ranged = {key: one for key, one in self.judged.items() if not one.predictable}
        story[CONVERGED] = known
        story[RANGES] = {key: [one.least, one.largest, one.converged] for key, one in ranged.items()}
        shown = self.run or self.plain
        return ensemble_result(self.moved, complete=True, verdict="ok", provenance=story, shown=shown)

    def words(self) -> str:
        """Which runs these are."""
        setting = f"tolerance {self.tolerance:.3g}" if self.tolerance else f"step {self.step:.4g} s"
        turned = ", rad and rad/s" if self.plain.turning else ""
        finer, unit = self.finer_setting, "" if self.tolerance else " s"
        others = f", {len(self.finer_courses)} of them with {finer:.3g}{unit}" if self.finer_courses else ""
        return (
            f"{self.runs} starts moved by up to {self.move:.2g} m{turned} (seed {self.seed}), {self.method} "
            f"with {setting}{others}, in the compiled loop"
        )

    @cached_property
    def endings(self) -> list[dict[str, Any]]:
        """How the moved starts ended, where a script has ended some; see `exunet.results.endings`."""
        return endings(self.moved)

    def ends(self) -> str:
        """The same in words; "" without."""
        words = words_of_endings(self.endings)
        return f"of {self.runs} moved starts ended {words}" if words else ""

    def verdict(self) -> str:
        """What is beyond the horizon of predictability, and what the ranges are worth."""
        beyond = names_of(item for item in self.judged.values() if not item.predictable)
        if not beyond:
            return "no headline is beyond the horizon of predictability: values with their errors"
        least = (
            f"a range of {self.runs} runs, least to largest" if self.runs < COVERING else "least to largest"
        )
        return f"beyond the horizon of predictability, given as median and range ({least}): {beyond}"

    def unconverged(self) -> str:
        """What is not converged, and what that means; "" if all is."""
        names = names_of(item for item in self.judged.values() if not item.converged)
        if not names:
            return ""
        words = "a finer setting, or another method, changes these by more than a move of the start does"
        advice = "a better solver.accuracy" if self.tolerance else "a smaller solver.step"
        return f"{NOT_CONVERGED} at this accuracy: {names}; {words}: ask for {advice}"

    def _judge(self, one: Headline) -> Judged | None:
        groups = [
            [value for course in courses if (value := one.value(course)) is not None]
            for courses in (self.courses, self.finer_courses)
        ]
        courses, values = self.moved, np.concatenate(groups)
        if not len(values):
            return None
        places: tuple[tuple[int, int], ...] = ()
        if one.place is not None:
            counted = Counter(place for course in courses if (place := one.place(course)) >= 0)
            places = tuple(sorted(counted.items(), key=lambda pair: (-pair[1], pair[0])))
        size = 0.0 if one.size is None else max(one.size(course) for course in (*courses, self.finer))
        least, middle, largest = float(values.min()), float(np.median(values)), float(values.max())
        last = max(one.last_digit(each, size) for each in (least, largest))
        spacing = _spacing(self.time) if one.at_a_time else 0.0
        unmoved = [value for course in (self.plain, self.finer) if (value := one.value(course)) is not None]
        low, high = _extended(one, least, largest, unmoved, last)
        ranged = Judged(
            one, len(values), middle, low, high, None, None, places, size, spacing, of_runs=len(courses)
        )
        converged = one.value(self.finer)
        if converged is None or len(values) < len(courses):
            return ranged
        agreeing = groups[1:] if len(groups[1]) >= FEWEST else groups  # few finer runs show nothing alone
        if max(map(_width, agreeing)) > last:
            return ranged
        error = max(abs(float(value) - converged) for value in (least, largest))
        if error > max(MOST_ERROR * max(abs(converged), size), one.least):
            return replace(ranged, converged=False)  # the setting does what moves do not
        error = _error(one, error, self.plain, self.finer, self.step or self.mean_step)
        return Judged(one, len(values), middle, least, largest, converged, error, places, size)

    def _compared(self, judged: Judged, level: float) -> Judged:
        """The same, not converged if the setting or the run itself tells so; level: chance of no reason."""
        if judged.predictable:
            return judged
        one = judged.headline
        coarse, finer = (
            [value for course in courses if (value := one.value(course)) is not None]
            for courses in (self.courses, self.finer_courses)
        )
        last = max(judged.last_digit(judged.least), judged.last_digit(judged.largest))
        if is_shifted(coarse, finer, last, level):
            judged = replace(judged, converged=False)
        value = None if self.run is None else one.value(self.run)
        if self.run is None or value is None:
            return judged
        # What its stored times alone miss of the start as it is does not count.
        often, seldom = one.value(self.plain), one.value(self.plain.at_times_of(self.run))
        missed = abs(often - seldom) if often is not None and seldom is not None else 0.0
        outside = max(judged.least - value, value - judged.largest) - missed
        if outside <= 0.0:
            return judged
        agrees = outside <= max(judged.largest - judged.least, last)
        low, high = _extended(one, judged.least, judged.largest, [value], last)
        return replace(judged, least=low, largest=high, converged=judged.converged and agrees)


def names_of(those: Iterable[Judged]) -> str:
    """Their names in the table, each once, and the number of those that are in summary.json alone."""
    every = list(those)
    found = dict.fromkeys(
        item.headline.row or item.headline.words for item in every if not item.headline.detail
    )
    details = sum(entry.headline.detail for entry in every)
    return ", ".join([*found, *[f"{details} more in summary.json alone"] * bool(details)])


def _width(values: Sequence[float]) -> float:
    return max(values) - min(values) if values else 0.0


def _extended(
    one: Headline, least: float, largest: float, unmoved: Sequence[float], last: float
) -> tuple[float, float]:
    """A range that holds the start as it is too, with some units of the last digit where that is its end.

    A start that is symmetric keeps its symmetry for long and may lie outside of all moved ones; other runs of
    it, with other steps, lie beside it. Times are known no better than their spacing, as it is.
    """
    margin = 0.0 if one.at_a_time or one.at_a_step else SCATTER * last
    low = min([least, *(value - margin for value in unmoved if value < least)])
    return low, max([largest, *(value + margin for value in unmoved if value > largest)])


def judged_in(spread: EnsembleResult, key: str) -> Judged | None:
    """A headline of a spread that is kept in a file, or of any ensemble: a range unless it tells a value.

    None if no run has it.
    """
    values = spread.headlines.get(key, np.zeros(0))
    values = values[~np.isnan(values)]
    if not len(values):
        return None
    low, middle, high = float(values.min()), float(np.median(values)), float(values.max())
    value, error = spread.provenance.get(CONVERGED, {}).get(key, (None, None))
    low, high, converged = spread.provenance.get(RANGES, {}).get(key, (low, high, True))
    one = headline(key)
    spacing = _spacing(spread.time) if one.at_a_time else 0.0
    return Judged(
        one,
        len(values),
        middle,
        low,
        high,
        value,
        error,
        spacing=spacing,
        converged=converged,
        of_runs=spread.runs,
    )


def _spacing(time: Floats) -> float:
    """Of instants [s]; 0 of a single one, where a script ends runs at once."""
    return float(time[1] - time[0]) if len(time) > 1 else 0.0


def _error(one: Headline, error: float, plain: Course, finer: Course, step: float) -> float:
    """`error` of moved starts, or what the setting or the spacing of the instants does, if that is more.

    step : [s], at the ends of which a peak is seen
    """
    fine, coarse, seldom = (one.value(course) for course in (finer, plain, finer.at_every_second()))
    assert fine is not None
    # Of the three, one has neither the instant of a largest value nor that of its larger neighbour.
    thirds = [one.value(finer.at_every_third(first)) for first in range(3)] if one.of_a_time else []
    for other in (coarse, seldom, *thirds):
        if other is not None:
            error = max(error, abs(other - fine))
    if one.at_a_time:
        error = max(error, 0.5 * _spacing(finer.time))
    if one.at_a_step:
        error = max(error, 0.5 * step)
    return error


def numbers(
    spread: Spread | str | None, this_run: dict[str, float | None], constant: Container[str] = ()
) -> dict[str, Any]:
    """The headlines for summary.json, by key.

    spread   : a reason in words, or None, where there is none
    this_run : of the run itself, over its stored times
    constant : those that have no value because something stays the same
    """
    judged = spread.judged if isinstance(spread, Spread) else {}
    return {
        key: {"this_run": value, **_numbers(judged.get(key))}
        for key, value in this_run.items()
        if value is not None or key in judged or key in constant
    }


def _numbers(one: Judged | None) -> dict[str, float | None]:
    """Of a headline: value and error, or median and range; nothing said twice."""
    found: dict[str, float | None]
    found = dict.fromkeys(("value", "error", "median", "least", "largest", "runs", "converged"))
    if one is None:
        return found
    if one.predictable:
        return {**found, "value": one.value, "error": one.error}
    ranged = {"median": one.median, "least": one.least, "largest": one.largest}
    return {**found, **ranged, "runs": one.runs, "converged": one.converged}


def whose(spread: Spread | str | None) -> str:
    """Whose a number without a spread is: of "this run only", unless no headline is beyond the horizon."""
    known = isinstance(spread, Spread) and spread.predictable
    return THIS_RUN if known else THIS_RUN_ALONE


def description(spread: Spread | str | None) -> dict[str, Any] | None:
    """The spread for summary.json: which runs, or why there is none; None if none was asked for."""
    if not isinstance(spread, Spread):
        return None if spread is None else {"refused": spread}
    peak = spread.judged.get("largest_tension_N")
    return {
        "runs": spread.runs,
        "finer_runs": len(spread.finer_courses),
        "move_m": spread.move,
        "seed": spread.seed,
        "method": spread.method,
        "tolerance": spread.tolerance,
        "step_s": spread.step,
        "endings": spread.endings,
        "predictable": spread.predictable,
        "converged": all(item.converged for item in spread.judged.values()),
        "elements_of_largest_tension": [
            {"element": place, "runs": runs} for place, runs in (peak.places if peak else ())
        ],
    }
