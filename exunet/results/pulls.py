"""How hard threads pull at each place that ties them to a body, over time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rotations import rotation_matrix
from exunet.net.arrays import Net
from exunet.results.attached import held_until
from exunet.results.loads import (
    carried_in,
    carried_until,
    is_carrier,
    loads,
    pull_on_packed,
    pulled_nodes,
    pulls_at,
)
from exunet.results.result import BodyStates, Result

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PACKED = -1  # in place of a node: the packed net that a body holds
_PACKED_NAME = "packed"


class PulledPlace(NamedTuple):
    """A node that is fixed to a body, for good or until a script releases it; or `PACKED`."""

    body: str
    node: int

    @property
    def name(self) -> str:
        """In keys of summary.json, such as "chaser_12" or "chaser_packed"."""
        return f"{self.body}_{_PACKED_NAME if self.node == PACKED else self.node}"

    @property
    def label(self) -> str:
        """In figures, such as "chaser, node 12" or "chaser, packed net"."""
        return f"{self.body}, {'packed net' if self.node == PACKED else f'node {self.node}'}"


def place_named(name: str) -> tuple[str, str]:
    """The body, and the place in words, of the name of a `PulledPlace`."""
    body, _, place = name.rpartition("_")
    return body, "by the packed net" if place == _PACKED_NAME else f"at node {place}"


def places_of(fixed: Mapping[str, Ints | None], story: Mapping[str, Any]) -> tuple[PulledPlace, ...]:
    """All places of a scene, body by body.

    fixed : nodes that are fixed to each body for good, by its name; None: none
    story : of the run, which tells what is held for a while
    """
    found = []
    for body, nodes in fixed.items():
        found += [PulledPlace(body, int(node)) for node in pulled_nodes(nodes, story, body)]
        found += [PulledPlace(body, PACKED)] * is_carrier(story, body)
    return tuple(found)


def pull_of(result: Result) -> tuple[tuple[PulledPlace, ...], Floats]:
    """The places of a result, and (t, n_places, 2) sizes of force [N], torque [N m] over its stored times.

    The torque of each is about the body's centre of mass, of a packed net too, so that they can be compared.
    """
    places = places_of({name: body.nodes for name, body in result.bodies.items()}, result.provenance)
    columns = []
    for body in dict.fromkeys(place.body for place in places):
        of = loads(result, body)
        columns += [_sizes(of.force[:, k], of.torque[:, k]) for k in range(len(of.nodes))]
        if (packed := of.carried) is not None:
            arm = packed.origin - np.asarray(result.bodies[body].position[:])
            columns.append(_sizes(packed.force, packed.torque + np.cross(arm, packed.force)))
    return places, np.stack(columns, axis=1) if columns else np.zeros((len(result.time), 0, 2))


def pull_in(
    net: Net,
    places: Sequence[PulledPlace],
    story: Mapping[str, Any],
    bodies: Mapping[str, BodyStates],
    position: Floats,
    tension: Floats,
) -> Floats:
    """(k, n_places, 2) the same in states of a run that goes on, as if nothing were let go: see `let_go`.

    bodies : with their places and attitudes in these states, by name
    """
    found = np.zeros((len(position), len(places), 2))
    for body in dict.fromkeys(place.body for place in places):
        states = bodies[body]
        columns = [k for k, one in enumerate(places) if one.body == body and one.node != PACKED]
        nodes = np.array([places[k].node for k in columns], dtype=np.int64)
        force, torque = pulls_at(net, nodes, states.position, position, tension)
        found[:, columns] = _sizes(force, torque)
        if PulledPlace(body, PACKED) in places and states.attitude is not None:
            arm = rotation_matrix(states.attitude) @ np.array(carried_in(story).origin_m)
            force, torque = pull_on_packed(net, story, states.position + arm, position, tension)
            of_packed = _sizes(force, torque + np.cross(arm, force))
            found[:, places.index(PulledPlace(body, PACKED))] = of_packed
    return found


def let_go(pull: Floats, time: Floats, places: Iterable[PulledPlace], story: Mapping[str, Any]) -> Floats:
    """`pull` (t, n_places, 2) without what a body does not hold any more at a time (t,) [s]."""
    found = pull.copy()
    for k, (body, node) in enumerate(places):
        found[time >= _held_until(story, body, node), k] = 0.0
    return found


def _held_until(story: Mapping[str, Any], body: str, node: int) -> float:
    """Until when [s] a place ties threads to a body; infinite: to the end."""
    return carried_until(story) if node == PACKED else held_until(story, body).get(node, math.inf)


def _sizes(force: Floats, torque: Floats) -> Floats:
    return np.stack([np.linalg.norm(force, axis=-1), np.linalg.norm(torque, axis=-1)], axis=-1)
