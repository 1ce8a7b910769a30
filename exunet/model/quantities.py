"""Quantities that conditions of scripts compare (see `exunet.scene.script`), computed from states."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.closing import LineStatus
from exunet.forces.contact.status import OF_BODY, STATUS, Status
from exunet.model.states import States
from exunet.model.system import System
from exunet.net.areas import mouth_against, mouth_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
LINE = f"{CLOSING}/line"
_CONTACT = "contact/"
_OF_CENTRE = frozenset(("range", "relative_speed"))


@dataclass(frozen=True, eq=False)
class Sources:
    """Parts of a system that quantities depend on.

    target    : number of the target among the rigid bodies; None without a target
    tensions, touching, touched : entries (name, number) of discrete states: tensions at the ends of the
                closing line; of each contact, the number of touching pairs, and the time of first contact
    """

    system: System
    target: int | None
    tensions: tuple[tuple[str, int], ...]
    touching: tuple[tuple[str, int], ...]
    touched: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, system: System, target: str | None) -> Sources:
        """Find the parts in a system; target : name of its body."""
        rigid = system.blocks.rigid
        contacts = [
            name
            for name in system.memory
            if name.startswith(_CONTACT) and not name.startswith(_CONTACT + OF_BODY)
        ]
        ends = [LineStatus._fields.index(name) for name in ("tension_start", "tension_end")]
        tensions = tuple((LINE, place) for place in ends if LINE in system.memory)
        touching, touched = (
            tuple((name, Status._fields.index(field) - STATUS) for name in contacts)
            for field in ("touching", "first_touch")
        )
        number = rigid.index(target) if target in rigid else None
        return cls(system, number, tensions, touching, touched)

    @property
    def reports(self) -> tuple[tuple[str, int], ...]:
        """Entries of discrete states, in the order in which `VALUES` gets them."""
        return (*self.tensions, *self.touching, *self.touched)


class Sample:
    """Ends of k steps: states, made at their first use, and entries of discrete states (k, n).

    See `Seen` for `mean`.
    """

    def __init__(self, states: Callable[[], States], reported: Floats, mean: Floats | None = None) -> None:
        self._states, self.reported, self.mean = states, reported, mean

    @cached_property
    def states(self) -> States:
        """States of the batch."""
        return self._states()


def weights(sources: Sources) -> Floats:
    """Return (n_net_nodes,) weights of the nodes in the centre of mass of the net."""
    mass = sources.system.net.mass[: sources.system.net.n_net_nodes]
    return np.asarray(mass / mass.sum())


def centre_weights(sources: Sources, names: Collection[str]) -> Floats:
    """Return the weights if quantities depend on the centre of mass, else an empty array.

    Empty also if nodes of the net are attached to bodies: within steps, their velocities may be of a stage.
    """
    attached = (sources.system.kinematics.tied < sources.system.net.n_net_nodes).any()
    return np.zeros(0) if attached or not _OF_CENTRE.intersection(names) else weights(sources)


def _offset(sources: Sources, sample: Sample, *, rates: bool) -> Floats:
    """Return (k, 3) vectors from the centre of mass of the target to that of the net [m], or rates [m/s]."""
    assert sources.target is not None
    states, bodies = sample.states, sample.states.bodies
    if sample.mean is not None:
        centre = sample.mean[:, 3:] if rates else sample.mean[:, :3]
    else:
        values = (states.velocity if rates else states.position)[:, : sources.system.net.n_net_nodes]
        centre = np.einsum("n,kna->ka", weights(sources), values)
    return np.asarray(centre - (bodies.velocity if rates else bodies.position)[:, sources.target])


def _range(sources: Sources, sample: Sample) -> Floats:
    return np.linalg.norm(_offset(sources, sample, rates=False), axis=1)


def _relative_speed(sources: Sources, sample: Sample) -> Floats:
    return np.linalg.norm(_offset(sources, sample, rates=True), axis=1)


def _mouth_diameter(sources: Sources, sample: Sample) -> Floats:
    return mouth_diameter(sources.system.net, sample.states.position)


def _area(sources: Sources, sample: Sample) -> Floats:
    return mouth_area(sources.system.net, sample.states.position[:, : sources.system.net.n_nodes])


def _tether_tension(sources: Sources, sample: Sample) -> Floats:
    net = sources.system.net
    first = net.n_net_elements
    i, j = net.element_nodes[first:].T
    span = sample.states.position[:, j] - sample.states.position[:, i]
    length, law = np.linalg.norm(span, axis=2), sample.states.law
    natural, stiffness = law.natural_length[first:], law.stiffness[first:]
    if law.relaxation_time is None:
        tension = cable.tension(length, natural, stiffness)
    else:
        along = np.einsum("kea,kea->ke", span, sample.states.velocity[:, j] - sample.states.velocity[:, i])
        rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
        tension = cable.viscous_tension(length, rate, natural, stiffness, law.relaxation_time[first:])
    for winding in sources.system.forces.cable.reels:
        element, _, pull = winding.outlets(sample.states.memory, *sample.states.flat)
        tension[:, element - first] = pull
    return np.asarray(tension.max(axis=1))


def _by_columns(ufunc: Callable[..., Floats], values: Floats, initial: float) -> Floats:
    """Reduce few columns (k, n) to (k,): far faster than by rows."""
    return reduce(ufunc, values.T, np.full(len(values), initial))


def _closing_tension(sources: Sources, sample: Sample) -> Floats:
    reported = sample.reported[:, : len(sources.tensions)]
    return _by_columns(np.maximum, reported, 0.0)


def _touching(sources: Sources, sample: Sample) -> Floats:
    first = len(sources.tensions)
    return _by_columns(np.add, sample.reported[:, first : first + len(sources.touching)], 0.0)


def _time(sources: Sources, sample: Sample) -> Floats:
    return sample.states.time


VALUES: Mapping[str, Callable[[Sources, Sample], Floats]] = {
    "time": _time,
    "range": _range,
    "relative_speed": _relative_speed,
    "mouth_diameter": _mouth_diameter,
    "area": _area,
    "tether_tension": _tether_tension,
    "closing_tension": _closing_tension,
    "touching": _touching,
}
DIFFERENCES: Mapping[str, Callable[[Sources, Sample, float], Floats]] = {
    "mouth_diameter": lambda sources, sample, bound: mouth_against(
        sources.system.net, sample.states.position, bound
    ),
}  # numbers with the sign of a quantity less a bound, where they are cheaper than the quantity
OF_VELOCITIES = ("relative_speed", "tether_tension")


def has_touched(sources: Sources, reported: Floats) -> NDArray[np.bool_]:
    """Return (k,) True from the first contact on."""
    return _by_columns(np.maximum, reported[:, len(reported[0]) - len(sources.touched) :], -1.0) >= 0.0


def observed_entries(sources: Sources, names: Collection[str]) -> tuple[Ints, Ints]:
    """Return the entries of x and v that quantities depend on: of some points, and all not of points."""
    system, nodes, speeds = sources.system, set[int](), set[int]()
    net, points = system.net, 3 * system.blocks.n_points
    if _OF_CENTRE.intersection(names) and not centre_weights(sources, names).size:
        nodes.update(range(net.n_net_nodes))
        speeds.update(range(net.n_net_nodes))
    nodes.update(net.mouth if {"area", "largest_area"}.intersection(names) else ())
    nodes.update(net.rim if "mouth_diameter" in names else ())
    if "tether_tension" in names:
        ends = net.element_nodes[net.n_net_elements :].ravel().tolist()
        nodes.update(ends)
        speeds.update(ends)
    return _entries(nodes, points, system.blocks.n_x), _entries(speeds, points, system.blocks.n_v)


def _entries(nodes: Iterable[int], points: int, size: int) -> Ints:
    """Return the entries of nodes, and all entries after those of points."""
    of_nodes = [3 * node + axis for node in sorted(nodes) for axis in range(3)]
    return np.array([*of_nodes, *range(points, size)], dtype=np.int64)


def observed_memories(system: System) -> tuple[str, ...]:
    """Return the discrete states that quantities depend on: of threads, reels, and points held by bodies."""
    threads = system.forces.cable
    kept = [] if threads.memory is None else [threads.memory.name]
    for winding in threads.reels:
        kept += [name for name in system.memory if name in (f"{winding.name}/reel", f"reel/{winding.name}")]
    return tuple(dict.fromkeys((*kept, *(item.memory for item in system.kinematics.held))))
