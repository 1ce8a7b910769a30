"""Several runs of one system at once, by fixed steps in compiled code on vectors of runs.

The text of these functions is copied into a kernel's module, beside that of the steps.

Steps and their text are those of a single run, so each run is bitwise equal to a single run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from exunet.base.arrays import Floats
from exunet.forces.terms import KernelCall
from exunet.integrators.compiled import steps
from exunet.integrators.compiled.steps import begin, observe_tensions, through_equal
from exunet.integrators.compiled.workspace import (
    Motion,
    ObservedRuns,
    ObservedSteps,
    Stages,
    StepInterval,
    StoredRuns,
    clock_at,
    largest_tensions_of,
    no_extremes,
    no_samples,
)
from exunet.kernels.compile import WIDTH, version_of
from exunet.kernels.kernel import Kernel
from exunet.methods.method import METHODS, Kind, Method, Plan
from exunet.model.states import States
from exunet.model.system import State, System

if TYPE_CHECKING:
    from exunet.kernels.lanes import lanes_of
    from exunet.kernels.pointers import borrowed


def see(t: float, elastic: Any, kinetic: Any, x: Any, v: Any, a: Any, seen: Any) -> None:
    """Look for the largest tension of each run that has enough elastic energy [J] for one.

    x, v, a and energies are vectors; `ObservedRuns` has their numbers one by one.
    """
    if elastic > seen.level[0]:
        lanes_of(seen.elastic)[0] = elastic
        for run in range(seen.peaks.size):
            if seen.elastic[0, run] > seen.look_above[0, run]:
                peaks = seen.peaks[run : run + 1]
                of_all = seen.elements
                of_run = ObservedSteps(
                    peaks,
                    seen.largest[run],
                    of_all.bounds,
                    of_all.half,
                    of_all.first,
                    of_all.second,
                    of_all.length,
                    of_all.stiffness,
                    of_all.twice_time,
                    of_all.jumps,
                    of_all.of_elements,
                    of_all.highest[run],
                    of_all.taut,
                    of_all.outlets,
                    of_all.winding,
                    of_all.law,
                    of_all.table,
                )
                observe_tensions(t, seen.x[:, run], seen.v[:, run], of_run)
                seen.look_above[0, run] = peaks[0]["look_above"]


def keep(row: int, t: float, m: Any, kept: Any) -> int:
    """Copy the states into a row of each run (`StoredRuns`); returns the next row."""
    kept.time[row] = t
    for run in range(kept.taken.shape[0]):
        kept.taken[run, row] = kept.now_taken[0, run]
        for c in range(m.x.size):
            kept.x[run, row, c] = kept.now_x[c, run]
        for c in range(m.v.size):
            kept.v[run, row, c] = kept.now_v[c, run]
    return row + 1


def look(t: float, m: Any, looks: Any) -> bool:
    """Nothing is watched."""
    return False


def in_lanes(run: Any) -> Any:
    """A `StepInterval` whose arrays have the runs as their last axis, as one of vectors."""
    m, clock, seen, kept, looks = borrowed(run)
    motion = Motion(
        lanes_of(m.x),
        lanes_of(m.v),
        lanes_of(m.c),
        lanes_of(m.z),
        m.inverse,
        m.inertia,
        m.external,
        m.has_external,
        m.data,
        m.takes,
        lanes_of(m.work),
        lanes_of(m.z1),
        lanes_of(m.rates),
        lanes_of(m.taken),
    )
    peaks, largest, elements, x, v, elastic, look_above, level, half = seen
    seen_in_lanes = ObservedRuns(peaks, largest, elements, x, v, elastic, look_above, lanes_of(level), half)
    return StepInterval(motion, clock, seen_in_lanes, kept, looks)


def begin_runs(t: float, verlet: bool, run: Any) -> None:
    """`begin` for all runs."""
    begin(t, verlet, in_lanes(run).motion)


def runs_through(verlet: bool, times: Any, step: float, run: Any) -> int:
    """`through_equal` for all runs."""
    return through_equal(verlet, times, step, in_lanes(run))


IMPORTS = (
    *steps.IMPORTS,
    "from exunet.integrators.compiled.workspace import Motion, StepInterval, ObservedSteps, ObservedRuns",
    f"from exunet.kernels.lanes import lanes_of  # {version_of('lanes')}",
)
_OTHERS = steps.see, steps.look
_STEPS = tuple(function for function in steps.STEPS if function not in _OTHERS)
STEPS = (*_STEPS, see, look, in_lanes, begin, keep, through_equal)
LOOP = (begin_runs, runs_through)


def side_by_side_kernel(system: System, plan: Plan) -> Kernel | None:
    """Build the kernel that advances several runs at once; None if that is not possible.

    It needs equal steps of the compiled loop, points only, no discrete states or inputs, and forces that can
    act on many runs: the elastic elements, and constant matrices and loads. Needs Numba.
    """
    facts = METHODS[plan.method]
    if facts.kind == Kind.ADAPTIVE or not facts.compiled or plan.step is None:
        return None
    if system.bodies or system.blocks.states or system.discrete:
        return None
    if not all(call.of_many for call in _calls(system)):
        return None
    return Kernel(system.forces, LOOP, STEPS, imports=IMPORTS, lanes=True)


def _calls(system: System) -> list[KernelCall]:
    return [call for term in system.forces for call in term.calls]


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

    def _run_with(self, rows: int) -> StepInterval:
        """With room for states at so many times."""
        x, v, taken = self._motion.x, self._motion.v, self._motion.taken
        shapes = (WIDTH, rows, len(x)), (WIDTH, rows, len(v))
        sizes = [math.prod(shape) for shape in shapes]
        if len(self._room) < sum(sizes):
            self._room = np.empty(sum(sizes))
        of_x, of_v = np.split(self._room[: sum(sizes)], sizes[:1])
        places, speeds = of_x.reshape(shapes[0]), of_v.reshape(shapes[1])
        kept = StoredRuns(np.zeros(rows), places, speeds, np.zeros((WIDTH, rows)), x, v, taken)
        return StepInterval(self._motion, self._clock, self._seen, kept, no_samples())

    def through(self, times: Floats) -> list[States]:
        """From times[0], the states' time, through all times [s]: states of each run.

        The next call overwrites them.
        """
        run = self._run_with(len(times))
        self._module.runs_through(self._verlet, np.array(times, dtype=float), self._plan.step, run)
        time, *parts = run.kept[:4]
        rows = zip(*(part[: self._runs] for part in parts), strict=True)
        return [States(self._system, time, x, v, self._system.discrete, taken) for x, v, taken in rows]

    def largest_tensions(self, run: int) -> Floats:
        """Return the largest tension of each group of elements, of all steps so far, see `Extremes`."""
        return largest_tensions_of(self._seen.largest[run])

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
        inverse=system.layout.inverse_mass(system, states[0].discrete),
        inertia=np.zeros((0, 3)),
        external=np.zeros(n),
        has_external=np.zeros(1),
        data=kernel.table().rows,
        takes=int(kernel.takes),
        work=work,
        z1=none,
        rates=np.zeros((7, 0, WIDTH)),
        taken=_aligned(1, WIDTH),
    )


def _seen_nothing(system: System, motion: Motion) -> ObservedRuns:
    """Tensions are looked at from the first step on."""
    elements = no_extremes(system)
    elements = elements._replace(highest=np.repeat(elements.highest[None], WIDTH, axis=0))
    peaks = np.repeat(elements.peaks, WIDTH)
    peaks["look_above"] = 0.0
    level, energy = _aligned(1, WIDTH), _aligned(1, WIDTH)
    largest = np.repeat(elements.largest[None], WIDTH, axis=0)
    return ObservedRuns(peaks, largest, elements, motion.x, motion.v, energy, level, level, elements.half)


def _aligned(*shape: int) -> Floats:
    """Zeros whose vectors of runs begin with a line of the cache."""
    size = int(np.prod(shape))
    room = np.zeros(size + 8)
    first = -room.ctypes.data % 64 // 8
    return room[first : first + size].reshape(shape)
