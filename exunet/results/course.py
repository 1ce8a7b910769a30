"""The course of a run: the few quantities over time of which its headlines are made.

The courses of a spread and of an ensemble have instants of their own (`instants`), so that their headlines do
not depend on which states a case stores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.distance import Mover
from exunet.bodies.kinematics import first_given
from exunet.forces.contact.self_contact import NAME as SELF_CONTACT
from exunet.forces.from_outside import effects_of
from exunet.net.areas import achievable_area, mouth_diameter
from exunet.net.closing import NAME
from exunet.results.capture import Measures, capture_of, rule_of
from exunet.results.clearance import MOST_PAIRS, Nearest, Pair, movers_of, nearest, pairs_of
from exunet.results.corner_units import units_over_time
from exunet.results.ends import ends_of_result, no_ends
from exunet.results.margins import (
    Groups,
    Margin,
    Peak,
    loaded_over_blocks,
    peaks_of,
)
from exunet.results.measures import (
    dissipation,
    largest_tensions,
    mouth_areas,
    net_centre,
    speeds_of,
    work_of_ejection,
)
from exunet.results.momenta import momenta_over_time
from exunet.results.over_time import OVER_TIME, OverTime
from exunet.results.pulls import PulledPlace, pull_of
from exunet.results.result import Result, StoredRows, over_blocks
from exunet.results.script_story import ending, times_of_awaited
from exunet.results.taken import taken_of, taken_over_time
from exunet.scene.capture import CaptureCriterion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

THREADS, NODES, BULLETS = TOUCHING = ("threads", "nodes", "bullets")  # what may touch a body
CONTACT = "contact_"  # before the name of the body, in the names of what is stored of contacts
SELF = f"{SELF_CONTACT}/"  # before the names of what is stored of threads that touch each other
LINE = f"{NAME}/"  # before the names of what is stored of a closing line
EDGE = f"{LINE}part"  # what is stored of an edge that becomes shorter: the part of its length that is left
REEL_STATES = ("wound_up", "work")  # of a reel, after the name of its tether, and of a closing line's winch
INTERVALS = 400  # between the instants of a course


def instants(end: float) -> Floats:
    """(401,) times [s] from 0 to `end`, at which the courses of a spread and of an ensemble are taken."""
    return np.linspace(0.0, end, INTERVALS + 1)


def breaks_of(story: Mapping[str, Any]) -> tuple[float, ...] | None:
    """When elements broke [s], in order, as the story of a run tells it; None: nothing can break."""
    broken = story.get("broken")
    return None if broken is None else tuple(sorted(float(item["time_s"]) for item in broken))


@dataclass(frozen=True, eq=False)
class Course(OverTime):
    """What headlines are computed from: one run, over its times.

    time            : (t,) [s], of `OverTime`
    achievable_area : the largest that the mouth can have [m2]; 0 or infinite: there is no mouth to speak of
    peaks           : the largest of all steps of each of `Net.spans`
    body_names      : of bodies, of point masses too
    turning, guided : the bodies that have an attitude; those whose motion is given
    outside         : effects whose impulse is kept
    ends            : (2, n_bodies + n_outside + 1) records `END` at the start and at the end, of bodies, of
                      these effects and of the net; (2, 0) without bodies
    ejection        : work of the ejection of the net until the end [J]; None: there is none in the scene
    tether_names    : of all tethers
    reel_names      : of tethers with reels, and of a closing line
    pulled          : the places of `pull`
    taken_names     : of what has taken the energies `taken`, see `exunet.results.taken`
    groups          : of elements whose strength is known; None: of none
    pairs, movers   : of bodies whose distances are headlines, and these bodies in motion
    rule            : when the target counts as captured; None: the case has none
    capture         : with the rule, the measures of the capture
    line            : (t,) what is stored of a closing line, by name ("closing/largest" and so on)
    contact         : (t,) what is stored of contacts, by name ("contact_BODY/threads_touching" and so on)
    together        : (t,) what is stored of threads that touch each other ("self_contact/touching" and so on)
    stopped         : verdict of the script that has ended the run at the last of the times; "": none has
    breaks          : when elements broke [s], in order; None: nothing can break
    awaited         : when entries of the script happened [s], by name, of those that wait for the run
    """

    time: Floats
    achievable_area: float
    peaks: Mapping[str, Peak]
    body_names: tuple[str, ...] = ()
    turning: tuple[str, ...] = ()
    guided: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    ends: NDArray[np.void] = field(default_factory=no_ends)
    ejection: float | None = None
    tether_names: tuple[str, ...] = ()
    reel_names: tuple[str, ...] = ()
    pulled: tuple[PulledPlace, ...] = ()
    taken_names: tuple[str, ...] = ()
    pairs: tuple[Pair, ...] = ()
    movers: Mapping[str, Mover] = field(default_factory=dict)
    groups: Groups | None = None
    rule: CaptureCriterion | None = None
    capture: Measures | None = None
    line: Mapping[str, Floats] = field(default_factory=dict)
    contact: Mapping[str, Floats] = field(default_factory=dict)
    together: Mapping[str, Floats] = field(default_factory=dict)
    stopped: str = ""
    breaks: tuple[float, ...] | None = None
    awaited: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def at_every_second(self) -> Course:
        """The same at half as many times, the last one included."""
        return self._at(np.arange(len(self.time) - 1, -1, -2)[::-1])

    def at_every_third(self, first: int) -> Course:
        """The same at a third of the times, from one of the first three on, the last one included."""
        rows = np.arange(first, len(self.time), 3)
        return self._at(np.union1d(rows, [len(self.time) - 1]))

    def at_times_of(self, other: Course) -> Course:
        """The same at those of its times that are nearest to the times of another course."""
        between = 0.5 * (self.time[1:] + self.time[:-1])
        return self._at(np.unique(np.searchsorted(between, other.time)))

    def _at(self, rows: Ints) -> Course:
        capture = None if self.capture is None else Measures(*(item[rows] for item in self.capture))
        contact = {name: values[rows] for name, values in self.contact.items()}
        line = {name: values[rows] for name, values in self.line.items()}
        together = {name: values[rows] for name, values in self.together.items()}
        movers = {name: replace(one, path=one.path.every_second()) for name, one in self.movers.items()}
        thinned = {name: getattr(self, name)[rows] for name in ("time", *OVER_TIME)}
        kept: dict[str, Any] = {"line": line, "contact": contact, "together": together}
        return replace(self, movers=movers, capture=capture, **kept, **thinned)

    @cached_property
    def nearest(self) -> dict[Pair, Nearest]:
        """How near the bodies of each pair come, between the times too."""
        return {(a, b): nearest(self.movers[a], self.movers[b]) for a, b in self.pairs}

    def margin(self, group: str) -> Margin | None:
        """The least of a group of elements; None where it has none."""
        if self.groups is None or group not in self.groups.names:
            return None
        number = self.groups.names.index(group)
        return self.groups.least(number, self.time, self.loaded, self.loaded_element, self.peaks)

    def peak_of(self, group: str) -> Peak | None:
        """The largest of a group of `Net.groups`; None where there is no such group."""
        own = (one for name, one in self.peaks.items() if name == group or name.startswith(f"{group} from "))
        return max(own, key=lambda item: (item.tension, -item.time), default=None)

    @property
    def peak(self) -> Peak:
        """The largest of all."""
        return max(self.peaks.values(), key=lambda peak: (peak.tension, -peak.time))


def course_of(result: Result) -> Course:
    """The course of a result over its stored times; the peak is that of all steps, where the run tells it."""
    bullets = result.net.bullet_nodes
    groups = Groups.of(result.net)
    pairs = pairs_of(list(movers := movers_of(result)))[:MOST_PAIRS]
    loaded, loaded_element = loaded_over_blocks(groups, result.tension)
    pulled, pull = pull_of(result)
    rule = rule_of(result)
    return Course(
        time=result.time,
        area=mouth_areas(result),
        achievable_area=achievable_area(result.net),
        centre=_of_rows(partial(net_centre, result.net), result.position, 3),
        bullet_speed=_of_rows(partial(speeds_of, bullets), result.velocity, len(bullets)),
        kinetic=result.kinetic,
        elastic=result.elastic,
        dissipated=dissipation(result),
        tension=largest_tensions(result),
        peaks=peaks_of(result),
        potential=result.potential,
        body_names=tuple(result.bodies),
        body_centre=_centres(result),
        turning=tuple(name for name, body in result.bodies.items() if body.attitude is not None),
        guided=tuple(name for name in result.bodies if first_given(name) in result.states),
        outside=effects_of(result.states),
        ends=ends_of_result(result),
        ejection=work_of_ejection(result.provenance),
        tether_names=tuple(result.net.tether_elements),
        reel_names=(reels := winches_of(result.states)),
        reel=_drums(result, reels),
        pulled=pulled,
        pull=pull,
        taken_names=taken_of(result.states),
        taken=taken_over_time(result),
        pairs=tuple(pairs),
        movers=movers,
        groups=groups,
        loaded=loaded,
        loaded_element=loaded_element,
        rule=rule,
        capture=None if rule is None else capture_of(result, rule),
        units=units_over_time(result),
        mouth=_mouth(result),
        edge=_edge(result),
        spin=_spins(result),
        momentum=momenta_over_time(result),
        line=_series(result, LINE),
        contact=_series(result, CONTACT),
        together=_series(result, SELF),
        stopped=ending(result.provenance),
        breaks=breaks_of(result.provenance),
        awaited=times_of_awaited(result.provenance),
    )


def _series(result: Result, prefix: str) -> dict[str, Floats]:
    """(t,) of each single value that is stored under names that begin so."""
    own = {name: one.values for name, one in result.states.items() if name.startswith(prefix)}
    return {name: np.asarray(values[:])[:, 0] for name, values in own.items()}


def winches_of(states: Iterable[str]) -> tuple[str, ...]:
    """What is wound up by a drive, tethers or a closing line, by the names of all states."""
    ending = f"/{REEL_STATES[0]}"
    return tuple(name.removesuffix(ending) for name in states if name.endswith(ending))


def _drums(result: Result, reels: tuple[str, ...]) -> Floats:
    """(t, n_reels, 2) wound up [m], work [J]."""
    found = np.zeros((len(result.time), len(reels), len(REEL_STATES)))
    for k, name in enumerate(reels):
        for m, state in enumerate(REEL_STATES):
            found[:, k, m] = np.asarray(result.states[f"{name}/{state}"].values[:])[:, 0]
    return found


def is_closing(states: Iterable[str]) -> bool:
    """True if something closes the mouth, by the names of all that is stored of forces."""
    return any(name.startswith(LINE) for name in states)


def _mouth(result: Result) -> Floats:
    """(t, 1) diameter [m], where something closes it; (t, 0) elsewhere."""
    if not is_closing(result.states):
        return np.zeros((len(result.time), 0))
    return over_blocks(partial(mouth_diameter, result.net), result.position)[:, None]


def _edge(result: Result) -> Floats:
    """(t, 1) part of its length that is left; (t, 0) without an edge that becomes shorter."""
    found = result.states.get(EDGE)
    return np.zeros((len(result.time), 0)) if found is None else np.asarray(found.values[:])


def _spins(result: Result) -> Floats:
    """(t, n_rigid, 3) [rad/s], in axes of each body."""
    every = (body.angular_velocity for body in result.bodies.values())
    found = [np.asarray(item[:]) for item in every if item is not None]
    return np.stack(found, axis=1) if found else np.zeros((len(result.time), 0, 3))


def _centres(result: Result) -> Floats:
    """(t, n_bodies, 3) [m]."""
    centres = [np.asarray(body.position[:]) for body in result.bodies.values()]
    return np.stack(centres, axis=1) if centres else np.zeros((len(result.time), 0, 3))


def _of_rows(measure: Callable[[Floats], Floats], values: Any, width: int) -> Any:
    """What `measure` makes of each row; of rows that stay in a file, when it is asked for."""
    if isinstance(values, StoredRows):
        return StoredRows(lambda start, stop: measure(values[start:stop]), (len(values), width))
    return measure(values)
