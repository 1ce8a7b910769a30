"""Reels: the drives of drums, the drums of a system, and the law of the outlet.

A tether of pieces of length l has wound up s [m] of its length; its first k inner nodes from the drum are
at the drum.  The outlet, the element from there on, has the reference length L0 = (k + 1) l - s.  With its
vector d, E11 = (d.d - L0^2)/(2 L0^2), free strain e, stretch q = |d|/L0, tension N and elastic energy
U = E A (E11 - e)^2 L0/2,

    dU/dL0 at constant d and e = U/L0 - N q,

so that the drum does the work (N q - U/L0) ds, and a viscous stress takes S11 dE11/dt A L0 of all powers,
with dE11/dt = d.d'/L0^2 + q^2 s'/L0.  s and k are parts of the state (`state`): k rests but for events.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reference_impl.arrays import Bools, Floats, Ints, dot
from reference_impl.case import Case, Command, Reel, Tether
from reference_impl.elements import Elements, carried
from reference_impl.net import Net

LOCKED = -1  # number of the command before the first


@dataclass(frozen=True)
class Drive:
    """One drive, which winds up at most `most` [m] and slows down over the last `ramp` [m] of its way."""

    commands: tuple[Command, ...]
    most: float
    ramp: float
    largest_rate: float  # [m/s]
    damping: float  # c [N s/m], infinite without damping

    def order(self, t: float) -> int:
        """Number of the command that holds from t [s] on."""
        return sum(command.at <= t for command in self.commands) + LOCKED

    def rate(self, order: int, pull: float, wound_up: float) -> float:
        """ds/dt [m/s] under an `order`, against an elastic tension [N], with s [m] wound up."""
        wished = min(max(self._wish(order, pull), -self.largest_rate), self.largest_rate)
        left = self.most - wound_up if wished > 0.0 else wound_up
        return wished * min(max(left / self.ramp, 0.0), 1.0)

    def _wish(self, order: int, pull: float) -> float:
        """ds/dt [m/s] before its limits."""
        command = None if order == LOCKED else self.commands[order]
        if command is None or command.mode == "lock":
            return 0.0
        if command.force is None:
            assert command.rate is not None
            return command.rate
        spare = (command.force - pull) / self.damping
        if command.mode == "tension":
            return spare
        return min(spare, 0.0 if command.rate is None else command.rate)


ROUND_OFF = 1e-9  # part of a piece within which the outlet has the length at which a node goes on or off
SHORT, LONG = 0.25, 1.5  # lengths of the outlet, over l, at which a node goes on the drum, and off it


@dataclass(frozen=True, eq=False)
class Wound:
    """States of R reels, at one time or many (leading axes ...)."""

    wound_up: Floats  # s (..., R) [m]
    held: Floats  # k (..., R), whole numbers
    work: Floats  # (..., R) [J] that the drums have done on their tethers


@dataclass(frozen=True, eq=False)
class Reels:
    """What R reels are.  Nodes and elements of their tethers are counted from the drum."""

    names: tuple[str, ...]  # of the tethers
    drum: Ints  # (R,) nodes at the drums: points of bodies
    nodes: tuple[Ints, ...]  # the inner nodes of each tether
    elements: tuple[Ints, ...]  # one more than these
    piece: Floats  # l (R,) [m]
    drives: tuple[Drive, ...]
    wound_up: Floats  # s (R,) [m] at time 0
    held: Floats  # k (R,) at time 0

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def fullest(self) -> Floats:
        """The greatest k (R,): the last element is always outside."""
        return np.array([float(len(nodes)) for nodes in self.nodes])

    def outlets(self, held: Floats) -> Ints:
        """Numbers (..., R) of the elements that are the outlets."""
        rows = [elements[held[..., q].astype(np.intp)] for q, elements in enumerate(self.elements)]
        return np.stack(rows, axis=-1) if rows else np.zeros(held.shape, dtype=np.intp)

    def outside(self, wound_up: Floats, held: Floats) -> Floats:
        """Reference lengths L0 (..., R) [m] of the outlets."""
        return np.asarray((held + 1.0) * self.piece - wound_up)

    def lengths(self, net: Net, wound_up: Floats, held: Floats) -> Floats:
        """Reference lengths (..., m) [m] of all elements; those on drums, slack at a point, keep theirs."""
        rows = np.broadcast_to(net.reference_length, (*held.shape[:-1], len(net.reference_length))).copy()
        if len(self):
            np.put_along_axis(rows, self.outlets(held), self.outside(wound_up, held), axis=-1)
        return rows

    def on_drum(self, reel: int, held: Floats) -> Bools:
        """Which inner nodes (..., j) of a reel's tether are at its drum."""
        return np.asarray(np.arange(len(self.nodes[reel])) < held[..., reel, None])

    def margins(self, wound_up: Floats, held: Floats) -> Floats:
        """(..., 2 R), over l: zero where a node goes on the drum, then where one comes off; below before."""
        over = self.outside(wound_up, held) / self.piece
        on = np.where(held < self.fullest, SHORT + ROUND_OFF - over, -np.inf)
        off = np.where(held > 0.0, over - (LONG - ROUND_OFF), -np.inf)
        return np.concatenate((on, off), axis=-1)

    def orders(self, t: float) -> tuple[int, ...]:
        """Numbers of the commands that hold from t [s] on."""
        return tuple(drive.order(t) for drive in self.drives)

    def rates(self, orders: tuple[int, ...], tension: Floats, wound_up: Floats) -> Floats:
        """ds/dt (R,) [m/s] of drives that follow their `orders` against elastic tensions (R,) [N]."""
        told = zip(self.drives, orders, tension.tolist(), wound_up.tolist(), strict=True)
        return np.array([drive.rate(order, pull, s) for drive, order, pull, s in told])


