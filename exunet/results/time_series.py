"""Time series of a run: the quantities over time of which an ensemble stores quantiles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.status import OF_BODY
from exunet.results.capture import Measures
from exunet.results.clearance import MOST_PAIRS, gaps_of, pairs_of, shapes_of
from exunet.results.loads import PACKED
from exunet.results.observables import CONTACT, EDGE, LINE, Observables

Floats = NDArray[np.float64]

PULLS = {"force": ("force", "N"), "torque": ("torque about the centre of mass", "N m")}  # words, unit


class TimeSeries(NamedTuple):
    """A quantity over the stored times of a run.

    name    : such as "area" or "contact_target/threads_force"
    words   : its name in figures
    unit    : "N", "m2", ...; "": none
    values  : (t,) in SI units
    general : it is one of every scene, which the figure of bands shows
    """

    name: str
    words: str
    unit: str
    values: Floats
    general: bool = False


def thrust_name(unit: int) -> str:
    """Return the name of the thrust of a corner unit, the first of which is number 0."""
    return f"control/thrust_{unit}"


def spin_name(body: str, axis: str) -> str:
    """Return the name of a rigid body's angular velocity about its axis "x", "y" or "z"."""
    return f"body_{body}/angular_velocity_{axis}"


def pull_name(place: str, quantity: str) -> str:
    """Return the name of one of `PULLS` of threads on a body at a place (`Attachment.name`)."""
    return f"attachment_{place}/{quantity}"


def momentum_name(kind: str, part: str) -> str:
    """Return the name of the change of a part's momentum of a kind ("linear", "angular")."""
    return f"{'momentum' if kind == 'linear' else 'angular_momentum'}/{part}"


def time_series(run: Observables, *, capture: bool = True) -> Iterator[TimeSeries]:
    """Yield the time series that a run has, but for momenta, whose direction an ensemble chooses.

    capture : with those of a capture, which take 20 ms a state
    """
    yield from _general(run, capture=capture)
    yield from _closing(run)
    for name, values in run.states(CONTACT).items():
        body, _, series = name.removeprefix(CONTACT).rpartition("/")
        what, _, quantity = series.removeprefix(OF_BODY).rpartition("_")
        if quantity == "touching":
            yield TimeSeries(name, f"number in contact, {what} on {body}", "", values)
        elif quantity == "force":
            yield TimeSeries(name, f"force across the surface, {what} on {body}", "N", values)
    for unit in range(0 if run.spent is None else run.spent.shape[1]):
        words = f"mean thrust of corner unit {unit} since the instant before"
        yield TimeSeries(thrust_name(unit), words, "N", _mean_thrust(run, unit))
    for place, sizes in run.attachments.items():
        where = "by the packed net" if place.node == PACKED else f"at {run.result.net.node_words(place.node)}"
        for column, (quantity, (words, unit_of)) in enumerate(PULLS.items()):
            words = f"{words} on {place.body} {where}"
            yield TimeSeries(pull_name(place.name, quantity), words, unit_of, sizes[:, column])
    for body, states in run.result.bodies.items():
        if states.angular_velocity is not None:
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
    for name in result.states:
        if name.endswith("/wound_up") and not name.startswith(LINE):
            words = f"length of {name.removesuffix('/wound_up')} wound up"
            yield TimeSeries(name, words, "m", run.state(name)[:, 0])
    pairs = pairs_of(list(shapes_of(result)))[:MOST_PAIRS]
    for (one, other), gaps in zip(pairs, gaps_of(result, pairs).T, strict=True):
        yield TimeSeries(f"distance {one} {other}", f"distance of {one} and {other}", "m", gaps)
