"""Quantities over time that are derived from a result, and its named time series."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.forces.contact.self_contact import NAME as SELF_CONTACT
from exunet.forces.contact.status import TOUCHING, ContactKey
from exunet.forces.corner_units import SPENT, WORK
from exunet.forces.from_outside import effects_of
from exunet.net.areas import achievable_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING
from exunet.results.capture import Measures, capture_of, centres_of
from exunet.results.clearance import (
    MOST_PAIRS,
    Nearest,
    Pair,
    gaps_of,
    movers_of,
    nearest,
    pairs_of,
    shapes_of,
)
from exunet.results.loads import PACKED, AttachmentPoint, Margin, attachment_loads, margins, peaks_of
from exunet.results.measures import (
    Totals,
    bullet_speeds,
    centre_of_mass,
    dissipation,
    largest_tensions,
    momenta,
    mouth_areas,
    prescribed,
)
from exunet.results.result import Result, over_blocks
from exunet.results.run_record import Peak, largest_of
from exunet.scene.capture import Capture

SELF = f"{SELF_CONTACT}/"  # before the names of what is stored of threads that touch each other
LINE = f"{CLOSING}/"  # before the names of what is stored of a closing line
EDGE = f"{LINE}part"  # what is stored of an edge that becomes shorter: the part of its length that is left
_SELF_STORED = f"{SELF}stored"
# First-order states [J] that count what contacts and a closing line dissipate, in words.
DISSIPATED = {
    "contact/damping": "damping of contact",
    "contact/friction": "friction of contact",
    f"{SELF_CONTACT}/damping": "damping between threads",
    f"{CLOSING}/viscosity": "viscosity of the closing line",
    f"{CLOSING}/friction": "friction of the closing line",
}


def earliest(*first: Floats) -> float | None:
    """Return the earliest of series of times of first contacts, -1 until then; None without a contact."""
    times = np.concatenate([np.zeros(0), *first])
    return float(times[times >= 0.0].min()) if (times >= 0.0).any() else None


@dataclass(frozen=True, eq=False)
class Observables:
    """Quantities of a result over its stored times (t,), each computed when it is first used."""

    result: Result

    @property
    def time(self) -> Floats:
        """(t,) [s]."""
        return self.result.time

    def state(self, name: str) -> Floats:
        """(t, m) of what is stored of a force under a name."""
        return np.asarray(self.result.states[name].values[:])

    def states(self, prefix: str) -> dict[str, Floats]:
        """(t,) of each single value that is stored under names with a prefix."""
        return {name: self.state(name)[:, 0] for name in self.result.states if name.startswith(prefix)}

    @cached_property
    def achievable_area(self) -> float:
        """The largest area that the mouth can have [m2]; 0: there is no mouth to speak of."""
        area = achievable_area(self.result.net)
        return area if 0.0 < area < math.inf else 0.0

    @cached_property
    def area(self) -> Floats:
        """(t,) of the mouth [m2]; zeros without one."""
        return mouth_areas(self.result)

    @cached_property
    def centre(self) -> Floats:
        """(t, 3) centre of mass of the net [m]."""
        return centre_of_mass(self.result)

    @cached_property
    def bullet_speed(self) -> Floats:
        """(t, n_bullets) [m/s]."""
        return bullet_speeds(self.result)

    @cached_property
    def tension(self) -> Floats:
        """(t,) largest tension of all elements [N]."""
        return largest_tensions(self.result)

    @cached_property
    def dissipated(self) -> Floats:
        """(t,) [J], without the work that is put in."""
        return dissipation(self.result)

    @cached_property
    def peaks(self) -> dict[str, Peak]:
        """Largest tension of each of `Net.spans`, of all steps where the run records it."""
        return peaks_of(self.result)

    def peak(self, group: str = "") -> Peak | None:
        """Return the largest tension of a group of `Net.groups`, or of all; None without such a group."""
        own = (
            peak
            for name, peak in self.peaks.items()
            if not group or name == group or name.startswith(f"{group} from ")
        )
        return largest_of(own)

    @cached_property
    def margins(self) -> dict[str, Margin]:
        """Least margin of each group of elements whose strength is known."""
        return margins(self.result)

    @cached_property
    def attachments(self) -> dict[AttachmentPoint, Floats]:
        """(t, 2) magnitudes of force [N] and torque [N m] of threads at each place on a body."""
        return attachment_loads(self.result)

    @cached_property
    def prescribed(self) -> tuple[str, ...]:
        """Bodies whose motion is given."""
        return prescribed(self.result)

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """External effects whose impulse is stored."""
        return effects_of(self.result.states)

    @cached_property
    def momenta(self) -> dict[str, Totals]:
        """Momentum and energy of each part, and impulses; empty without bodies."""
        return momenta(self.result)

    @cached_property
    def nearest(self) -> dict[Pair, Nearest]:
        """How near the bodies with shapes of each pair come, between the stored times too."""
        movers = movers_of(self.result)
        return {(a, b): nearest(movers[a], movers[b]) for a, b in pairs_of(list(movers))[:MOST_PAIRS]}

    @cached_property
    def criterion(self) -> Capture | None:
        """Criterion of a capture; None: the case has none."""
        return self.result.run.capture

    @cached_property
    def capture(self) -> Measures | None:
        """(t,) each, of a case with a criterion."""
        return None if self.criterion is None else capture_of(self.result, self.criterion)

    @cached_property
    def net_motion(self) -> tuple[Floats, Floats]:
        """(t, 3) centre of mass [m] of the net's largest piece, and its velocity [m/s]."""
        return centres_of(self.result)

    @cached_property
    def touched_bodies(self) -> tuple[str, ...]:
        """Bodies whose contacts with the net are stored."""
        return touched_bodies(self.result)

    def contact(self, key: ContactKey) -> Floats:
        """(t,) of a series of a contact."""
        return np.asarray(self.result.contacts[key].values[:])[:, 0]

    def contacts(self, body: str, quantity: str) -> list[Floats]:
        """(t,) of a quantity of threads, of nodes and of bullets, as far as these touch the body."""
        keys = (ContactKey(body, what, quantity) for what in TOUCHING)
        return [self.contact(key) for key in keys if key in self.result.contacts]

    def first_contact(self, body: str) -> float | None:
        """Return when the net first touched a body [s]; None: it did not."""
        return earliest(*self.contacts(body, "first"))

    @cached_property
    def reels(self) -> tuple[str, ...]:
        """Tethers with reels, and a closing line with a winch."""
        names = sorted((*self.result.net.tether_elements, CLOSING))
        return tuple(name for name in names if f"{name}/wound_up" in self.result.states)

    @cached_property
    def spent(self) -> Floats | None:
        """(t, n) impulse that each corner unit has spent [N s]; None without units."""
        return self.state(SPENT) if SPENT in self.result.states else None

    @cached_property
    def work_of_units(self) -> Floats:
        """(t,) work of all corner units [J]."""
        return self.state(WORK)[:, 0]

    @cached_property
    def mouth(self) -> Floats | None:
        """(t,) diameter of the mouth [m], where something closes it or a capture is judged; else None."""
        if self.criterion is None and not any(name.startswith(LINE) for name in self.result.states):
            return None
        return over_blocks(partial(mouth_diameter, self.result.net), self.result.position)

    @cached_property
    def stored_in_contact(self) -> Floats | None:
        """(t,) energy that all contacts store [J]; None: there is no contact."""
        stored = [self.contact(key) for key in self.result.contacts if key.quantity == "stored"]
        stored += [self.state(_SELF_STORED)[:, 0]] if _SELF_STORED in self.result.states else []
        return np.sum(stored, axis=0) if stored else None

    @cached_property
    def dissipated_by(self) -> dict[str, Floats]:
        """(t,) energy dissipated [J] by each of `DISSIPATED` that the scene has."""
        return {name: self.state(name)[:, 0] for name in DISSIPATED if name in self.result.states}


