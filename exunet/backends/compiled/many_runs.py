"""The steps of `many_steps` on vectors of runs (`exunet.codegen.lanes`): the same text, another type.

The text of these functions is copied into a kernel's module, beside that of the steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from exunet.backends.compiled import many_steps, seeing
from exunet.backends.compiled.many_steps import begin, through_equal
from exunet.backends.compiled.seeing import see_tensions
from exunet.backends.compiled.work_space import Motion, Run, SeenOfRuns, SeenOfSteps
from exunet.codegen.compile import version_of

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.codegen.borrowing import borrowed
    from exunet.codegen.lanes import lanes_of


def see(t: float, elastic: Any, kinetic: Any, x: Any, v: Any, seen: Any) -> None:
    """Look for the largest tension of each run that has enough elastic energy [J] for one.

    x, v and energies are vectors; `SeenOfRuns` has their numbers one by one.
    """
    if elastic > seen.level[0]:
        lanes_of(seen.elastic)[0] = elastic
        for run in range(seen.peaks.size):
            if seen.elastic[0, run] > seen.look_above[0, run]:
                peaks = seen.peaks[run : run + 1]
                of_all = seen.elements
                of_run = SeenOfSteps(
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
                    of_all.longest[run],
                )
                see_tensions(t, seen.x[:, run], seen.v[:, run], of_run)
                seen.look_above[0, run] = peaks[0]["look_above"]


def keep(row: int, t: float, m: Any, kept: Any) -> int:
    """Copy the states into a row of each run (`KeptOfRuns`); returns the next row."""
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
    """A `Run` whose arrays have the runs as their last axis, as one of vectors."""
    m, clock, seen, kept, looks = borrowed(run)
    motion = Motion(
        lanes_of(m.x),
        lanes_of(m.v),
        lanes_of(m.c),
        lanes_of(m.z),
        m.inverse,
        m.inertia,
        m.push,
        m.pushed,
        m.data,
        m.takes,
        lanes_of(m.work),
        lanes_of(m.z1),
        lanes_of(m.rates),
        lanes_of(m.taken),
    )
    peaks, largest, elements, x, v, elastic, look_above, level, half = seen
    seen_in_lanes = SeenOfRuns(peaks, largest, elements, x, v, elastic, look_above, lanes_of(level), half)
    return Run(motion, clock, seen_in_lanes, kept, looks)


def begin_runs(t: float, verlet: bool, run: Any) -> None:
    """`begin` for all runs."""
    begin(t, verlet, in_lanes(run).motion)


def runs_through(verlet: bool, times: Any, step: float, run: Any) -> int:
    """`through_equal` for all runs."""
    return through_equal(verlet, times, step, in_lanes(run))


IMPORTS = (
    *many_steps.IMPORTS,
    "from exunet.backends.compiled.work_space import Motion, Run, SeenOfSteps, SeenOfRuns",
    f"from exunet.codegen.lanes import lanes_of  # {version_of('lanes')}",
)
_OTHERS = seeing.see, seeing.look
_STEPS = tuple(function for function in many_steps.STEPS if function not in _OTHERS)
STEPS = (*_STEPS, see, look, in_lanes, begin, keep, through_equal)
LOOP = (begin_runs, runs_through)
