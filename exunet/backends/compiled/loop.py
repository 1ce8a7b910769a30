"""A net integrated by the compiled loop: in one go, or with the face of the engine's `Stepper`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.many_steps import LOOP, TINY_IN_A_ROW
from exunet.backends.exudyn.stepper import StepCounts, StepsCollapsed
from exunet.base.interrupt import postponed
from exunet.codegen.compile import require_numba
from exunet.codegen.kernel import Kernel, net_kernel, sever
from exunet.methods.method import METHODS, Kind, Method
from exunet.simulation.breaking import Breaks
from exunet.simulation.guards import STRETCH_BOUND
from exunet.simulation.preparation import Start

Floats = NDArray[np.float64]
Watcher = Callable[[Floats, Floats, Floats, Floats], None]

_ROWS = 256  # states that the guards look at in one go
_ATTEMPTS = 2000  # steps between two looks at the keyboard


def loop_kernel(start: Start) -> Kernel:
    """The net's forces and the loop around them; raises MissingExtra without Numba."""
    require_numba('engine.loop = "compiled"')
    return net_kernel(start.net, start.terms, LOOP)


class March:
    """The state of one net and how far it has got.

    start  : net, terms, initial state and plan; its method is one of `exunet.methods.method.COMPILED_METHODS`
    kernel : what `loop_kernel` gives for `start`, which several marches may share
    """

    def __init__(self, start: Start, kernel: Kernel) -> None:
        self._plan = start.plan
        self._chosen = METHODS[start.plan.method].kind == Kind.ADAPTIVE
        self._verlet = start.plan.method == Method.VELOCITY_VERLET
        self._kernel, self._module = kernel, kernel.module
        free = np.ones(start.net.n_nodes)
        free[start.net.fixed_nodes] = 0.0
        self._x, self._v = start.position.ravel().copy(), start.velocity.ravel().copy()
        self._taken, self._counts = np.zeros(1), np.zeros(2, dtype=np.int64)
        self._seen = np.array([0.0, np.inf, np.inf, np.inf, 0.0, 0.0, -1.0])
        law = start.terms.law(start.net)
        relaxation = np.zeros(start.net.n_elements) if law.relaxation_time is None else law.relaxation_time
        self._stiffness = law.stiffness.copy()
        self._clock = np.array([0.0, start.plan.first_step, 0.0, 0.0])
        self._state = (
            self._x,
            self._v,
            np.repeat(free / start.net.mass, 3),
            kernel.data,
            np.zeros((16, len(self._x))),
            self._taken,
            self._counts,
            (
                0.5 * np.repeat(start.net.mass, 3),
                self._seen,
                start.net.element_nodes,
                law.natural_length,
                self._stiffness,
                2.0 * relaxation,
            ),
        )
        self._module.accelerate(0.0, *self._state[:4], self._state[4][0])

    def through(self, times: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """From times[0] = 0 through all times [s] without a look at keyboard or guards.

        Returns time (k,), position and velocity (k, n_nodes, 3) and the energy taken out until then (k,);
        fewer rows than times if the steps collapsed (see `collapse`).
        """
        plan, kept = self._plan, _rows(len(times), len(self._x))
        at = np.array(times, dtype=float)
        last = (self._clock, *self._state, kept)
        if self._chosen:
            limits = (plan.tolerance, plan.longest_step, plan.least_step, TINY_IN_A_ROW)
            rows = self._module.through_chosen(at, *limits, *last)
        else:
            rows = self._module.through_equal(self._verlet, at, plan.step, *last)
        return _of_nodes(kept, rows)

    def collapse(self) -> str:
        """What to say when no step is small enough for the tolerance; "" if that is not so."""
        if self._clock[3] <= TINY_IN_A_ROW:
            return ""
        return (
            f"the steps collapsed to {self._clock[1]:.1g} s at t = {self.time:.6g} s: the tolerance "
            f"{self._plan.tolerance:.2g} cannot be met"
        )

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return float(self._clock[0])

    @property
    def counts(self) -> StepCounts:
        """Accepted and rejected steps so far."""
        return StepCounts(int(self._counts[0]), int(self._counts[1]))

    @property
    def right_hand_sides(self) -> int:
        """Evaluations of the forces so far."""
        stages = 6 if self._chosen else METHODS[self._plan.method].stages  # the last of 7 is the next first
        return 1 + stages * int(self._counts.sum())

    def state(self) -> tuple[Floats, Floats]:
        """Copies of position [m] and velocity [m/s], (n_nodes, 3) each."""
        return self._x.reshape(-1, 3).copy(), self._v.reshape(-1, 3).copy()


class Loop(March):
    """Advances a net to asked times and hands states, in batches, to a watcher.

    The watcher gets (time (k,), position (k, n, 3), velocity (k, n, 3), energy taken out until then (k,));
    batches overlap in one state. They come later than `advance` has gone there, but before the end of the run
    or StepsCollapsed, or when told to `hand_over`. `every` thins the states (1 = each step), but none is left
    out in which an element may be stretched beyond the law's sense. `begin` is the time of the start's state
    [s], `taken` the energy [J] taken out until then.
    """

    def __init__(
        self,
        start: Start,
        end: float,
        watcher: Watcher,
        every: int = 64,
        begin: float = 0.0,
        taken: float = 0.0,
    ) -> None:
        super().__init__(start, loop_kernel(start))
        self._clock[0], self._taken[0] = begin, taken
        self._seen[2:4] = least_energy_beyond(start), 0.0  # from now on, steps are looked at
        self._module.accelerate(begin, *self._state[:4], self._state[4][0])
        self._watcher = watcher
        self._every = every
        self._end = end
        n = len(self._x)
        self._breaks: Breaks | None = None
        self._limit = _ATTEMPTS
        self._kept = _rows(max(16, min(_ROWS, 2**19 // max(1, n))), n)
        self._row = self._module.keep(0, begin, self._x, self._v, self._taken, self._kept)

    @property
    def dissipated(self) -> float:
        """Energy [J] that terms without a potential have taken out so far."""
        return float(self._taken[0])

    @property
    def extremes(self) -> tuple[float, float]:
        """Largest elastic and least kinetic energy [J] of the steps of the last `advance`."""
        return float(self._seen[0]), float(self._seen[1])

    @property
    def largest_tension(self) -> tuple[float, float, int]:
        """Time [s], tension [N] and element (-1: none pulled) of the largest tension of all steps so far."""
        return float(self._seen[5]), float(self._seen[4]), int(self._seen[6])

    def watch_for(self, breaks: Breaks) -> None:
        """Look for elements that break at the end of each step from now on, so step by step."""
        self._breaks, self._limit, self._every = breaks, 1, 1

    def advance(self, until: float) -> None:
        """Integrate from the current time to `until` [s] exactly."""
        self._seen[:2] = 0.0, np.inf
        with postponed() as check_interrupt:
            advance = self._advance_chosen if self._chosen else self._advance_equal
            advance(until, check_interrupt)
        if until >= self._end or not np.isfinite(self._x).all():
            self.hand_over()

    def _advance_chosen(self, until: float, check_interrupt: Callable[[], None]) -> None:
        plan = self._plan
        limits = (plan.tolerance, plan.longest_step, plan.least_step, self._limit)
        while self._clock[0] < until:
            self._shorten(until)
            self._row = self._module.chosen_steps(
                self._clock, until, *limits, self._row, *self._state, self._every, self._kept
            )
            self._make_room()
            self._look_for_breaks()
            if words := self.collapse():
                self.hand_over()
                raise StepsCollapsed(words)
            check_interrupt()

    def _advance_equal(self, until: float, check_interrupt: Callable[[], None]) -> None:
        begin, before = self.time, int(self._counts[0])
        number = max(1, math.ceil((until - begin) / (self._plan.step or math.inf) * (1 - 1e-9)))
        done = 0
        while done < number:
            stretch: tuple[Any, ...] = (self._verlet, begin, until, number, done, self._limit)
            self._row = self._module.equal_steps(*stretch, self._row, *self._state, self._every, self._kept)
            done = int(self._counts[0]) - before
            self._clock[0] = until if done == number else begin + done * (until - begin) / number
            self._make_room()
            self._look_for_breaks()
            check_interrupt()

    def _shorten(self, until: float) -> None:
        """Make the step that comes end near the limit of what it would break."""
        if self._breaks is None:
            return
        step = min(self._clock[1], self._plan.longest_step or math.inf, until - self.time)
        shorter = self._breaks.step_within(step, 8.0 * (self._plan.least_step or 0.0), *self.state())
        if shorter < step:
            self._clock[1] = shorter

    def _look_for_breaks(self) -> None:
        if self._breaks is None:
            return
        position, _ = self.state()
        broken = self._breaks.found(position)
        if len(broken):
            self.hand_over()  # so that no batch has states from before and after
            self._taken[0] += self._breaks.book(self.time, position, broken)
            self._kept[3][0] = self._taken[0]
            sever(self._kernel, broken)
            self._stiffness[broken] = 0.0
            self._module.accelerate(self.time, *self._state[:4], self._state[4][0])

    def _make_room(self) -> None:
        if self._row == len(self._kept[0]):
            self.hand_over()

    def hand_over(self) -> None:
        """Let the watcher see the states it has not seen; the last one stays, to begin the next batch."""
        rows = self._row
        if rows > 1:
            batch = _of_nodes(tuple(kept[:rows].copy() for kept in self._kept), rows)
            for kept in self._kept:
                kept[0] = kept[rows - 1]
            self._row = 1
            self._watcher(*batch)


def least_energy_beyond(start: Start) -> float:
    """Elastic energy [J], eq. (19), without which no element of the net can be stretched by STRETCH_BOUND."""
    law = start.terms.law(start.net)
    strain = 0.5 * (STRETCH_BOUND**2 - 1.0)
    return 0.5 * strain**2 * float((law.stiffness * law.natural_length).min(initial=math.inf))


def _rows(rows: int, n: int) -> tuple[Floats, Floats, Floats, Floats]:
    return np.zeros(rows), np.zeros((rows, n)), np.zeros((rows, n)), np.zeros(rows)


def _of_nodes(kept: tuple[Floats, ...], rows: int) -> tuple[Floats, Floats, Floats, Floats]:
    time, x, v, taken = kept
    return time[:rows], x[:rows].reshape(rows, -1, 3), v[:rows].reshape(rows, -1, 3), taken[:rows]
