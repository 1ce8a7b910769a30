"""A run in progress: the state at hand, what it cost, what was stored; and how a run can end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from reference_impl import contact_forces
from reference_impl.arrays import Bools, Floats, Ints, orthonormal
from reference_impl.bodies import BodyStates
from reference_impl.closing import LONGEST, Drawn, Line, order_at
from reference_impl.contacts import gaps
from reference_impl.elements import strain
from reference_impl.events import Break, Watch
from reference_impl.forces import response, seen
from reference_impl.friction import SLIDING, nothing
from reference_impl.jumps import eject, hand_over
from reference_impl.reels import Wound
from reference_impl.self_contact import too_near
from reference_impl.state import Given, Layout, Mode, layout
from reference_impl.stick_slip import Adhesion
from reference_impl.system import System


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the stored times, and what they cost."""

    t: Floats  # (nt,) [s]
    x: Floats  # (nt, n, 3) [m]
    v: Floats  # (nt, n, 3) [m/s]
    dissipated: Floats  # (nt,) [J]
    n_rhs: int  # evaluations of the forces; of EM its residuals
    n_steps: int
    n_rejected: int
    n_newton: int  # linear systems solved by EM
    n_halvings: int  # steps of EM that were done in two halves because Newton's method failed
    bodies: BodyStates  # (nt, b, ...)
    intact: Bools  # (nt, m) false from the instant an element broke
    breaks: tuple[Break, ...]  # in order of time
    given: Given  # (nt, b, ...) by bodies whose motion is given
    reels: Wound  # (nt, R)
    gone: Bools  # (nt, k) bullets that have left their barrels
    drawn: Drawn  # (nt, c) of what closes the mouth
    rubbing: Floats  # (nt, 2) [J] taken where bodies are touched, by damping and by friction


class Diverged(ArithmeticError):
    """No finite step is left at `time` [s]; `element` was the most strained, `trajectory` what was stored."""

    def __init__(self, time: float, element: int, strain: float, why: str, trajectory: Trajectory) -> None:
        super().__init__(
            f"{why} at t = {time:.9g} s; most strained element then: {element} (E11 = {strain:.3g})"
        )
        self.time, self.element, self.strain, self.trajectory = time, element, strain, trajectory


class Pierced(Diverged):
    """A thread or bullet is deeper in a body than contact allows; `element` is -1 of a bullet."""

    def __init__(self, time: float, worst: contact_forces.Deepest, trajectory: Trajectory) -> None:
        ArithmeticError.__init__(self, f"{worst.what}, at t = {time:.9g} s")
        self.time, self.element, self.strain, self.trajectory = time, worst.element, 0.0, trajectory


class Interrupted(KeyboardInterrupt):
    """Stopped from the keyboard; `trajectory` is what was stored."""

    def __init__(self, trajectory: Trajectory) -> None:
        super().__init__()
        self.trajectory = trajectory


class Breakdown(Exception):
    """No step can be taken from the present state."""


class TooDeep(Breakdown):
    """Something is deeper in a body than contact allows."""

    def __init__(self, worst: contact_forces.Deepest) -> None:
        super().__init__(worst.what)
        self.worst = worst


