"""A system integrated by the compiled loop in one go, without a look at keyboard, guards, events."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.many_steps import IMPORTS, LOOP, STEPS, TINY_IN_A_ROW
from exunet.backends.compiled.work_space import (
    Kept,
    Run,
    StepLimits,
    clock_at,
    empty_rows,
    motion_of,
    no_looks,
    seen_nothing,
    told_largest,
)
from exunet.backends.protocol import Arrays, Batch, Largest, StepCounts
from exunet.codegen.compile import require_numba
from exunet.codegen.kernel import Kernel
from exunet.methods.method import METHODS, Kind, Method
from exunet.methods.plan import Plan
from exunet.system.system import State, System

Floats = NDArray[np.float64]

WITHOUT_LIMIT = 2**62


def loop_kernel(system: System, *, compiled: bool = True) -> Kernel:
    """The system's forces and the loop around them; raises MissingExtra without Numba.

    compiled : False: in plain Python
    """
    require_numba('engine.backend = "compiled"')
    return Kernel(
        system.forces,
        LOOP,
        STEPS,
        bodies=bool(system.bodies),
        first_order=bool(system.blocks.states),
        imports=IMPORTS,
        compiled=compiled,
    )


class CompiledIntegration:
    """The state of one system and how far it has got.

    plan   : its method is one that the compiled loop has
    kernel : what `loop_kernel` gives for the system, which several integrations may share
    """

    def __init__(self, system: System, state: State, plan: Plan, kernel: Kernel) -> None:
        self._system, self._layout, self._plan = system, system.layout, plan
        self._chosen = METHODS[plan.method].kind == Kind.ADAPTIVE
        self._verlet = plan.method == Method.VELOCITY_VERLET
        self._kernel, self._module = kernel, kernel.module
        self._memory: Arrays = state.memory
        self._table = kernel.table(state.memory)
        self._motion = motion_of(system, state, self._table)
        self._clock = clock_at(state.time, plan.first_step)
        self._time, self._tiny, self._steps = (self._clock[name] for name in ("time", "tiny", "steps"))
        self._seen = seen_nothing(system)
        self._control = StepLimits(plan.tolerance or 0.0, plan.longest_step, plan.least_step)
        self._module.begin(state.time, self._verlet, self._motion)

    def look_at_tensions(self) -> None:
        """Look for the largest tensions in the steps to come, each of them."""
        self._seen.peaks["look_above"] = 0.0

    @property
    def largest_tensions(self) -> tuple[Largest, ...]:
        """Of each group of elements, of the steps looked at."""
        return told_largest(self._seen.largest)

    def through(self, times: Floats, most: int = WITHOUT_LIMIT) -> Batch:
        """From times[0], the state's time, through all times [s] without a look at keyboard, guards, events.

        most : attempts of steps whose size is chosen, about, from the state's first on
        The batch has fewer rows than times if the steps collapsed (see `collapse`), or were more.
        """
        kept, at = empty_rows(len(times), self._system), np.array(times, dtype=float)
        run = Run(self._motion, self._clock, self._seen, kept, no_looks())
        if self._chosen:
            rows = self._module.through_chosen(at, self._control, TINY_IN_A_ROW, np.int64(most), run)
        else:
            rows = self._module.through_equal(self._verlet, at, self._plan.step, run)
        return self._batch(kept, rows)

    def _batch(self, kept: Kept, rows: int) -> Batch:
        time, x, v, taken = (values[:rows] for values in kept)
        kinematics = self._system.kinematics
        return Batch(time, *self._layout.unpack(x, v).completed(kinematics, time, self._memory), taken)

    def collapse(self) -> str:
        """What to say when no step is small enough for the tolerance; "" if that is not so."""
        if self._tiny[0] <= TINY_IN_A_ROW:
            return ""
        step = self._clock["step"][0]
        return (
            f"the steps collapsed to {step:.1g} s at t = {self.time:.6g} s: the tolerance "
            f"{self._plan.tolerance:.2g} cannot be met"
        )

    @property
    def time(self) -> float:
        """Time reached [s]."""
        return float(self._time[0])

    @property
    def counts(self) -> StepCounts:
        """Steps and evaluations of the forces so far."""
        steps, rejected = int(self._clock["steps"][0]), int(self._clock["rejections"][0])
        stages = METHODS[self._plan.method].compiled_stages
        return StepCounts(steps, rejected, right_hand_sides=1 + stages * (steps + rejected))
