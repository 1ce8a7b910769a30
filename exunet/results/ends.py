"""What the bodies and the net have at the start and at the end of a run: motion, momentum, energy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import GIVEN, first_given
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.from_outside import OUTSIDE, QUANTITIES, effects_of
from exunet.model.ejection import Ejection
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]

# Of a body, or of the net with its tethers, at one instant:
#
# momentum, angular_momentum : [kg m/s], about the scene's origin [kg m2/s]
# kinetic                    : [J]
# velocity, attitude, spin   : of a body's centre of mass [m/s], quaternion, in body axes [rad/s]
# impulse, angular_impulse, work : that a body of given motion has given to all else [N s], about the scene's
#                              origin [N m s], [J]; the first two also of an effect from outside
END = np.dtype(
    [("momentum", "f8", (3,)), ("angular_momentum", "f8", (3,)), ("kinetic", "f8", ())]
    + [("velocity", "f8", (3,)), ("attitude", "f8", (4,)), ("spin", "f8", (3,))]
    + [(name, "f8", (size,) if size > 1 else ()) for name, size, _ in GIVEN]
)


class Points(NamedTuple):
    """Points with masses of their own (n,) [kg]: places and velocities (t, n, 3) [m], [m/s]."""

    mass: Floats
    position: Floats
    velocity: Floats


class AtEnds(NamedTuple):
    """A body at some instants, as the start and the end.

    body  : whose arrays have a row for each
    given : (t, m) of each quantity in `GIVEN`, by name, of one whose motion is given; else none
    """

    body: BodyStates
    given: Mapping[str, Floats]


def no_ends() -> NDArray[np.void]:
    """(2, 0): of a scene without bodies, of which no book is kept."""
    return np.zeros((2, 0), dtype=END)


def ends_of(
    points: Points, bodies: Sequence[AtEnds], effects: Sequence[Mapping[str, Floats]] = ()
) -> NDArray[np.void]:
    """(t, n_bodies + n_effects + 1) records `END`: of each body, each effect, and last the net (the points).

    effects : (t, 3) of each of its quantities by name (`exunet.forces.from_outside.QUANTITIES`)
    """
    found = np.zeros((len(points.position), len(bodies) + len(effects) + 1), dtype=END)
    for k, effect in enumerate(effects, start=len(bodies)):
        for name, impulses in effect.items():
            found[name][:, k] = impulses
    for k, (body, given) in enumerate(bodies):
        own, spin, attitude = found[:, k], body.angular_velocity, body.attitude
        own["velocity"] = body.velocity
        own["momentum"], own["angular_momentum"] = momenta_of(body)
        own["kinetic"] = 0.5 * body.mass * np.einsum("ta,ta->t", body.velocity, body.velocity)
        if spin is not None and attitude is not None and body.inertia is not None:
            turns = spin @ body.inertia
            own["spin"], own["attitude"] = spin, attitude
            own["kinetic"] += 0.5 * np.einsum("ta,ta->t", spin, turns)
        for name, values in given.items():
            own[name] = values.reshape(own[name].shape)
    net, (mass, position, velocity) = found[:, -1], points
    net["momentum"] = np.einsum("n,tna->ta", mass, velocity)
    net["angular_momentum"] = np.einsum("n,tna->ta", mass, np.cross(position, velocity))
    net["kinetic"] = 0.5 * np.einsum("n,tna,tna->t", mass, velocity, velocity)
    return found


def before_throw(
    ends: NDArray[np.void], names: Sequence[str], guided: Collection[str], story: Mapping[str, Any]
) -> NDArray[np.void]:
    """`ends` with the momenta and energies of the start as they were before an ejection at time 0.

    names : of the bodies; guided : those whose motion is given; story : with the events of the run
    """
    at_start = [item for item in story.get(Ejection.heading, []) if item["time_s"] == 0.0]
    if not at_start:
        return ends
    (event,), found = at_start, ends.copy()
    net, body = found[:1, -1], found[:1, names.index(event["body"])]
    kinetic = event["net_kinetic_energy_gained_J"]
    gains = {
        "momentum": np.array(event["net_momentum_gained_kg_m_s"]),
        "angular_momentum": np.array(event["net_angular_momentum_gained_kg_m2_s"]),
        "kinetic": kinetic,
    }
    for quantity, gain in gains.items():
        net[quantity] -= gain
    if event["body"] in guided:
        for quantity, *_ in GIVEN:
            body[quantity] = 0.0
        return found
    body["momentum"] += gains["momentum"]
    body["angular_momentum"] += gains["angular_momentum"]
    body["kinetic"] += event["energy_lost_J"] + kinetic
    return found


def momenta_of(body: BodyStates) -> tuple[Floats, Floats]:
    """(t, 3) momentum of a body [kg m/s] and angular momentum about the scene's origin [kg m2/s]."""
    linear = body.mass * np.asarray(body.velocity[:])
    angular = np.cross(np.asarray(body.position[:]), linear)
    if body.angular_velocity is not None and body.attitude is not None and body.inertia is not None:
        turns = np.asarray(body.angular_velocity[:]) @ body.inertia
        angular += np.einsum("tab,tb->ta", rotation_matrix(np.asarray(body.attitude[:])), turns)
    return linear, angular


def ends_of_result(result: Result) -> NDArray[np.void]:
    """Of the first and the last stored state; before an ejection at time 0."""
    if not result.bodies:
        return no_ends()
    mass = result.net.mass.copy()
    bodies = []
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        states = ((quantity, result.states.get(f"{name}/{quantity}")) for quantity, *_ in GIVEN)
        given = {quantity: _ends(one.values) for quantity, one in states if one is not None}
        moving = BodyStates(body.mass, body.inertia, _ends(body.position), _ends(body.velocity))
        if body.attitude is not None and body.angular_velocity is not None:
            turning = _ends(body.attitude), _ends(body.angular_velocity)
            moving = replace(moving, attitude=turning[0], angular_velocity=turning[1])
        bodies.append(AtEnds(moving, given))
    effects = [
        {name: _ends(result.states[f"{OUTSIDE}{effect}/{name}"].values) for name, _ in QUANTITIES}
        for effect in effects_of(result.states)
    ]
    found = ends_of(Points(mass, _ends(result.position), _ends(result.velocity)), bodies, effects)
    guided = [name for name in result.bodies if first_given(name) in result.states]
    return before_throw(found, list(result.bodies), guided, result.provenance)


def _ends(values: Floats) -> Floats:
    """The first and the last row, which are read alone where they stay in a file."""
    return np.stack([values[0], values[len(values) - 1]])
