"""What a script looks at: numbers of states, by the names that `exunet.case.script` lists."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.closing import LineStatus
from exunet.forces.contact.status import OF_BODY, STATUS, Status
from exunet.net.areas import mouth_against, mouth_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING
from exunet.system.states import States
from exunet.system.system import System

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
LINE = f"{CLOSING}/line"
_CONTACT = "contact/"
_OF_CENTRE = frozenset(("range", "relative_speed"))


@dataclass(frozen=True, eq=False)
class Sight:
    """Which parts of a system quantities are of.

    target    : the number of the target among the rigid bodies; None: there is none
    tensions, touching, touched : numbers of memories (name, place): tensions at the ends of the closing line;
                of each contact, how many pairs touch, and when something touched first
    """

    system: System
    target: int | None
    tensions: tuple[tuple[str, int], ...]
    touching: tuple[tuple[str, int], ...]
    touched: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, system: System, target: str | None) -> Sight:
        """Of a system whose target has a name."""
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
    def tells(self) -> tuple[tuple[str, int], ...]:
        """The numbers of memories, in the order in which `LOOKS` gets them."""
        return (*self.tensions, *self.touching, *self.touched)


class Look:
    """States (k) at the ends of steps, made when they are asked for; the numbers of memories then (k, n).

    See `Seen` for `mean`.
    """

    def __init__(self, states: Callable[[], States], told: Floats, mean: Floats | None = None) -> None:
        self._states, self.told, self.mean = states, told, mean

    @cached_property
    def states(self) -> States:
        """The states."""
        return self._states()


def weights(sight: Sight) -> Floats:
    """(n_net_nodes,) of the nodes in the centre of mass of the net."""
    mass = sight.system.net.mass[: sight.system.net.n_net_nodes]
    return np.asarray(mass / mass.sum())


def watched_weights(sight: Sight, names: Collection[str]) -> Floats:
    """The same, if quantities follow from the centre; else none.

    None also if bodies carry nodes of the net, whose velocities may be some stages old within steps.
    """
    carried = (sight.system.kinematics.tied < sight.system.net.n_net_nodes).any()
    return np.zeros(0) if carried or not _OF_CENTRE.intersection(names) else weights(sight)


def _offset(sight: Sight, look: Look, *, rates: bool) -> Floats:
    """(k, 3) from the target's centre of mass to the net's [m], or its rate [m/s]."""
    assert sight.target is not None
    states, bodies = look.states, look.states.bodies
    if look.mean is not None:
        centre = look.mean[:, 3:] if rates else look.mean[:, :3]
    else:
        values = (states.velocity if rates else states.position)[:, : sight.system.net.n_net_nodes]
        centre = np.einsum("n,kna->ka", weights(sight), values)
    return np.asarray(centre - (bodies.velocity if rates else bodies.position)[:, sight.target])


def _range(sight: Sight, look: Look) -> Floats:
    return np.linalg.norm(_offset(sight, look, rates=False), axis=1)


def _relative_speed(sight: Sight, look: Look) -> Floats:
    return np.linalg.norm(_offset(sight, look, rates=True), axis=1)


def _mouth_diameter(sight: Sight, look: Look) -> Floats:
    return mouth_diameter(sight.system.net, look.states.position)


def _area(sight: Sight, look: Look) -> Floats:
    return mouth_area(sight.system.net, look.states.position[:, : sight.system.net.n_nodes])


def _tether_tension(sight: Sight, look: Look) -> Floats:
    net = sight.system.net
    first = net.n_net_elements
    i, j = net.element_nodes[first:].T
    span = look.states.position[:, j] - look.states.position[:, i]
    length, law = np.linalg.norm(span, axis=2), look.states.law
    natural, stiffness = law.natural_length[first:], law.stiffness[first:]
    if law.relaxation_time is None:
        found = cable.tension(length, natural, stiffness)
    else:
        along = np.einsum("kea,kea->ke", span, look.states.velocity[:, j] - look.states.velocity[:, i])
        rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
        found = cable.viscous_tension(length, rate, natural, stiffness, law.relaxation_time[first:])
    for winding in sight.system.forces.cable.reels:
        element, _, pull = winding.outlets(look.states.memory, *look.states.flat)
        found[:, element - first] = pull
    return np.asarray(found.max(axis=1))


def _by_columns(ufunc: Callable[..., Floats], values: Floats, initial: float) -> Floats:
    """(k,) of few columns (k, n), which is far faster than by rows."""
    return reduce(ufunc, values.T, np.full(len(values), initial))


def _closing_tension(sight: Sight, look: Look) -> Floats:
    told = look.told[:, : len(sight.tensions)]
    return _by_columns(np.maximum, told, 0.0)


def _touching(sight: Sight, look: Look) -> Floats:
    first = len(sight.tensions)
    return _by_columns(np.add, look.told[:, first : first + len(sight.touching)], 0.0)


def _time(sight: Sight, look: Look) -> Floats:
    return look.states.time


LOOKS: Mapping[str, Callable[[Sight, Look], Floats]] = {
    "time": _time,
    "range": _range,
    "relative_speed": _relative_speed,
    "mouth_diameter": _mouth_diameter,
    "area": _area,
    "tether_tension": _tether_tension,
    "closing_tension": _closing_tension,
    "touching": _touching,
}
AGAINST: Mapping[str, Callable[[Sight, Look, float], Floats]] = {
    "mouth_diameter": lambda sight, look, bound: mouth_against(sight.system.net, look.states.position, bound),
}  # numbers of the sign of a quantity less a bound, where those are cheaper than the quantity
OF_VELOCITIES = ("relative_speed", "tether_tension")


def has_touched(sight: Sight, told: Floats) -> NDArray[np.bool_]:
    """(k,) true from the first contact on."""
    return _by_columns(np.maximum, told[:, len(told[0]) - len(sight.touched) :], -1.0) >= 0.0


def looked_at(sight: Sight, names: Collection[str]) -> tuple[Ints, Ints]:
    """Entries of x and v from which quantities follow: of some points, and all that are not of points."""
    system, nodes, speeds = sight.system, set[int](), set[int]()
    net, points = system.net, 3 * system.blocks.n_points
    if _OF_CENTRE.intersection(names) and not watched_weights(sight, names).size:
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
    """Of nodes, and what follows points."""
    of_nodes = [3 * node + axis for node in sorted(nodes) for axis in range(3)]
    return np.array([*of_nodes, *range(points, size)], dtype=np.int64)


def seen_memories(system: System) -> tuple[str, ...]:
    """The memories that quantities follow from: of threads, of reels, of what bodies still hold."""
    threads = system.forces.cable
    kept = [] if threads.memory is None else [threads.memory.name]
    for winding in threads.reels:
        kept += [name for name in system.memory if name in (f"{winding.name}/reel", f"reel/{winding.name}")]
    return tuple(dict.fromkeys((*kept, *(one.memory for one in system.kinematics.held))))
