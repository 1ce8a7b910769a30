"""Metrics of a run: named numbers with unit and, where they have one, time and place.

A metric is yielded by one of the functions in `METRICS`. To add a metric, add a function to that list, and a
line to the list of metrics in docs/reference/metrics.md. A metric that a run does not have is not yielded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.bodies.rotations import product, rotation_vector
from exunet.forces.contact.status import ContactKey
from exunet.forces.effects import EFFECTS
from exunet.forces.from_outside import OUTSIDE
from exunet.net.arrays import NET, TETHER
from exunet.results.capture import Measures
from exunet.results.clearance import Pair
from exunet.results.loads import PACKED, AttachmentPoint
from exunet.results.measures import (
    IMPULSE_OF,
    NEARLY_OPEN,
    deployment_from_area,
    stays_the_same,
    work_of_ejection,
)
from exunet.results.measures import NET as NET_PART
from exunet.results.observables import DISSIPATED, LINE, SELF, Observables, earliest, touching_pairs
from exunet.results.outcome import Outcome, outcome
from exunet.results.result import Result
from exunet.results.run_record import ALL_STEPS, Peak

STEADY = 0.01  # part of the largest area: a mouth that changes by less does not open
COUNT = 1.0 - 1e-9  # resolution of whole numbers: printed as such, of which any two differ
# Change of numbers by perturbations of 1e-9 m themselves: [m/s], [rad/s], [rad], [N], [N m], [N s], [J].
SMALL = 1e-8
STORED, STEP = "stored times", "steps"  # what limits the resolution of an instant
DIGITS = 4  # significant digits that are printed


def printed(value: float, last: float) -> str:
    """Format a value down to a digit: 1234.6 with 0.1, 1200 with 100; without rounding where that is 0."""
    if last <= 0.0 or not math.isfinite(last):
        return f"{value:.4g}"
    if abs(value) < 0.5 * last:
        return "0"
    decimals = -math.floor(math.log10(last) + 1e-9)
    if abs(value) >= 1e7 or decimals > 7:
        digits = max(0, math.floor(math.log10(max(abs(value), last))) + decimals)
        return f"{value:.{digits}e}"
    return f"{round(value, decimals):.{max(0, decimals)}f}"


@dataclass(frozen=True)
class Metric:
    """A named number of a run.

    name       : without unit
    words      : its name in tables and figures
    unit       : "N", "m2", ...; "": none
    value      : in SI units
    time       : when [s]; None: at no particular time
    place      : where, such as "element 63"; "": nowhere in particular
    remark     : printed after the value
    resolution : differences up to this [unit] are those of round-off, or of perturbations themselves
    size       : what the printed digits are counted from, where that is more than the value: of a component
                 the whole vector, of a difference what it is small against
    instant    : `STORED` or `STEP`: a time that is known no better than the interval of these; "": no such
    balance    : it is an entry of the balances of momentum and energy
    detail     : not in tables and figures: one of many, of which they have the largest
    """

    name: str
    words: str
    unit: str
    value: float
    time: float | None = None
    place: str = ""
    remark: str = ""
    resolution: float = 1e-12
    size: float = 0.0
    instant: str = ""
    balance: bool = False
    detail: bool = False

    @property
    def key(self) -> str:
        """Name and unit, as in summary.json."""
        unit = self.unit.replace("/", "_").replace(" ", "_")
        return f"{self.name}_{unit}" if unit else self.name

    def last_digit(self, value: float) -> float:
        """Return what the last printed digit of a value counts."""
        size = max(abs(value), self.size)
        digit = 10.0 ** (math.floor(math.log10(size)) - DIGITS + 1) if size else 0.0
        return max(digit, self.resolution)

    def __str__(self) -> str:
        return f"{printed(self.value, self.last_digit(self.value))} {self.unit}".rstrip()


@takes(result=Result)
def metrics(result: Result) -> dict[str, Metric]:
    """Compute the metrics of a result, by key, such as "largest_tension_N"."""
    return metrics_of(Observables(result))


def metrics_of(run: Observables) -> dict[str, Metric]:
    """Compute the metrics from observables that are computed already in part."""
    return {metric.key: metric for function in METRICS for metric in function(run)}


def _vector(
    name: str, words: str, unit: str, vector: Floats, size: float = 0.0, **more: Any
) -> Iterator[Metric]:
    """Yield the components x, y, z of a vector (3,); size: what it is small against."""
    size = max(size, float(np.linalg.norm(vector)))
    for axis, value in zip("xyz", vector.tolist(), strict=True):
        yield Metric(f"{name}_{axis}", f"{words}, {axis}", unit, value, size=size, **more)


def _with_time(metric: Metric, before: str, instant: str) -> Iterator[Metric]:
    """Yield a metric and, where it has one, its time as a metric of its own; before: what names its owner."""
    yield metric
    if metric.time is not None:
        name = f"{before}time_of_{metric.name.removeprefix(before)}"
        yield Metric(name, f"time of {metric.words}", "s", metric.time, instant=instant, detail=metric.detail)


# --- the net


def largest_tension(run: Observables) -> Iterator[Metric]:
    """Largest tension of all elements and steps, its time and element."""
    peak = run.peak()
    if peak is None:
        return
    constant = stays_the_same(np.append(run.tension, peak.tension))  # of no step it is the largest then
    yield from _peak("", "largest tension", peak, timed=not constant)
    if peak.element >= 0:
        yield Metric(
            "element_of_largest_tension", "element with the largest tension", "", float(peak.element),
            resolution=COUNT, detail=True,
        )  # fmt: skip


def _peak(before: str, words: str, peak: Peak, *, timed: bool = True) -> Iterator[Metric]:
    taut = peak.element >= 0
    place = f"element {peak.element}" if taut else ""
    remark = "no element was ever taut" if not taut else "" if peak.of == ALL_STEPS else f"of the {peak.of}"
    time = peak.time if taut and timed else None
    metric = Metric(f"{before}largest_tension", words, "N", peak.tension, time, place, remark)
    yield from _with_time(metric, before, STEP)


def deployment(run: Observables) -> Iterator[Metric]:
    """The four metrics of deployment; a mouth that is largest at the start has no time of opening."""
    found = deployment_from_area(run.time, run.area, run.centre, run.achievable_area)
    if found is None:
        return
    opens = not found.constant and found.time_of_largest > run.time[0]
    steady = float(np.ptp(run.area)) <= STEADY * found.largest_area
    yield Metric(
        "largest_area", "largest area", "m2", found.largest_area, found.time_of_largest if opens else None,
        remark=f"changes by less than {STEADY:.0%}" if steady else "",
    )  # fmt: skip
    yield Metric(
        "relative_area", "largest / achievable area", "", found.relative_area, resolution=1e-4,
        remark=f"achievable {found.achievable_area:.3f} m2",
    )  # fmt: skip
    if opens:
        late = "at the end of the run: still growing?" if found.at_end else ""
        yield Metric(
            "time_of_largest_area", "time of largest area", "s", found.time_of_largest, instant=STORED,
            remark=late,
        )  # fmt: skip
        yield Metric(
            "distance", "distance travelled", "m", found.distance, resolution=SMALL,
            remark="centre of mass, until the largest area",
        )  # fmt: skip
    name = f"time_above_{NEARLY_OPEN:.0%}".replace("%", "_percent")
    remark = f"of the achievable: {NEARLY_OPEN * found.achievable_area:.3f} m2"
    yield Metric(name, "area above 80 %", "s", found.time_open, remark=remark)


def bullet_speed(run: Observables) -> Iterator[Metric]:
    """Mean speed of the bullets at the end."""
    if run.bullet_speed.shape[1]:
        yield Metric(
            "bullet_speed_at_end", "bullet speed at the end", "m/s", float(run.bullet_speed[-1].mean()),
            remark="mean",
        )  # fmt: skip


def dissipated_energy(run: Observables) -> Iterator[Metric]:
    """Energy dissipated by the end."""
    effects = run.result.run.effects
    less = " and ".join(kind.PUTS_IN for name, kind in EFFECTS.items() if name in effects and kind.PUTS_IN)
    remark = f"less what {less} put in" if less else ""
    yield Metric("dissipated_energy", "energy dissipated", "J", float(run.dissipated[-1]), remark=remark)


def margins(run: Observables) -> Iterator[Metric]:
    """Least margin of the threads, the strings and each tether."""
    tethers = {TETHER + name: f"tether_{name}_margin" for name in run.result.net.tether_elements}
    for group, margin in run.margins.items():
        name = tethers.get(group, f"margin_of_{group}")
        of = "" if margin.of == ALL_STEPS else ", at stored times, between which it may be less"
        yield Metric(
            name, f"margin of {group}", "", margin.margin, margin.time, f"element {margin.element}",
            f"allowable load {margin.strength:.4g} N / largest tension - 1, at t = {margin.time:.6g} s{of}",
            resolution=1e-4,
        )  # fmt: skip


def tensions_of_groups(run: Observables) -> Iterator[Metric]:
    """In a scene with tethers, the largest tension of the net and of each tether."""
    names = tuple(run.result.net.tether_elements)
    net = run.peak(NET)
    if names and net is not None and net.element >= 0:
        yield from _peak("net_", "largest tension of the net", net)
    for name in names:
        if (peak := run.peak(TETHER + name)) is not None:
            yield from _peak(f"tether_{name}_", f"largest tension of tether {name}", peak)


def closing_line(run: Observables) -> Iterator[Metric]:
    """Largest tension of a closing line that was ever taut, and its margin."""
    line = run.states(LINE)
    if not line or f"{LINE}largest" not in line or not line[f"{LINE}largest"][-1] > 0.0:
        return
    tension, time = (float(line[LINE + name][-1]) for name in ("largest", "largest_time"))
    words = "largest tension of the closing line"
    metric = Metric("closing_largest_tension", words, "N", tension, time, remark="of all steps")
    yield from _with_time(metric, "closing_", STEP)
    if f"{LINE}load" in line:
        load, remark = float(line[f"{LINE}load"][-1]), "strength / largest tension - 1"
        yield Metric(
            "closing_margin",
            "margin of the closing line",
            "",
            1.0 / load - 1.0,
            remark=remark,
            resolution=1e-4,
        )


def corner_units(run: Observables) -> Iterator[Metric]:
    """Impulse of the corner units, of each and of all, and their work."""
    if run.spent is None:
        return
    spent, work = run.spent[-1], float(run.work_of_units[-1])
    yield Metric(
        "impulse_of_units", "impulse of the corner units", "N s", float(spent.sum()), remark="of all"
    )
    yield Metric("work_of_units", "work of the corner units", "J", work, remark="of all, put in")
    for k, value in enumerate(spent.tolist()):
        yield Metric(f"unit_{k}_impulse", f"impulse of corner unit {k}", "N s", value, detail=True)


def breaks(run: Observables) -> Iterator[Metric]:
    """Number of elements that broke, and when the first did."""
    broken = run.result.run.breaks
    if not run.result.run.can_break:
        return
    yield Metric("elements_broken", "elements that broke", "", float(len(broken)), resolution=COUNT)
    if broken:
        first = min(event.time_s for event in broken)
        yield Metric("first_break", "first break of an element", "s", first, instant=STEP)


def script_entries(run: Observables) -> Iterator[Metric]:
    """Yield first activation and count of each script entry whose time the case does not give."""
    events = run.result.run.done
    for entry in (item.entry for item in run.result.run.script_entries if item.awaited):
        times = [event.time_s for event in events if event.entry == entry]
        if times:
            yield Metric(f"script_{entry}_first", f"script: first {entry}", "s", times[0], instant=STEP)
        number, words = float(len(times)), f"script: times of {entry}"
        yield Metric(f"script_{entry}_times", words, "", number, resolution=COUNT, detail=True)


def wound_up(run: Observables) -> Iterator[Metric]:
    """Length on the drum of each reel, and of a closing line's winch, at the end."""
    for name in run.reels:
        key, words = f"tether_{name}_wound_up", f"length of {name} on the drum"
        if f"{name}/" == LINE:
            key, words = f"{name}_wound_up", "length of the closing line wound up"
        value = float(run.state(f"{name}/wound_up")[-1, 0])
        yield Metric(key, words, "m", value, resolution=1e-9, remark="at the end")


