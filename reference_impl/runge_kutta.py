"""Embedded Runge-Kutta pairs with step control: DOP853 and RK45, the latter with the rules of MATLAB's ode45.

The stages are combined by plain elementwise sums, the same for every component, never by a matrix product
whose order of additions may depend on the place in the array: mirrored components stay mirrored to the last
bit.  The energy W taken by damping has no part in the control of the step, with one exception (`Dop853`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853, RK45
from scipy.optimize import brentq

from reference_impl.arrays import Floats, Ints
from reference_impl.events import INSTANT
from reference_impl.friction import Memory
from reference_impl.run import Breakdown, Run
from reference_impl.state import Mode


@dataclass(frozen=True, eq=False)
class _Pair:
    """An embedded Runge-Kutta pair: stages a (s, s), result b (s,), times c (s,), error weights (s + 1,)."""

    a: Floats
    b: Floats
    c: Floats
    error: Floats


def _pair(method: type[RK45] | type[DOP853], error: ArrayLike) -> _Pair:
    """A pair of Dormand and Prince with SciPy's coefficients."""
    return _Pair(*(np.asarray(values, dtype=float) for values in (method.A, method.B, method.C, error)))


def _combine(weights: Floats, rates: Floats) -> Floats:
    """Sum over s of weights (s,) times rates (s, N), row by row: the same operations in every column."""
    return np.asarray(np.add.reduce(weights[:, None] * rates, axis=0))


class _Stages:
    """The stages of a pair along a run; `rates` (s + 1, N), the last row at the end of the step tried."""

    def __init__(self, run: Run, pair: _Pair) -> None:
        self.run, self.pair = run, pair
        self.rates = np.empty((len(pair.b) + 1, run.y.size))
        self.rates[-1] = run.rate(run.t, run.y)
        if not np.all(np.isfinite(self.rates[-1])):
            raise Breakdown("the initial acceleration is not finite")
        self.stale = False  # the forces have changed since the last rate

    def begin(self) -> None:
        """First same as last."""
        if self.stale:
            self.rates[-1], self.stale = self.run.rate(self.run.t, self.run.y), False
        self.rates[0] = self.rates[-1]

    def attempt(self, h: float, arrival: float) -> Floats:
        """The state after a step of h [s], and its rate in the last row."""
        run, pair, rates = self.run, self.pair, self.rates
        for s in range(1, len(pair.b)):
            rates[s] = run.rate(run.t + pair.c[s] * h, run.y + h * _combine(pair.a[s, :s], rates[:s]))
        y = run.y + h * _combine(pair.b, rates[:-1])
        rates[-1] = run.rate(arrival, y)
        return np.asarray(y)

    def finish(self, h: float, arrival: float, y: Floats) -> None:
        """Ends the run's step of h [s] in y, just attempted, or at the first event in it."""
        run, grip = self.run, self.run.mode.memory
        if not (run.watch.any or grip is not None):
            run.arrive(arrival, y)
            return
        repeated = False

        def attempt(tau: float) -> Floats:
            nonlocal repeated
            repeated = True
            return self.attempt(tau, run.t + tau)

        event = None
        if run.watch.any:
            event = run.watch.landing((run.y, y), self.rates[[0, -1]], h, run.mode, attempt)
        if event is not None:
            y = event.y
        elif repeated:
            y = self.attempt(h, arrival)
        if grip is not None:
            span, repeated = h if event is None else event.after, False
            after = self._grip_changes(y, span, grip, attempt)
            if after is not None:
                event, y, arrival = None, attempt(after), run.t + after
            elif repeated:
                y = attempt(span) if event is not None else self.attempt(h, arrival)
        run.arrive(arrival if event is None else run.t + event.after, y)
        if event is not None:
            run.settle(run.watch.due(run.y, run.mode, event.margin))
            self.stale = True
        if grip is not None:
            self.stale = run.change_grip(self.rates[-1]) or self.stale

    def _grip_changes(
        self, y: Floats, span: float, memory: Memory, attempt: Callable[[float], Floats]
    ) -> float | None:
        """When, in a step of `span` [s] that was just attempted and ends in y, something begins to touch,
        to stick or to slide, from the step's beginning [s]; None: not in it."""
        adhesion = self.run.adhesion
        before = adhesion.margins(self.run.y, self.rates[0], memory)
        after = adhesion.margins(y, self.rates[-1], memory)
        coming = (before < 0.0) & (after >= 0.0)
        if not np.any(coming):
            return None

        def greatest(tau: float) -> float:
            if tau == 0.0:
                return float(np.max(before[coming]))
            there = attempt(tau)
            return float(np.max(adhesion.margins(there, self.rates[-1], memory)[coming]))

        root = float(brentq(_finite(greatest), 0.0, span, xtol=INSTANT))
        return min(root * (1.0 + 4.0 * np.finfo(float).eps) + INSTANT, span)

    def scaled_error(self, h: float, scale: Floats, part: slice | Ints) -> Floats:
        """Estimated error of the step over `scale` of a part of the components of y."""
        return np.asarray(h * (_combine(self.pair.error, self.rates)[part] / scale))


