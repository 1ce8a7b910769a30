"""Quantities over time: declared once, filled in by results and by moved starts alike, thinned together."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import get_type_hints

import numpy as np
import pytest
from scenes import thrown

import exunet
from exunet.results.course import Course, course_of
from exunet.results.over_time import OVER_TIME, Floats, Ints, OverTime
from exunet.simulation.preparation import prepare
from exunet.studies.ensemble import run_ensemble

END, STEP = 0.05, 0.005  # [s], before the first snap at 0.1 s
BODY = {
    "body": {
        "mass": 2.0,
        "inertia": [0.2, 0.3, 0.4],
        "velocity": [0.0, 0.0, 1.0],
        "angular_velocity": [0.1, 2.0, 0.3],
    },
    "held": {"mass": 1.0, "inertia": [0.2, 0.3, 0.4], "position": [0.0, 0.0, 5.0], "motion": "fixed"},
}
CLOSING = {"kind": "perimeter", "at": 0.01, "rate": 0.5, "part": 0.99}  # until 0.03 s
GRAVITY = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}


@pytest.fixture(scope="module")
def both() -> tuple[Course, Course]:
    """Of a result, and of a run of an ensemble from the same start through the same times."""
    scene = thrown({}, end=END, engine={"backend": "compiled"}, bodies=BODY, effects=GRAVITY, closing=CLOSING)
    start = prepare(scene)
    many = run_ensemble(start, start.position[None], together=False)
    return course_of(exunet.run(scene)), many.course(0, 4.0)


@pytest.mark.parametrize("name", OVER_TIME)
def test_results_and_moved_starts_give_the_same(both: tuple[Course, Course], name: str) -> None:
    """The same steps, so the same numbers but for round-off; a net of some metres, some joules."""
    of_result, of_ensemble = (np.asarray(getattr(item, name)[:]) for item in both)
    where = f"{name} of `course_of` and of `measured` (exunet/studies/measured.py)"
    assert len(of_result) == 1 + round(END / STEP), f"{where}: has no row for each time"
    assert of_result.shape == of_ensemble.shape, where
    np.testing.assert_allclose(of_ensemble, of_result, rtol=1e-9, atol=1e-9, err_msg=where)


def test_what_closes_the_mouth_is_of_scenes_that_have_it(both: tuple[Course, Course]) -> None:
    """The edge loses a hundredth of its length; a mouth that nothing closes is not looked at."""
    for course in both:
        assert (course.mouth.shape, course.spin.shape) == ((11, 1), (11, 2, 3))
        assert course.edge[[0, -1], 0].tolist() == pytest.approx([1.0, 0.99], abs=1e-12)
    of = course_of(exunet.run(thrown({}, end=0.01, engine={"backend": "compiled"})))
    assert of.mouth.shape == of.edge.shape == (3, 0)


def test_all_of_them_are_thinned(both: tuple[Course, Course]) -> None:
    for course in both:
        thinned = course.at_every_second()
        assert len(thinned.time) == 6  # of 11
        for name in OVER_TIME:
            assert np.array_equal(getattr(thinned, name), getattr(course, name)[::2]), name


def test_what_is_not_filled_in_is_an_error_at_once() -> None:
    """A default would leave it empty in results, or in moved starts, without a word."""
    given = [
        field.name
        for field in fields(OverTime)
        if (field.default, field.default_factory) != (MISSING, MISSING)
    ]
    assert not given, f"{given} of exunet/results/over_time.py: no quantity over time has a default"


def test_a_course_has_no_quantity_over_time_beside_them() -> None:
    """It would not be thinned, and lack in moved starts. Mappings by name are of contact and closing."""
    declared = {field.name for field in fields(OverTime)}
    kinds = get_type_hints(Course)
    own = {item.name for item in fields(Course) if item.name not in declared}
    beside = {name for name in own if kinds[name] in (Floats, Ints)} - {"time"}
    assert not beside, f"declare {sorted(beside)} in exunet/results/over_time.py: see docs/extending.md"
