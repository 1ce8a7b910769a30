"""Events: elements break, bullets leave barrels, nodes go on and off drums; where in a step.

An event is a margin that reaches zero from below: of an intact element E11 less its limit, of a pushed bullet
s less the stroke.  `Watch.landing` finds the first one in a step by repeating the step at other lengths until
the instant is enclosed (Hairer, Norsett, Wanner, Solving ODEs I, II.6), so that the state there has the full
order of the method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from reference_impl.arrays import Floats, skew, turned
from reference_impl.bodies import turning
from reference_impl.elements import energy_density, strain
from reference_impl.reels import Wound
from reference_impl.state import Layout, Mode
from reference_impl.system import System

INSTANT = 1e-13  # [s] how closely an event is enclosed
TOGETHER = 1e-12  # [s] events closer than this are one: round-off does not decide which of equals comes first
_SAMPLES = np.arange(1, 17) / 16.0  # of a step, at which its interpolant is looked at


@dataclass(frozen=True)
class Break:
    """An element that broke, when [s], and the elastic energy it held [J]."""

    element: int
    time: float
    energy: float


@dataclass(frozen=True, eq=False)
class Event:
    """The first event in a step: `after` which time [s] of it, the state `y` then, which margin is zero."""

    after: float
    y: Floats
    margin: int


@dataclass(frozen=True, eq=False)
class Watch:
    """The events of a system."""

    system: System
    layout: Layout

    @cached_property
    def any(self) -> bool:
        """Whether anything can happen at all."""
        effects = self.system.effects
        reels = self.system.reels is not None
        return effects.breaking is not None or effects.launch_force is not None or reels

    def at(self, y: Floats, mode: Mode) -> Floats:
        """Margins (..., q) in the states y."""
        whole = self.layout.whole(y)
        return self.margins(whole.x, whole.attitude, mode, self.layout.wound(y))

    def margins(self, x: Floats, attitude: Floats, mode: Mode, wound: Wound) -> Floats:
        """Margins (..., q) at places x (..., N, 3) and attitudes (..., b, 3, 3).

        2 R of reels, m of strain, k of ways [m]: strain where things can break; reels: see `Reels.margins`.
        """
        parts = []
        if (reels := self.system.reels) is not None:
            parts.append(reels.margins(wound.wound_up, wound.held))
        if mode.intact is not None:
            over = strain(self.system, x) - self.system.limits
            parts.append(np.where(mode.intact, over, -np.inf))
        if mode.pushed is not None and self.system.effects.launch_force is not None:
            beyond = self.system.ways(x, attitude) - self.system.effects.launch_force.stroke
            parts.append(np.where(mode.pushed, beyond, -np.inf))
        return np.concatenate(parts, axis=-1)

    def due(self, y: Floats, mode: Mode, certain: int | None = None) -> np.ndarray:
        """Which margins (q,) are reached in y within TOGETHER, the `certain` one among them."""
        whole = self.layout.whole(y)
        w = turning(whole.attitude, whole.spin, self.system.bodies.mobility)
        x, attitude = whole.x + TOGETHER * whole.v, turned(whole.attitude, TOGETHER * w)
        margin, later = self.at(y, mode), self.margins(x, attitude, mode, self.layout.wound(y))
        reached = (margin >= 0.0) | (later >= 0.0)
        reels = self.due_of_reels(y, TOGETHER)
        reached[: len(reels)] = reels
        if certain is not None:
            reached[certain] = True
        return np.asarray(reached)

    def due_of_reels(self, y: Floats, within: float) -> np.ndarray:
        """Which margins (2 R,) of reels are reached in y, `within` a part of a piece."""
        wound, reels = self.layout.wound(y), self.system.reels
        if reels is None:
            return np.empty(0, dtype=bool)
        return np.asarray(reels.margins(wound.wound_up, wound.held) >= -within)

    def settle(self, t: float, y: Floats, mode: Mode, reached: np.ndarray) -> tuple[Mode, list[Break]]:
        """The mode after the events `reached` (q,) at t [s], and what broke."""
        breaks: list[Break] = []
        if mode.intact is not None:
            broken = np.flatnonzero(reached[: len(mode.intact)])  # beside breaking there are no reels
            energies = elastic_of(self.system, self.layout.positions(y)[: self.layout.nodes])
            breaks = [Break(e, t, float(energies[e])) for e in broken.tolist()]
            intact = mode.intact.copy()
            intact[broken] = False
            mode = replace(mode, intact=intact)
        if mode.pushed is not None:
            mode = replace(mode, pushed=mode.pushed & ~reached[len(reached) - len(mode.pushed) :])
        return mode, breaks

    def landing(
        self,
        ends: tuple[Floats, Floats],
        rates: Floats,
        h: float,
        mode: Mode,
        attempt: Callable[[float], Floats],
    ) -> Event | None:
        """The first event in a step of h [s]; None without an event.

        `ends`, `rates` are y and y' at both ends of the step; attempt(tau) repeats it with the length tau.
        """
        layout = self.layout
        begin = self.at(ends[0], mode)
        below = begin < 0.0  # what is at its limit already has been settled
        wound = _wound_between(layout, ends, rates, h)
        inside = _between(layout, ends, rates, h)
        looked = np.concatenate((begin[None], self.margins(*inside, mode, wound)))
        looked[-1] = self.at(ends[1], mode)

        def margins(y: Floats) -> Floats:
            return np.where(below, self.at(y, mode), -np.inf)

        def greatest(tau: float) -> float:
            return float(np.max(margins(attempt(tau) if tau else ends[0])))

        for place in _suspects(looked[:, below]):
            if greatest(place * h) >= 0.0:
                after = float(brentq(greatest, 0.0, place * h, xtol=INSTANT))
                y = attempt(after)
                return Event(after, y, int(np.argmax(margins(y))))
        return None


def elastic_of(system: System, x: Floats) -> Floats:
    """Elastic energy S11 (E11 - e) A L/2 (..., m) [J] of each element, were it intact."""
    e11 = strain(system, x)
    volume = system.net.area * system.net.reference_length
    return np.asarray(energy_density(system, e11) * volume)


def _suspects(looked: Floats) -> list[float]:
    """Places in (0, 1] of a step, in order, at which a margin may be above zero.

    looked (17, c) are margins at the beginning and at _SAMPLES: the first sample of each that is not below
    zero, and the tops of parabolas through three samples.
    """
    if not looked.size:
        return []
    top = np.argmax(looked, axis=0)
    found = {float(_SAMPLES[k - 1]) for k in np.argmax(looked >= 0.0, axis=0).tolist() if k}
    inner = np.flatnonzero((top > 0) & (top < len(_SAMPLES)) & np.all(looked < 0.0, axis=0))
    if inner.size:
        before, at, after = (looked[top[inner] + k, inner] for k in (-1, 0, 1))
        bend = np.maximum(2.0 * at - before - after, np.finfo(float).tiny)
        height = at + (after - before) ** 2 / (8.0 * bend)
        place = (top[inner] + 0.5 * (after - before) / bend) / len(_SAMPLES)
        found.update(place[height >= 0.0].tolist())
    return sorted(found)


def _wound_between(layout: Layout, ends: tuple[Floats, Floats], rates: Floats, h: float) -> Wound:
    """The reels (16, R) at _SAMPLES of a step: Hermite's cubic through s and ds/dt at both ends."""
    p = _SAMPLES[:, None]
    before, after = (layout.wound(y) for y in ends)
    slope0, slope1 = (h * layout.wound(rate).wound_up for rate in rates)
    gap = after.wound_up - before.wound_up
    s = before.wound_up + p * gap + p * (1.0 - p) * (slope0 - gap - p * (slope0 + slope1 - 2.0 * gap))
    shape = (len(p), layout.reels)
    return Wound(s, np.broadcast_to(before.held, shape), np.broadcast_to(before.work, shape))


