"""Shipped cases of captures: what their heads say that comes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.results.capture_headlines import first_contact, told
from exunet.results.course import course_of
from exunet.results.measures import energy_balance, momentum_books
from exunet.results.passages import passages
from exunet.results.touching import touching_threads

CASES = Path(__file__).parents[2] / "cases" / "capture"

pytestmark = pytest.mark.slow  # kernels, compiled in a minute each


@pytest.mark.parametrize(
    ("name", "enclosed", "together"),
    [
        ("free_sphere", 0.34, 0.94),
        ("fixed_sphere", 0.33, 0.94),
        ("box", 0.32, 0.96),
        ("rocket", 0.38, 0.93),
        ("satellite", 1.2, 6.1),
        ("cubesat", 1.4, 2.54),
        ("cylinder", 0.95, 4.0),
        ("l_shape", 0.33, 0.93),
    ],
)
def test_a_net_that_nothing_closes_lets_go(name: str, enclosed: float, together: float) -> None:
    """When the target is enclosed [s], and when net and target are slowest against each other."""
    case = exunet.load(CASES / f"{name}.toml", ["engine.loop=compiled"])
    result, apart = exunet.run(case), case.scene.time.output_step
    assert apart is not None
    course = course_of(result)
    found = told(course)
    assert found is not None
    assert course.capture is not None
    assert (found["outcome"], found["since_s"]) == ("escaped" if name == "l_shape" else "touched", None)
    assert result.time[np.argmax(course.capture.enclosed >= 0.9)] == pytest.approx(enclosed, abs=1.1 * apart)
    slowest = int(course.capture.relative_speed.argmin())
    assert result.time[slowest] == pytest.approx(together, abs=3.1 * apart)
    assert course.rule is not None
    assert course.rule.relative_speed is not None
    assert course.capture.relative_speed[slowest] < course.rule.relative_speed
    # Momentum is kept to round-off, angular momentum by the method.
    books = momentum_books(result)
    assert books["linear"].residual < 1e-10 * books["linear"].size
    assert books["angular"].residual < 1e-8 * books["angular"].size
    assert energy_balance(result) < 1e-3
    assert passages(result, but=[found["target"]]) == []
    # What a moving picture marks is as many as contact has counted.
    counted = np.asarray(result.states[f"contact_{found['target']}/threads_touching"].values[:, 0])
    assert [touching_threads(result, k).sum() for k in range(0, len(counted), 7)] == counted[::7].tolist()


def test_a_net_that_flies_past_misses() -> None:
    course = course_of(exunet.run(exunet.load(CASES / "miss.toml", ["engine.loop=compiled"])))
    found = told(course)
    assert found is not None
    assert found["outcome"] == "missed"
    assert first_contact(course, "ball") is None
