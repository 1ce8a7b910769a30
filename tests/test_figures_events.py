"""Texts of events in figures: side by side, each joined to its own line."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.text import Annotation
from test_script import FALL, case_of, entry

import exunet
from exunet.figures.events import apart


def test_places_are_moved_apart_as_little_as_can_be() -> None:
    """By hand: two at 0.5 and 0.52 go 0.04 to either side of their mean, one far away stays."""
    np.testing.assert_allclose(apart(np.array([0.2, 0.5, 0.52]), 0.1), [0.2, 0.46, 0.56], atol=1e-15)
    np.testing.assert_allclose(apart(np.array([0.0, 0.0, 1.0]), 0.1), [0.1, 0.2, 1.0], atol=1e-15)
    np.testing.assert_allclose(apart(np.full(4, 0.5), 0.3), [0.25, 0.5, 0.75, 1.0], atol=1e-15)
    assert apart(np.zeros(0), 0.1).size == 0


@pytest.mark.parametrize("size", [(170.0, 90.0), (85.0, 70.0)])
def test_each_text_is_joined_to_its_line_and_hides_no_other(size: tuple[float, float]) -> None:
    """Six entries, one of them twice; four within 12 ms in a second, less than a text is wide."""
    script = (
        entry("first", at=0.300, do="note")
        + entry("second", at=0.304, do="note")
        + entry("third", after="second", delay=0.004, do="note")
        + entry("often", when="range > 1.5", repeat=True, do="note")
        + entry("fourth", at=0.312, do="note")
        + entry("last", at=0.9, do="note")
    )
    result = exunet.run(case_of(script, scene=FALL))
    figure = exunet.figure(result, "energies", size=size)
    top = figure.axes[0]
    low, high = top.get_xlim()
    texts = [one for one in top.texts if isinstance(one, Annotation)]
    figure.draw_without_rendering()
    times = {"often": 0.0, "first": 0.3, "second": 0.304, "third": 0.308, "fourth": 0.312, "last": 0.9}
    assert [one.get_text().partition(":")[0].partition(",")[0] for one in texts] == list(times)
    cause = ": range > 1.5" if size[0] > 100.0 else ""  # where there is room for it
    assert texts[0].get_text() == f"often{cause}, 2 times"
    for one, time in zip(texts, times.values(), strict=True):
        assert low + one.xy[0] * (high - low) == pytest.approx(time, abs=1e-9)
        assert one.arrow_patch is not None
        assert one.get_zorder() > max(curve.get_zorder() for curve in top.lines)  # none crosses it
    for left, right in pairwise(texts):
        boxes = [one.get_bbox_patch().get_window_extent() for one in (left, right)]
        assert boxes[0].x1 <= boxes[1].x0 + 0.5  # pixels