def _between(layout: Layout, ends: tuple[Floats, Floats], rates: Floats, h: float) -> tuple[Floats, Floats]:
    """Positions (16, N, 3) and attitudes (16, b, 3, 3) at _SAMPLES of a step."""
    place, attitude = [], []
    for y, rate in zip(ends, rates, strict=True):
        whole = layout.whole(y)
        place.append((whole.x, h * whole.v, h * h * layout.accelerations(y, rate)))
        w, angular = (skew(values) for values in layout.turnings(y, rate))
        turn = whole.attitude
        attitude.append((turn, h * w @ turn, h * h * (angular + w @ w) @ turn))
    return _quintic(*place), _quintic(*attitude)


def _quintic(before: tuple[Floats, Floats, Floats], after: tuple[Floats, Floats, Floats]) -> Floats:
    """Values (16, ...) at _SAMPLES: Hermite's quintic through values, slopes and curvatures at both ends."""
    (x0, v0, a0), (x1, v1, a1) = before, after
    s = _SAMPLES.reshape(-1, *[1] * x0.ndim)
    gap, slope0, slope1 = x1 - x0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    cubic = 10.0 * gap - 4.0 * slope0 + 0.5 * slope1
    quartic = -15.0 * gap + 7.0 * slope0 - slope1
    quintic = 6.0 * gap - 3.0 * slope0 + 0.5 * slope1
    return np.asarray(x0 + s * (v0 + s * (0.5 * a0 + s * (cubic + s * (quartic + s * quintic)))))
