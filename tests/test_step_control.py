"""Which steps the compiled control tries, by hand: errors and jumps are given, as plain Python."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import no_table
from seen_elements import seen_of

from exunet.integrators.compiled import steps
from exunet.integrators.compiled.loop import CompiledLoop
from exunet.integrators.compiled.workspace import Kept, Run, StepLimits, clock_at, motion_at, no_samples

TOLERANCE, LONGEST, LEAST = 1e-3, 0.5, 2.0**-10
LIMITS = StepLimits(TOLERANCE, LONGEST, LEAST)
NONE = (math.inf, math.inf)


class Control:
    """A control whose attempts have errors of so many tolerances, and whose looks for jumps find these."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        errors: Sequence[float],
        jumps: Sequence[tuple[float, float]] = (),
        step: float = 0.1,
    ) -> None:
        self.tried: list[float] = []
        self.looked: list[float] = []
        left, ahead = iter(errors), iter(jumps)

        def attempt(t: float, h: float, m: Any) -> tuple[float, float]:
            self.tried.append(h)
            steps.stages_of(m.work).x1[0] = m.x[0] + h
            steps.stages_of(m.work).a7[0] = t
            return next(left) * TOLERANCE, t

        def jump_ahead(within: float, tolerance: float, t: float, m: Any, seen: Any) -> tuple[float, float]:
            assert tolerance == TOLERANCE
            self.looked.append(within)
            return next(ahead)

        monkeypatch.setattr(steps, "dormand_prince_step", attempt)
        monkeypatch.setattr(steps, "jump_ahead", jump_ahead)
        monkeypatch.setattr(steps, "borrowed", lambda value: value, raising=False)
        monkeypatch.setattr(steps, "BODIES", False, raising=False)
        monkeypatch.setattr(steps, "remember", lambda *state: None, raising=False)
        motion = motion_at(np.zeros(1), np.zeros(1), np.ones(1), no_table(), np.zeros((0, 3)), 1)
        seen = seen_of(np.zeros((0, 2), dtype=int), half=np.ones(1), look_above=np.inf)
        self.kept = Kept(np.zeros(50), np.zeros((50, 1)), np.zeros((50, 1)), np.zeros(50))
        self.clock = clock_at(0.0, step)
        self.run = Run(motion, self.clock, seen, self.kept, no_samples())

    def go(self, until: float = 100.0, attempts: int = 1, every: int = 1) -> int:
        return steps.chosen_steps(LIMITS, until, attempts, 0, every, self.run)

    def at(self, name: str) -> float:
        return float(self.clock[name][0])


SHRUNK = 0.9 / 2.0  # after an error of 32 tolerances
TRIED: dict[str, tuple[float, list[float], list[float]]] = {
    # first step, errors; the steps that are tried, and what comes after them
    "at most twice as long": (0.1, [0.0, 1e-9], [0.1, 0.2, 0.4]),
    "by the fifth root": (0.1, [1.0, 2.0**-5], [0.1, 0.09, 0.09 * 1.8]),
    "no longer than the longest": (0.4, [0.0, 0.0], [0.4, 0.5, 0.5]),
    "rejected": (0.1, [32.0, 1.0], [0.1, 0.1 * SHRUNK, 0.1 * SHRUNK * 0.9]),
    "not longer at once": (0.1, [32.0, 0.0, 0.0], [0.1, 0.045, 0.045, 0.09]),
    "rejected twice": (0.1, [32.0, 32.0, 0.0], [0.1, 0.045, 0.045 * SHRUNK, 0.045 * SHRUNK]),
    "at most a fifth": (0.1, [1e9, 0.0], [0.1, 0.02, 0.02]),
    "beyond numbers": (0.1, [math.inf, 0.0], [0.1, 0.02, 0.02]),
    "not a number": (0.1, [math.nan, 0.0], [0.1, 0.02, 0.02]),
    "just the tolerance": (0.1, [1.0], [0.1, 0.09]),
    "no less than the least": (2.0 * LEAST, [1e9, 1e9, 0.0], [2.0 * LEAST, LEAST, LEAST, 2.0 * LEAST]),
}


