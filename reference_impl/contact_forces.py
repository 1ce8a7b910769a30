"""What touching does to a system: forces on nodes and bodies, energies, and depths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl import friction, held
from reference_impl.arrays import Floats, Ints, cross
from reference_impl.bodies import BodyStates
from reference_impl.contacts import Contacts, Group, depths
from reference_impl.friction import Memory
from reference_impl.system import System


@dataclass(frozen=True, eq=False)
class View:
    """The lines of a group as their body sees them, at places x (n, 3) [m] moving with w (n, 3) [m/s]."""

    group: Group
    x: Floats
    w: Floats
    rows: Ints  # that may touch at all now


@dataclass(frozen=True, eq=False)
class Touched:
    """Forces of contact, and the powers that damping and friction take."""

    on_nodes: list[tuple[int, Floats]]  # body, and the forces (n, 3) [N] from it on the nodes
    taken: Floats  # (2,) [W] by damping, by friction


def views(
    system: System, x: Floats, v: Floats, attitude: Floats, w: Floats, held_now: Floats | None, packed: bool
) -> list[View]:
    """Every group as its body sees it.

    x, v (N, 3) are those of nodes and bodies, `attitude` (b, 3, 3) and angular velocities w (b, 3) those of
    bodies; `held_now` (R,) nodes on drums.  What a body holds, and what ends there, does not touch it;
    what is of a packed net touches nothing.
    """
    contacts, net = system.contacts, system.net
    assert contacts is not None
    n, carried, found = len(net.mass), None, []
    if system.reels is not None or packed:
        carried = held.load(system, held_now, packed)
    for group in contacts.groups:
        centre, axes = n + group.body, attitude[group.body]
        place = (x[:n] - x[centre]) @ axes
        moving = (v[:n] - v[centre]) @ axes - cross(w[group.body] @ axes, place)
        rows = np.arange(len(group.i))
        if carried is not None:
            mine = carried.node[carried.body == group.body]
            idle = np.isin(group.i, mine) | np.isin(group.j, mine)
            if packed:
                idle |= (net.tether[group.number] < 0) if group.threads else True
            rows = rows[~idle]
        found.append(View(group, place, moving, rows))
    return found


def touched(
    contacts: Contacts, seen: list[View], attitude: Floats, memory: Memory | None, e: Floats
) -> Touched:
    """The forces in the scene's axes; e (P, 3) directions of friction's bristles that slide."""
    on_nodes, taken, law = [], np.zeros(2), contacts.law
    for view in seen:
        group, x, w = view.group, view.x, view.w
        found = contacts.press(group, x, w, view.rows)
        if not len(found.row):
            continue
        on_i, on_j = found.on_i, found.on_j
        taken[0] += np.sum(found.damped)
        if law.friction and (memory is not None or law.slip_speed is not None):
            dragged = friction.drag(law, group, found, memory, e, x, w)
            on_i = on_i + (1.0 - dragged.s)[:, None] * dragged.force
            on_j = on_j + dragged.s[:, None] * dragged.force
            taken[1] += np.sum(dragged.taken)
        force = np.zeros_like(x)
        np.add.at(force, group.i[found.row], on_i)
        np.add.at(force, group.j[found.row], on_j)
        on_nodes.append((group.body, force @ attitude[group.body].T))
    return Touched(on_nodes, taken)


def view_of_states(
    system: System, x: Floats, v: Floats, bodies: BodyStates, held_now: Floats | None, packed: bool
) -> list[View]:
    """The views of one state: x, v (n, 3), bodies (b, ...)."""
    w = np.einsum("bij,bj->bi", bodies.attitude, bodies.angular_velocity)
    both = np.concatenate((x, bodies.position)), np.concatenate((v, bodies.velocity))
    return views(system, *both, bodies.attitude, w, held_now, packed)


def stored(contacts: Contacts, seen: list[View]) -> float:
    """Energy [J] that is stored across the surfaces."""
    return float(sum(np.sum(contacts.press(view.group, view.x, view.w, view.rows).stored) for view in seen))


@dataclass(frozen=True)
class Deepest:
    """What is deepest in its body."""

    depth: float  # [m], 0 where nothing touches
    over: float  # depth over what is allowed
    what: str  # such as "element 3 is deeper in the body target than 0.05 m"
    element: int  # -1 of a node or bullet


def deepest(seen: list[View]) -> Deepest:
    """The greatest depth of all, and what is deepest of what is allowed for it."""
    most, worst = 0.0, Deepest(0.0, 0.0, "nothing touches", -1)
    for view in seen:
        group = view.group
        deep, _ = depths(group, view.x, view.rows)
        if not len(deep):
            continue
        most = max(most, float(np.max(deep)))
        over = deep / group.allowed
        k = int(np.argmax(over))
        if over[k] > worst.over:
            number = int(group.number[k])
            what = f"{group.what} {number} is deeper in the body {group.name} than {group.allowed[k]:.6g} m"
            worst = Deepest(0.0, float(over[k]), what, number if group.threads else -1)
    return Deepest(most, worst.over, worst.what, worst.element)


TOO_DEEP = 1.0 - 1e-14  # of what is allowed: inside a core no direction leads out
