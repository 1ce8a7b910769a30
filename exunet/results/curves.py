"""The quantities over time of which an ensemble has quantiles: one registry, of a run's `Course`.

Some are of every scene (`CURVES`), some of each contact, rigid body, part with momentum, place that ties
threads to a body, and corner unit, and of what closes a mouth: those that a result stores have its names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.status import OF_BODY
from exunet.net.closing import NAME as CLOSING
from exunet.results.course import CONTACT, EDGE, LINE, REEL_STATES, Course
from exunet.results.momenta import KINDS, direction, momenta_at_start, part_names
from exunet.results.pulls import place_named

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


def _mouth(course: Course) -> Floats | None:
    if course.capture is not None:
        return course.capture.mouth
    return course.mouth[:, 0] if course.mouth.shape[1] else None


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
    Curve("mouth", "diameter of the mouth", "m", _mouth),
)


_TOUCHING, _FORCE = "_touching", "_force"  # endings of what is stored of a contact
_THRUST = "control/thrust_"
_MOMENTA = {"linear": "momentum/", "angular": "angular_momentum/"}  # before the names of parts, by kind
_BODY, _SPIN = "body_", "/angular_velocity_"
_PULL = "attachment_"
PULLS = {"force": ("force", "N"), "torque": ("torque about the centre of mass", "N m")}  # words, unit


def thrust_name(unit: int) -> str:
    """Of the quantiles of the thrust of a corner unit, the first of which is number 0."""
    return f"{_THRUST}{unit}"


def spin_name(body: str, axis: str) -> str:
    """Of the quantiles of a rigid body's angular velocity about its axis "x", "y" or "z"."""
    return f"{_BODY}{body}{_SPIN}{axis}"


def pull_name(place: str, quantity: str) -> str:
    """Of the quantiles of what threads pull on a body with, at a place (`PulledPlace.name`); of `PULLS`."""
    return f"{_PULL}{place}/{quantity}"


def momentum_name(kind: str, part: str) -> str:
    """Of the quantiles of what a part's momentum of a kind ("linear", "angular") has changed by."""
    return f"{_MOMENTA[kind]}{part}"


def _of_contact(name: str) -> Curve:
    """Of "contact_BODY/WHAT_touching" or "contact_BODY/WHAT_force"."""
    body, _, series = name.removeprefix(CONTACT).rpartition("/")
    what, _, quantity = series.removeprefix(OF_BODY).rpartition("_")
    told = {_TOUCHING: ("number that touch", ""), _FORCE: ("force across the surface", "N")}
    words, unit = told[f"_{quantity}"]
    return Curve(name, f"{words}, {what} on {body}", unit, lambda course: course.contact.get(name))


def _of_line(name: str, words: str, unit: str) -> Curve:
    """What a closing line stores."""
    return Curve(name, words, unit, lambda course: course.line.get(name))


def _wound_up(course: Course) -> Floats | None:
    if CLOSING not in course.reel_names:
        return None
    return course.reel[:, course.reel_names.index(CLOSING), 0]


def _edge(course: Course) -> Floats | None:
    return course.edge[:, 0] if course.edge.shape[1] else None


_OF_CLOSING = (
    _of_line(f"{LINE}tension_start", "tension at the start of the closing line", "N"),
    _of_line(f"{LINE}tension_end", "tension at the end of the closing line", "N"),
    _of_line(f"{LINE}way", "way of the closing line through its rings", "m"),
    Curve(f"{LINE}{REEL_STATES[0]}", "length of the closing line wound up", "m", _wound_up),
    Curve(EDGE, "part of the edge's length that is left", "", _edge),
)


def _of_unit(name: str) -> Curve:
    unit = int(name.removeprefix(_THRUST))
    words = f"mean thrust of corner unit {unit} since the instant before"
    return Curve(name, words, "N", partial(_mean_thrust, unit=unit))


def _mean_thrust(course: Course, unit: int) -> Floats | None:
    """(t,) between each time and that before; at the first that of the first interval, or 0 without one."""
    if not 0 <= unit < course.units.shape[1] - 1:
        return None
    found = np.diff(course.units[:, unit]) / np.diff(course.time)
    return np.concatenate([found[:1], found]) if len(found) else np.zeros(1)


