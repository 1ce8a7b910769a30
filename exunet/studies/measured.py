"""Quantities over time that perturbed runs and ensembles store of their states, and both ends of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import GIVEN
from exunet.bodies.rigid import RigidBody, in_frames
from exunet.forces.corner_units import SPENT, WORK
from exunet.forces.from_outside import OUTSIDE, QUANTITIES, effects_of
from exunet.model.states import States
from exunet.model.system import System
from exunet.net.areas import mouth_diameter
from exunet.results import measures as metrics
from exunet.results.capture import capture, target_of
from exunet.results.clearance import MOST_PAIRS, Pair, pairs_of
from exunet.results.course import EDGE, INTERVALS, REEL_STATES, is_closing, winches_of
from exunet.results.ends import AtEnds, Points, before_throw, ends_of, no_ends
from exunet.results.margins import Groups, loaded_over_blocks
from exunet.results.momenta import momenta_in
from exunet.results.over_time import OverTime
from exunet.results.pulls import PulledPlace, places_of, pull_in
from exunet.results.result import BodyStates
from exunet.results.taken import taken_from
from exunet.scene.capture import CaptureCriterion
from exunet.simulation.extremes import series_of
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import fixed_nodes, scene_provenance

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PulledPlaces:
    """The places that tie threads to the bodies of a scene.

    story : metadata of the scene before its run, with the bodies that are held for a while
    """

    places: tuple[PulledPlace, ...] = ()
    story: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, start: Start) -> PulledPlaces:
        """Those of a scene."""
        story = scene_provenance(start).as_json()
        return cls(places_of(fixed_nodes(start.system), story), story)

    def pull(self, states: States) -> Floats:
        """(k, n_places, 2) sizes of force [N] and torque [N m], as if nothing were ever let go."""
        if not self.places:
            return np.zeros((len(states), 0, 2))
        system = states.system
        framed = in_frames(system.bodies, states.bodies)
        bodies = {
            body.name: BodyStates(
                body.mass, None, framed.position[:, k], framed.velocity[:, k], attitude=framed.attitude[:, k]
            )
            for k, body in enumerate(system.bodies)
        }
        position = states.position[:, : system.net.n_nodes]
        return pull_in(system.net, self.places, self.story, bodies, position, states.tension)


_COPIES = 3  # of the numbers of a course in memory: itself, with those beside it, and quantiles over many
MOTION = 13  # numbers of a body: place, velocity, attitude, angular velocity


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured(OverTime):
    """What an ensemble keeps of states (k,), here of one run.

    motion  : (k, n_shown, 13) of the bodies of `shown_pairs`: place [m] and velocity [m/s] of the centre of
              mass, attitude, angular velocity in axes of the body [rad/s]
    capture : (k, 6) the fields of `exunet.results.capture.Measures`; (k, 0) without a rule
    """

    motion: Floats
    capture: Floats


MEASURED = tuple(item.name for item in fields(Measured))


def rows_of(measured: Measured, start: int, stop: int) -> Measured:
    """Some rows of what was measured."""
    return Measured(**{name: getattr(measured, name)[start:stop] for name in MEASURED})


def shown_pairs(system: System) -> list[Pair]:
    """The bodies whose distances are headlines."""
    return pairs_of([body.name for body in system.bodies if body.shape is not None])[:MOST_PAIRS]


def _drums(states: States) -> Floats:
    """(k, n_reels, 2) of each reel: wound up [m], work [J]."""
    blocks = states.system.blocks
    reels, first = winches_of(state.name for state in blocks.states), blocks.n_x - blocks.n_states
    columns = [blocks.state(f"{name}/{what}") - first for name in reels for what in REEL_STATES]
    return np.asarray(states.first_order[:, columns].reshape(len(states), len(reels), len(REEL_STATES)))


def _units(states: States) -> Floats:
    """(k, n_units + 1) impulse that each corner unit has spent [N s], and then the work of all [J]."""
    blocks = states.system.blocks
    size = sum(len(state.initial) for state in blocks.states if state.name in (SPENT, WORK))
    first = blocks.state(SPENT) - (blocks.n_x - blocks.n_states) if size else 0
    return states.first_order[:, first : first + size]


def _mouth(states: States) -> Floats:
    """(k, 1) diameter of the mouth [m], where something closes it; (k, 0) elsewhere."""
    system = states.system
    kept = [state.name for state in system.blocks.states] + [one.name for _, one in series_of(system)]
    if not is_closing(kept):
        return np.zeros((len(states), 0))
    return mouth_diameter(system.net, states.position[:, : system.net.n_nodes])[:, None]


def _edge(states: States) -> Floats:
    """(k, 1) part that is left of an edge that becomes shorter; (k, 0) without one."""
    blocks = states.system.blocks
    size = sum(state.name == EDGE for state in blocks.states)
    first = blocks.state(EDGE) - (blocks.n_x - blocks.n_states) if size else 0
    return states.first_order[:, first : first + size]


def _spins(states: States) -> Floats:
    """(k, n_rigid, 3) angular velocities of rigid bodies, in axes of each [rad/s], as in a result."""
    if not states.system.bodies:
        return np.zeros((len(states), 0, 3))
    return in_frames(states.system.bodies, states.bodies).angular_velocity


def _taken(states: States) -> Floats:
    """(k, n_taken) what damping and friction of contacts have taken [J]."""
    blocks = states.system.blocks
    first = blocks.n_x - blocks.n_states
    names = (state.name for state in blocks.states)
    return taken_from(states.first_order, names, lambda name: blocks.state(name) - first)


def shown_bodies(system: System) -> list[RigidBody]:
    """Those of these pairs."""
    names = {name for pair in shown_pairs(system) for name in pair}
    return [body for body in system.bodies if body.name in names]


def _motion(states: States) -> Floats:
    """(k, n_shown, 13) of these bodies: place, velocity, attitude and angular velocity, as in a result."""
    shown = {body.name for body in shown_bodies(states.system)}
    rows = [k for k, body in enumerate(states.system.bodies) if body.name in shown]
    if not rows:
        return np.zeros((len(states), 0, MOTION))
    framed = in_frames(states.system.bodies, states.bodies)
    return np.concatenate([part[:, rows] for part in framed.parts()], axis=-1)


def _capture(states: States, rule: CaptureCriterion | None) -> Floats:
    """(k, 6) the measures of a capture; (k, 0) without a rule."""
    if rule is None:
        return np.zeros((len(states), 0))
    system = states.system
    number = [body.name for body in system.bodies].index(rule.target)
    shape = system.bodies[number].shape
    assert shape is not None  # which a check of the case sees to
    framed = in_frames(system.bodies, states.bodies)
    own = system.bodies[number]
    pose = own.frame_poses(states.bodies.position[:, number], states.bodies.attitude[:, number])
    nodes = slice(0, system.net.n_nodes)
    points = states.position[:, nodes], states.velocity[:, nodes]
    twist = [framed.velocity[:, number], framed.angular_velocity[:, number]]
    body = pose, np.concatenate(twist, axis=1)
    found = capture(system.net, rule, target_of(shape, own.centre), points, body)
    return np.stack(found, axis=1)


def measured(
    states: States,
    dissipated: Floats,
    rule: CaptureCriterion | None = None,
    pulled: PulledPlaces = PulledPlaces(),
) -> Measured:
    """Of states (k,).

    dissipated : (k,) energy taken out by then [J]
    rule       : of the capture; None: the case has none
    pulled     : where threads pull on bodies
    """
    net = states.system.net
    tension = states.tension
    masses = list(states.system.blocks.body.values())
    position = states.position[:, : net.n_nodes]
    loaded, loaded_element = loaded_over_blocks(Groups.of(net), tension)
    return Measured(
        bullet_speed=metrics.speeds_of(net.bullet_nodes, states.velocity),
        area=metrics.mouth_area(net, position),
        kinetic=states.kinetic,
        elastic=states.elastic,
        potential=states.potential,
        dissipated=dissipated + states.system.put_in(states.first_order),
        centre=metrics.net_centre(net, position),
        tension=tension.max(axis=1, initial=0.0),
        body_centre=np.concatenate([states.position[:, masses], states.bodies.position], axis=1),
        reel=_drums(states),
        motion=_motion(states),
        loaded=loaded,
        loaded_element=loaded_element,
        capture=_capture(states, rule),
        units=_units(states),
        pull=pulled.pull(states),
        mouth=_mouth(states),
        edge=_edge(states),
        spin=_spins(states),
        momentum=_momenta(states),
        taken=_taken(states),
    )


def ends_in(first: States, last: States, story: Mapping[str, Any]) -> NDArray[np.void]:
    """At the first of some states, before an ejection there, and at the last of others.

    story : with the events of the run
    """
    system = first.system
    if not (system.bodies or system.blocks.body):
        return no_ends()
    position, velocity = (
        np.stack([getattr(first, name)[0], getattr(last, name)[-1]]) for name in ("position", "velocity")
    )
    framed = (in_frames(system.bodies, states.bodies) for states in (first, last))
    whole = [np.stack([a[0], b[-1]]) for a, b in zip(*(item.parts() for item in framed), strict=True)]
    given = np.stack([first.first_order[0], last.first_order[-1]])
    ends = _records(system, position, velocity, whole, given)
    rigid = [body.name for body in system.bodies]
    guided = [name for name, free in zip(rigid, system.moves_freely, strict=True) if not free]
    return before_throw(ends, [*system.blocks.body, *rigid], guided, story)


def _momenta(states: States) -> Floats:
    """(k, n_parts, 6) momenta of all parts; (k, 0, 6) without bodies."""
    system = states.system
    if not (system.bodies or system.blocks.body):
        return np.zeros((len(states), 0, 6))
    whole = in_frames(system.bodies, states.bodies).parts()
    records = _records(system, states.position, states.velocity, whole, states.first_order)
    guided = [False] * len(system.blocks.body) + [not free for free in system.moves_freely]
    return momenta_in(records, guided, records.shape[1] - len(guided) - 1)


def _records(
    system: System, position: Floats, velocity: Floats, whole: Sequence[Any], given: Floats
) -> NDArray[np.void]:
    """(k, n_bodies + n_outside + 1) records `END` in k states.

    position, velocity : (k, n_points, 3) [m], [m/s]
    whole : of rigid bodies in their frames: place, velocity, attitude, angular velocity
    given : (k, n_states) first-order states
    """
    found = [
        AtEnds(BodyStates(float(system.mass[k]), None, position[:, k], velocity[:, k]), {})
        for k in system.blocks.body.values()
    ]
    for k, body in enumerate(system.bodies):
        parts = (values[:, k] for values in whole)
        moved = {} if system.moves_freely[k] else _given(system, body.name, given)
        found.append(AtEnds(BodyStates(body.mass, body.inertia_in_frame, *parts), moved))
    nodes, kept = slice(0, system.net.n_nodes), (state.name for state in system.blocks.states)
    effects = [_given(system, OUTSIDE + name, given, len(QUANTITIES)) for name in effects_of(kept)]
    return ends_of(Points(system.mass[nodes], position[:, nodes], velocity[:, nodes]), found, effects)


def _given(system: System, name: str, first_order: Floats, number: int = len(GIVEN)) -> dict[str, Floats]:
    """(k, m) of the first quantities that a guided body, or an effect, has given, from (k, n_states)."""
    blocks = system.blocks
    found = {}
    for quantity, size, _ in GIVEN[:number]:
        at = blocks.state(f"{name}/{quantity}") - (blocks.n_x - blocks.n_states)
        found[quantity] = first_order[:, at : at + size]
    return found


def course_bytes(start: Start) -> int:
    """What the course of a run takes in memory at most, quantiles over many of them included [bytes]."""
    first = States.of(start.system, start.state)
    found = measured(first, np.zeros(1), start.scene.capture, PulledPlaces.of(start))
    numbers = sum(np.size(getattr(found, name)) for name in MEASURED) + len(series_of(start.system))
    return _COPIES * 8 * numbers * (INTERVALS + 1)
