"""Shipped cases of captures: what their heads say that comes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.results.capture_headlines import told
from exunet.results.course import course_of
from exunet.results.measures import energy_balance, momentum_books
from exunet.results.passages import passages

CASES = Path(__file__).parents[2] / "cases" / "capture"

pytestmark = [pytest.mark.slow, pytest.mark.ci]  # a kernel, compiled in a minute


def test_a_net_that_nothing_closes_lets_go_of_a_ball() -> None:
    result = exunet.run(exunet.load(CASES / "free_sphere.toml", ["engine.loop=compiled"]))
    course = course_of(result)
    found = told(course)
    assert found is not None
    assert course.capture is not None
    assert (found["outcome"], found["since_s"]) == ("touched", None)
    assert result.time[np.argmax(course.capture.enclosed > 0.9)] == pytest.approx(0.34, abs=0.011)
    slow = result.time[course.capture.relative_speed < 0.2]
    assert 0.9 < slow.min() < slow.max() < 1.0
    # Momentum and angular momentum are kept to round-off, angular momentum by the method; energy to 1e-3.
    books = momentum_books(result)
    assert books["linear"].residual < 1e-10 * books["linear"].size
    assert books["angular"].residual < 1e-8 * books["angular"].size
    assert energy_balance(result) < 1e-3
    assert passages(result, but=["ball"]) == []
