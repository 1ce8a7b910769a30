"""What threads pull on bodies: at each node that is fixed to one, and by a packed net that one holds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.errors import InputError
from exunet.base.short_repr import ShortRepr
from exunet.bodies.rotations import rotation_matrix
from exunet.model.ejection import Ejection
from exunet.net.arrays import Net
from exunet.results.attached import held_until
from exunet.results.margins import Margin, margins
from exunet.results.provenance import Carried, SceneProvenance
from exunet.results.result import Result, row_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_ROWS = 512  # states that are looked at in one go


@dataclass(frozen=True, repr=False)
class CarriedLoads(ShortRepr):
    """The pull of the threads, such as tethers, on a packed net that a body holds, over the stored times.

    until  : when the body lets the net go [s]; from then on force and torque are 0
    origin : (n_times, 3) the net's origin, in the scene [m]
    force  : (n_times, 3) on the body [N], in the axes of the scene
    torque : (n_times, 3) about the net's origin [N m], in the axes of the scene
    """

    until: float
    origin: Floats
    force: Floats
    torque: Floats


@dataclass(frozen=True, repr=False)
class Loads(ShortRepr):
    """The pull of the threads at the nodes that are fixed to a body, over the stored times.

    nodes  : (m,) these nodes
    force  : (n_times, m, 3) on the body at each [N], in the axes of the scene
    torque : (n_times, m, 3) of each about the body's centre of mass [N m], in the axes of the scene
    margins : the least margin to the strength of the elements that end at these nodes, as of
             `exunet.margins`; empty where no strength is known
    carried : of the packed net that the body holds until it ejects it; None: it holds none
    """

    nodes: Ints
    force: Floats
    torque: Floats
    margins: Mapping[str, Margin] = field(default_factory=dict)
    carried: CarriedLoads | None = None

    @property
    def size(self) -> Floats:
        """(n_times, m) size of each force [N]."""
        return np.asarray(np.linalg.norm(self.force, axis=-1))

    @property
    def total(self) -> tuple[Floats, Floats]:
        """Force [N] and torque about the centre of mass [N m] at all nodes, (n_times, 3): not `carried`."""
        return self.force.sum(axis=1), self.torque.sum(axis=1)


@takes(result=Result, body=str)
def loads(result: Result, body: str) -> Loads:
    """What the threads, those of tethers too, pull on a body; of no nodes if none is fixed to it.

    Of a packed net that the body holds, what pulls on it from elsewhere; of a node that a script releases,
    what pulls on it until then.

    Forces that act on the nodes themselves, such as drag, are not in it, nor is the inertia of their lumped
    masses, which are part of the body. Raises InputError for an unknown body.
    """
    if body not in result.bodies:
        known = ", ".join(result.bodies) or "none"
        raise InputError(f"loads: there is no body {body!r} (bodies: {known})")
    states, story = result.bodies[body], result.provenance
    nodes = pulled_nodes(states.nodes, story, body)
    found = []
    for first, last in row_ranges(len(result.time), _ROWS):  # both arrays may be too large for memory
        rows, centre = slice(first, last), np.asarray(states.position[first:last])
        found.append(pulls_at(result.net, nodes, centre, result.position[rows], result.tension[rows]))
    force, torque = (np.concatenate(parts) for parts in zip(*found, strict=True))
    for k, node in enumerate(nodes.tolist()):
        force[result.time >= (until := held_until(story, body).get(node, math.inf)), k] = 0.0
        torque[result.time >= until, k] = 0.0
    ends = np.asarray(np.isin(result.net.element_nodes, nodes).any(axis=1))
    return Loads(nodes, force, torque, margins(result, ends), _carried(result, body))


def pulled_nodes(fixed: Ints | None, story: Mapping[str, Any], body: str) -> Ints:
    """(m,) nodes that are fixed to a body for good (None: none), and those that a script releases from it."""
    return np.array([*([] if fixed is None else fixed.tolist()), *held_until(story, body)], dtype=np.int64)


def _carried(result: Result, body: str) -> CarriedLoads | None:
    story, states = result.provenance, result.bodies[body]
    if not is_carrier(story, body) or states.attitude is None:
        return None
    turn = rotation_matrix(np.asarray(states.attitude[:]))
    origin = np.asarray(states.position[:]) + turn @ np.array(carried_in(story).origin_m)
    force, torque = np.zeros((2, len(result.time), 3))
    until = carried_until(story)
    for first, last in row_ranges(int(np.searchsorted(result.time, until)), _ROWS):
        states_of = origin[first:last], result.position[first:last], result.tension[first:last]
        force[first:last], torque[first:last] = pull_on_packed(result.net, story, *states_of)
    return CarriedLoads(min(until, float(result.time[-1])), origin, force, torque)


def is_carrier(story: Mapping[str, Any], body: str) -> bool:
    """True of the body that holds the packed net, as the story of a run tells it."""
    carried = SceneProvenance.of(story).carried
    return carried is not None and carried.body == body


def carried_in(story: Mapping[str, Any]) -> Carried:
    """Return the body that holds the packed net, in a run with such a body."""
    carried = SceneProvenance.of(story).carried
    assert carried is not None
    return carried


def carried_until(story: Mapping[str, Any]) -> float:
    """When the packed net is let go [s]; infinite: a script was to do it and has not."""
    until = carried_in(story).until_s
    if until is None:
        until = next((item["time_s"] for item in story.get(Ejection.heading, [])), math.inf)
    return float(until)


def pull_on_packed(
    net: Net, story: Mapping[str, Any], origin: Floats, position: Floats, tension: Floats
) -> tuple[Floats, Floats]:
    """The pull on the packed net of elements that have one end in it: force [N], torque [N m], each (k, 3).

    origin : (k, 3) of the net, about which the torque is [m]
    """
    within = np.zeros(net.n_nodes, dtype=bool)
    within[carried_in(story).nodes] = True
    ends = net.element_nodes
    elements = np.flatnonzero(within[ends].sum(axis=1) == 1)
    inner = np.where(within[ends[elements, 0]], *ends[elements].T)
    outer = ends[elements].sum(axis=1) - inner
    span = position[:, outer] - position[:, inner]
    length = np.linalg.norm(span, axis=-1, keepdims=True)
    way = np.divide(span, length, out=np.zeros_like(span), where=length > 0.0)
    pull = tension[:, elements, None] * way
    arms = position[:, inner] - origin[:, None]
    return pull.sum(axis=1), np.cross(arms, pull).sum(axis=1)


def pulls_at(
    net: Net, nodes: Ints, centre: Floats, position: Floats, tension: Floats
) -> tuple[Floats, Floats]:
    """The pull of the elements that end at each of these nodes: force [N], torque [N m], each (k, m, 3).

    centre : (k, 3) of mass of the body, about which the torque is [m]
    """
    force = _forces(net, nodes, position, tension)
    return force, np.cross(position[:, nodes] - centre[:, None], force)


def _forces(net: Net, nodes: Ints, position: Floats, tension: Floats) -> Floats:
    """(k, m, 3) sum of the forces of the elements that end at each node [N]."""
    found = np.zeros((len(position), len(nodes), 3))
    for k, node in enumerate(nodes.tolist()):
        for near, far in ((0, 1), (1, 0)):
            elements = np.flatnonzero(net.element_nodes[:, near] == node)
            ends = net.element_nodes[elements, far]
            found[:, k] += _pull(position, tension, node, elements, ends).sum(axis=1)
        for elements, ends, at in _on_drum(net, node, position):
            found[:, k] += at[:, None] * _pull(position, tension, node, elements, ends)[:, 0]
    return found


def _pull(position: Floats, tension: Floats, node: int, elements: Ints, ends: Ints) -> Floats:
    """(k, n, 3) pull of elements from a node towards their far ends [N]."""
    span = position[:, ends] - position[:, [node]]
    length = np.linalg.norm(span, axis=-1, keepdims=True)
    way = np.divide(span, length, out=np.zeros_like(span), where=length > 0.0)
    return np.asarray(tension[:, elements, None] * way)


def _on_drum(net: Net, node: int, position: Floats) -> Iterator[tuple[Ints, Ints, Floats]]:
    """The elements of a tether that begin at nodes on a drum, and when (k,): 1.0 for those states.

    A node that a reel has wound up is where the tether's end is, to the last bit.
    """
    for tether in net.tethers:
        nodes, elements = tether.nodes, tuple(net.tether_elements[tether.name])
        if node == nodes[-1]:
            nodes, elements = nodes[::-1], elements[::-1]
        for k in range(1, len(nodes) - 1) if node == nodes[0] else ():
            at = (position[:, nodes[k]] == position[:, node]).all(axis=1)
            if not at.any():
                break
            yield np.array([elements[k]]), np.array([nodes[k + 1]]), at.astype(float)
