"""Several runs of one system at once, by equal steps in compiled code that works on vectors of runs.

The steps are those of a run alone, their text too, so each run has the bits that it has alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled import many_runs
from exunet.backends.compiled.work_space import (
    KeptOfRuns,
    Motion,
    Run,
    SeenOfRuns,
    Stages,
    clock_at,
    no_looks,
    seen_nothing,
    told_largest,
)
from exunet.backends.protocol import Largest
from exunet.codegen.compile import WIDTH
from exunet.codegen.kernel import Kernel
from exunet.forces.kernel_call import KernelCall
from exunet.methods.method import METHODS, Kind, Method
from exunet.methods.plan import Plan
from exunet.system.system import State, System

Floats = NDArray[np.float64]


def side_by_side_kernel(system: System, plan: Plan) -> Kernel | None:
    """What advances several runs at once; None where that cannot be.

    It needs equal steps of the compiled loop, points only, no memories or inputs, and forces that can act on
    many runs: the elastic elements, and constant matrices and loads. Needs Numba.
    """
    facts = METHODS[plan.method]
    if facts.kind == Kind.ADAPTIVE or not facts.compiled or plan.step is None:
        return None
    if system.bodies or system.blocks.states or system.memory:
        return None
    if not all(call.of_many for call in _calls(system)):
        return None
    return Kernel(system.forces, many_runs.LOOP, many_runs.STEPS, imports=many_runs.IMPORTS, lanes=True)


def _calls(system: System) -> list[KernelCall]:
    return [call for term in system.forces for call in term.calls]


class StatesOfRuns(NamedTuple):
    """States of several runs at times (k,) [s].

    position, velocity : (runs, k, n_points, 3) [m], [m/s]
    taken              : (runs, k) energy [J] that terms without a potential have taken out so far
    """

    time: Floats
    position: Floats
    velocity: Floats
    taken: Floats


class RunsSideBySide:
    """Up to WIDTH runs of one system at a time, by one plan; each thread has its own.

    kernel : what `side_by_side_kernel` gives for both, which several of these may share

    All groups of runs use the same room: to fetch other pages takes longer than what is done with the states.
    """

    def __init__(self, system: System, plan: Plan, kernel: Kernel) -> None:
        self._system, self._plan, self._kernel, self._module = system, plan, kernel, kernel.module
        self._verlet = plan.method == Method.VELOCITY_VERLET
        self._room = np.empty(0)

    def begin(self, states: Sequence[State]) -> None:
        """Go on with runs from these states, which have one time."""
        system = self._system
        self._runs = len(states)
        self._motion = _motion_of(system, states, self._kernel)
        self._clock = clock_at(states[0].time, 0.0)
        self._seen = _seen_nothing(system, self._motion)
        self._module.begin_runs(states[0].time, self._verlet, self._run_with(0))

    def _run_with(self, rows: int) -> Run:
        """With room for states at so many times."""
        x, v, taken = self._motion.x, self._motion.v, self._motion.taken
        shapes = (WIDTH, rows, len(x)), (WIDTH, rows, len(v))
        sizes = [math.prod(shape) for shape in shapes]
        if len(self._room) < sum(sizes):
            self._room = np.empty(sum(sizes))
        of_x, of_v = np.split(self._room[: sum(sizes)], sizes[:1])
        places, speeds = of_x.reshape(shapes[0]), of_v.reshape(shapes[1])
        kept = KeptOfRuns(np.zeros(rows), places, speeds, np.zeros((WIDTH, rows)), x, v, taken)
        return Run(self._motion, self._clock, self._seen, kept, no_looks())

    def through(self, times: Floats) -> StatesOfRuns:
        """From times[0], the states' time, through all times [s]; the next call overwrites them."""
        run = self._run_with(len(times))
        self._module.runs_through(self._verlet, np.array(times, dtype=float), self._plan.step, run)
        x, v, taken = (part[: self._runs] for part in (run.kept.x, run.kept.v, run.kept.taken))
        points = self._runs, len(times), -1, 3
        return StatesOfRuns(run.kept.time, x.reshape(points), v.reshape(points), taken)

    def largest_tensions(self, run: int) -> tuple[Largest, ...]:
        """Of each group of elements, of all steps so far."""
        return told_largest(self._seen.largest[run])

    @property
    def right_hand_sides(self) -> int:
        """Evaluations of the forces so far, of each run."""
        return 1 + METHODS[self._plan.method].compiled_stages * int(self._clock["steps"][0])


def _motion_of(system: System, states: Sequence[State], kernel: Kernel) -> Motion:
    """A `Motion` with the runs as the last axis of all that differs from run to run."""
    flat = [system.layout.pack(state.moving) for state in states]
    flat += flat[-1:] * (WIDTH - len(flat))  # runs that nobody looks at
    places, speeds = (np.stack(parts, axis=1) for parts in zip(*flat, strict=True))
    n = len(places)
    work = _aligned(len(Stages._fields), n, WIDTH)
    x, v = _aligned(n, WIDTH), _aligned(n, WIDTH)
    x[:], v[:] = places, speeds
    none = np.zeros((0, WIDTH))
    return Motion(
        x,
        v,
        c=x,
        z=none,
        inverse=system.layout.inverse_mass(system, states[0].memory),
        inertia=np.zeros((0, 3)),
        push=np.zeros(n),
        pushed=np.zeros(1),
        data=kernel.table().rows,
        takes=int(kernel.takes),
        work=work,
        z1=none,
        rates=np.zeros((7, 0, WIDTH)),
        taken=_aligned(1, WIDTH),
    )


def _seen_nothing(system: System, motion: Motion) -> SeenOfRuns:
    """Tensions are looked at from the first step on."""
    elements = seen_nothing(system)
    elements = elements._replace(longest=np.repeat(elements.longest[None], WIDTH, axis=0))
    peaks = np.repeat(elements.peaks, WIDTH)
    peaks["look_above"] = 0.0
    level, energy = _aligned(1, WIDTH), _aligned(1, WIDTH)
    largest = np.repeat(elements.largest[None], WIDTH, axis=0)
    return SeenOfRuns(peaks, largest, elements, motion.x, motion.v, energy, level, level, elements.half)


def _aligned(*shape: int) -> Floats:
    """Zeros whose vectors of runs begin with a line of the cache."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8)
    first = -room.ctypes.data % 64 // 8
    return room[first : first + size].reshape(shape)