def work_of_reels(run: Observables) -> Iterator[Metric]:
    """Work of each reel on its tether, and of the winch on the closing line."""
    for name in run.reels:
        key, words, remark = f"tether_{name}_work_of_reel", f"work of the reel of {name}", "on the tether"
        if f"{name}/" == LINE:
            key, words, remark = f"{name}_work", "work of the winch", "on the closing line"
        yield Metric(key, words, "J", float(run.state(f"{name}/work")[-1, 0]), remark=remark)


# --- bodies


def motion_of_bodies(run: Observables) -> Iterator[Metric]:
    """Displacement of each body; of a free body its velocities at the end, and its rotation."""
    for name, body in run.result.bodies.items():
        position = body.position[len(run.time) - 1] - body.position[0]
        yield Metric(
            f"body_{name}_displacement", f"displacement of {name}", "m", float(np.linalg.norm(position)),
            resolution=SMALL, remark="at the end",
        )  # fmt: skip
        if name in run.prescribed:
            continue
        yield from _vector(
            f"body_{name}_velocity", f"velocity of {name}", "m/s", body.velocity[len(run.time) - 1],
            resolution=SMALL, remark="at the end, in the scene's axes",
        )  # fmt: skip
        yield from _vector(
            f"body_{name}_angular_velocity", f"angular velocity of {name}", "rad/s",
            body.angular_velocity[len(run.time) - 1], resolution=SMALL,
            remark="at the end, in the body's axes",
        )  # fmt: skip
        back = body.attitude[0] * [1.0, -1.0, -1.0, -1.0]
        turned = float(np.linalg.norm(rotation_vector(product(body.attitude[len(run.time) - 1], back))))
        yield Metric(
            f"body_{name}_turned", f"rotation of {name}", "rad", turned, resolution=SMALL, size=1e-2,
            remark="first attitude to last, the shorter way",
        )  # fmt: skip


