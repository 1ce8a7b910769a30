"""The headline quantities of a run: one registry, of which table, summary, spread and ensembles are made.

A headline is a function of a run's `Course`. To add one, add a line to `HEADLINES`; what it needs over time
and no course has yet is a field of `exunet.results.over_time.OverTime`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import chain

import numpy as np

from exunet.net.arrays import NET, TETHER
from exunet.net.closing import NAME as LINE_NAME
from exunet.results.attachment_headlines import pulls_at_place, pulls_on_body
from exunet.results.body_headlines import (
    OF_A_BODY,
    OF_A_SCENE,
    OF_AN_EFFECT,
    books_of_bodies,
    headlines_of_bodies,
)
from exunet.results.capture_headlines import OF_A_CAPTURE, OF_SELF_CONTACT, headlines_of_capture, of_contact
from exunet.results.clearance import Nearest
from exunet.results.course import Course
from exunet.results.drive_headlines import (
    OF_A_LINE,
    OF_TAKEN,
    headlines_of_taken,
    of_reel,
    reel_work,
    wound_up,
)
from exunet.results.headline import COUNT, Headline
from exunet.results.margins import STRINGS, THREADS, Peak
from exunet.results.measures import NEARLY_OPEN, deployment_of_course, stays_the_same
from exunet.results.touching_bodies import JOINED, of_touching_pair, stored_pairs

NEVER_TAUT = ": no element was ever taut"


def _time_of_peak(course: Course) -> float | None:
    if _constant_tension(course):
        return None
    return course.peak.time if course.peak.element >= 0 else None


def _constant_tension(course: Course) -> str:
    lasts = course.peak.element >= 0 and stays_the_same(np.append(course.tension, course.peak.tension))
    return "the largest tension is constant" if lasts else ""


def _constant_area(course: Course) -> str:
    has_mouth = 0.0 < course.achievable_area < math.inf
    return "the area of the mouth is constant" if has_mouth and stays_the_same(course.area) else ""


def _of_deployment(measure: str) -> Callable[[Course], float | None]:
    """One of the four measures of `Deployment`."""

    def value(course: Course) -> float | None:
        found = deployment_of_course(course.time, course.area, course.centre, course.achievable_area)
        return None if found is None else float(getattr(found, measure))

    return value


def _unless_constant(measure: str) -> Callable[[Course], float | None]:
    """One that needs the time of the largest area."""
    of_deployment = _of_deployment(measure)
    return lambda course: None if _constant_area(course) else of_deployment(course)


def _mean_bullet_speed(course: Course) -> float | None:
    return float(course.bullet_speed[-1].mean()) if course.bullet_speed.shape[1] else None


HEADLINES = (
    Headline(
        "largest_tension",
        "largest tension",
        "N",
        lambda course: course.peak.tension,
        place=lambda course: course.peak.element,
        place_is="in element",
        nowhere=NEVER_TAUT,
    ),
    Headline(
        "time_of_largest_tension",
        "time of largest tension",
        "s",
        _time_of_peak,
        at_a_step=True,
        constant=_constant_tension,
    ),
    Headline("largest_area", "largest area", "m2", _of_deployment("largest_area"), of_a_time=True),
    Headline(
        "time_of_largest_area",
        "time of largest area",
        "s",
        _unless_constant("time_of_largest"),
        at_a_time=True,
        constant=_constant_area,
    ),
    Headline(
        "distance",
        "distance travelled",
        "m",
        _unless_constant("distance"),
        least=1e-8,
        of_a_time=True,
        remark="centre of mass, until the largest area",
        constant=_constant_area,
    ),
    Headline(
        f"time_above_{NEARLY_OPEN:.0%}".replace("%", "_percent"),
        "area above 80 %",
        "s",
        _of_deployment("time_open"),
    ),
    Headline("bullet_speed_at_end", "bullet speed at the end", "m/s", _mean_bullet_speed, remark="mean"),
    Headline("dissipated_energy", "energy dissipated", "J", lambda course: float(course.dissipated[-1])),
)


def of_tether(name: str) -> tuple[Headline, Headline]:
    """The largest tension along a tether, and when."""
    return _of_group(TETHER + name, f"tether_{name}", f"tether {name}")


def _of_group(group: str, key: str, words: str) -> tuple[Headline, Headline]:
    """The largest tension of a group of `Net.groups`, and when."""

    def peak(course: Course) -> Peak | None:
        return course.peak_of(group)

    def tension(course: Course) -> float | None:
        found = peak(course)
        return None if found is None else found.tension

    def time(course: Course) -> float | None:
        found = peak(course)
        return None if found is None or found.element < 0 else found.time

    def place(course: Course) -> int:
        found = peak(course)
        return -1 if found is None else found.element

    return (
        Headline(
            f"{key}_largest_tension",
            f"largest tension of {words}",
            "N",
            tension,
            place=place,
            place_is="in element",
            nowhere=NEVER_TAUT,
            peak_of=group,
        ),
        Headline(
            f"{key}_time_of_largest_tension",
            f"time of largest tension of {words}",
            "s",
            time,
            at_a_step=True,
        ),
    )


def _is_taut(course: Course) -> bool:
    """True if an element of the net ever was."""
    peak = course.peak_of(NET)
    return peak is not None and peak.element >= 0


_OF_THE_NET = _of_group(NET, "net", "the net")  # where there are tethers too


def of_margin(group: str) -> Headline:
    """The least margin of a group of elements to their strength."""

    def value(course: Course) -> float | None:
        found = course.margin(group)
        return None if found is None else found.margin

    def place(course: Course) -> int:
        found = course.margin(group)
        return -1 if found is None else found.element

    name = f"margin_of_{group}"
    if group.startswith(TETHER):
        name = f"tether_{group.removeprefix(TETHER)}_margin"
    return Headline(
        name,
        f"margin of {group}",
        "",
        value,
        least=1e-4,
        place=place,
        place_is="in element",
        nowhere=NEVER_TAUT,
        remark="strength / largest tension - 1",
        group=group,
    )


def _spent(course: Course) -> float | None:
    """At the end, of all units."""
    return float(course.units[-1, :-1].sum()) if course.units.shape[1] else None


def _work_of_units(course: Course) -> float | None:
    return float(course.units[-1, -1]) if course.units.shape[1] else None


OF_UNITS = (
    Headline("impulse_of_units", "impulse of the corner units", "N s", _spent, remark="of all, spent"),
    Headline("work_of_units", "work of the corner units", "J", _work_of_units, remark="of all, put in"),
)


def of_unit(number: str) -> tuple[Headline]:
    """The impulse that a corner unit has spent, by its place among all, from 0."""

    def value(course: Course) -> float | None:
        at = int(number)
        return float(course.units[-1, at]) if at < course.units.shape[1] - 1 else None

    name, words = f"unit_{number}_impulse", f"impulse of corner unit {number}"
    return (Headline(name, words, "N s", value, detail=True),)


def _of_units(course: Course) -> tuple[Headline, ...]:
    """Of a case with corner units."""
    number = course.units.shape[1] - 1
    return (*OF_UNITS, *chain.from_iterable(of_unit(str(k)) for k in range(number))) if number > 0 else ()


OF_BREAKS = (
    Headline(
        "elements_broken",
        "elements that broke",
        "",
        lambda course: None if course.breaks is None else float(len(course.breaks)),
        least=COUNT,
    ),
    Headline(
        "first_break",
        "first break of an element",
        "s",
        lambda course: course.breaks[0] if course.breaks else None,
        at_a_step=True,
    ),
)


def of_awaited(entry: str) -> tuple[Headline, Headline]:
    """When an entry of the script first happened, and how often, of one whose time the case does not give."""

    def first(course: Course) -> float | None:
        return next(iter(course.awaited.get(entry, ())), None)

    def number(course: Course) -> float | None:
        return float(len(course.awaited[entry])) if entry in course.awaited else None

    return (
        Headline(f"script_{entry}_first", f"script: first {entry}", "s", first, at_a_step=True),
        Headline(f"script_{entry}_times", f"script: times of {entry}", "", number, least=COUNT, detail=True),
    )


def of_pair(pair: str) -> Headline:
    """The least distance of two bodies, "one+other"."""

    def value(course: Course) -> float | None:
        found = _nearest(course, pair)
        return None if found is None else found.distance

    words = f"least distance of {pair.replace(JOINED, ' and ')}"
    remark = "surface to surface, between stored times by interpolation"
    return Headline(f"bodies_{pair}_least_distance", words, "m", value, least=1e-8, remark=remark)


def _nearest(course: Course, pair: str) -> Nearest | None:
    """Of the two bodies "one+other"."""
    return {JOINED.join(one): found for one, found in course.nearest.items()}.get(pair)


def of_time_of_pair(pair: str) -> Headline:
    """When two bodies are nearest; None if they always are as near, as two that do not move."""

    def constant(course: Course) -> str:
        found = _nearest(course, pair)
        same = found is not None and stays_the_same(np.array([found.distance, found.largest]))
        return "the distance is constant" if same else ""

    def value(course: Course) -> float | None:
        found = _nearest(course, pair)
        return None if found is None or constant(course) else found.time

    words = f"time of least distance of {pair.replace(JOINED, ' and ')}"
    key = f"bodies_{pair}_time_of_least_distance"
    return Headline(key, words, "s", value, constant=constant)


def _of_pair_both(pair: str) -> tuple[Headline, Headline]:
    return of_pair(pair), of_time_of_pair(pair)


def headlines_for(course: Course) -> tuple[Headline, ...]:
    """The headlines of a scene: those of every net, then margins, and those of its tethers and bodies."""
    return (
        *HEADLINES,
        *map(of_margin, course.groups.names if course.groups else ()),
        *(_OF_THE_NET if course.tether_names and _is_taut(course) else ()),
        *chain.from_iterable(map(of_tether, course.tether_names)),
        *(OF_A_LINE if course.line else ()),
        *_of_units(course),
        *(OF_BREAKS if course.breaks is not None else ()),
        *chain.from_iterable(map(of_awaited, course.awaited)),
        *map(wound_up, course.reel_names),
        *headlines_of_bodies(course),
        *chain.from_iterable(map(pulls_on_body, dict.fromkeys(element.body for element in course.pulled))),
        *chain.from_iterable(pulls_at_place(item.name) for item in course.pulled),
        *chain.from_iterable(_of_pair_both(JOINED.join(pair)) for pair in course.pairs),
        *chain.from_iterable(of_touching_pair(JOINED.join(entry)) for entry in stored_pairs(course.contact)),
        *headlines_of_capture(course),
        *books_of_bodies(course),
        *headlines_of_taken(course),
        *map(reel_work, course.reel_names),
    )


# All that there are: those of one name, and those of which each body, tether, effect or pair has its own.
ONES = (
    *HEADLINES,
    *_OF_THE_NET,
    of_margin(THREADS),
    of_margin(STRINGS),
    *OF_A_SCENE,
    *OF_A_CAPTURE,
    *OF_SELF_CONTACT,
    *OF_A_LINE,
    *OF_UNITS,
    *OF_BREAKS,
    *OF_TAKEN,
    wound_up(LINE_NAME),
    reel_work(LINE_NAME),
)
OF_A_NAME: tuple[Callable[[str], tuple[Headline, ...]], ...] = (
    *OF_A_BODY,
    *OF_AN_EFFECT,
    pulls_on_body,
    pulls_at_place,
    of_awaited,
    of_unit,
    of_tether,
    of_contact,
    lambda name: (of_margin(TETHER + name),),
    of_reel,
    _of_pair_both,
    of_touching_pair,
)
ANY = "*"  # in place of a name


# The four measures of deployment, in the order of the paper.
DEPLOYMENT = ("largest_area_m2", "time_of_largest_area_s", "distance_m", "time_above_80_percent_s")


def headline(key: str) -> Headline:
    """The headline of a key; raises KeyError if there is none."""
    for item in ONES:
        if item.key == key:
            return item
    for made in OF_A_NAME:
        for number, any_one in enumerate(made(ANY)):
            begin, _, end = any_one.key.partition(ANY)
            if key.startswith(begin) and key.endswith(end):
                return made(key[len(begin) : -len(end)])[number]
    raise KeyError(key)


def constants_of(course: Course) -> dict[str, str]:
    """Why headlines have no value that otherwise have one, by key: what stays the same all the time."""
    found = ((item.key, item.constant(course)) for item in headlines_for(course) if item.constant is not None)
    return {key: words for key, words in found if words}


def headlines_of(course: Course) -> dict[str, float | None]:
    """All headlines of a course, by key."""
    return {item.key: item.value(course) for item in headlines_for(course)}
