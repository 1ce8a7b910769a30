"""A run in progress: the state at hand, what it cost, what was stored; and how a run can end."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from reference_impl.arrays import Bools, Floats
from reference_impl.bodies import BodyStates, orthonormal
from reference_impl.effects.launch_force import LaunchForce
from reference_impl.elements import strain
from reference_impl.events import Break, Watch
from reference_impl.forces import response, ways
from reference_impl.handover import eject, hand_over
from reference_impl.mode import Mode
from reference_impl.reels import Wound
from reference_impl.state import Given, Layout, layout
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
    gone: Bools  # (nt, k) bullets that have left their barrels in a body for good


class Diverged(ArithmeticError):
    """No finite step is left at `time` [s]; `element` was the most strained, `trajectory` what was stored."""

    def __init__(self, time: float, element: int, strain: float, why: str, trajectory: Trajectory) -> None:
        super().__init__(
            f"{why} at t = {time:.9g} s; most strained element then: {element} (E11 = {strain:.3g})"
        )
        self.time, self.element, self.strain, self.trajectory = time, element, strain, trajectory


class Interrupted(KeyboardInterrupt):
    """Stopped from the keyboard; `trajectory` is what was stored."""

    def __init__(self, trajectory: Trajectory) -> None:
        super().__init__()
        self.trajectory = trajectory


class Breakdown(Exception):
    """No step can be taken from the present state."""


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

    def begin(self, located: bool) -> None:
        """The mode at the start.  `located`: bullets change theirs at events; else their way s decides it."""
        effects = self.system.effects
        pushed = gone = None
        if effects.launch_force is not None:
            beyond = self._beyond(effects.launch_force)
            pushed = ~beyond if located else None
            gone = beyond if effects.launch_force.body is not None else None
        intact = np.ones(len(self.system.net.area), dtype=bool) if effects.breaking is not None else None
        self.mode = Mode(intact, pushed, gone)
        self.enter_segment()
        self.break_exceeded()

    def enter_segment(self) -> bool:
        """Takes the segment of thrust and the commands that hold at t; whether there is any thrust."""
        thrust, reels = self.system.effects.thrust, self.system.reels
        if reels is not None:
            self.mode = replace(self.mode, orders=reels.orders(self.t))
        if thrust is not None:
            self.mode = replace(self.mode, segment=thrust.segment(self.t))
        return thrust is not None

    def rate(self, t: float, y: Floats) -> Floats:
        """dy/dt, eqs. (15), (16), the turning of bodies, and the power that leaves."""
        self.n_rhs += 1
        whole = self.layout.whole(y)
        return self.layout.rate(y, whole, response(self.system, t, whole, self.mode))

    def arrive(self, t: float, y: Floats) -> None:
        """Ends a step at t in y, which must be finite; attitudes are made orthonormal."""
        if not np.all(np.isfinite(y)):
            raise Breakdown(f"the state became infinite in a step of {t - self.t:.3g} s")
        if len(self.system.bodies.rigid):
            y = y.copy()
            y[2 * self.half : self.layout.turned] = orthonormal(self.layout.held(y).attitude).ravel()
        self.t, self.y = t, y
        self.n_steps += 1

    def settle(self, reached: np.ndarray) -> None:
        """Enters the mode after events; the elastic energy of what breaks leaves the system."""
        self.mode, breaks = self.watch.settle(self.t, self.y, self.mode, reached)
        if (reels := self.system.reels) is not None:
            for number in np.flatnonzero(reached[: 2 * len(reels)]).tolist():
                self.y = hand_over(self.layout, self.y, number % len(reels), onto=number < len(reels))
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

    def reels_exceeded(self) -> bool:
        """Takes nodes onto drums and off them where that is due now; whether any was."""
        any_was = False
        while (due := self.watch.due_of_reels(self.y, 0.0)).any():
            if self.mode.pushed is not None:
                due = np.concatenate((due, np.zeros(len(self.mode.pushed), dtype=bool)))
            self.settle(due)
            any_was = True
        return any_was

    def bullets_gone(self) -> bool:
        """Lets bullets go that are out of their barrels in a body now; whether any was pushed before."""
        launch = self.system.effects.launch_force
        if self.mode.gone is None or launch is None:
            return False
        gone = self.mode.gone | self._beyond(launch)
        changed = bool(np.any(gone != self.mode.gone))
        self.mode = replace(self.mode, gone=gone)
        return changed

    def _beyond(self, launch: LaunchForce) -> Bools:
        """Which bullets (k,) are out of their barrels now."""
        whole = self.layout.whole(self.y)
        return np.asarray(ways(self.system, whole.x, whole.attitude) >= launch.stroke)

    def store(self, t: float, y: Floats, mode: Mode) -> None:
        self.times.append(t)
        self.stored.append(y.copy())
        self.modes.append(mode)

    def trajectory(self) -> Trajectory:
        y = np.array(self.stored).reshape(len(self.times), -1)
        n, m, k = self.layout.nodes, len(self.system.net.area), len(self.system.net.bullet_nodes)
        whole, none = np.ones(m, dtype=bool), np.zeros(k, dtype=bool)
        gone = [none if mode.gone is None else mode.gone for mode in self.modes]
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
        )

    def diverged(self, why: str) -> Diverged:
        with np.errstate(over="ignore"):
            e11 = strain(self.system, self.layout.positions(self.y)[: self.layout.nodes])
        worst = int(np.argmax(e11)) if e11.size else -1
        return Diverged(self.t, worst, float(e11[worst]) if e11.size else 0.0, why, self.trajectory())
