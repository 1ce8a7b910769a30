"""The state of a system as one array y = (x, v, R, h, W), its parts, and the mode in which it moves.

Within a step the mode is held, so that every stage sees smooth forces; it changes between steps.

x, v: positions and velocities of N = n + b particles, the net's nodes and the bodies' centres of mass; R, h:
rotation matrices and angular momenta of the bodies (`bodies`); W: the energy that has left.

Where motions are given, time and what these d bodies gave stand before W: impulse, angular impulse, work.
Of the R reels the lengths wound up and the numbers of nodes on the drums stand after the time, their work
before what bodies gave.  What closes the mouth has one unknown after those of the reels, and its work after
theirs.  Where a body ejects the net, 1 while it is packed, then 0, stands before that work.
Where bodies are touched, the directions of friction's bristles (`friction`) and then what damping and
friction have taken stand before that.
Nodes that are points of bodies or held by them, and driven bodies, have rows that rest; `Layout.whole` puts
in what they do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reference_impl.arrays import Bools, Floats, orthonormal
from reference_impl.bodies import (
    Bodies,
    BodyStates,
    Guided,
    attitude_rate,
    own_turning,
    turning,
    turning_rate,
)
from reference_impl.closing import Drawn
from reference_impl.friction import Memory
from reference_impl.held import load, place, place_packed
from reference_impl.reels import Wound
from reference_impl.system import System


@dataclass(frozen=True, eq=False)
class Whole:
    """All that moves: N = n + b particles, nodes and then bodies."""

    x: Floats  # (..., N, 3) [m]
    v: Floats  # (..., N, 3) [m/s]
    attitude: Floats  # R (..., b, 3, 3)
    spin: Floats  # h (..., b, 3) [kg m2/s] about the centres of mass, in the scene's axes
    wound_up: Floats | None = None  # s (..., R) [m] of the reels
    held: Floats | None = None  # k (..., R)
    packed: Floats | None = None  # (..., 1) 1 while a body holds the net, then 0; None: the time decides
    bristles: Floats | None = None  # (..., P, 3) directions of friction's bristles that slide; None: none
    drawn: Floats | None = None  # (..., c) of what closes the mouth, see `closing.Drawn`


@dataclass(frozen=True, eq=False)
class Response:
    """What the forces do: accelerations (zero without a motion of one's own), torques, power that leaves."""

    acceleration: Floats  # (N, 3) [m/s2]
    torque: Floats  # (b, 3) [N m] about the centres of mass
    power: float  # [W]
    given: Floats  # (d, 7) by driven bodies: force [N], torque about the origin [N m], power [W]
    reeling: Floats  # (2, R) of reels: ds/dt [m/s], power on their tethers [W]
    rubbing: Floats  # (2,) [W] taken where bodies are touched, by damping and by friction
    drawing: Floats  # (2,) of what closes the mouth: rate of its unknown, power of its work [W]; (0,) without


@dataclass(frozen=True, eq=False)
class Mode:
    """Which elements are intact, which bullets are pushed, which segment of thrust holds, what reels do.

    And what friction remembers of what touches.
    """

    intact: Bools | None = None  # (m,); None: none is broken
    pushed: Bools | None = None  # (k,) by launch_force; None: those with s < stroke
    segment: int | None = None  # of thrust, see `Thrust.at`; None: the one that holds at t
    burns: tuple[int, ...] | None = None  # likewise of `System.propelled`
    orders: tuple[int, ...] | None = None  # of reels, see `Reels.orders`; None: those that hold at t
    closing: int | None = None  # of what closes the mouth, see `closing.order_at`; None: as holds at t
    memory: Memory | None = None  # None: friction has no memory


BY_STATE = Mode()  # nothing broken, everything else decided by time and state


@dataclass(frozen=True, eq=False)
class Given:
    """What bodies with a given motion gave to all else since the start; zero for free bodies."""

    impulse: Floats  # (..., b, 3) [N s]
    angular_impulse: Floats  # (..., b, 3) [N m s] about the origin
    work: Floats  # (..., b) [J]


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parts of y are: size 6 N + 12 b + 3 R + 2 c + 1, and 7 d + 1 more with d > 0 driven bodies.

    One more with a net that a body ejects; with contact 3 P + 2 more, or 2 where friction has no memory.
    """

    system: System

    @cached_property
    def nodes(self) -> int:
        """n."""
        return len(self.system.net.mass)

    @property
    def bodies(self) -> Bodies:
        return self.system.bodies

    @cached_property
    def half(self) -> int:
        """Size 3 N of positions, and of velocities."""
        return 3 * (self.nodes + len(self.bodies.names))

    @cached_property
    def turned(self) -> int:
        """Where attitudes end and angular momenta begin."""
        return 2 * self.half + 9 * len(self.bodies.names)

    @cached_property
    def moved(self) -> int:
        """Where the motion ends and the balances begin."""
        return self.turned + 3 * len(self.bodies.names)

    @cached_property
    def controlled(self) -> int:
        """How much of y, from its beginning, adaptive methods keep accurate: motion, clock, reels."""
        return self.moved + self.clocks + 2 * self.reels + self.closings

    @cached_property
    def closings(self) -> int:
        """c, 1 where something closes the mouth, else 0."""
        return int(self.system.closing is not None)

    @cached_property
    def reels(self) -> int:
        """R."""
        return 0 if self.system.reels is None else len(self.system.reels)

    @cached_property
    def booked(self) -> int:
        """Where the work of reels and of closing ends and what driven bodies gave begins."""
        return self.freed + self.reels + self.closings

    @cached_property
    def freed(self) -> int:
        """Where it ends whether a net is packed, and the work of reels begins."""
        return self.rubbed + int(self.system.packed is not None)

    @cached_property
    def bristled(self) -> int:
        """Where the directions of bristles end, which begin after what is controlled."""
        contacts = self.system.contacts
        return self.controlled + (0 if contacts is None else 3 * contacts.bristles)

    @cached_property
    def rubbed(self) -> int:
        """Where ends what has been taken by damping and friction where bodies are touched."""
        return self.bristled + (0 if self.system.contacts is None else 2)

    def bristles(self, y: Floats) -> Floats:
        """Directions (..., P, 3) of bristles that slide, in the axes of the bodies; P = 0 without."""
        return y[..., self.controlled : self.bristled].reshape(*y.shape[:-1], -1, 3)

    def rubbing(self, y: Floats) -> Floats:
        """What damping and friction have taken where bodies are touched (..., 2) [J]; (..., 0) without."""
        return y[..., self.bristled : self.rubbed]

    def packed(self, y: Floats) -> Floats:
        """Whether a body still holds the packed net in the states y, (..., 1) of 1 or 0; (..., 0) without."""
        return y[..., self.rubbed : self.freed]

    def wound(self, y: Floats) -> Wound:
        """The reels in the states y."""
        begin, count = self.moved + self.clocks, self.reels
        return Wound(
            y[..., begin : begin + count],
            y[..., begin + count : begin + 2 * count],
            y[..., self.freed : self.freed + count],
        )

    def drawn(self, y: Floats) -> Drawn:
        """What closes the mouth in the states y."""
        amount = y[..., self.controlled - self.closings : self.controlled]
        return Drawn(amount, y[..., self.booked - self.closings : self.booked])

    @cached_property
    def clocks(self) -> int:
        """1 where given motions need the time t, else 0."""
        return int(len(self.bodies.driven) > 0)

    def held(self, y: Floats) -> Whole:
        """The rows of y as they stand."""
        lead = y.shape[:-1]
        return Whole(
            y[..., : self.half].reshape(*lead, -1, 3),
            y[..., self.half : 2 * self.half].reshape(*lead, -1, 3),
            y[..., 2 * self.half : self.turned].reshape(*lead, -1, 3, 3),
            y[..., self.turned : self.moved].reshape(*lead, -1, 3),
        )

    def whole(self, y: Floats) -> Whole:
        """x, v (..., N, 3), R (..., b, 3, 3) and h (..., b, 3) of all particles and bodies."""
        whole = self._led(y)
        if self.closings:
            whole = replace(whole, drawn=self.drawn(y).amount)
        return replace(whole, bristles=self.bristles(y)) if self.bristled > self.controlled else whole

    def _led(self, y: Floats) -> Whole:
        """With the places and velocities of what bodies lead."""
        held, levers = self._driven(y, self.held(y)), self.system.levers
        if not len(levers) and self.system.packed is None:
            return held  # nor are there reels, whose drums are points of bodies
        x, v = held.x.copy(), held.v.copy()
        lever = levers.turned(held.attitude)
        w = turning(held.attitude, held.spin, self.bodies.mobility)
        bodies = slice(self.nodes, None)
        x[..., levers.node, :] = levers.places(x[..., bodies, :], lever)
        v[..., levers.node, :] = levers.velocities(v[..., bodies, :], w, lever)
        if self.system.packed is not None and np.any(there := self.packed(y)):
            levers = self.system.packed.levers
            lever = levers.turned(held.attitude)
            place_packed(self.system, x, there, levers.places(x[..., bodies, :], lever))
            place_packed(self.system, v, there, levers.velocities(v[..., bodies, :], w, lever))
        if not self.reels:
            return Whole(x, v, held.attitude, held.spin, packed=self.packed(y))
        wound = self.wound(y)
        for values in (x, v):
            place(self.system, values, wound.held)
        return Whole(x, v, held.attitude, held.spin, wound.wound_up, wound.held, self.packed(y))

    def _driven(self, y: Floats, held: Whole) -> Whole:
        """With the given motions put in."""
        if not self.clocks:
            return held
        whole = Whole(held.x.copy(), held.v.copy(), held.attitude.copy(), held.spin.copy())
        for k, motion in self._motions(y):
            whole.x[..., self.nodes + k, :] = motion.position
            whole.v[..., self.nodes + k, :] = motion.velocity
            whole.attitude[..., k, :, :] = motion.attitude
            own = np.einsum("...ji,...j->...i", motion.attitude, motion.turning)
            carried = own @ self.bodies.inertia[k].T
            whole.spin[..., k, :] = np.einsum("...ij,...j->...i", motion.attitude, carried)
        return whole

    def _motions(self, y: Floats) -> list[tuple[int, Guided]]:
        """Driven bodies: number, motion in the states y."""
        return self.bodies.motions(y[..., self.moved]) if self.clocks else []

    def positions(self, y: Floats) -> Floats:
        """(..., N, 3) [m]."""
        return self.whole(y).x

    def velocities(self, y: Floats) -> Floats:
        """(..., N, 3) [m/s]."""
        return self.whole(y).v

    def accelerations(self, y: Floats, rate: Floats) -> Floats:
        """(..., N, 3) [m/s2] in the states y, whose rates are dy/dt."""
        change, levers = self.held(rate), self.system.levers
        if not len(levers) and not self.clocks and self.system.packed is None:
            return change.v
        whole, result = self.whole(y), change.v.copy()
        w, angular = self.turnings(y, rate)
        for k, motion in self._motions(y):
            result[..., self.nodes + k, :] = motion.acceleration
        linear = result[..., self.nodes :, :]
        lever = levers.turned(whole.attitude)
        result[..., levers.node, :] = levers.accelerations(linear, angular, w, lever)
        if self.system.packed is not None and np.any(there := self.packed(y)):
            levers = self.system.packed.levers
            held = levers.accelerations(linear, angular, w, levers.turned(whole.attitude))
            place_packed(self.system, result, there, held)
        if self.reels:
            place(self.system, result, self.wound(y).held)
        return result

    def turnings(self, y: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """w [rad/s], w' [rad/s2] (..., b, 3) in the scene's axes, in the states y, whose rates are dy/dt."""
        whole = self.whole(y)
        angular = turning_rate(whole.attitude, whole.spin, self.held(rate).spin, self.bodies)
        for k, motion in self._motions(y):
            angular[..., k, :] = motion.angular
        return turning(whole.attitude, whole.spin, self.bodies.mobility), angular

    def pack(self, x: Floats, v: Floats, bodies: BodyStates | None, t: float = 0.0) -> Floats:
        """y at t [s]; its books are empty but for a throw at time 0."""
        if bodies is None:
            closing = self.system.closing
            drawn = () if closing is None else (closing.begin, 0.0)
            return np.concatenate((np.ravel(x), np.ravel(v), drawn, (0.0,)))
        own = np.einsum("bij,bj->bi", self.bodies.inertia, bodies.angular_velocity)
        spin = self.bodies.free[:, None] * np.einsum("bij,bj->bi", bodies.attitude, own)
        moving = np.array(v, dtype=float)
        moving[self.system.levers.node] = 0.0
        drifting = self.bodies.free[:, None] * bodies.velocity
        books = np.zeros(self.reels + self.closings + 7 * len(self.bodies.driven) + 1)
        if (begun := self.system.begun) is not None and t == 0.0:
            books[-1] = begun.left
            row = self.reels + self.closings + 7 * np.flatnonzero(self.bodies.driven == begun.body)
            books[row[:, None] + np.arange(7)] = begun.given
        wound, held = np.empty(0), None
        if (reels := self.system.reels) is not None:
            wound, held = np.concatenate((reels.wound_up, reels.held)), reels.held
        if self.system.closing is not None:
            wound = np.append(wound, self.system.closing.begin)
        packed = np.full(self.freed - self.rubbed, float(self.system.packs(t)))
        rubbed = np.zeros(self.rubbed - self.controlled)
        moving[load(self.system, held, self.system.packs(t)).node] = 0.0
        clock = np.full(self.clocks, t)
        motion = (x, bodies.position, moving, drifting, bodies.attitude, spin)
        parts = (*motion, clock, wound, rubbed, packed, books)
        return np.concatenate([np.ravel(part) for part in parts])

    def rate(self, y: Floats, whole: Whole, response: Response) -> Floats:
        """dy/dt in a state y with these particles, whose forces have this response."""
        parts = [y[self.half : 2 * self.half], response.acceleration.ravel()]
        if self.booked == 2 * self.half and not self.clocks:  # points alone
            return np.concatenate((*parts, (response.power,)))
        if len(self.bodies.names):
            turned = attitude_rate(whole.attitude, whole.spin, self.bodies.mobility)
            if self.clocks:
                turned = self.bodies.free[:, None, None] * turned
            parts += [turned.ravel(), response.torque.ravel()]
        if self.clocks:
            parts.append(np.ones(1))
        if self.reels:
            parts += [response.reeling[0], np.zeros(self.reels)]
        parts.append(response.drawing[:1])
        parts.append(np.zeros(self.bristled - self.controlled))
        if self.rubbed > self.bristled:
            parts.append(response.rubbing)
        parts += [np.zeros(self.freed - self.rubbed), response.reeling[1], response.drawing[1:]]
        if self.clocks:
            parts.append(response.given.ravel())
        return np.concatenate((*parts, (response.power,)))

    def given(self, y: Floats) -> Given:
        """What driven bodies have given up to the states y; zero for the others."""
        books = np.zeros((*y.shape[:-1], len(self.bodies.names), 7))
        driven = self.bodies.driven
        books[..., driven, :] = y[..., self.booked : -1].reshape(*y.shape[:-1], len(driven), 7)
        return Given(books[..., :3], books[..., 3:6], books[..., 6])

    def body_states(self, y: Floats) -> BodyStates:
        """States (..., b, ...) of the bodies, attitudes made orthonormal."""
        whole = self.whole(y)
        attitude = orthonormal(whole.attitude)
        angular = own_turning(attitude, whole.spin, self.bodies.mobility)
        return BodyStates(whole.x[..., self.nodes :, :], whole.v[..., self.nodes :, :], attitude, angular)


def layout(system: System) -> Layout:
    """The layout of a system's state."""
    return Layout(system)
