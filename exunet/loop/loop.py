"""A net integrated by the compiled loop, with the face of `exunet.engine.stepper.Stepper`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.build import Start
from exunet.engine.stepper import Counts, EngineFailed
from exunet.kernel.compile import require_numba
from exunet.kernel.net import net_kernel
from exunet.loop.march import LOOP
from exunet.solvers import METHODS

Floats = NDArray[np.float64]
Watcher = Callable[[Floats, Floats, Floats, Floats], None]

_ROWS = 256  # states that the guards look at in one go
_ATTEMPTS = 2000  # steps between two looks at the keyboard
_TINY = 200.0  # accepted steps of the least size, one after the other


class Loop:
    """Advances a net to asked times and hands states, in batches, to a watcher.

    The watcher gets (time (k,), position (k, n, 3), velocity (k, n, 3), energy taken out until then (k,));
    batches overlap in one state. `every` thins the states (1 = each step). Raises MissingExtra without Numba.
    """

    def __init__(self, start: Start, end: float, watcher: Watcher, every: int = 64) -> None:
        require_numba('engine.loop = "compiled"')
        self._plan = start.plan
        self._adaptive = METHODS[start.plan.method].kind == "adaptive"
        self._watcher = watcher
        self._every = every
        self._end = end
        self._kernel = net_kernel(start.net, start.terms, LOOP)
        self._march = self._kernel.module
        free = np.ones(start.net.n_nodes)
        free[start.net.fixed_nodes] = 0.0
        self._inverse = np.repeat(free / start.net.mass, 3)
        self._x, self._v = start.position.ravel().copy(), start.velocity.ravel().copy()
        n = len(self._x)
        self._work = np.zeros((16, n))
        self._taken, self._counts = np.zeros(1), np.zeros(2, dtype=np.int64)
        rows = max(16, min(_ROWS, 2**19 // max(1, n)))
        self._kept = (np.zeros(rows), np.zeros((rows, n)), np.zeros((rows, n)), np.zeros(rows))
        self._clock = np.array([0.0, start.plan.first_step, 0.0, 0.0])
        self._march.accelerate(0.0, self._x, self._v, self._inverse, self._kernel.data, self._work[0])
        self._rows = self._march.keep(0, 0.0, self._x, self._v, self._taken, self._kept)

    def advance(self, until: float) -> None:
        """Integrate from the current time to `until` [s] exactly."""
        common = (
            self._x,
            self._v,
            self._inverse,
            self._kernel.data,
            self._work,
            self._taken,
            self._counts,
            self._every,
            self._kept,
        )
        try:
            if self._adaptive:
                self._advance_chosen(until, common)
            else:
                self._advance_equal(until, common)
        except KeyboardInterrupt:
            self._flush()
            raise
        if until >= self._end or not np.isfinite(self._x).all():
            self._flush()

    def _advance_chosen(self, until: float, common: tuple[Any, ...]) -> None:
        plan = self._plan
        while self._clock[0] < until:
            self._rows = self._march.chosen_steps(
                self._clock,
                until,
                plan.tolerance,
                plan.longest_step,
                plan.least_step,
                _ATTEMPTS,
                self._rows,
                *common,
            )
            self._make_room()
            if self._clock[3] > _TINY:
                self._flush()
                raise EngineFailed(
                    f"the steps collapsed to {self._clock[1]:.1g} s at t = {self.time:.6g} s: the tolerance "
                    f"{plan.tolerance:.2g} cannot be met; give a larger solver.accuracy (or solver.tolerance)"
                )

    def _advance_equal(self, until: float, common: tuple[Any, ...]) -> None:
        begin = self.time
        number = max(1, math.ceil((until - begin) / (self._plan.step or math.inf) * (1 - 1e-12)))
        done = 0
        before = int(self._counts[0])
        while done < number:
            self._rows = self._march.equal_steps(
                self._plan.method == "VelocityVerlet",
                begin,
                until,
                number,
                done,
                _ATTEMPTS,
                self._rows,
                *common,
            )
            done = int(self._counts[0]) - before
            self._clock[0] = until if done == number else begin + done * (until - begin) / number
            self._make_room()

    def _make_room(self) -> None:
        if self._rows == len(self._kept[0]):
            self._flush()

    def _flush(self) -> None:
        """Hand the kept states over; the last one stays as the first of the next batch."""
        rows = self._rows
        if rows > 1:
            time, x, v, taken = (kept[:rows].copy() for kept in self._kept)
            for kept in self._kept:
                kept[0] = kept[rows - 1]
            self._rows = 1
            self._watcher(time, x.reshape(rows, -1, 3), v.reshape(rows, -1, 3), taken)

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return float(self._clock[0])

    @property
    def dissipated(self) -> float:
        """Energy [J] that terms without a potential have taken out so far."""
        return float(self._taken[0])

    @property
    def counts(self) -> Counts:
        """Accepted and rejected steps so far."""
        return Counts(int(self._counts[0]), int(self._counts[1]))

    @property
    def right_hand_sides(self) -> int:
        """Evaluations of the forces so far."""
        if self._adaptive:
            return 1 + 6 * int(self._counts.sum())
        return 1 + METHODS[self._plan.method].stages * int(self._counts[0])

    def state(self) -> tuple[Floats, Floats]:
        """Copies of position [m] and velocity [m/s], (n_nodes, 3) each."""
        return self._x.reshape(-1, 3).copy(), self._v.reshape(-1, 3).copy()
