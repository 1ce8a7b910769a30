"""A run in progress: the state at hand, what it cost, what was stored; and how a run can end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from reference_impl.forces import System, motion, strain
from reference_impl.weave import Floats


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
    n_newton: int = 0  # linear systems solved by EM
    n_halvings: int = 0  # steps of EM that were done in two halves because Newton's method failed


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
    """State y = (x, v, W) flattened (6n + 1,) at time t, its cost so far, and the states stored so far."""

    system: System
    t: float
    y: Floats
    n_rhs: int = 0
    n_steps: int = 0
    n_rejected: int = 0
    n_newton: int = 0
    n_halvings: int = 0
    times: list[float] = field(default_factory=list)
    stored: list[Floats] = field(default_factory=list)

    @property
    def half(self) -> int:
        """Size 3n of positions, and of velocities, in y."""
        return self.y.size // 2

    def rate(self, t: float, y: Floats) -> Floats:
        """dy/dt, eqs. (15), (16), and the power taken by damping."""
        self.n_rhs += 1
        half = y.size // 2
        v = y[half:-1].reshape(-1, 3)
        acceleration, power = motion(self.system, t, y[:half].reshape(-1, 3), v)
        return np.concatenate((y[half:-1], acceleration.ravel(), (power,)))

    def arrive(self, t: float, y: Floats) -> None:
        """Ends a step at t in y, which must be finite."""
        if not np.all(np.isfinite(y)):
            raise Breakdown(f"the state became infinite in a step of {t - self.t:.3g} s")
        self.t, self.y = t, y
        self.n_steps += 1

    def store(self, t: float, y: Floats) -> None:
        self.times.append(t)
        self.stored.append(y.copy())

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
            self.n_newton,
            self.n_halvings,
        )

    def diverged(self, why: str) -> Diverged:
        e11 = strain(self.system, self.y[: self.half].reshape(-1, 3))
        worst = int(np.argmax(e11)) if e11.size else -1
        return Diverged(self.t, worst, float(e11[worst]) if e11.size else 0.0, why, self.trajectory())