@pytest.mark.parametrize("name", TRIED)
def test_steps_follow_from_errors(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first, errors, steps = TRIED[name]
    control = Control(monkeypatch, errors, [NONE] * 9, first)
    control.go(attempts=len(errors))
    follows = min(control.at("step"), LONGEST)
    assert [*control.tried, follows] == pytest.approx(steps, rel=1e-12)
    taken = [h for h, error in zip(steps, errors, strict=False) if error <= 1.0 or h <= LEAST]
    assert control.at("time") == pytest.approx(sum(taken), rel=1e-12)
    assert (control.at("steps"), control.at("rejections")) == (len(taken), len(errors) - len(taken))
    assert control.run.motion.x[0] == pytest.approx(sum(taken), rel=1e-12)


ENDS: dict[str, tuple[float, float, list[float], float]] = {
    # first step, end, the steps to it with errors of the tolerance / 2, and the step that is kept for later
    "cut short": (0.3, 0.1, [0.1], 0.3),
    "as long": (0.25, 0.25, [0.25], 0.25 * 0.9 * 2.0**0.2),
    "all but as long": (0.25, 0.25 * (1.0 + 5e-8), [0.25 * (1.0 + 5e-8)], 0.25 * 0.9 * 2.0**0.2),
    "a little longer": (0.25, 0.25 * (1.0 + 2e-7), [0.125 * (1.0 + 2e-7)] * 2, 0.25),
    "two of equal length": (0.3, 0.5, [0.25, 0.25], 0.3),
    "twice as long": (0.25, 0.5, [0.25, 0.25], 0.25 * 0.9 * 2.0**0.2),
}


@pytest.mark.parametrize("name", ENDS)
def test_the_last_steps_end_where_they_must(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first, until, steps, later = ENDS[name]
    control = Control(monkeypatch, [0.5] * 9, step=first)
    rows = control.go(until, attempts=9, every=100)
    assert control.tried == pytest.approx(steps, rel=1e-12)
    assert control.at("time") == until
    assert control.at("step") == pytest.approx(later, rel=1e-6)
    assert (rows, control.kept.time[0]) == (1, until)


def test_a_step_that_was_cut_short_and_errs_is_not_lengthened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the least length, it is taken whatever its error; the step before it was not for such an error."""
    control = Control(monkeypatch, [3.0], step=0.3)
    control.go(0.5 * LEAST)
    assert control.tried == [0.5 * LEAST]
    assert control.at("step") == LEAST


def test_rows_are_kept_as_often_as_asked_and_where_much_is_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in three, the last, and those that hold more than the bound: here what is held is the time."""
    control = Control(monkeypatch, [0.9**5] * 9)
    control.run.seen.peaks["keep_above"] = 0.5
    rows = control.go(0.75, attempts=20, every=3)
    ends = np.cumsum(control.tried)
    begins = ends - control.tried
    number = np.arange(1, len(ends) + 1)
    known = ends[(number % 3 == 0) | (begins > 0.5) | (ends >= 0.75)]
    assert 3 < rows < len(ends)
    np.testing.assert_allclose(control.kept.time[:rows], known, rtol=1e-12)
    assert control.run.motion.work[0, 0] == begins[-1]  # the next step's first acceleration


def test_steps_of_the_least_length_in_a_row_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to four times as long; one that is longer ends the row, and one that is no number all."""
    control = Control(monkeypatch, [1.0, 0.0, 0.0, 0.0, 1e9, 1e9], step=4.0 * LEAST)
    counts = []
    for _ in range(3):
        control.go()
        counts.append(control.at("tiny"))
    assert control.tried == pytest.approx(LEAST * np.array([4.0, 3.6, 7.2]), rel=1e-12)
    assert counts == [1.0, 2.0, 0.0]
    control = Control(monkeypatch, [2.0, 2.0, math.inf], [NONE], step=LEAST)
    for known in (1.0, 2.0, math.inf):
        control.go()
        assert control.at("tiny") == known
    assert (control.at("steps"), control.at("rejections")) == (2, 1)


# Jumps of the forces, of which steps end just before one, and one goes across. A step of 0.1 s is rejected at
# first, with an error of 32 tolerances, after which 0.045 s would be tried.
FAR, NEAR = (0.03, 0.001), (0.0005, 0.001)
JUMPS: dict[str, tuple[list[float], list[tuple[float, float]], list[float], list[float]]] = {
    # errors, what looks find; the steps that are tried, and within what time is looked
    "none": ([32.0, 1.0], [NONE], [0.1, 0.045], [0.1]),
    "to it, across and on": (
        [32.0, 1.0, 1e9, 1.0, 1.0],
        [FAR, FAR, NEAR, NONE],
        [0.1, 0.0295, 0.0015, 0.1, 0.09],
        [0.1, 0.1, 0.1, 0.1],
    ),
    "by a hundredth of the way": ([32.0, 1.0], [(0.05, 1e-5)] * 2, [0.1, 0.05 - 5e-4], [0.1, 0.1]),
    "just as near": ([32.0, 1e9], [FAR, (0.001, 0.001)], [0.1, 0.002], [0.1, 0.1]),
    "the way is too long": (
        [32.0, 32.0, 1.0, 1.0],
        [FAR, FAR, FAR],
        [0.1, 0.0295, 0.0295 * 0.45, 0.0295 * 0.45 * 0.9],
        [0.1, 0.1, 0.1],
    ),
    "gone when looked at again": ([32.0, 1.0, 1.0], [FAR, NONE], [0.1, 0.045, 0.0405], [0.1, 0.1]),
    "across is no number": (
        [32.0, math.inf, 1.0],
        [NEAR, NEAR, FAR],
        [0.1, 0.0015, LEAST],
        [0.1, 0.1, 0.1],
    ),
}


@pytest.mark.parametrize("name", JUMPS)
def test_jumps_are_approached_and_crossed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    errors, jumps, steps, looks = JUMPS[name]
    control = Control(monkeypatch, errors, jumps)
    control.go(attempts=len(errors))
    assert control.tried == pytest.approx(steps, rel=1e-12)
    assert control.looked == pytest.approx(looks, rel=1e-12)
    if name == "to it, across and on":
        assert control.at("time") == pytest.approx(0.0295 + 0.0015 + 0.19, rel=1e-12)
        assert (control.at("beyond"), control.at("towards")) == (0.0, 0.0)


def test_a_step_across_a_jump_is_not_counted_among_the_least(monkeypatch: pytest.MonkeyPatch) -> None:
    across = (LEAST, LEAST)
    control = Control(monkeypatch, [32.0, 1.0, 1.0], [across, across, NONE])
    control.go(attempts=2)
    assert control.tried == pytest.approx([0.1, 2.0 * LEAST])
    assert control.at("tiny") == 0.0


@pytest.mark.parametrize(("most", "attempts"), [(999, 1000), (1000, 2000), (1500, 2000)])
def test_attempts_come_to_an_end(most: int, attempts: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are counted a thousand at a time, rejected ones too."""
    control = Control(monkeypatch, [32.0, 0.0, 0.0, 0.0] * 1000, [NONE] * 1000)
    times = np.array([0.0, 1e9])
    assert steps.through_chosen(times, LIMITS, 10.0, most, control.run) == 1
    assert len(control.tried) == attempts
    assert (control.at("steps"), control.at("rejections")) == (0.75 * attempts, 0.25 * attempts)


def test_a_collapse_ends_them_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once more of the least length came in a row than may; a thousand are tried before that is looked at."""
    control = Control(monkeypatch, [2.0] * 3000, step=LEAST)
    times = np.array([0.0, 1e9])
    assert steps.through_chosen(times, LIMITS, 1000.0, 10**9, control.run) == 1
    assert len(control.tried) == 2000
    control = Control(monkeypatch, [2.0] * 3000, step=LEAST)
    assert steps.through_chosen(times, LIMITS, 999.0, 10**9, control.run) == 1
    assert len(control.tried) == 1000


@pytest.mark.parametrize(
    ("step", "beyond", "longest", "until", "tried"),
    [
        (0.1, 0.0, 0.5, 9.0, 0.1),
        (0.1, 0.3, 0.5, 9.0, 0.3),  # on the way to a jump that counts with which the control goes on
        (0.7, 0.0, 0.5, 9.0, 0.5),
        (0.1, 0.3, 0.5, 1.05, 0.05),
    ],
)
@pytest.mark.parametrize("within", [0.02, 9.0])
def test_the_step_before_an_event_ends_near_it(
    step: float, beyond: float, longest: float, until: float, tried: float, within: float
) -> None:
    """Not shorter than eight times the least: such a step does not count among those that collapse."""
    asked, clock = [], clock_at(1.0, step)
    clock["beyond"] = beyond

    def step_within(own: float, least: float, x: Any, v: Any) -> float:
        asked.append((own, least, x, v))
        return min(own, within)

    loop: Any = SimpleNamespace(
        _clock=clock, time=1.0, _motion=SimpleNamespace(x="x", v="v"),
        _plan=SimpleNamespace(longest_step=longest, least_step=LEAST),
        _events=SimpleNamespace(step_within=step_within),
    )  # fmt: skip
    CompiledLoop._shorten(loop, until)
    assert asked == [(pytest.approx(tried), 8.0 * LEAST, "x", "v")]
    short = within < tried
    assert clock["step"][0] == (within if short else step)
    assert clock["beyond"][0] == (min(beyond, within) if short else beyond)