@dataclass
class Run:
    """State y (`state.Layout`) at time t, its cost so far, and the states stored so far."""

    system: System
    t: float
    y: Floats
    mode: Mode = field(default_factory=Mode)
    n_rhs: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    n_newton: int = 0
    n_halvings: int = 0
    times: list[float] = field(default_factory=list)
    stored: list[Floats] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)
    breaks: list[Break] = field(default_factory=list)

    @cached_property
    def layout(self) -> Layout:
        return layout(self.system)

    @cached_property
    def half(self) -> int:
        """Size 3N of positions, and of velocities, in y."""
        return self.layout.half

    @cached_property
    def watch(self) -> Watch:
        return Watch(self.system, self.layout)

    def begin(self) -> None:
        """Sets the mode at the start; bullets change theirs at events."""
        effects = self.system.effects
        pushed = None
        if (launch := effects.launch_force) is not None:
            whole = self.layout.whole(self.y)
            pushed = self.system.ways(whole.x, whole.attitude) < launch.stroke
        intact = np.ones(len(self.system.net.area), dtype=bool) if effects.breaking is not None else None
        self.mode = Mode(intact, pushed)
        self.enter_segment()
        self.break_exceeded()
        self.check_depth()
        self.check_stretch()
        if (contacts := self.system.contacts) is not None and contacts.law.sticks:
            self.mode = replace(self.mode, memory=nothing(contacts.pairs))
            self.begin_to_touch()

    @cached_property
    def adhesion(self) -> Adhesion:
        """Of friction that remembers."""
        assert self.system.contacts is not None
        return Adhesion(self.layout, self.system.contacts)

    def begin_to_touch(self) -> None:
        """Remembers what touches; twice, because what then sticks or slides changes how it goes on."""
        if self.mode.memory is not None:
            for _ in range(2):
                self.change_grip(self.rate(self.t, self.y))

    def change_grip(self, rate: Floats) -> bool:
        """What is due to stick, to slide or to be forgotten in the state of this rate; whether any was."""
        assert self.mode.memory is not None
        self.y, memory, changed = self.adhesion.settle(self.y, rate, self.mode.memory)
        self.mode = replace(self.mode, memory=memory)
        return changed

    def check_depth(self) -> None:
        """Stops where threads or bullets are deeper in a body, or in each other, than contact allows."""
        pairs = self.system.meeting
        if pairs is not None and (words := too_near(pairs, self.layout.positions(self.y))):
            raise Breakdown(words)
        if self.system.contacts is None:
            return
        whole, packed = self.layout.whole(self.y), bool(np.any(self.layout.packed(self.y)))
        worst = contact_forces.deepest(seen(self.system, whole, packed))
        if worst.over > contact_forces.TOO_DEEP:
            raise TooDeep(worst)

    def check_stretch(self) -> None:
        """Stops where a closing line is longer than it may be, or an element than its table goes."""
        net = self.system.net
        if any(len(points) > 2 for points in net.curves):
            e11 = strain(self.system, self.layout.positions(self.y)[: self.layout.nodes])
            last = np.array([points[-1, 0] for points in net.curves])[np.maximum(net.law, 0)]
            if np.any((net.law >= 0) & (e11 > last + 0.5 * last**2)):
                raise Breakdown("an element is longer than its table goes")
        if not isinstance(line := self.system.closing, Line):
            return
        outside = line.length - float(self.layout.drawn(self.y).amount[0])
        free = outside * math.sqrt(1.0 + 2.0 * self.system.free_strain)
        if float(line.way(self.layout.positions(self.y))) > LONGEST * free:
            raise Breakdown("the closing line is more than twice as long as when free of stress")

    def controlled(self, books: bool) -> slice | Ints:
        """What of y adaptive methods keep accurate: its motion, and W if the `books` are to be too.

        Of the bristles those that slide.
        """
        end = self.layout.controlled
        if self.system.contacts is None:
            return slice(None) if books else slice(end)
        last = np.full(int(books), len(self.y) - 1)
        return np.concatenate((np.arange(end), self.sliding(), last))

    def longest_step(self, rate: Floats) -> float:
        """How long a step from here may be [s] that passes over no contact; `rate` is dy/dt.

        What is a gap away from a ball round a body may come as far as that, and not deeper than a quarter
        of what is allowed, at its speed and acceleration.
        """
        if self.system.contacts is None:
            return np.inf
        whole, packed = self.layout.whole(self.y), bool(np.any(self.layout.packed(self.y)))
        acceleration, longest = self.layout.accelerations(self.y, rate), np.inf
        for view in seen(self.system, whole, packed):
            lines, n = view.group.some(view.rows), self.layout.nodes
            if not len(lines.i):
                continue
            body = acceleration[n + lines.body]
            size = np.linalg.norm(acceleration[:n] - body, axis=1)
            speed = np.linalg.norm(view.w, axis=1)
            way = np.maximum(gaps(lines, view.x), 0.25 * lines.allowed)
            v, a = np.maximum(speed[lines.i], speed[lines.j]), np.maximum(size[lines.i], size[lines.j])
            # way = v h + a h^2/2, without cancellation
            slow = v + np.sqrt(v * v + 2.0 * a * way)
            longest = min(longest, float(np.min(2.0 * way / np.where(slow > 0.0, slow, 1e-300))))
        return longest

    def sliding(self) -> Ints:
        """Where in y the directions of the bristles that slide are."""
        if self.mode.memory is None or self.layout.bristled == self.layout.controlled:
            return np.empty(0, dtype=np.intp)
        pairs = np.flatnonzero(self.mode.memory.law == SLIDING)
        return np.asarray(self.layout.controlled + (3 * pairs[:, None] + np.arange(3)).ravel())

    def enter_segment(self) -> bool:
        """Takes the segment of thrust and the commands that hold at t; whether there is any thrust."""
        thrust, reels, closing = self.system.effects.thrust, self.system.reels, self.system.closing
        if closing is not None:
            self.mode = replace(self.mode, closing=order_at(closing, self.t))
        if reels is not None:
            self.mode = replace(self.mode, orders=reels.orders(self.t))
        if thrust is not None:
            self.mode = replace(self.mode, segment=thrust.segment(self.t))
        propelled = self.system.propelled
        if propelled:
            burns = tuple(thruster.profile.segment(self.t) for _, thruster in propelled)
            self.mode = replace(self.mode, burns=burns)
        return thrust is not None or bool(propelled)

    def rate(self, t: float, y: Floats) -> Floats:
        """dy/dt, eqs. (15), (16), the turning of bodies, and the power that leaves."""
        self.n_rhs += 1
        whole = self.layout.whole(y)
        rate = self.layout.rate(y, whole, response(self.system, t, whole, self.mode))
        if self.mode.memory is not None:
            bristles = slice(self.layout.controlled, self.layout.bristled)
            rate[bristles] = self.adhesion.turning(y, rate, self.mode.memory)
        return rate

    def arrive(self, t: float, y: Floats) -> None:
        """Ends a step at t in y, which must be finite; attitudes are made orthonormal."""
        if not np.all(np.isfinite(y)):
            raise Breakdown(f"the state became infinite in a step of {t - self.t:.3g} s")
        if len(self.system.bodies.names):
            y = y.copy()
            y[2 * self.half : self.layout.turned] = orthonormal(self.layout.held(y).attitude).ravel()
        self.t, self.y = t, y
        self.n_steps += 1
        self.check_depth()
        self.check_stretch()

    def settle(self, reached: np.ndarray) -> None:
        """Enters the mode after events; the elastic energy of what breaks leaves the system.

        Nodes go on and off drums reel by reel: one jumps with the body as the one before has left it.
        """
        self.mode, breaks = self.watch.settle(self.t, self.y, self.mode, reached)
        if (reels := self.system.reels) is not None:
            for reel, way in np.argwhere(reached[: 2 * len(reels)].reshape(2, -1).T).tolist():
                self.y = hand_over(self.layout, self.y, reel, onto=way == 0)
        if breaks:
            self.breaks += breaks
            self.y = self.y.copy()
            self.y[-1] += sum(b.energy for b in breaks)

    def eject(self) -> None:
        """Lets the packed net go."""
        self.y = eject(self.layout, self.y)

    def break_exceeded(self) -> bool:
        """Breaks what is at or beyond its limit now; whether anything did."""
        if self.mode.intact is None:
            return False
        breaking = replace(self.mode, pushed=None)
        reached = self.watch.at(self.y, breaking) >= 0.0
        if not reached.any():
            return False
        if self.mode.pushed is not None:
            reached = np.concatenate((reached, np.zeros(len(self.mode.pushed), dtype=bool)))
        self.settle(reached)
        return True

    def store(self, t: float, y: Floats, mode: Mode) -> None:
        self.times.append(t)
        self.stored.append(y.copy())
        self.modes.append(mode)

    def trajectory(self) -> Trajectory:
        y = np.array(self.stored).reshape(len(self.times), -1)
        n, m, k = self.layout.nodes, len(self.system.net.area), len(self.system.net.bullet_nodes)
        whole, none = np.ones(m, dtype=bool), np.zeros(k, dtype=bool)
        gone = [none if mode.pushed is None else ~mode.pushed for mode in self.modes]
        intact = [whole if mode.intact is None else mode.intact for mode in self.modes]
        return Trajectory(
            np.array(self.times),
            self.layout.positions(y)[:, :n],
            self.layout.velocities(y)[:, :n],
            y[:, -1],
            self.n_rhs,
            self.n_steps,
            self.n_rejected,
            self.n_newton,
            self.n_halvings,
            self.layout.body_states(y),
            np.array(intact).reshape(len(y), m),
            tuple(self.breaks),
            self.layout.given(y),
            self.layout.wound(y),
            np.array(gone, dtype=bool).reshape(len(y), k),
            self.layout.drawn(y),
            self.layout.rubbing(y) if self.system.contacts is not None else np.zeros((len(y), 2)),
        )

    def diverged(self, error: Breakdown) -> Diverged:
        """The run's end for want of a step."""
        if isinstance(error, TooDeep):
            return Pierced(self.t, error.worst, self.trajectory())
        why = str(error)
        with np.errstate(over="ignore"):
            e11 = strain(self.system, self.layout.positions(self.y)[: self.layout.nodes])
        worst = int(np.argmax(e11)) if e11.size else -1
        return Diverged(self.t, worst, float(e11[worst]) if e11.size else 0.0, why, self.trajectory())