def attachment_loads(run: Observables) -> Iterator[Metric]:
    """Largest force and torque of threads at the attachments of each body, and at each attachment."""
    places = list(run.attachments)
    for body in dict.fromkeys(place.body for place in places):
        own = [place for place in places if place.body == body]
        yield from _largest_load(run, own, f"body_{body}_attachment_", f"at an attachment of {body}")
    for place in places:
        where = "by the packed net" if place.node == PACKED else f"at {run.result.net.node_words(place.node)}"
        yield from _largest_load(
            run, [place], f"attachment_{place.name}_", f"on {place.body} {where}", detail=True
        )


def _largest_load(
    run: Observables, places: list[AttachmentPoint], before: str, where: str, *, detail: bool = False
) -> Iterator[Metric]:
    for column, (word, unit, remark) in enumerate(
        (
            ("force", "N", "of threads, at stored times, between which it may be larger"),
            ("torque", "N m", "of that pull, about the body's centre of mass"),
        )
    ):
        sizes = np.stack([run.attachments[place][:, column] for place in places], axis=1)
        row, place = np.unravel_index(int(sizes.argmax()), sizes.shape)
        pulls = sizes[row, place] > 0.0
        metric = Metric(
            f"{before}largest_{word}", f"largest {word} {where}", unit, float(sizes[row, place]),
            float(run.time[row]) if pulls else None, _node(run, places[place]) if pulls else "", remark,
            resolution=SMALL, detail=detail,
        )  # fmt: skip
        yield from _with_time(metric, before, STORED)