def touched_bodies(result: Result, kinds: tuple[str, ...] = TOUCHING) -> tuple[str, ...]:
    """Return the bodies whose contacts with threads, nodes or bullets of the net are stored."""
    keys = (key for key in result.contacts if key.other in kinds and not key.of_bodies)
    return tuple(dict.fromkeys(key.body for key in keys))


def touching_pairs(result: Result) -> tuple[Pair, ...]:
    """Return the pairs of bodies whose contact with each other is stored; both ways are stored apart."""
    found = {frozenset((key.other, key.body)) for key in result.contacts if key.of_bodies}
    bodies = sorted({name for pair in found for name in pair})
    return tuple(pair for pair in pairs_of(bodies) if frozenset(pair) in found)


_CONTACT = {"touching": ("number in contact", ""), "force": ("force across the surface", "N")}  # words, unit
PULLS = {"force": ("force", "N"), "torque": ("torque about the centre of mass", "N m")}  # words, unit


class TimeSeries(NamedTuple):
    """A quantity over the stored times of a run.

    name    : such as "area" or "contact_target/threads_force"
    words   : its name in figures
    unit    : "N", "m2", ...; "": none
    values  : (t,) in SI units
    general : it is one of every scene, which the figure of bands shows
    contact : key of a series of a contact
    """

    name: str
    words: str
    unit: str
    values: Floats
    general: bool = False
    contact: ContactKey | None = None


def thrust_name(unit: int) -> str:
    """Return the name of the thrust of a corner unit, the first of which is number 0."""
    return f"control/thrust_{unit}"


def spin_name(body: str, axis: str) -> str:
    """Return the name of a rigid body's angular velocity about its axis "x", "y" or "z"."""
    return f"body_{body}/angular_velocity_{axis}"


