"""Shipped cases of missions: what their heads say that comes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exunet
from exunet.results.capture_headlines import told
from exunet.results.course import course_of
from exunet.results.measures import energy_balance, momentum_books

CASES = Path(__file__).parents[2] / "cases" / "missions"

pytestmark = pytest.mark.slow  # kernels, compiled in a minute each


@pytest.mark.parametrize(
    ("name", "outcome", "mouth"), [("closed_box", "captured", 0.3), ("open_box", "touched", 1.41)]
)
def test_a_net_captures_if_it_is_closed(name: str, outcome: str, mouth: float) -> None:
    """mouth : its largest diameter from 1.6 s on [m], when the line is locked; 1.4 m of the open one."""
    result = exunet.run(exunet.load(CASES / f"{name}.toml", ["engine.loop=compiled"]))
    course = course_of(result)
    found = told(course)
    assert found is not None
    assert course.capture is not None
    assert found["outcome"] == outcome
    widest = course.capture.mouth[result.time >= 1.6].max()
    assert widest < mouth
    assert (widest < 0.3) == (outcome == "captured")
    books = momentum_books(result)
    assert books["linear"].residual < 1e-10 * books["linear"].size
    assert books["angular"].residual < 1e-6 * books["angular"].size
    assert energy_balance(result) < 1e-3
    if outcome == "captured":
        way = np.asarray(result.states["closing/way"].values[:])[:, 0]
        assert way[result.time >= 1.6].max() < 0.6  # of 0.58 m at least that the winch leaves