@dataclass(frozen=True, eq=False)
class Outlets:
    """Elements (q,) whose reference lengths change, in a state: the outlets of reels, a shrinking edge."""

    element: Ints  # (q,)
    per_length: Floats  # S11 A/L0 (q,) [N/m], its force over d
    taken: float  # [W] by viscous stress
    rate: Floats  # -dL0/dt (q,) [m/s]
    power: Floats  # (q,) [W] that what shortens them does on them


def pay(
    system: Elements, reels: Reels, orders: tuple[int, ...], x: Floats, v: Floats, s: Floats, k: Floats
) -> Outlets:
    """The outlets at places x and velocities v (n, 3) [m, m/s], with s (R,) [m] and k (R,)."""
    return shorten(
        system, reels.outlets(k), reels.outside(s, k), lambda pull: reels.rates(orders, pull, s), x, v
    )


def shorten(
    system: Elements, element: Ints, length: Floats, rates: Callable[[Floats], Floats], x: Floats, v: Floats
) -> Outlets:
    """Elements (q,) of the reference lengths (q,) [m]; `rates` gives -dL0/dt from elastic tensions [N]."""
    i, j = system.net.element_nodes[element].T
    d, u = x[j] - x[i], v[j] - v[i]
    squared, stiffness = length * length, system.net.youngs_modulus[element] * system.net.area[element]
    e11 = 0.5 * (dot(d, d) - squared) / squared
    pulled, stretch = carried(system, e11, element), np.sqrt(dot(d, d)) / length
    elastic = stiffness * pulled.stress / length
    rate = rates(elastic * stretch * length)
    straining = dot(d, u) / squared + stretch * stretch * rate / length
    viscosity = system.effects.relaxation_time * stiffness / length
    taut = np.where(elastic > 0.0, pulled.viscous, 0.0)
    viscous = np.maximum(viscosity * taut * straining, -elastic)
    taken = math.fsum((viscous * straining * squared).tolist())
    power = ((elastic + viscous) * stretch * stretch * length - stiffness * pulled.energy) * rate
    return Outlets(element, elastic + viscous, taken, rate, power)


def reeled(case: Case, net: Net) -> Reels:
    """The reels of a case and its net."""
    made = [(number, tether, tether.reel) for number, tether in enumerate(case.tethers) if tether.reel]
    chains = [chain(net.element_nodes, net.tether, number, reel.at_start) for number, _, reel in made]
    starts = [at_start(t.length, t.divisions, reel.paid_out) for _, t, reel in made]

    def column(values: list[float]) -> Floats:
        return np.array(values, dtype=float)

    return Reels(
        tuple(tether.name for _, tether, _ in made),
        np.array([nodes[0] for nodes, _ in chains], dtype=np.intp),
        tuple(nodes[1:-1] for nodes, _ in chains),
        tuple(elements for _, elements in chains),
        column([tether.piece for _, tether, _ in made]),
        tuple(_drive(tether, reel) for _, tether, reel in made),
        column([s for s, _ in starts]),
        column([float(k) for _, k in starts]),
    )


def _drive(tether: Tether, reel: Reel) -> Drive:
    most, ramp = tether.length - reel.shortest, 0.25 * tether.piece
    return Drive(reel.commands, most, ramp, reel.largest_rate, reel.damping)


def chain(element_nodes: Ints, tether: Ints, number: int, from_start: bool) -> tuple[Ints, Ints]:
    """Nodes (q + 1,) and elements (q,) of a tether, in order from one of its ends.

    element_nodes (m, 2), and the tether (m,) that each is of.
    """
    elements = np.flatnonzero(tether == number)
    nodes = np.concatenate((element_nodes[elements, 0], element_nodes[elements[-1:], 1]))
    return (nodes, elements) if from_start else (nodes[::-1], elements[::-1])


def at_start(length: float, divisions: int, paid_out: float) -> tuple[float, int]:
    """s [m] and k at time 0 of a tether of this length [m] in so many pieces, `paid_out` [m] outside."""
    piece, s = length / divisions, length - paid_out
    k = math.floor(s / piece)
    if (k + 1) * piece - s <= (SHORT + ROUND_OFF) * piece:
        k += 1
    return s, min(k, divisions - 1)


def spread_outside(length: float, divisions: int, paid_out: float) -> Floats:
    """Places (divisions - 1,) of inner nodes at time 0: parts of the way from the drum to the other end."""
    s, k = at_start(length, divisions, paid_out)
    beyond = np.arange(1, divisions) * (length / divisions) - s
    return np.asarray(np.where(np.arange(divisions - 1) < k, 0.0, beyond / paid_out))
