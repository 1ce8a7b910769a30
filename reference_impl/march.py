"""Integration in time of the first-order system (15)-(17).

Output times are hit exactly, by shortening steps, not by interpolation: a stored state is then a state of
the integrator itself, of its full order (8, where the interpolant of DOP853 has 7; 5 against 4 for the pair
behind ode45), and its error is under the same control.  The price is that stored times influence the sequence
of steps; store fewer states to disturb it less.

The energy taken by damping is one more unknown, W' = v^T D v, W(0) = 0, advanced with the same weights.  It
stays out of the estimate of the error, so the motion is what it would be without it.

The stages are combined by plain elementwise sums, the same for every component, never by a matrix product
whose order of additions may depend on the place in the array: mirrored components stay mirrored to the last
bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853, RK45

from reference_impl.forces import System, motion, strain
from reference_impl.weave import Floats

TOLERANCES = {"RK45": (1e-3, 1e-6), "DOP853": (1e-10, 1e-12)}  # rtol, atol; for RK45 as in ode45
METHODS = (*TOLERANCES, "RK4")

Progress = Callable[[float, float], None]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the stored times, and what they cost."""

    t: Floats  # (nt,) [s]
    x: Floats  # (nt, n, 3) [m]
    v: Floats  # (nt, n, 3) [m/s]
    dissipated: Floats  # (nt,) [J]
    n_rhs: int
    n_steps: int
    n_rejected: int


class Diverged(ArithmeticError):  # noqa: N818
    """No finite step is left at `time` [s]; `element` was the most strained, `partial` is what was stored."""

    def __init__(self, time: float, element: int, strain: float, why: str, partial: Trajectory) -> None:
        super().__init__(
            f"{why} at t = {time:.9g} s; most strained element then: {element} (E11 = {strain:.3g})"
        )
        self.time, self.element, self.strain, self.partial = time, element, strain, partial


class Interrupted(KeyboardInterrupt):
    """Stopped from the keyboard; `partial` is what was stored."""

    def __init__(self, partial: Trajectory) -> None:
        super().__init__()
        self.partial = partial


class _Breakdown(Exception):  # noqa: N818
    """No step can be taken from the present state."""