def _of_pull(name: str) -> Curve:
    place, _, quantity = name.removeprefix(_PULL).rpartition("/")
    words, unit = PULLS[quantity]
    body, where = place_named(place)
    value = partial(_pull, place=place, quantity=list(PULLS).index(quantity))
    return Curve(name, f"{words} on {body} {where}", unit, value)


def _pull(course: Course, place: str, quantity: int) -> Floats | None:
    names = [item.name for item in course.pulled]
    return course.pull[:, names.index(place), quantity] if place in names else None


def _of_spin(name: str) -> Curve:
    body, _, axis = name.removeprefix(_BODY).rpartition(_SPIN)
    words = f"angular velocity of {body} in its axes, {axis}"
    return Curve(name, words, "rad/s", partial(_spin, body=body, axis="xyz".index(axis)))


def _spin(course: Course, body: str, axis: int) -> Floats | None:
    if body not in course.turning:
        return None
    return course.spin[:, course.turning.index(body), axis]


def _of_momentum(name: str, along: Mapping[str, Floats] | None = None) -> Curve:
    """What has been changed along a direction (3,) of each kind; not defined without one."""
    ((kind, begin),) = (item for item in _MOMENTA.items() if name.startswith(item[1]))
    part, which = name.removeprefix(begin), KINDS.index(kind)
    words = (
        f"change of the {'momentum' if kind == KINDS[0] else 'angular momentum'} of {part} along a direction"
    )

    def value(course: Course) -> Floats | None:
        names = parts_of(course)
        if along is None or part not in names:
            return None
        found = course.momentum[:, names.index(part), 3 * which : 3 * which + 3]
        start = _momenta_at_start(course)[names.index(part), 3 * which : 3 * which + 3]
        return np.asarray((found - start) @ along[kind])

    return Curve(name, words, ("kg m/s", "kg m2/s")[which], value)


def parts_of(course: Course) -> tuple[str, ...]:
    """The names of its parts that have momentum, or have given some."""
    return part_names(course.body_names, course.guided, course.outside)


def _momenta_at_start(course: Course) -> Floats:
    return momenta_at_start(course.ends, course.body_names, course.guided, course.outside)


def directions_of(course: Course) -> dict[str, Floats] | None:
    """(3,) along which the largest change of momentum is, of each kind; None without bodies."""
    if not (names := parts_of(course)):
        return None
    gained = course.momentum - _momenta_at_start(course)
    parts = {name: np.split(gained[:, k], 2, axis=1) for k, name in enumerate(names)}
    return {kind: direction({name: both[k] for name, both in parts.items()}) for k, kind in enumerate(KINDS)}


_OF_A_NAME: tuple[tuple[str, Sequence[str], Callable[[str], Curve]], ...] = (
    (CONTACT, (_TOUCHING, _FORCE), _of_contact),
    (_THRUST, ("",), _of_unit),
    (_PULL, tuple(f"/{quantity}" for quantity in PULLS), _of_pull),
    (_BODY, tuple(_SPIN + axis for axis in "xyz"), _of_spin),
    (_MOMENTA["linear"], ("",), _of_momentum),
    (_MOMENTA["angular"], ("",), _of_momentum),
)  # how their names begin and end, and what makes them


def curves_for(course: Course, along: Mapping[str, Floats] | None = None) -> tuple[Curve, ...]:
    """Those that the scene of a course has: each has values.

    along : directions of momenta (`directions_of`), without which these have no values
    """
    names = [
        *(name for name in course.contact if name.endswith((_TOUCHING, _FORCE))),
        *map(thrust_name, range(course.units.shape[1] - 1)),
        *(pull_name(place.name, quantity) for place in course.pulled for quantity in PULLS),
        *(spin_name(body, axis) for body in course.turning for axis in "xyz"),
    ]
    momenta = [momentum_name(kind, part) for kind in KINDS for part in parts_of(course)]
    every = (*CURVES, *_OF_CLOSING, *map(curve, names), *(_of_momentum(name, along) for name in momenta))
    return tuple(item for item in every if item.value(course) is not None)


def curve(name: str) -> Curve:
    """The curve of a name; raises KeyError if there is none."""
    for item in (*CURVES, *_OF_CLOSING):
        if item.name == name:
            return item
    for begin, ends, made in _OF_A_NAME:
        if name.startswith(begin) and name.endswith(tuple(ends)):
            try:
                return made(name)
            except ValueError:  # no number of a unit
                break
    raise KeyError(name)