def _finite(margin: Callable[[float], float]) -> Callable[[float], float]:
    """A margin whose root can be sought where it is infinite elsewhere."""
    return lambda tau: min(max(margin(tau), -1e9), 1e9)


class Dop853:
    """Dormand and Prince 8(5), step control of Hairer, Norsett, Wanner, Solving ODEs I, II.4.

    Stored times are hit by shortening steps, not by interpolation: a stored state then has the full order and
    its error is under the same control; many stored times shorten steps.  Only the fifth-order estimate is
    used.  The customary blend with a third-order one presumes smooth motion: now and then it lets a step
    pass over an impact, and 1e-5 of the energy is lost at rtol 1e-10.

    Under material_damping the control includes W [J].  A cable that contracts so fast that it would push has
    no force but still dissipates: nodes fly freely, no error of x or v shortens the step, and that of W would
    be anything.  So it is where damping would hold back what leaves a body.
    """

    def __init__(self, run: Run, rtol: float, atol: float, times: Floats) -> None:
        self.run, self.rtol, self.atol = run, max(rtol, 100.0 * np.finfo(float).eps), atol
        self.stages = _Stages(run, _pair(DOP853, DOP853.E5))
        effects = run.system.effects
        damped = any(law is not None and law.damping for law in (effects.contact, effects.self_contact))
        self.books = bool(effects.relaxation_time or damped)
        self.h = self._first_step(float(times[-1] - times[0]))

    def _rms(self, ratio: Floats) -> float:
        return math.sqrt(float(ratio @ ratio) / ratio.size)

    def _first_step(self, span: float) -> float:
        """A first step [s] from the sizes of y' and y'' (HNW, II.4, starting step size)."""
        run, rate = self.run, self.stages.rates[-1]
        end = run.layout.controlled
        scale = self.atol + self.rtol * np.abs(run.y[:end])
        size, speed = self._rms(run.y[:end] / scale), self._rms(rate[:end] / scale)
        h = min(0.01 * size / speed if size > 1e-5 and speed > 1e-5 else 1e-6, span)
        change = self._rms((run.rate(run.t + h, run.y + h * rate) - rate)[:end] / scale) / h
        greatest = max(speed, change)
        if not math.isfinite(greatest):
            raise Breakdown("the initial acceleration is not finite")
        second = (0.01 / greatest) ** (1.0 / 6.0) if greatest > 1e-15 else max(1e-6, 1e-3 * h)
        return float(min(100.0 * h, second, span)) or span

    def renew(self, until: float) -> None:
        """The forces changed at t; they are smooth `until` [s], where a call of `advance` ends."""
        self.stages.stale = True

    def advance(self, end: float) -> tuple[Floats, Mode]:
        """Takes the run to t = end [s] exactly; the state and mode then."""
        run = self.run
        while run.t < end:
            left = end - run.t
            if left <= 10.0 * math.ulp(run.t):  # an event or a knot next to a stored time
                run.t = end
                break
            last = self.h >= left
            shortened = left if last else 0.5 * left if 2.0 * self.h > left else self.h
            suggestion = self._step(shortened, end if last else run.t + shortened)
            # a step cut short by an output says little about how long the next may be
            self.h = max(self.h, suggestion) if shortened < self.h and suggestion >= shortened else suggestion
        return run.y, run.mode

    def _step(self, h: float, arrival: float) -> float:
        """Takes one step of at most h, to `arrival` if h itself will do; returns the step to try next [s]."""
        run, stages, most = self.run, self.stages, 10.0
        stages.begin()
        part = run.controlled(self.books)
        if h > (bound := run.longest_step(stages.rates[0])):
            h, arrival = bound, run.t + bound
        while True:
            if not abs(h) > 10.0 * math.ulp(run.t):
                raise Breakdown(f"the step collapsed to {h:.3g} s")
            y = stages.attempt(h, arrival)
            largest = np.maximum(np.abs(run.y), np.abs(y))[part]
            scale = self.atol + self.rtol * largest
            error = self._rms(stages.scaled_error(h, scale, part))
            if error < 1.0:
                break
            run.n_rejected += 1
            h *= max(0.2, 0.9 * error ** (-1.0 / 6.0)) if math.isfinite(error) else 0.2
            arrival, most = run.t + h, 1.0
        stages.finish(h, arrival, y)
        return h * (most if error == 0.0 else min(most, max(0.2, 0.9 * error ** (-1.0 / 6.0))))


