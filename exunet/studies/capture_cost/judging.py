"""What is to be known of a capture, and whether a setting moves it by more than moved starts do.

A capture is chaotic soon after the first contact: two runs of it differ, however fine both are. What can be
right is a distribution over moved starts. The bias of a setting is the difference of its median from that of
the finest one; it matters where it is a third of the range of the finest runs or more, and more than the
digits that are printed. Where nothing is spread, as before the horizon of predictability, these digits alone
are asked for. A bias that is not told apart from what moved starts do alone decides nothing: with more of
them it may be seen, or vanish.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.results.body_headlines import gained_by, given_by
from exunet.results.capture_headlines import bodies_with_contacts, first_contact, of_contact, outcome
from exunet.results.convergence import CHANCE, PART, around_one_more, is_shifted, rank_test, shift_of
from exunet.results.course import Course
from exunet.results.headline import Headline
from exunet.results.headlines import headline
from exunet.results.verdict import Outcome

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Bias:
    """A quantity with a setting, beside the finest.

    median, least, largest : of the moved starts; of a form that runs once its value
    runs    : how many of them have the quantity
    bias    : difference of the median from that of the finest; None: the finest has none
    low, high : its 90 % interval; nan where it is of one run
    range   : of the finest, largest less least
    allowed : up to which a bias does not matter
    told_apart : False where moved starts alone may make this difference
    """

    quantity: Headline
    median: float
    least: float
    largest: float
    runs: int
    bias: float | None = None
    low: float = float("nan")
    high: float = float("nan")
    range: float = 0.0
    allowed: float = 0.0
    told_apart: bool = False

    @property
    def matters(self) -> bool:
        """True if the bias is not below what is allowed."""
        return self.bias is not None and abs(self.bias) >= self.allowed

    @property
    def shown(self) -> bool:
        """True if moved starts are enough to show that it is: the whole interval lies below."""
        return max(abs(self.low), abs(self.high)) < self.allowed


@dataclass(frozen=True)
class Verdicts:
    """What became of the target in the moved starts, and whether that is so with the finest setting.

    counts : how often each, the most frequent first
    same   : the most frequent is that of the finest, and its share is not told apart
    """

    counts: dict[str, int]
    same: bool

    @property
    def words(self) -> str:
        """Each with its number, of all."""
        runs = sum(self.counts.values())
        return ", ".join(f"{name} {number}" for name, number in self.counts.items()) + f" of {runs}"


def targets_of(course: Course) -> tuple[str, ...]:
    """The body that is to be captured; without [verdict] all that may be touched."""
    return bodies_with_contacts(course) if course.rule is None else (course.rule.target,)


def quantities_of(course: Course) -> tuple[Headline, ...]:
    """What is judged of a scene: momentum and first contact of each target, capture time and indices."""
    found: list[Headline] = []
    for body in targets_of(course):
        found += [_momentum(body), of_contact(body)[0]]
    if course.rule is not None:
        found += [headline(key) for key in ("capture_time_s", "capture_cqi", "capture_mcqi")]
    return tuple(found)


def _momentum(body: str) -> Headline:
    """Size of the momentum that a body got from all that acts on it; of given motion: that it took."""

    def value(course: Course) -> float | None:
        of_body = given_by if body in course.guided else gained_by
        parts = [value for one in of_body(body)[:3] if (value := one.value(course)) is not None]
        return float(np.linalg.norm(parts)) if len(parts) == 3 else None

    return Headline(f"momentum_{body}", f"momentum that {body} got", "N s", value, least=1e-8)


def verdict_of(course: Course) -> str:
    """What became of the target; without [verdict] whether anything was touched."""
    found = outcome(course)
    if found is not None:
        return found.outcome.value
    touched = any(first_contact(course, body) is not None for body in bodies_with_contacts(course))
    return (Outcome.TOUCHED if touched else Outcome.MISSED).value


def verdicts(courses: Sequence[Course], finest: Sequence[Course], settings: int = 1) -> Verdicts:
    """Of the runs of a setting.

    finest   : those that they are compared with, none of the finest itself
    settings : how many are compared with these
    """
    names, others = ([verdict_of(one) for one in some] for some in (courses, finest))
    counts = dict(Counter(names).most_common())
    if not others:
        return Verdicts(counts, same=True)
    expected = Counter(others).most_common(1)[0][0]
    if next(iter(counts)) != expected:
        return Verdicts(counts, same=len(names) == 1 and names[0] in others)
    shares = ([float(name == expected) for name in some] for some in (names, others))
    return Verdicts(counts, same=rank_test(*shares) >= CHANCE / settings)


def biases(
    courses: Sequence[Course], finest: Sequence[Course], step: float, settings: int = 1
) -> tuple[Bias, ...]:
    """Each quantity of the runs of a setting, which have it.

    finest : runs that they are compared with; of the finest setting itself none
    step   : of the setting [s]; 0: not known
    settings : how many are compared with these; CHANCE: that any of them is told apart which does nothing
    """
    found = []
    quantities = quantities_of(courses[0])
    for one in quantities:
        values, others = _values(one, courses), _values(one, finest)
        if len(values):
            resolved = _resolved(one, courses[0], step)
            level = CHANCE / (settings * len(quantities))
            found.append(_bias(one, values, others, resolved, level))
    return tuple(found)


def _values(one: Headline, courses: Sequence[Course]) -> Floats:
    return np.array([value for course in courses if (value := one.value(course)) is not None])


def _resolved(one: Headline, course: Course, step: float) -> float:
    """To which the instants or the steps tell a time."""
    if one.at_a_time:
        return float(np.diff(course.time).max())
    return step if one.at_a_step else 0.0


def _bias(one: Headline, values: Floats, finest: Floats, resolved: float, level: float) -> Bias:
    median, least, largest = (float(number(values)) for number in (np.median, np.min, np.max))
    own = Bias(one, median, least, largest, len(values))
    if not len(finest):
        return own
    width, bias = float(np.ptp(finest)), median - float(np.median(finest))
    last = max(resolved, one.last_digit(float(np.median(finest))))
    allowed = max(PART * width, last)
    if len(values) == 1:  # one more run, or not
        around = float(around_one_more(finest)) if len(finest) > 1 else float("inf")
        apart = abs(median - float(finest.mean())) > max(last, around)
        return Bias(one, median, least, largest, 1, bias, range=width, allowed=allowed, told_apart=apart)
    shift = shift_of(finest, values, one.least)
    low, high = (bias, bias) if shift is None else (shift.low * width, shift.high * width)
    apart = abs(bias) > last and is_shifted(values.tolist(), finest.tolist(), last, level)
    return Bias(one, median, least, largest, len(values), bias, low, high, width, allowed, told_apart=apart)