def pull_name(place: str, quantity: str) -> str:
    """Return the name of one of `PULLS` of threads on a body at a place (`AttachmentPoint.name`)."""
    return f"attachment_{place}/{quantity}"


def time_series(run: Observables, *, capture: bool = True) -> Iterator[TimeSeries]:
    """Yield the time series that a run has.

    capture : with those of a capture, which take 20 ms a state
    """
    yield from _general(run, capture=capture)
    yield from _closing(run)
    for key in run.result.contacts:
        if key.quantity in _CONTACT:
            quantity, symbol = _CONTACT[key.quantity]
            words = f"{quantity}, {key.other} on {key.body}"
            yield TimeSeries(str(key), words, symbol, run.contact(key), contact=key)
    for unit in range(0 if run.spent is None else run.spent.shape[1]):
        words = f"mean thrust of corner unit {unit} since the instant before"
        yield TimeSeries(thrust_name(unit), words, "N", _mean_thrust(run, unit))
    for place, sizes in run.attachments.items():
        where = "by the packed net" if place.node == PACKED else f"at {run.result.net.node_words(place.node)}"
        for column, (quantity, (words, unit_of)) in enumerate(PULLS.items()):
            words = f"{words} on {place.body} {where}"
            yield TimeSeries(pull_name(place.name, quantity), words, unit_of, sizes[:, column])
    for body, states in run.result.bodies.items():
        spin = np.asarray(states.angular_velocity[:])
        for column, axis in enumerate("xyz"):
            words = f"angular velocity of {body} in its axes, {axis}"
            yield TimeSeries(spin_name(body, axis), words, "rad/s", spin[:, column])


def _general(run: Observables, *, capture: bool) -> Iterator[TimeSeries]:
    result, speed = run.result, run.bullet_speed
    found: list[tuple[str, str, str, Floats | None]] = []
    if run.achievable_area:
        found.append(("area", "mouth area", "m2", run.area))
    if speed.shape[1]:
        found.append(("bullet_speed", "mean speed of bullets", "m/s", speed.mean(axis=1)))
        found.append(("slowest_bullet", "slowest bullet", "m/s", speed.min(axis=1)))
        found.append(("fastest_bullet", "fastest bullet", "m/s", speed.max(axis=1)))
    found += [
        ("tension", "largest tension of all elements", "N", run.tension),
        ("kinetic", "kinetic energy", "J", np.asarray(result.kinetic[:])),
        ("elastic", "elastic energy", "J", np.asarray(result.elastic[:])),
        ("dissipated", "energy dissipated", "J", run.dissipated),
    ]
    found.append(("mouth", "diameter of the mouth", "m", run.mouth))
    for name, words, unit, values in found:
        if values is not None:
            yield TimeSeries(name, words, unit, values, general=True)
    if capture and run.capture is not None:
        yield from capture_series(run.capture)


def capture_series(measures: Measures) -> Iterator[TimeSeries]:
    """Yield what is shown of the measures of a capture."""
    yield TimeSeries("enclosed", "part enclosed", "", measures.enclosed, general=True)
    yield TimeSeries("cqi", "capture quality index", "", measures.cqi, general=True)
    yield TimeSeries("mcqi", "modified index", "", measures.mcqi, general=True)


_CLOSING = (
    (f"{LINE}tension_start", "tension at the start of the closing line", "N"),
    (f"{LINE}tension_end", "tension at the end of the closing line", "N"),
    (f"{LINE}way", "path length of the closing line through its rings", "m"),
    (f"{LINE}wound_up", "length of the closing line wound up", "m"),
    (EDGE, "part of the edge's length that is left", ""),
)


def _closing(run: Observables) -> Iterator[TimeSeries]:
    for name, words, unit in _CLOSING:
        if name in run.result.states:
            yield TimeSeries(name, words, unit, run.state(name)[:, 0])


def _mean_thrust(run: Observables, unit: int) -> Floats:
    """(t,) between each time and that before; at the first that of the first interval, or 0 without one."""
    assert run.spent is not None
    thrust = np.diff(run.spent[:, unit]) / np.diff(run.time)
    return np.concatenate([thrust[:1], thrust]) if len(thrust) else np.zeros(1)


def further_series(run: Observables) -> Iterator[TimeSeries]:
    """Yield what is shown over time but not stored of ensembles: potential energy, distances, reels."""
    result = run.result
    potential = np.asarray(result.potential[:])
    if np.ptp(potential):
        yield TimeSeries("potential", "potential energy", "J", potential)
    for name in (name for name in run.reels if name != CLOSING):
        values = run.state(f"{name}/wound_up")[:, 0]
        yield TimeSeries(f"{name}/wound_up", f"length of {name} wound up", "m", values)
    pairs = pairs_of(list(shapes_of(result)))[:MOST_PAIRS]
    for (one, other), gaps in zip(pairs, gaps_of(result, pairs).T, strict=True):
        yield TimeSeries(f"distance {one} {other}", f"distance of {one} and {other}", "m", gaps)