def _node(run: Observables, place: AttachmentPoint) -> str:
    return "" if place.node == PACKED else run.result.net.node_words(place.node)


def distances(run: Observables) -> Iterator[Metric]:
    """Least distance of bodies with shapes; bodies that always are as near have no time of it."""
    for (one, other), nearest in run.nearest.items():
        constant = stays_the_same(np.array([nearest.distance, nearest.largest]))
        before, words = f"bodies_{one}+{other}_", f"least distance of {one} and {other}"
        late = "; at the end of the run: still approaching?" if nearest.time == run.time[-1] else ""
        metric = Metric(
            f"{before}least_distance", words, "m", nearest.distance, None if constant else nearest.time,
            resolution=SMALL, remark=f"surface to surface, between stored times by interpolation{late}",
        )  # fmt: skip
        yield from _with_time(metric, before, "")


def contacts_of_bodies(run: Observables) -> Iterator[Metric]:
    """First contact of two bodies, maximum penetration, and largest force."""
    for pair in touching_pairs(run.result):
        first, deepest, force = (_of_pair(run, pair, name) for name in ("first", "deepest", "force"))
        if (touched := earliest(*first)) is None:
            continue
        before, words = f"bodies_{'+'.join(pair)}_", " and ".join(pair)
        yield from _contact(
            before, f"of {words}", f"deepest contact of {words}", f"largest force of {words}",
            touched, float(np.max(deepest)),
            float(np.sum(force, axis=0).max()), "sum across the surfaces, of the stored times",
        )  # fmt: skip