@dataclass
class _Run:
    """State y = (x, v, W) flattened (6n + 1,) at time t, its cost so far, and the states stored so far."""

    system: System
    t: float
    y: Floats
    n_rhs: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    times: list[float] = field(default_factory=list)
    stored: list[Floats] = field(default_factory=list)

    def rate(self, t: float, y: Floats) -> Floats:
        """dy/dt, eqs. (15), (16), and the power taken by damping."""
        self.n_rhs += 1
        half = y.size // 2
        v = y[half:-1].reshape(-1, 3)
        acceleration, power = motion(self.system, t, y[:half].reshape(-1, 3), v)
        return np.concatenate((y[half:-1], acceleration.ravel(), (power,)))

    def store(self) -> None:
        self.times.append(self.t)
        self.stored.append(self.y.copy())

    def trajectory(self) -> Trajectory:
        y = np.array(self.stored).reshape(len(self.times), -1)
        half = y.shape[1] // 2
        shape = (len(y), half // 3, 3)
        return Trajectory(
            np.array(self.times),
            y[:, :half].reshape(shape),
            y[:, half:-1].reshape(shape),
            y[:, -1],
            self.n_rhs,
            self.n_steps,
            self.n_rejected,
        )

    def diverged(self, why: str) -> Diverged:
        e11 = strain(self.system, self.y[: self.y.size // 2].reshape(-1, 3))
        worst = int(np.argmax(e11)) if e11.size else -1
        return Diverged(self.t, worst, float(e11[worst]) if e11.size else 0.0, why, self.trajectory())


def march(
    system: System,
    x0: Floats,
    v0: Floats,
    times: Sequence[float] | Floats,
    method: str = "DOP853",
    rtol: float | None = None,
    atol: float | None = None,
    step: float | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """States at `times` [s] from x0, v0 (n, 3) at times[0].

    `rtol`, `atol` [m, m/s] are for RK45 and DOP853, `step` [s] for RK4.  `progress(t, end)` is called at each
    stored time.  Raises Diverged where no finite step is left, Interrupted on Ctrl-C; both carry what was
    stored.
    """
    times = np.asarray(times, dtype=float)
    _check(system, x0, v0, times, method, rtol, atol, step)
    run = _Run(system, float(times[0]), np.concatenate((np.ravel(x0), np.ravel(v0), (0.0,))))
    advance: Callable[[float], None]
    try:
        with np.errstate(all="ignore"):
            run.store()
            if method == "RK4":
                advance = _Classical(run, float(step or 0.0)).advance
            else:
                defaults = TOLERANCES[method]
                pair = _pair_rk45() if method == "RK45" else _pair_dop853()
                advance = _Adaptive(
                    run,
                    pair,
                    defaults[0] if rtol is None else rtol,
                    defaults[1] if atol is None else atol,
                    float(times[-1]),
                ).advance
            for time in times[1:].tolist():
                advance(time)
                run.store()
                if progress is not None:
                    progress(time, float(times[-1]))
    except _Breakdown as error:
        raise run.diverged(str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted(run.trajectory()) from None
    return run.trajectory()


def _check(
    system: System,
    x0: Floats,
    v0: Floats,
    times: Floats,
    method: str,
    rtol: float | None,
    atol: float | None,
    step: float | None,
) -> None:
    """Refuses arguments that cannot be meant."""
    shape = system.net.reference_position.shape
    if np.shape(x0) != shape or np.shape(v0) != shape:
        raise ValueError(f"x0 and v0 must have the shape {shape}")
    if not (np.all(np.isfinite(x0)) and np.all(np.isfinite(v0))):
        raise ValueError("x0 and v0 must be finite")
    if np.any(np.asarray(v0)[system.net.fixed_nodes]):
        raise ValueError("fixed nodes must start at rest")
    if times.ndim != 1 or not times.size or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0.0):
        raise ValueError("times must be finite and increase strictly")
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method}")
    if (method == "RK4") != (step is not None):
        raise ValueError("a step goes with RK4, and RK4 needs one")
    if method == "RK4" and (rtol is not None or atol is not None):
        raise ValueError("RK4 has no tolerances")
    for name, value in (("rtol", rtol), ("atol", atol), ("step", step)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} must be a finite number greater than 0")


def _combine(weights: Floats, rates: Floats) -> Floats:
    """Sum over s of weights (s,) times rates (s, N), row by row: the same operations in every column."""
    return np.asarray(np.add.reduce(weights[:, None] * rates, axis=0))


class _Classical:
    """Classical Runge-Kutta method of order 4, fixed step [s]; the last step before an output is shorter."""

    def __init__(self, run: _Run, step: float) -> None:
        self.run, self.step = run, step

    def advance(self, end: float) -> None:
        """Takes the run to t = end: whole steps counted from the last output, so that none drifts in time."""
        run, begin = self.run, self.run.t
        whole = math.ceil((end - begin) / self.step * (1.0 - 1e-12))
        for k in range(1, whole + 1):
            arrival = end if k == whole else begin + k * self.step
            h = arrival - run.t
            k1 = run.rate(run.t, run.y)
            k2 = run.rate(run.t + 0.5 * h, run.y + 0.5 * h * k1)
            k3 = run.rate(run.t + 0.5 * h, run.y + 0.5 * h * k2)
            k4 = run.rate(arrival, run.y + h * k3)
            y = run.y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
            if not np.all(np.isfinite(y)):
                raise _Breakdown(f"the state became infinite in a step of {h:.3g} s")
            run.t, run.y = arrival, y
            run.n_steps += 1


@dataclass(frozen=True, eq=False)
class _Pair:
    """An embedded Runge-Kutta pair: stages a (s, s), result b (s,), times c (s,), error weights (s + 1,)."""

    a: Floats
    b: Floats
    c: Floats
    error: Floats
    error_order: int


def _pair_rk45() -> _Pair:
    """Dormand and Prince 5(4), with SciPy's coefficients."""
    return _Pair(_floats(RK45.A), _floats(RK45.B), _floats(RK45.C), _floats(RK45.E), 4)


def _pair_dop853() -> _Pair:
    """Dormand and Prince 8(5), with SciPy's coefficients.

    Only the fifth-order estimate is used.  The customary blend with a third-order one presumes smooth motion:
    now and then it lets a step swallow an impact, and 1e-5 of the energy goes astray at rtol 1e-10.
    """
    return _Pair(_floats(DOP853.A), _floats(DOP853.B), _floats(DOP853.C), _floats(DOP853.E5), 5)


def _floats(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=float)


class _Adaptive:
    """Steps of an embedded pair with the step control of Hairer, Norsett, Wanner, Solving ODEs I, II.4."""

    def __init__(self, run: _Run, pair: _Pair, rtol: float, atol: float, end: float) -> None:
        self.run, self.pair, self.rtol, self.atol = run, pair, max(rtol, 100.0 * np.finfo(float).eps), atol
        self.rates = np.empty((len(pair.b) + 1, run.y.size))
        self.rates[-1] = run.rate(run.t, run.y)
        self.h = self._first_step(end - run.t)

    def _rms(self, values: Floats, scale: Floats) -> float:
        ratio = values[:-1] / scale
        return math.sqrt(float(ratio @ ratio) / ratio.size)

    def _first_step(self, span: float) -> float:
        """A first step [s] from the sizes of y' and y'' (HNW, II.4, starting step size)."""
        run, rate = self.run, self.rates[-1]
        scale = self.atol + self.rtol * np.abs(run.y[:-1])
        size, speed = self._rms(run.y, scale), self._rms(rate, scale)
        h = min(0.01 * size / speed if size > 1e-5 and speed > 1e-5 else 1e-6, span)
        change = self._rms(run.rate(run.t + h, run.y + h * rate) - rate, scale) / h
        greatest = max(speed, change)
        if not math.isfinite(greatest):
            raise _Breakdown("the initial acceleration is not finite")
        second = (
            (0.01 / greatest) ** (1.0 / (self.pair.error_order + 1))
            if greatest > 1e-15
            else max(1e-6, 1e-3 * h)
        )
        return float(min(100.0 * h, second, span)) or span

    def advance(self, end: float) -> None:
        """Takes the run to t = end exactly."""
        run = self.run
        while run.t < end:
            left = end - run.t
            last = self.h >= left
            shortened = left if last else 0.5 * left if 2.0 * self.h > left else self.h
            suggestion = self._step(shortened, end if last else run.t + shortened)
            # a step cut short by an output says little about how long the next may be
            self.h = max(self.h, suggestion) if shortened < self.h and suggestion >= shortened else suggestion

    def _step(self, h: float, arrival: float) -> float:
        """Takes one step of at most h, to `arrival` if h itself will do; returns the step to try next [s]."""
        run, pair, rates = self.run, self.pair, self.rates
        stages, exponent, most = len(pair.b), -1.0 / (pair.error_order + 1), 10.0
        rates[0] = rates[-1]
        while True:
            if not abs(h) > 10.0 * math.ulp(run.t):
                raise _Breakdown(f"the step collapsed to {h:.3g} s")
            for s in range(1, stages):
                rates[s] = run.rate(run.t + pair.c[s] * h, run.y + h * _combine(pair.a[s, :s], rates[:s]))
            y = run.y + h * _combine(pair.b, rates[:stages])
            rates[stages] = run.rate(arrival, y)
            error = h * self._error(y)
            if error < 1.0:
                break
            run.n_rejected += 1
            h *= max(0.2, 0.9 * error**exponent) if math.isfinite(error) else 0.2
            arrival, most = run.t + h, 1.0
        run.t, run.y = arrival, y
        run.n_steps += 1
        return h * (most if error == 0.0 else min(most, max(0.2, 0.9 * error**exponent)))

    def _error(self, y: Floats) -> float:
        """Estimated error in units of the tolerance, per second of step; W has no part in it."""
        scale = self.atol + self.rtol * np.maximum(np.abs(self.run.y[:-1]), np.abs(y[:-1]))
        return self._rms(_combine(self.pair.error, self.rates), scale)
