"""Which step the engine's adaptive methods try next: the control's formula, and the way across a jump."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exunet.forces.cable_term import Jump
from exunet.integrators.compiled.steps import TINY_IN_A_ROW
from exunet.integrators.exudyn.step_control import StepChoice
from exunet.integrators.protocol import StepsCollapsed
from exunet.methods.method import Method


def choice(attempt: float = 0.01, error: float = 1.0, jumps: list[Jump | None] | None = None) -> Any:
    """The control of DOPRI5, after a step from 1 s that was tried with `attempt` and had an error estimate.

    jumps : what a search for the next jump finds, one after the other
    """
    progress = SimpleNamespace(
        currentTime=1.0,
        currentStepSize=attempt,
        automaticStepSizeError=error,
        minStepSize=1e-4,
        maxStepSize=0.05,
        initialStepSize=0.0,
    )
    integration = SimpleNamespace(stepSizeMaxIncrease=2.0, stepSizeSafety=0.9, absoluteTolerance=1e-6)
    left = None if jumps is None else iter(jumps)
    found = StepChoice(
        SimpleNamespace(  # type: ignore[arg-type]
            method=Method.DOPRI5, tolerance=1e-6, first_step=0.005, least_step=1e-5
        ),
        SimpleNamespace(it=progress),
        SimpleNamespace(timeIntegration=integration),
        None if left is None else lambda within: next(left),
    )
    found.attempted()
    found.begin_stretch(2.0)
    return found, progress, integration


@pytest.mark.parametrize(
    ("attempt", "error", "step"),
    [
        (0.01, 32.0, 0.9 * 0.01 / 2.0),  # error^(-1/5), times the safety
        (0.01, 1.0, 0.9 * 0.01),
        (0.01, 0.5, 0.9 * 0.01 * 2.0**0.2),
        (0.01, 1e-3, 0.02),  # not more than twice the step
        (0.01, 0.0, 0.02),
        (0.04, 1e-3, 0.05),  # nor than the longest
        (0.01, 1e15, 1e-4),  # nor less than the least
    ],
)
def test_the_next_stretch_begins_with_the_step_of_the_engines_own_control(
    attempt: float, error: float, step: float
) -> None:
    found, _, _ = choice(attempt, error)
    assert found.numbers() == pytest.approx([1.0, 0.005])  # before the first stretch ends: the plan's
    found.end_stretch(1.5)
    assert found.numbers() == pytest.approx([1.5, step], rel=1e-14)
    again, progress, _ = choice()
    again.restore(found.numbers())
    assert np.array_equal(again.numbers(), found.numbers())
    assert [progress.currentTime, progress.initialStepSize] == found.numbers().tolist()


def test_steps_end_with_the_stretch_and_lengthen_again_after_one_that_was_cut_short() -> None:
    found, progress, _ = choice(0.01, 0.5)
    assert found.choose(1.01, True, False) == 1.0  # left as the engine has chosen it
    assert progress.currentStepSize == 0.01
    found.accepted(1.995)
    assert found.choose(2.0, True, False) == 2.0
    assert progress.currentStepSize == pytest.approx(0.005, rel=1e-12)
    found.begin_stretch(3.0)
    progress.currentStepSize = 0.003
    found.begin_stretch(2.1)
    found.choose(2.1, True, False)  # cut by the engine: the control's own step is put back
    assert progress.currentStepSize == pytest.approx(0.9 * 0.01 * 2.0**0.2, rel=1e-14)


def test_a_stretch_of_next_to_nothing_does_not_tell_how_the_next_one_begins() -> None:
    found, progress, _ = choice(1e-13, 1e-3)
    progress.currentStepSize = 2e-13  # what the engine goes on with
    assert found.choose(1.0 + 2e-13, False, False) == 1.0 + 1e-5
    assert progress.currentStepSize == 1e-5  # the least of the plan
    progress.currentStepSize = 2e-13
    found.choose(1.0 + 2e-13, True, True)  # what the control itself has come to, it keeps
    assert progress.currentStepSize == 2e-13


def test_a_jump_is_approached_crossed_with_a_lifted_tolerance_and_left_with_the_step_of_before() -> None:
    far, near = Jump(0.004, 8.0, 1e-5), Jump(2e-6, 8.0, 1e-5)
    found, progress, integration = choice(0.01, 40.0, [far, near, None])
    found.choose(1.004, True, True)  # rejected: to just before the jump
    assert progress.currentStepSize == pytest.approx(0.004 - 0.01 * 0.004, rel=1e-14)
    assert integration.absoluteTolerance == 1e-6
    found.choose(1.004, True, False)  # across it, with the error that this costs
    assert progress.currentStepSize == pytest.approx(1.2e-5, rel=1e-14)
    assert integration.absoluteTolerance == pytest.approx(8.0 * 1.2e-5, rel=1e-14)
    found.choose(1.004, True, False)  # none ahead: the step that had been tried before
    assert progress.currentStepSize == 0.01
    assert integration.absoluteTolerance == 1e-6


def test_a_jump_that_comes_sooner_than_foreseen_is_left_to_the_control() -> None:
    found, progress, _ = choice(0.01, 40.0, [Jump(0.004, 8.0, 1e-5)] * 2)
    found.choose(1.004, True, True)
    progress.currentStepSize = 0.001
    found.choose(1.001, True, True)
    assert progress.currentStepSize == 0.001
    progress.currentStepSize = 0.0015
    found.choose(1.0025, True, False)  # nor is it looked for again before a step is rejected
    assert progress.currentStepSize == 0.0015


def test_steps_that_are_no_longer_than_four_of_the_least_collapse_in_a_row() -> None:
    """One that is longer, or a new stretch, ends the row."""
    found, progress, _ = choice()
    least, tiny = 1e-5, int(TINY_IN_A_ROW)
    for size, number in ((4.0 * least, tiny), (4.1 * least, 1), (least, tiny)):
        progress.currentStepSize = size
        for _ in range(number):
            found.refuse_collapse(1.5)
    found.begin_stretch(2.0)
    for _ in range(tiny):
        found.refuse_collapse(1.5)
    with pytest.raises(StepsCollapsed, match=r"to 1e-05 s at t = 1\.5 s: the tolerance 1e-06 cannot be met"):
        found.refuse_collapse(1.5)