def _of_pair(run: Observables, pair: Pair, quantity: str) -> list[Floats]:
    """(t,) of each way of two bodies, as far as it is stored; empty where they never touched."""
    series = []
    for presses, touched in (pair, pair[::-1]):
        first = ContactKey(touched, presses, "first", of_bodies=True)
        if first in run.result.contacts and run.contact(first).max() >= 0.0:
            series.append(run.contact(replace(first, quantity=quantity)))
    return series


def _contact(
    before: str,
    of: str,
    deepest_words: str,
    force_words: str,
    first: float,
    deepest: float,
    force: float,
    sum_of: str,
) -> Iterator[Metric]:
    yield Metric(
        f"{before}first{'_contact' * before.startswith('bodies_')}",
        f"first contact {of}",
        "s",
        first,
        instant=STEP,
    )
    remark = "surface in surface, of all steps"
    yield Metric(f"{before}deepest", deepest_words, "m", deepest, resolution=SMALL, remark=remark)
    yield Metric(f"{before}largest_force", force_words, "N", force, remark=sum_of)


def contacts_of_the_net(run: Observables) -> Iterator[Metric]:
    """First contact of the net with each body, maximum penetration, number in contact, and largest force."""
    for body in run.touched_bodies:
        first = run.first_contact(body)
        if first is None:
            continue
        deepest = float(np.max(run.contacts(body, "deepest")))
        touching, force = (np.sum(run.contacts(body, name), axis=0).max() for name in ("touching", "force"))
        yield from _contact(
            f"contact_{body}_", f"with {body}", f"deepest in {body}", f"largest force on {body}",
            first, deepest, float(force), "sum across the surface, of the stored times",
        )  # fmt: skip
        yield Metric(
            f"contact_{body}_most_touching", f"most that touch {body}", "", float(touching), resolution=COUNT,
            remark="elements, nodes and bullets, of the stored times",
        )  # fmt: skip


def contacts_of_threads(run: Observables) -> Iterator[Metric]:
    """First contact of threads with each other, maximum penetration, number of pairs, and largest force."""
    series = run.states(SELF)
    if f"{SELF}first" not in series or (first := earliest(series[f"{SELF}first"])) is None:
        return
    yield from _contact(
        "self_contact_", "of threads", "deepest overlap of threads", "largest force between threads",
        first, float(series[f"{SELF}deepest"].max()), float(series[f"{SELF}force"].max()),
        "sum over all pairs, of the stored times",
    )  # fmt: skip
    yield Metric(
        "self_contact_most_touching", "most pairs of elements that touch", "",
        float(series[f"{SELF}touching"].max()), resolution=COUNT, remark="of the stored times",
    )  # fmt: skip


_OF_THE_COUNT = 1e-3  # to which an enclosed part is known, see `exunet.results.capture.POINTS`
_CAPTURE = {  # words, unit, remark, resolution
    "enclosed": ("part enclosed", "", "of the target's volume, in the convex hull of the net", _OF_THE_COUNT),
    "cqi": ("capture quality index", "", "less is better", SMALL),
    "mcqi": ("modified index", "", "less is better", _OF_THE_COUNT),
    "mouth": ("diameter of the mouth", "m", "largest distance of two nodes of its rim", SMALL),
    "relative_speed": ("relative speed", "m/s", "of the centres of net and target", SMALL),
    "relative_spin": ("relative spin", "rad/s", "of net and target", SMALL),
    "distance": ("distance of net and target", "m", "of the nearest node", SMALL),
}
assert tuple(_CAPTURE) == Measures._fields


