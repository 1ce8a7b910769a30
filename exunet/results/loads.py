"""Margins of threads to their strength, and forces of threads on bodies.

The margin of an element is strength x knot efficiency / (safety factor x largest tension) - 1: 0 where the
tension reaches what the element may bear, negative beyond. The strength is what the case states for its cable
or follows from its material or, without either, the limit of the effect `breaking` (`Net.strength`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import ShortRepr, shown, takes
from exunet.base.arrays import Floats, Ints
from exunet.base.errors import InputError
from exunet.bodies.rotations import rotation_matrix
from exunet.net.arrays import TETHER, Net
from exunet.results.result import Result, blocks, over_blocks, row_ranges
from exunet.results.run_record import ALL_STEPS, STORED_TIMES, Peak, Release, RunRecord


@dataclass(frozen=True)
class Margin:
    """The least margin of a group of elements.

    margin   : strength / tension - 1
    element  : which has it
    time     : when [s]
    tension  : its tension then [N]
    strength : of it, times knot efficiency / safety factor [N]
    of       : "all steps", or "stored times": a peak between two of these is not in it
    """

    margin: float
    element: int
    time: float
    tension: float
    strength: float
    of: str


@takes(result=Result)
def margins(result: Result, among: NDArray[np.bool_] | None = None) -> dict[str, Margin]:
    """Compute the least margin to the strength of threads, of strings and of each tether.

    By "threads", "strings" and "tether NAME": of those whose strength the case states, or that can break, and
    that were ever taut.

    among : (n_elements,) True for the elements that count; None: all
    """
    if among is not None and np.shape(among) != (result.net.n_elements,):
        raise InputError(f"margins: among: needs {result.net.n_elements} True or False, got {shown(among)}")
    peaks = result.run.largest_tensions
    found = {name: _least(result, own, peaks) for name, own in _groups(result.net, among).items()}
    return {name: margin for name, margin in found.items() if margin is not None}


def _groups(net: Net, among: NDArray[np.bool_] | None) -> dict[str, Ints]:
    """Elements whose strength is known, by the name of their group; no empty groups."""
    if net.strength is None:
        return {}
    known = net.strength > 0.0 if among is None else among & (net.strength > 0.0)
    own = np.arange(net.n_elements) < net.n_net_elements
    groups = {
        "threads": np.flatnonzero(known & own & ~net.is_string),
        "strings": np.flatnonzero(known & own & net.is_string),
        **{TETHER + name: np.array(run)[known[run]] for name, run in net.tether_elements.items()},
    }
    return {name: elements for name, elements in groups.items() if len(elements)}


def _least(result: Result, own: Ints, peaks: Mapping[str, Peak]) -> Margin | None:
    """Least margin of some elements; None if none of them was ever taut.

    peaks : the largest tension of all steps of each of `Net.spans`, as far as they are known. That of a span
            is the worst of it, whose elements bear the same; unless its element is not one of `own`
    """
    net = result.net
    assert net.strength is not None
    worst, which, when, first = 0.0, -1, 0.0, 0
    for block in blocks(result.tension):
        parts = block[:, own] / net.strength[own]
        row, column = np.unravel_index(int(parts.argmax()), parts.shape)
        if parts[row, column] > worst:
            worst, which, when = float(parts[row, column]), int(own[column]), float(result.time[first + row])
        first += len(block)
    known = 0  # elements of which all steps are
    for name, peak in peaks.items():
        mine = own[np.isin(own, net.spans[name])]
        if peak.of != ALL_STEPS or not len(mine):
            continue
        if peak.element in mine:
            bears = float(net.strength[peak.element])
            if peak.tension >= worst * bears:
                worst, which, when = peak.tension / bears, peak.element, peak.time
        if peak.element in mine or peak.element < 0:
            known += len(mine)
    if worst <= 0.0:
        return None
    of, bears = ALL_STEPS if known == len(own) else STORED_TIMES, float(net.strength[which])
    return Margin(1.0 / worst - 1.0, which, when, worst * bears, bears, of)


def peaks_of(result: Result) -> dict[str, Peak]:
    """Return the largest tension of each of `Net.spans`; of the stored times where the run has no other."""
    known, spans = result.run.largest_tensions, result.net.spans
    return {name: known.get(name) or _at_stored_times(result, own) for name, own in spans.items()}


def _at_stored_times(result: Result, own: range) -> Peak:
    largest = over_blocks(lambda part: part[:, own.start : own.stop].max(axis=1, initial=0.0), result.tension)
    at = int(np.argmax(largest))
    element = -1
    if largest[at] > 0.0:
        element = own.start + int(np.argmax(result.tension[at][own.start : own.stop]))
    return Peak(float(largest[at]), float(result.time[at]), element, STORED_TIMES)


_ROWS = 512  # states of one block
PACKED = -1  # in place of a node: the packed net that a body holds


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
        """(n_times, m) magnitude of each force [N]."""
        return np.asarray(np.linalg.norm(self.force, axis=-1))


@takes(result=Result, body=str)
def loads(result: Result, body: str) -> Loads:
    """Compute what the threads, those of tethers too, pull on a body; no nodes if none is fixed to it.

    Of a packed net that the body holds, what pulls on it from elsewhere; of a node that a script releases,
    what pulls on it until then.

    Forces that act on the nodes themselves, such as drag, are not in it, nor is the inertia of their lumped
    masses, which are part of the body. Raises InputError for an unknown body.
    """
    if body not in result.bodies:
        known = ", ".join(result.bodies) or "none"
        raise InputError(f"loads: no body is named {body!r} (bodies: {known})")
    nodes, force, torque = _at_nodes(result, body)
    ends = np.asarray(np.isin(result.net.element_nodes, nodes).any(axis=1))
    return Loads(nodes, force, torque, margins(result, ends), _carried(result, body))


def _at_nodes(result: Result, body: str) -> tuple[Ints, Floats, Floats]:
    """Nodes (m,), forces and torques (n_times, m, 3) of `loads`."""
    states, until = result.bodies[body], held_until(result.run, body)
    fixed = [] if states.nodes is None else states.nodes.tolist()
    nodes = np.array([*fixed, *until], dtype=np.int64)
    if not len(nodes):
        return nodes, *np.zeros((2, len(result.time), 0, 3))
    found = []
    for first, last in row_ranges(len(result.time), _ROWS):  # both arrays may be too large for memory
        position, tension = result.position[first:last], result.tension[first:last]
        forces = _forces(result.net, nodes, position, tension)
        arms = position[:, nodes] - np.asarray(states.position[first:last])[:, None]
        found.append((forces, np.cross(arms, forces)))
    force, torque = (np.concatenate(parts) for parts in zip(*found, strict=True))
    for k, node in enumerate(nodes.tolist()):
        released = result.time >= until.get(node, math.inf)
        force[released, k] = torque[released, k] = 0.0
    return nodes, force, torque


def attached_nodes(result: Result, body: str) -> Ints:
    """Return the nodes (m,) that are or were fixed to a body: contact never acts on what ends there."""
    fixed = result.bodies[body].nodes
    released = [item.node for item in _releases(result.run, body)]
    return np.array([*([] if fixed is None else fixed.tolist()), *released], dtype=np.int64)


def held_until(run: RunRecord, body: str) -> dict[int, float]:
    """Return until when [s] nodes were fixed to a body that a script releases; infinite: to the end."""
    return {item.node: released_at(run, item.tie) for item in _releases(run, body) if item.tied}


def broken_at(result: Result) -> dict[int, float]:
    """Return when each element broke or was cut [s]; the first stored time if before the run."""
    before = result.run.restart
    found = dict.fromkeys(() if before is None else before.broken, float(result.time[0]))
    cuts = [(event.element, event.time_s) for event in result.run.done if event.element is not None]
    for element, time in (*((event.element, event.time_s) for event in result.run.breaks), *cuts):
        found.setdefault(element, time)
    return {element: found[element] for element in sorted(found) if element < result.net.n_elements}


def released_at(run: RunRecord, tie: str) -> float:
    """Return when a script released a tie [s]; infinite if it did not."""
    return next((event.time_s for event in run.done if event.tie == tie), math.inf)


def _releases(run: RunRecord, body: str) -> list[Release]:
    return [item for item in run.releases if item.body == body]


def carried_until(run: RunRecord) -> float:
    """Return when the packed net is released [s]; infinite if it never is."""
    if run.carried is not None and run.carried.until_s is not None:
        return run.carried.until_s
    times = (event.time_s for event in run.ejections)
    return math.inf if run.carried is None else next(times, math.inf)


def _carried(result: Result, body: str) -> CarriedLoads | None:
    """Compute the pull of the elements that have one end in the packed net; None of a body without it."""
    carried, states, net = result.run.carried, result.bodies[body], result.net
    if carried is None or carried.body != body:
        return None
    turn = rotation_matrix(np.asarray(states.attitude[:]))
    origin = np.asarray(states.position[:]) + turn @ np.array(carried.origin_m)
    within = np.zeros(net.n_nodes, dtype=bool)
    within[carried.nodes] = True
    elements = np.flatnonzero(within[net.element_nodes].sum(axis=1) == 1)
    ends = net.element_nodes[elements]
    inner = np.where(within[ends[:, 0]], *ends.T)
    outer = ends.sum(axis=1) - inner
    force, torque = np.zeros((2, len(result.time), 3))
    until = carried_until(result.run)
    for first, last in row_ranges(int(np.searchsorted(result.time, until)), _ROWS):
        position = result.position[first:last]
        pull = _along(position[:, outer] - position[:, inner], result.tension[first:last][:, elements])
        force[first:last] = pull.sum(axis=1)
        torque[first:last] = np.cross(position[:, inner] - origin[first:last, None], pull).sum(axis=1)
    return CarriedLoads(min(until, float(result.time[-1])), origin, force, torque)


def _along(span: Floats, tension: Floats) -> Floats:
    """(k, n, 3) tensions (k, n) [N] along spans (k, n, 3) [m]."""
    length = np.linalg.norm(span, axis=-1, keepdims=True)
    return np.asarray(tension[..., None] * np.divide(span, length, out=np.zeros_like(span), where=length > 0))


def _forces(net: Net, nodes: Ints, position: Floats, tension: Floats) -> Floats:
    """(k, m, 3) sum of the forces of the elements that end at each node [N]."""
    found = np.zeros((len(position), len(nodes), 3))
    for k, node in enumerate(nodes.tolist()):
        for near, far in ((0, 1), (1, 0)):
            elements = np.flatnonzero(net.element_nodes[:, near] == node)
            ends = net.element_nodes[elements, far]
            found[:, k] += _along(position[:, ends] - position[:, [node]], tension[:, elements]).sum(axis=1)
        for element, end, at in _on_drum(net, node, position):
            found[:, k] += at[:, None] * _along(position[:, end] - position[:, node], tension[:, element])
    return found


def _on_drum(net: Net, node: int, position: Floats) -> Iterator[tuple[int, int, Floats]]:
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
            yield elements[k], nodes[k + 1], at.astype(float)


# --- magnitudes at each place of attachment


class AttachmentPoint(NamedTuple):
    """A node that is fixed to a body, for good or until a script releases it; or `PACKED`."""

    body: str
    node: int

    @property
    def name(self) -> str:
        """In keys of metrics and time series, such as "chaser_12" or "chaser_packed"."""
        return f"{self.body}_{'packed' if self.node == PACKED else self.node}"


def attachment_loads(result: Result) -> dict[AttachmentPoint, Floats]:
    """Compute the magnitudes (t, 2) of force [N] and torque [N m] at each place where threads pull on a body.

    The torque of each is about the body's centre of mass, of a packed net too, so that they can be compared.
    """
    found = {}
    for body, states in result.bodies.items():
        nodes, force, torque = _at_nodes(result, body)
        for k, node in enumerate(nodes.tolist()):
            found[AttachmentPoint(body, node)] = _sizes(force[:, k], torque[:, k])
        if (packed := _carried(result, body)) is not None:
            arm = packed.origin - np.asarray(states.position[:])
            torque = packed.torque + np.cross(arm, packed.force)
            found[AttachmentPoint(body, PACKED)] = _sizes(packed.force, torque)
    return found


def _sizes(force: Floats, torque: Floats) -> Floats:
    return np.stack([np.linalg.norm(force, axis=-1), np.linalg.norm(torque, axis=-1)], axis=-1)
