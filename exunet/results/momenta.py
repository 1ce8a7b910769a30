"""Momentum and energy of each part of a scene over time, and what effects and prescribed bodies gave."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.kinematics import GIVEN, first_given
from exunet.bodies.rotations import rotation_matrix
from exunet.forces.from_outside import OUTSIDE, effects_of
from exunet.model.ejection import Ejection
from exunet.results.result import BodyStates, Result, blocks

Floats = NDArray[np.float64]

NET = "net"  # name of the net among the parts: all mass that is not a body's
IMPULSE_OF = "impulse of "  # before the name of what has given it
KINDS = {"linear": slice(0, 3), "angular": slice(3, 6)}  # columns of `Part`


class Part(NamedTuple):
    """Momentum [kg m/s], angular momentum about the scene's origin [kg m2/s] and energy [J] of a part.

    values : (t, 7) of a free body or of the net, with its kinetic energy; of a prescribed body the impulse,
             angular impulse and work that it has given to all else; of an effect without work
    start  : (7,) at the start, before an ejection at time 0
    """

    values: Floats
    start: Floats

    @property
    def gained(self) -> Floats:
        """(t, 7) change since the start: an ejection at time 0 is part of the run."""
        return self.values - self.start


def prescribed(result: Result) -> tuple[str, ...]:
    """Return the names of the bodies whose motion is given."""
    return tuple(name for name in result.bodies if first_given(name) in result.states)


def momenta(result: Result) -> dict[str, Part]:
    """Compute the parts of the balances of a scene with bodies, in the scene's axes; empty without bodies.

    Free bodies by their names, the net (with strings, bullets and tethers) as "net", and what prescribed
    bodies and external effects have given as "impulse of NAME".
    """
    if not result.bodies:
        return {}
    fixed, mass = prescribed(result), result.net.mass.copy()
    values = {}
    for name, body in result.bodies.items():
        if body.nodes is not None:
            mass[body.nodes] = 0.0  # which the body has
        if name not in fixed:
            values[name] = _of_body(body)
    values[NET] = np.concatenate(
        [
            _of_points(mass, position, velocity)
            for position, velocity in zip(blocks(result.position), blocks(result.velocity), strict=True)
        ]
    )
    given = {name: name for name in fixed} | {name: OUTSIDE + name for name in effects_of(result.states)}
    for name, term in given.items():
        states = (result.states.get(f"{term}/{quantity}") for quantity, *_ in GIVEN)
        parts = [np.asarray(state.values[:]) for state in states if state is not None]
        work = [] if name in fixed else [np.zeros((len(result.time), 1))]
        values[IMPULSE_OF + name] = np.concatenate([*parts, *work], axis=1)
    starts = {name: part[0].copy() for name, part in values.items()}
    for event in result.provenance.get(Ejection.heading, []):
        if event["time_s"] == 0.0:
            _before_ejection(starts, event)
    return {name: Part(part, starts[name]) for name, part in values.items()}


def _before_ejection(starts: dict[str, Floats], event: Mapping[str, object]) -> None:
    """Set the momenta and energies of the start to those before an ejection at time 0."""
    named = ("net_momentum_gained_kg_m_s", "net_angular_momentum_gained_kg_m2_s")
    momentum = np.concatenate([np.array(event[name], dtype=float) for name in named])
    kinetic, body = float(event["net_kinetic_energy_gained_J"]), str(event["body"])  # type: ignore[arg-type]
    starts[NET] = starts[NET] - np.append(momentum, kinetic)
    if body in starts:
        lost = float(event["energy_lost_J"])  # type: ignore[arg-type]
        starts[body] = starts[body] + np.append(momentum, lost + kinetic)
    else:
        starts[IMPULSE_OF + body] = np.zeros(7)


def _of_points(mass: Floats, position: Floats, velocity: Floats) -> Floats:
    """(t, 7) of points of masses (n,), (t, n, 3) [m], [m/s]."""
    linear = np.einsum("n,tna->ta", mass, velocity)
    angular = np.einsum("n,tna->ta", mass, np.cross(position, velocity))
    energy = 0.5 * np.einsum("n,tna,tna->t", mass, velocity, velocity)
    return np.concatenate([linear, angular, energy[:, None]], axis=1)


def _of_body(body: BodyStates) -> Floats:
    """(t, 7) of a body."""
    position, velocity = np.asarray(body.position[:]), np.asarray(body.velocity[:])
    linear = body.mass * velocity
    angular = np.cross(position, linear)
    energy = 0.5 * body.mass * np.einsum("ta,ta->t", velocity, velocity)
    if body.angular_velocity is not None and body.attitude is not None and body.inertia is not None:
        spin = np.asarray(body.angular_velocity[:])
        turns = spin @ body.inertia
        angular = angular + np.einsum("tab,tb->ta", rotation_matrix(np.asarray(body.attitude[:])), turns)
        energy = energy + 0.5 * np.einsum("ta,ta->t", spin, turns)
    return np.concatenate([linear, angular, energy[:, None]], axis=1)


def direction(changes: Mapping[str, Floats]) -> Floats:
    """(3,) unit vector of the largest of some changes (t, 3), its largest part positive; x without any."""
    largest = max(changes.values(), key=lambda change: float(np.linalg.norm(change, axis=1).max()))
    row = largest[int(np.linalg.norm(largest, axis=1).argmax())]
    size = float(np.linalg.norm(row))
    if size == 0.0:
        return np.array([1.0, 0.0, 0.0])
    return np.asarray(row / size * np.sign(row[int(np.abs(row).argmax())])) + 0.0
