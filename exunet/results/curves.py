"""The quantities over time of which an ensemble has quantiles: one registry, of a run's `Course`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.course import Course

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """One quantity over time, of which an ensemble has quantiles: name, words, unit, (t,) values of a course.

    value : None where it is not defined
    """

    name: str
    words: str
    unit: str
    value: Callable[[Course], Floats | None]


def _mouth_area(course: Course) -> Floats | None:
    return course.area if 0.0 < course.achievable_area < math.inf else None


def _of_bullets(course: Course, number: Callable[..., Any]) -> Floats | None:
    return np.asarray(number(course.bullet_speed, axis=1)) if course.bullet_speed.shape[1] else None


CURVES = (
    Curve("area", "mouth area", "m2", _mouth_area),
    Curve("bullet_speed", "mean speed of bullets", "m/s", lambda course: _of_bullets(course, np.mean)),
    Curve("slowest_bullet", "slowest bullet", "m/s", lambda course: _of_bullets(course, np.min)),
    Curve("fastest_bullet", "fastest bullet", "m/s", lambda course: _of_bullets(course, np.max)),
    Curve("tension", "largest tension of all elements", "N", lambda course: course.tension),
    Curve("kinetic", "kinetic energy", "J", lambda course: course.kinetic),
    Curve("elastic", "elastic energy", "J", lambda course: course.elastic),
    Curve("dissipated", "energy dissipated", "J", lambda course: course.dissipated),
    Curve("enclosed", "part enclosed", "", lambda course: course.capture and course.capture.enclosed),
    Curve("cqi", "capture quality index", "", lambda course: course.capture and course.capture.cqi),
    Curve("mcqi", "modified index", "", lambda course: course.capture and course.capture.mcqi),
    Curve("mouth", "diameter of the mouth", "m", lambda course: course.capture and course.capture.mouth),
)