def capture(run: Observables) -> Iterator[Metric]:
    """When the target was captured, lost or missed, and the quantities of the criterion at the end."""
    found = outcome(run)
    if found is None or run.capture is None:
        return
    if found.outcome is Outcome.ESCAPED and found.time is not None:
        yield Metric("escape_time", "escaped after", "s", found.time, instant=STORED)
    if found.outcome is Outcome.MISSED:
        metric = Metric(
            "capture_missed_by", "missed by", "m", found.distance, found.time, resolution=SMALL,
            remark="least distance of a node from the target",
        )  # fmt: skip
        yield from _with_time(metric, "capture_", STORED)
    if found.outcome is Outcome.CAPTURED and found.since is not None:
        yield Metric("capture_time", "captured from", "s", found.since, instant=STORED)
    for name, (words, unit, remark, resolution) in _CAPTURE.items():
        value = float(getattr(run.capture, name)[-1])
        words = f"{words} at the end"
        yield Metric(f"capture_{name}", words, unit, value, resolution=resolution, remark=remark)


# --- balances of momentum and energy

# What an entry of the balances is small against: parts of the largest entry, and of its own quantity.
_OF_LARGEST, _OF_OWN = 1e-3, 1e-6
_MOMENTUM, _ANGULAR, _ENERGY = slice(0, 3), slice(3, 6), slice(6, 7)  # columns of `momenta.Part`


def balances(run: Observables) -> Iterator[Metric]:
    """Yield gains of free bodies and the net, and shares of prescribed bodies, effects and an ejection."""
    if not run.momenta:
        return
    for name in run.result.bodies:
        if name in run.prescribed:
            yield from _given(run, f"body_{name}", name, f"given by {name}", "to all else")
            yield _work(run, f"body_{name}", name, "on all else")
        else:
            yield from _gained(run, f"body_{name}", name, name)
    for name in run.effects:
        yield from _given(run, f"effect_{name}", name, f"of {name}", "on all", NET_PART)
        if f"{OUTSIDE}{name}/work" in run.result.states:
            yield _work(run, f"effect_{name}", name, "put in")
    yield from _gained(run, "net", NET_PART, "the net")
    elastic, potential, ejection = _energies(run)
    largest = _OF_LARGEST * _largest(run, _ENERGY)
    yield Metric(
        "elastic_energy_gained", "elastic energy gained", "J", elastic, size=largest, resolution=SMALL,
        remark="of all threads", balance=True,
    )  # fmt: skip
    if potential is not None:
        own = _OF_OWN * float(np.abs(run.result.potential).max(initial=0.0))
        yield Metric(
            "potential_energy_gained", "potential energy gained", "J", potential, size=max(own, largest),
            resolution=SMALL, remark="of contact, loads, fields, springs, and outlets of reels", balance=True,
        )  # fmt: skip
    if ejection is not None:
        remark = "on the net and the body that held it"
        yield Metric("work_of_ejection", "work of the ejection", "J", ejection, remark=remark, balance=True)


def launch_speeds(run: Observables) -> Iterator[Metric]:
    """Speeds that a body's launch gives, before and after its recoil."""
    for event in run.result.run.ejections[:1]:
        for name, words, value in (
            ("added", "launch speed before recoil", event.launch_speed_added_m_s),
            ("relative", "launch speed after recoil", event.launch_speed_relative_m_s),
        ):
            yield Metric(f"launch_speed_{name}", words, "m/s", value, remark=f"relative to {event.body}")


def _energies(run: Observables) -> tuple[float, float | None, float | None]:
    """Changes of elastic and potential energy, and the work of an ejection [J]; None: the scene has none."""
    elastic, potential = run.result.elastic, run.result.potential
    changed = float(potential[-1] - potential[0]) if np.any(potential) else None
    return float(elastic[-1] - elastic[0]), changed, work_of_ejection(run.result.run)


