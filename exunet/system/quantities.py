"""What a script looks at: numbers of states, by the names that `exunet.case.script` lists."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.forces import cable
from exunet.forces.closing_loops import Status as LineStatus
from exunet.forces.contact.status import status_of
from exunet.net.areas import mouth_area, mouth_diameter
from exunet.net.closing import NAME as CLOSING
from exunet.system.states import States
from exunet.system.system import System

Floats = NDArray[np.float64]
LINE = f"{CLOSING}/line"
_CONTACT = "contact/"


@dataclass(frozen=True, eq=False)
class Sight:
    """Which parts of a system quantities are of.

    target   : the number of the target among the rigid bodies; None: there is none
    contacts : names of the memories of contact
    """

    system: System
    target: int | None
    contacts: tuple[str, ...]

    @classmethod
    def of(cls, system: System, target: str | None) -> Sight:
        """Of a system whose target has a name."""
        rigid = system.blocks.rigid
        contacts = tuple(name for name in system.memory if name.startswith(_CONTACT))
        return cls(system, rigid.index(target) if target in rigid else None, contacts)


def _offset(sight: Sight, states: States, *, rates: bool) -> Floats:
    """(k, 3) from the target's centre of mass to the net's [m], or its rate [m/s]."""
    assert sight.target is not None
    net, bodies = sight.system.net, states.bodies
    values = states.velocity if rates else states.position
    mass = net.mass[: net.n_net_nodes]
    centre = np.einsum("n,kna->ka", mass, values[:, : net.n_net_nodes]) / mass.sum()
    return np.asarray(centre - (bodies.velocity if rates else bodies.position)[:, sight.target])


def _range(sight: Sight, states: States) -> Floats:
    return np.linalg.norm(_offset(sight, states, rates=False), axis=1)


def _relative_speed(sight: Sight, states: States) -> Floats:
    return np.linalg.norm(_offset(sight, states, rates=True), axis=1)


def _mouth_diameter(sight: Sight, states: States) -> Floats:
    return mouth_diameter(sight.system.net, states.position)


def _area(sight: Sight, states: States) -> Floats:
    return mouth_area(sight.system.net, states.position[:, : sight.system.net.n_nodes])


def _tether_tension(sight: Sight, states: States) -> Floats:
    net = sight.system.net
    first = net.n_net_elements
    i, j = net.element_nodes[first:].T
    span = states.position[:, j] - states.position[:, i]
    length, law = np.linalg.norm(span, axis=2), states.law
    natural, stiffness = law.natural_length[first:], law.stiffness[first:]
    if law.relaxation_time is None:
        found = cable.tension(length, natural, stiffness)
    else:
        along = np.einsum("kea,kea->ke", span, states.velocity[:, j] - states.velocity[:, i])
        rate = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
        found = cable.viscous_tension(length, rate, natural, stiffness, law.relaxation_time[first:])
    for winding in sight.system.forces.cable.reels:
        element, _, pull = winding.outlets(states.memory, *states.flat)
        found[:, element - first] = pull
    return np.asarray(found.max(axis=1))


def _closing_tension(sight: Sight, states: States) -> Floats:
    status = LineStatus(*states.memory[LINE][: len(LineStatus._fields)])
    return np.full(len(states), max(status.tension_start, status.tension_end))


def _touching(sight: Sight, states: States) -> Floats:
    return np.full(len(states), sum(status_of(states.memory[name]).touching for name in sight.contacts))


def _time(sight: Sight, states: States) -> Floats:
    return states.time


LOOKS: Mapping[str, Callable[[Sight, States], Floats]] = {
    "time": _time,
    "range": _range,
    "relative_speed": _relative_speed,
    "mouth_diameter": _mouth_diameter,
    "area": _area,
    "tether_tension": _tether_tension,
    "closing_tension": _closing_tension,
    "touching": _touching,
}
OF_VELOCITIES = ("relative_speed", "tether_tension")
KEPT = ("closing_tension", "touching")  # known at the ends of steps only


def has_touched(sight: Sight, states: States) -> bool:
    """True from the first contact on."""
    return any(status_of(states.memory[name]).first_touch >= 0.0 for name in sight.contacts)


def seen_memories(system: System) -> tuple[str, ...]:
    """The memories that quantities follow from."""
    kept = [name for name in system.memory if name.startswith(_CONTACT) or name == LINE]
    threads = system.forces.cable
    kept += [] if threads.memory is None else [threads.memory.name]
    for winding in threads.reels:
        kept += [name for name in system.memory if name in (f"{winding.name}/reel", f"reel/{winding.name}")]
    return tuple(kept)