class Ode45:
    """Dormand and Prince 5(4) with the rules of MATLAB's ode45: Shampine & Reichelt, The MATLAB ODE Suite,
    SIAM J. Sci. Comput. 18 (1997), doi:10.1137/S1064827594276424.

    Error in the maximum norm, each component over max(|y|, atol/rtol); steps of at most a tenth of the whole;
    stored states come from the pair's interpolant of order 4, so that stored times leave the steps alone (the
    second one bounds the first step, though).
    """

    def __init__(self, run: Run, rtol: float, atol: float, times: Floats) -> None:
        self.run, self.rtol = run, max(rtol, 100.0 * np.finfo(float).eps)
        self.threshold = atol / self.rtol
        self.end = float(times[-1])
        self.longest = 0.1 * (self.end - run.t)
        self.stages = _Stages(run, _pair(RK45, RK45.E))
        self.powers = np.asarray(RK45.P, dtype=float)
        self.before = (run.t, run.y, run.mode)
        moved = run.layout.controlled
        scale = np.maximum(np.abs(run.y[:moved]), self.threshold)
        speed = float(np.max(np.abs(self.stages.rates[-1][:moved] / scale))) / (0.8 * self.rtol**0.2)
        h = min(self.longest, float(times[1] - times[0])) if len(times) > 1 else 0.0
        self.h = 1.0 / speed if h * speed > 1.0 else h

    def renew(self, until: float) -> None:
        """The forces changed at t; they are smooth `until` [s], where a step ends."""
        self.stages.stale, self.end = True, until

    def advance(self, end: float) -> tuple[Floats, Mode]:
        """Takes the run to t >= end [s]; state and mode at `end`, interpolated over its step."""
        run = self.run
        while run.t < end:
            self._step()
        if run.t == end:
            return run.y, run.mode
        begin, y, mode = self.before
        h = run.t - begin
        weights = _combine(((end - begin) / h) ** np.arange(1.0, 5.0), self.powers.T)
        return np.asarray(y + h * _combine(weights, self.stages.rates)), mode

    def _step(self) -> None:
        run, stages, failed = self.run, self.stages, False
        stages.begin()
        shortest = 16.0 * math.ulp(run.t)
        h = min(self.longest, run.longest_step(stages.rates[0]), max(shortest, self.h))
        part = run.controlled(False)
        while True:
            last = 1.1 * h >= self.end - run.t and not failed
            if last:
                h = self.end - run.t
            arrival = self.end if last else run.t + h
            y = stages.attempt(h, arrival)
            larger = np.maximum(np.abs(run.y), np.abs(y))[part]
            scale = np.maximum(larger, self.threshold)
            error = float(np.max(np.abs(stages.scaled_error(h, scale, part))))
            if error <= self.rtol:
                break
            run.n_rejected += 1
            if h <= shortest:
                raise Breakdown(f"the step collapsed to {h:.3g} s")
            finite = math.isfinite(error)
            cut = 0.5 if failed else max(0.1, 0.8 * (self.rtol / error) ** 0.2) if finite else 0.1
            h, failed = max(shortest, h * cut), True
        self.before = (run.t, run.y, run.mode)
        stages.finish(h, arrival, y)
        growth = 1.25 * (error / self.rtol) ** 0.2
        self.h = h if failed else h / growth if growth > 0.2 else 5.0 * h


PAIRS: dict[str, Callable[[Run, float, float, Floats], Dop853 | Ode45]] = {"RK45": Ode45, "DOP853": Dop853}
