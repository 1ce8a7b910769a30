"""The headline quantities of a run: one registry, of which table, summary, spread and ensembles are made.

A headline is a function of a run's `Course`: a few quantities over time, and what was seen of all steps. The
courses of a spread and of an ensemble have instants of their own (`instants`), so that their headlines do not
depend on which states a case stores.

To add one, add a line to `HEADLINES`; what it needs and no course has yet is a field of `Course`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.results.areas import achievable_area
from exunet.results.clearance import MOST_PAIRS, Pair, gaps_of, pairs_of, shapes_of
from exunet.results.margins import (
    STRINGS,
    TETHER,
    THREADS,
    Groups,
    Margin,
    Peak,
    loaded_over_blocks,
    peak_of_all_steps,
)
from exunet.results.measures import (
    NEARLY_OPEN,
    deployment_of_course,
    largest_tensions,
    mouth_areas,
    net_centre,
    speeds_of,
    tensions_of_tethers,
)
from exunet.results.result import Result
from exunet.results.rows import StoredRows, over_blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

INTERVALS = 400  # between the instants of a course


def instants(end: float) -> Floats:
    """(401,) times [s] from 0 to `end`, at which the courses of a spread and of an ensemble are taken."""
    return np.linspace(0.0, end, INTERVALS + 1)


@dataclass(frozen=True, eq=False)
class Course:
    """What headlines are computed from: one run, over its times.

    time            : (t,) [s]
    area            : (t,) of the mouth [m2]; zeros without one
    achievable_area : the largest that the mouth can have [m2]; 0 or infinite: there is no mouth to speak of
    centre          : (t, 3) centre of mass of the net [m]
    bullet_speed    : (t, n_bullets) [m/s]
    kinetic, elastic, dissipated : (t,) [J]
    tension         : (t,) largest tension of all elements at each time [N]
    peak            : the largest of all steps
    body_names, body_centre       : (t, n_bodies, 3) centres of mass [m], of point masses too
    tether_names, tether_tension  : (t, n_tethers) largest tension along each [N]
    reel_names, reel : (t, n_reels, 2) length of the tether that is wound up [m], work of the drum on it [J]
    groups          : of elements whose strength is known; None: of none
    pairs, gap      : (t, n_pairs) distance of two bodies, surface to surface [m]
    loaded, loaded_element : (t, n_groups) largest tension / strength in each group, and in which element
    """

    time: Floats
    area: Floats
    achievable_area: float
    centre: Floats
    bullet_speed: Floats
    kinetic: Floats
    elastic: Floats
    dissipated: Floats
    tension: Floats
    peak: Peak
    body_names: tuple[str, ...] = ()
    body_centre: Floats = field(default_factory=lambda: np.zeros((0, 0, 3)))
    tether_names: tuple[str, ...] = ()
    tether_tension: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    reel_names: tuple[str, ...] = ()
    reel: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    pairs: tuple[Pair, ...] = ()
    gap: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    groups: Groups | None = None
    loaded: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    loaded_element: Ints = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))

    def at_every_second(self) -> Course:
        """The same at half as many times, the last one included."""
        rows = np.arange(len(self.time) - 1, -1, -2)[::-1]
        names = ["time", "area", "centre", "bullet_speed", "kinetic", "elastic", "dissipated", "tension"]
        names += ["body_centre"] if self.body_names else []
        names += ["tether_tension"] if self.tether_names else []
        names += ["reel"] if self.reel_names else []
        names += ["gap"] if self.pairs else []
        names += ["loaded", "loaded_element"] if self.groups else []
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def margin(self, group: str) -> Margin | None:
        """The least of a group of elements; None where it has none."""
        if self.groups is None or group not in self.groups.names:
            return None
        number = self.groups.names.index(group)
        return self.groups.least(number, self.time, self.loaded, self.loaded_element, self.peak)


@dataclass(frozen=True)
class Headline:
    """One quantity that stands in the summary and in the table.

    name     : its key in summary.json, without the unit
    words    : its name in tables and figures
    unit     : "N", "m2", ...; "": none
    value    : from a course; None where it is not defined
    digits   : significant ones that are printed
    least    : differences up to this [unit] are those of round-off, or of the moves themselves
    place    : where a value was found, as the element of a tension; None: nowhere in particular
    place_is : what `place` numbers, in a word
    at_a_time : it is one of the course's times, known no better than to half of their spacing
    remark   : what the table says after the value
    group    : of elements, whose margin it is; "": of none
    """

    name: str
    words: str
    unit: str
    value: Callable[[Course], float | None]
    digits: int = 4
    least: float = 1e-12
    place: Callable[[Course], int] | None = None
    place_is: str = ""
    at_a_time: bool = False
    remark: str = ""
    group: str = ""

    @property
    def key(self) -> str:
        """Its key in summary.json: name and unit."""
        return f"{self.name}_{self.unit.replace('/', '_')}" if self.unit else self.name


def _time_of_peak(course: Course) -> float | None:
    return course.peak.time if course.peak.element >= 0 else None


def _of_deployment(measure: str) -> Callable[[Course], float | None]:
    """One of the four measures of `Deployment`."""

    def value(course: Course) -> float | None:
        found = deployment_of_course(course.time, course.area, course.centre, course.achievable_area)
        return None if found is None else float(getattr(found, measure))

    return value


def _mean_bullet_speed(course: Course) -> float | None:
    return float(course.bullet_speed[-1].mean()) if course.bullet_speed.shape[1] else None


HEADLINES = (
    Headline(
        "largest_tension",
        "largest tension",
        "N",
        lambda course: course.peak.tension,
        place=lambda course: course.peak.element,
        place_is="element",
    ),
    Headline("time_of_largest_tension", "time of largest tension", "s", _time_of_peak),
    Headline("largest_area", "largest area", "m2", _of_deployment("largest_area")),
    Headline(
        "time_of_largest_area", "time of largest area", "s", _of_deployment("time_of_largest"), at_a_time=True
    ),
    Headline(
        "distance",
        "distance travelled",
        "m",
        _of_deployment("distance"),
        least=1e-8,
        remark="centre of mass, until the largest area",
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


_OF_BODY, _OF_TETHER = ("body_", "_displacement"), ("tether_", "_largest_tension")
_MARGIN_OF_TETHER = ("tether_", "_margin")


def of_body(name: str) -> Headline:
    """How far the centre of mass of a body is from its start at the end."""

    def value(course: Course) -> float | None:
        if name not in course.body_names:
            return None
        centre = course.body_centre[:, course.body_names.index(name)]
        return float(np.linalg.norm(centre[-1] - centre[0]))

    words = f"displacement of {name}"
    return Headline(name.join(_OF_BODY), words, "m", value, least=1e-8, remark="at the end")


def of_tether(name: str) -> Headline:
    """The largest tension along a tether."""

    def value(course: Course) -> float | None:
        if name not in course.tether_names:
            return None
        return float(course.tether_tension[:, course.tether_names.index(name)].max(initial=0.0))

    words = f"largest tension of tether {name}"
    return Headline(name.join(_OF_TETHER), words, "N", value, remark="at stored times")


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
        name = group.removeprefix(TETHER).join(_MARGIN_OF_TETHER)
    return Headline(
        name,
        f"margin of {group}",
        "",
        value,
        least=1e-4,
        place=place,
        place_is="element",
        remark="strength / largest tension - 1",
        group=group,
    )


def _of_margin_of_tether(name: str) -> Headline:
    return of_margin(TETHER + name)


_WOUND_UP, _REEL_WORK = ("tether_", "_wound_up"), ("tether_", "_work_of_reel")
REEL_STATES = ("wound_up", "work")  # of a reel, after the name of its tether


def of_reel(name: str) -> tuple[Headline, Headline]:
    """How much of a tether is wound up at the end, and the work that its drum has done."""
    return _wound_up(name), _reel_work(name)


def _wound_up(name: str) -> Headline:
    words = f"wound up of tether {name}"
    return Headline(
        name.join(_WOUND_UP), words, "m", partial(_of_drum, name, 0), least=1e-9, remark="at the end"
    )


def _reel_work(name: str) -> Headline:
    words = f"work of the reel of {name}"
    return Headline(name.join(_REEL_WORK), words, "J", partial(_of_drum, name, 1), remark="on the tether")


def _of_drum(name: str, quantity: int, course: Course) -> float | None:
    """At the end."""
    if name not in course.reel_names:
        return None
    return float(course.reel[-1, course.reel_names.index(name), quantity])


_OF_PAIR, _JOINED = ("bodies_", "_least_distance"), "+"  # which no name has


def of_pair(pair: str) -> Headline:
    """The least distance of two bodies, "one+other"."""

    def value(course: Course) -> float | None:
        names = [_JOINED.join(one) for one in course.pairs]
        return float(course.gap[:, names.index(pair)].min()) if pair in names else None

    words = f"least distance of {pair.replace(_JOINED, ' and ')}"
    return Headline(pair.join(_OF_PAIR), words, "m", value, least=1e-8, remark="surface to surface")


def of_time_of_pair(pair: str) -> Headline:
    """When two bodies are nearest; None if they always are as near, as two that do not move."""

    def value(course: Course) -> float | None:
        names = [_JOINED.join(one) for one in course.pairs]
        if pair not in names:
            return None
        gap = course.gap[:, names.index(pair)]
        return float(course.time[gap.argmin()]) if np.ptp(gap) > 0.0 else None

    words = f"time of least distance of {pair.replace(_JOINED, ' and ')}"
    return Headline(pair.join(_TIME_OF_PAIR), words, "s", value, at_a_time=True)


_TIME_OF_PAIR = ("bodies_", "_time_of_least_distance")


def _of_pair_both(pair: str) -> tuple[Headline, Headline]:
    return of_pair(pair), of_time_of_pair(pair)


def headlines_for(course: Course) -> tuple[Headline, ...]:
    """The headlines of a scene: those of every net, then margins, and those of its tethers and bodies."""
    return (
        *HEADLINES,
        *map(of_margin, course.groups.names if course.groups else ()),
        *map(of_tether, course.tether_names),
        *chain.from_iterable(map(of_reel, course.reel_names)),
        *map(of_body, course.body_names),
        *chain.from_iterable(_of_pair_both(_JOINED.join(pair)) for pair in course.pairs),
    )


def headline(key: str) -> Headline:
    """The headline of a key; raises KeyError if there is none."""
    for one in (*HEADLINES, of_margin(THREADS), of_margin(STRINGS)):
        if one.key == key:
            return one
    for (begin, _), made in (
        (_OF_BODY, of_body),
        (_OF_TETHER, of_tether),
        (_WOUND_UP, _wound_up),
        (_REEL_WORK, _reel_work),
        (_MARGIN_OF_TETHER, _of_margin_of_tether),
        (_OF_PAIR, of_pair),
        (_TIME_OF_PAIR, of_time_of_pair),
    ):
        end = made("").key.removeprefix(begin)
        if key.startswith(begin) and key.endswith(end):
            return made(key[len(begin) : -len(end)])
    raise KeyError(key)


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
    Curve("tension", "largest tension then", "N", lambda course: course.tension),
    Curve("kinetic", "kinetic energy", "J", lambda course: course.kinetic),
    Curve("elastic", "elastic energy", "J", lambda course: course.elastic),
    Curve("dissipated", "energy dissipated", "J", lambda course: course.dissipated),
)


def headlines_of(course: Course) -> dict[str, float | None]:
    """All headlines of a course, by key."""
    return {one.key: one.value(course) for one in headlines_for(course)}


def course_of(result: Result) -> Course:
    """The course of a result over its stored times; the peak is that of all steps, where the run tells it."""
    tension, bullets = largest_tensions(result), result.net.bullet_nodes
    groups = Groups.of(result.net)
    pairs = pairs_of(list(shapes_of(result)))[:MOST_PAIRS]
    loaded, loaded_element = loaded_over_blocks(groups, result.tension)
    return Course(
        time=result.time,
        area=mouth_areas(result),
        achievable_area=achievable_area(result.net),
        centre=_of_rows(partial(net_centre, result.net), result.position, 3),
        bullet_speed=_of_rows(partial(speeds_of, bullets), result.velocity, len(bullets)),
        kinetic=result.kinetic,
        elastic=result.elastic,
        dissipated=result.dissipated,
        tension=tension,
        peak=_peak(result, tension),
        body_names=tuple(result.bodies),
        body_centre=_centres(result),
        tether_names=tuple(result.net.tether_elements),
        tether_tension=over_blocks(partial(tensions_of_tethers, result.net), result.tension),
        reel_names=(reels := _reels(result)),
        reel=_drums(result, reels),
        pairs=tuple(pairs),
        gap=gaps_of(result, pairs),
        groups=groups,
        loaded=loaded,
        loaded_element=loaded_element,
    )


def _reels(result: Result) -> tuple[str, ...]:
    """The tethers that have one."""
    return tuple(name for name in result.net.tether_elements if f"{name}/{REEL_STATES[0]}" in result.states)


def _drums(result: Result, reels: tuple[str, ...]) -> Floats:
    """(t, n_reels, 2) wound up [m], work [J]."""
    found = np.zeros((len(result.time), len(reels), len(REEL_STATES)))
    for k, name in enumerate(reels):
        for m, state in enumerate(REEL_STATES):
            found[:, k, m] = np.asarray(result.states[f"{name}/{state}"].values[:])[:, 0]
    return found


def _centres(result: Result) -> Floats:
    """(t, n_bodies, 3) [m]."""
    centres = [np.asarray(body.position[:]) for body in result.bodies.values()]
    return np.stack(centres, axis=1) if centres else np.zeros((len(result.time), 0, 3))


def _of_rows(measure: Callable[[Floats], Floats], values: Any, width: int) -> Any:
    """What `measure` makes of each row; of rows that stay in a file, when it is asked for."""
    if isinstance(values, StoredRows):
        return StoredRows(lambda start, stop: measure(values[start:stop]), (len(values), width))
    return measure(values)


def _peak(result: Result, tension: Floats) -> Peak:
    if known := peak_of_all_steps(result):
        return known
    at = int(np.argmax(tension))
    element = int(np.argmax(result.tension[at])) if tension[at] > 0.0 else -1
    return Peak(float(tension[at]), float(result.time[at]), element)


def shown(one: Headline, value: float) -> str:
    """A value to the digits that a headline has, with its unit."""
    return f"{printed(value, max(unit_of_last_digit(value, one.digits), one.least))} {one.unit}".rstrip()


def unit_of_last_digit(value: float, digits: int) -> float:
    """What the last of so many significant digits of a value counts; 0 for 0."""
    return 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1) if value else 0.0


def printed(value: float, unit_of_last: float) -> str:
    """A value down to a digit: 1234.6 with 0.1, 1200 with 100; without rounding where that is 0."""
    if unit_of_last <= 0.0 or not math.isfinite(unit_of_last):
        return f"{value:.4g}"
    if abs(value) < 0.5 * unit_of_last:
        return "0"
    decimals = -math.floor(math.log10(unit_of_last) + 1e-9)
    if abs(value) >= 1e7 or decimals > 7:
        digits = max(0, math.floor(math.log10(max(abs(value), unit_of_last))) + decimals)
        return f"{value:.{digits}e}"
    return f"{round(value, decimals):.{max(0, decimals)}f}"
