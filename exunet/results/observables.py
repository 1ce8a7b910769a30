"""Quantities over time that are derived from a result, of which metrics and time series are made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.self_contact import NAME as SELF_CONTACT
from exunet.forces.contact.status import OF_BODY
from exunet.forces.corner_units import SPENT, WORK
from exunet.forces.from_outside import effects_of
from exunet.net.areas import achievable_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING
from exunet.results.capture import Measures, capture_of, rule_of
from exunet.results.clearance import MOST_PAIRS, Nearest, Pair, movers_of, nearest, pairs_of
from exunet.results.loads import Attachment, attachment_loads
from exunet.results.margins import Margin, Peak, margins, peaks_of
from exunet.results.measures import bullet_speeds, centre_of_mass, dissipation, largest_tensions, mouth_areas
from exunet.results.momenta import Part, momenta, prescribed
from exunet.results.result import Result, over_blocks
from exunet.scene.capture import CaptureCriterion

Floats = NDArray[np.float64]

THREADS, NODES, BULLETS = TOUCHING = ("threads", "nodes", "bullets")  # what may touch a body
CONTACT = "contact_"  # before the name of the body, in the names of what is stored of contacts
SELF = f"{SELF_CONTACT}/"  # before the names of what is stored of threads that touch each other
LINE = f"{CLOSING}/"  # before the names of what is stored of a closing line
EDGE = f"{LINE}part"  # what is stored of an edge that becomes shorter: the part of its length that is left
_WOUND_UP = "/wound_up"  # of a reel, after the name of its tether, and of a closing line's winch
# First-order states [J] that count what contacts and a closing line dissipate, in words.
DISSIPATED = {
    "contact/damping": "damping of contact",
    "contact/friction": "friction of contact",
    f"{SELF_CONTACT}/damping": "damping between threads",
    f"{CLOSING}/viscosity": "viscosity of the closing line",
    f"{CLOSING}/friction": "friction of the closing line",
}


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
        return max(own, key=lambda peak: (peak.tension, -peak.time), default=None)

    @cached_property
    def margins(self) -> dict[str, Margin]:
        """Least margin of each group of elements whose strength is known."""
        return margins(self.result)

    @cached_property
    def attachments(self) -> dict[Attachment, Floats]:
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
    def momenta(self) -> dict[str, Part]:
        """Momentum and energy of each part, and impulses; empty without bodies."""
        return momenta(self.result)

    @cached_property
    def nearest(self) -> dict[Pair, Nearest]:
        """How near the bodies with shapes of each pair come, between the stored times too."""
        movers = movers_of(self.result)
        return {(a, b): nearest(movers[a], movers[b]) for a, b in pairs_of(list(movers))[:MOST_PAIRS]}

    @cached_property
    def criterion(self) -> CaptureCriterion | None:
        """Criterion of a capture; None: the case has none."""
        return rule_of(self.result)

    @cached_property
    def capture(self) -> Measures | None:
        """(t,) each, of a case with a criterion."""
        return None if self.criterion is None else capture_of(self.result, self.criterion)

    @cached_property
    def touched_bodies(self) -> tuple[str, ...]:
        """Bodies whose contacts with the net are stored."""
        return touched_bodies(self.result)

    def contacts(self, body: str, quantity: str) -> list[Floats]:
        """(t,) of a quantity of threads, of nodes and of bullets, as far as these touch the body."""
        names = (f"{CONTACT}{body}/{what}_{quantity}" for what in TOUCHING)
        return [self.state(name)[:, 0] for name in names if name in self.result.states]

    def first_contact(self, body: str) -> float | None:
        """Return when the net first touched a body [s]; None: it did not."""
        return min((float(t[-1]) for t in self.contacts(body, "first") if t[-1] >= 0.0), default=None)

    @cached_property
    def reels(self) -> tuple[str, ...]:
        """Tethers with reels, and a closing line with a winch."""
        return tuple(name.removesuffix(_WOUND_UP) for name in self.result.states if name.endswith(_WOUND_UP))

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
        if rule_of(self.result) is None and not any(name.startswith(LINE) for name in self.result.states):
            return None
        return over_blocks(partial(mouth_diameter, self.result.net), self.result.position)

    @cached_property
    def stored_in_contact(self) -> Floats | None:
        """(t,) energy that all contacts store [J]; None: there is no contact."""
        series = self.states(CONTACT) | self.states(SELF)
        stored = [values for name, values in series.items() if name.endswith("stored")]
        return np.sum(stored, axis=0) if stored else None

    @cached_property
    def dissipated_by(self) -> dict[str, Floats]:
        """(t,) energy dissipated [J] by each of `DISSIPATED` that the scene has."""
        return {name: self.state(name)[:, 0] for name in DISSIPATED if name in self.result.states}


def touched_bodies(result: Result) -> tuple[str, ...]:
    """Return the bodies whose contacts with the net are stored."""
    parts = (name.removeprefix(CONTACT).rpartition("/") for name in result.states if name.startswith(CONTACT))
    return tuple(dict.fromkeys(body for body, _, series in parts if series.startswith(TOUCHING)))


def touching_pairs(result: Result) -> tuple[Pair, ...]:
    """Return the pairs of bodies whose contact with each other is stored; both ways are stored apart."""
    found = set()
    for name in result.states:
        body, _, series = name.removeprefix(CONTACT).rpartition("/")
        if name.startswith(CONTACT) and series.startswith(OF_BODY) and series.endswith("_deepest"):
            found.add(frozenset((series.removeprefix(OF_BODY).removesuffix("_deepest"), body)))
    bodies = sorted({name for pair in found for name in pair})
    return tuple(pair for pair in pairs_of(bodies) if frozenset(pair) in found)