def _gained(run: Observables, key: str, part: str, name: str) -> Iterator[Metric]:
    gained = run.momenta[part].end - run.momenta[part].start
    for columns, kind, unit, remark in (
        (_MOMENTUM, "momentum", "kg m/s", "in the scene's axes"),
        (_ANGULAR, "angular momentum", "kg m2/s", "about the scene's origin"),
    ):
        yield from _vector(
            f"{key}_{kind.replace(' ', '_')}_gained", f"{kind} gained by {name}", unit, gained[columns],
            _size(run, part, columns), remark=remark, resolution=SMALL, balance=True,
        )  # fmt: skip
    yield Metric(
        f"{key}_kinetic_energy_gained", f"kinetic energy gained by {name}", "J", float(gained[6]),
        size=_size(run, part, _ENERGY), resolution=SMALL, balance=True,
    )  # fmt: skip


def _given(
    run: Observables, key: str, name: str, words: str, to: str, small_against: str = ""
) -> Iterator[Metric]:
    """Yield the impulses that a prescribed body or an effect has given by the end."""
    values = run.momenta[IMPULSE_OF + name].end
    for columns, kind, unit, axes in (
        (_MOMENTUM, "impulse", "N s", "in the scene's axes"),
        (_ANGULAR, "angular impulse", "N m s", "about the scene's origin"),
    ):
        yield from _vector(
            f"{key}_{kind.replace(' ', '_')}", f"{kind} {words}", unit, values[columns],
            _size(run, small_against, columns) if small_against else 0.0, remark=f"{to}, {axes}",
            resolution=SMALL, balance=True,
        )  # fmt: skip


def _work(run: Observables, key: str, name: str, remark: str) -> Metric:
    work = float(run.momenta[IMPULSE_OF + name].end[6])
    return Metric(f"{key}_work", f"work of {name}", "J", work, remark=remark, resolution=SMALL, balance=True)


def _size(run: Observables, part: str, columns: slice) -> float:
    """Return the size relative to which a change counts as small."""
    entry = run.momenta[part]
    own = max(float(np.linalg.norm(ends[columns])) for ends in entry)
    return max(_OF_OWN * own, _OF_LARGEST * _largest(run, columns))


def _largest(run: Observables, columns: slice) -> float:
    """The largest change among free bodies and the net; of energies also those of other kinds."""
    parts = (part for name, part in run.momenta.items() if not name.startswith(IMPULSE_OF))
    changes = [float(np.linalg.norm((part.end - part.start)[columns])) for part in parts]
    if columns is _ENERGY:
        changes += [abs(energy) for energy in _energies(run) if energy is not None]
    return max(changes, default=0.0)


def contact_energies(run: Observables) -> Iterator[Metric]:
    """Energy stored in contacts at the end, and dissipated by contacts and a closing line."""
    if run.stored_in_contact is not None:
        yield Metric(
            "stored_in_contact", "stored in contact", "J", float(run.stored_in_contact[-1]),
            size=_OF_LARGEST * float(abs(run.result.potential).max(initial=0.0)), resolution=SMALL,
            remark="at the end, of the potential energy", balance=True,
        )  # fmt: skip
    for name, values in run.dissipated_by.items():
        yield Metric(
            f"taken_by_{name.replace('/', '_')}", f"taken by {DISSIPATED[name]}", "J", float(values[-1]),
            size=_OF_LARGEST * abs(float(run.dissipated[-1])), resolution=SMALL,
            remark="of the energy dissipated", balance=True,
        )  # fmt: skip


METRICS: tuple[Callable[[Observables], Iterator[Metric]], ...] = (
    largest_tension,
    deployment,
    launch_speeds,
    bullet_speed,
    dissipated_energy,
    margins,
    tensions_of_groups,
    closing_line,
    corner_units,
    breaks,
    script_entries,
    wound_up,
    motion_of_bodies,
    attachment_loads,
    distances,
    contacts_of_bodies,
    contacts_of_the_net,
    contacts_of_threads,
    capture,
    balances,
    contact_energies,
    work_of_reels,
)

# The four metrics of deployment, in the order of the paper.
DEPLOYMENT = ("largest_area_m2", "time_of_largest_area_s", "distance_m", "time_above_80_percent_s")


def without_values(metric: Metric) -> Metric:
    """Return what a metric is, without its number, time and place."""
    return replace(metric, value=math.nan, time=None, place="")
