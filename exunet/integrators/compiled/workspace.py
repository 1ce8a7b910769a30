"""The arrays that compiled steps work on, as named tuples: compiled code reads their fields by name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.arrays import Floats, Ints
from exunet.forces.loops import Index
from exunet.forces.terms import Watch
from exunet.kernels.kernel import ForceTable
from exunet.model.system import State, System

# Steps at which conditions are looked at in one go; of a power of 2 all entries of a step would fall on the
# same few lines of the processor's cache.
_SAMPLES = 504


class Stages(NamedTuple):
    """Work space of one step, as rows of `Motion.work`; see `schemes.stages_of`.

    a1 ... a7   : (n_force,) accelerations of the stages, then rates of first-order states; a1 holds those at
                  the state, from the step before
    x1, v1      : the step's result
    v2, v3, v4  : (n_v,) velocities of stages
    of_x, of_v  : error estimates
    middle_x, middle_v, scratch : state in the middle of a step, and forces, for the work that is taken out
    All rows have n_x entries, which is the longest; the others use as many as they have.
    """

    a1: Floats
    x1: Floats
    v1: Floats
    a2: Floats
    a3: Floats
    a4: Floats
    a5: Floats
    a6: Floats
    a7: Floats
    v2: Floats
    v3: Floats
    v4: Floats
    of_x: Floats
    of_v: Floats
    middle_x: Floats
    middle_v: Floats
    scratch: Floats


class Motion(NamedTuple):
    """A state in flat arrays (see `exunet.forces.blocks`) and what moves it.

    x, v    : (n_x,), (n_v,)
    c       : (n_c,) view of x: places of points and centres, whose rates v has
    z       : (n_z,) view of x: what is of first order, attitudes and states of terms
    inverse : (n_force,) 1 / mass or inertia; zero for what is held still, 1 for first-order states
    inertia : (n_bodies, 3) principal moments [kg m2]
    external : (n_force,) external forces [N], and torques in body axes [N m]
    has_external : (1,) 1.0 where one of these forces is not zero
    data    : rows of the kernel's `ForceTable`
    takes   : a `Takes`: how the energy is known that the forces take out
    work    : (17, n_x) the rows of `Stages`
    z1      : (n_z,) view of the row x1: what is of first order at a stage, and at the step's end
    rates   : (7, n_z) its rates in the stages
    taken   : (1,) energy [J] that terms without a potential have taken out so far
    """

    x: Floats
    v: Floats
    c: Floats
    z: Floats
    inverse: Floats
    inertia: Floats
    external: Floats
    has_external: Floats
    data: Any
    takes: int
    work: Floats
    z1: Floats
    rates: Floats
    taken: Floats


# Where a step control stands: an array of one record, which compiled code reads and writes by name.
#
# time     : [s]
# step     : to try next [s]
# rejected : 1 after a rejected step, else 0
# tiny     : number of accepted steps in a row near the least length, at which no error is too large
# beyond   : step [s] to continue with beyond a jump of the forces that is approached, else 0
# towards  : 1 if the last attempt was on the way to it
# steps, rejections : accepted and rejected so far
CLOCK = np.dtype(
    [(name, "f8") for name in ("time", "step", "rejected", "tiny", "beyond", "towards")]
    + [(name, "i8") for name in ("steps", "rejections")]
)

# What was seen of all accepted steps, not only of those that are kept.
#
# elastic, kinetic : largest elastic and least kinetic energy [J] since they were last set back
# keep_above       : elastic energy [J] above which every step is kept for the guards
# look_above       : elastic energy [J] above which a tension may be the largest; below 0: it stays so
PEAKS = np.dtype([(name, "f8") for name in ("elastic", "kinetic", "keep_above", "look_above")])

# The largest tension of a group of elements [N], when [s], and in which element (-1: none pulled).
LARGEST = np.dtype([("tension", "f8"), ("time", "f8"), ("element", "i8")])


# The outlet of a reel, an element whose natural length follows from the length wound up.
#
# element     : its number
# wound, rate : where the length wound up stands in x, and its rate in accelerations
# base, least : reference length were nothing wound up, and that below which it is not taken [m]
# ratio       : natural over reference length
OUTLET = np.dtype(
    [(name, "i8") for name in ("element", "wound", "rate")]
    + [(name, "f8") for name in ("base", "least", "ratio")]
)


class StepLimits(NamedTuple):
    """The limits of a step control: tolerance [m, m/s], longest and least step [s]."""

    tolerance: float
    longest: float
    least: float


class ObservedSteps(NamedTuple):
    """Observations of steps: peaks, largest tensions, and the arrays that computing them takes.

    peaks            : one record `PEAKS`
    largest          : (n_groups,) a record `LARGEST` of each group of `Net.spans`
    bounds           : (n_groups + 1,) the first element of each group, and the number of elements
    half             : (n_v,) half the mass or inertia [kg], [kg m2]
    first, second    : (n_elements,) 3 i and 3 j of the nodes i, j at their ends
    length, stiffness, twice_time : (n_elements,) natural lengths [m], axial stiffnesses [N], 2 tau [s]
    jumps            : (n_elements,) 2 tau [s] of those whose jumps of the force are looked for; else 0
    of_elements      : (n_elements,) largest tension of each so far [N], of the steps that are looked at
    highest          : (n_elements,) L^2 [m2] of each then, up to which it has no larger tension; with viscous
                       stress the largest q^2 L^2 [m6] instead, q = L^2 - L0^2 + 2 tau d . dv
    taut             : (n_elements,) 0.0 of those with jumps that the forces at a step's end found slack
    outlets          : (n_reels,) records `OUTLET`
    winding          : (n_elements,) -d(ln L1)/dt [1/s] of outlets, else 0
    law, table       : (n_elements,) numbers of the elements' laws, and rows of their tables
    """

    peaks: NDArray[np.void]
    largest: NDArray[np.void]
    bounds: NDArray[Index]
    half: Floats
    first: NDArray[Index]
    second: NDArray[Index]
    length: Floats
    stiffness: Floats
    twice_time: Floats
    jumps: Floats
    of_elements: Floats
    highest: Floats
    taut: Floats
    outlets: NDArray[np.void]
    winding: Floats
    law: Ints
    table: Floats


class ObservedRuns(NamedTuple):
    """Observations of the steps of several runs, which are the last axis of x, v and look_above.

    peaks      : (runs,) a record `PEAKS` of each
    largest    : (runs, n_groups) records `LARGEST`
    elements   : the rest of `ObservedSteps`, without its own records; its `highest` is (runs, n_elements)
    x, v       : (n_x, runs), (n_v, runs) the states
    elastic    : (1, runs) elastic energies [J] of a step that is looked at
    look_above : (1, runs) as in the records; level: the same memory, as vectors in compiled code
    half       : as in `ObservedSteps`
    """

    peaks: NDArray[np.void]
    largest: NDArray[np.void]
    elements: ObservedSteps
    x: Floats
    v: Floats
    elastic: Floats
    look_above: Floats
    level: Floats
    half: Floats


class Kept(NamedTuple):
    """Rows of states: time (k,), x (k, n_x), v (k, n_v), taken (k,)."""

    time: Floats
    x: Floats
    v: Floats
    taken: Floats


class StoredRuns(NamedTuple):
    """Rows of states of several runs, each run's own beside each other, and where the runs stand.

    time         : (k,)
    x, v, taken  : (runs, k, n_x), (runs, k, n_v), (runs, k)
    now_x, now_v, now_taken : (n_x, runs), (n_v, runs), (1, runs) the states
    """

    time: Floats
    x: Floats
    v: Floats
    taken: Floats
    now_x: Floats
    now_v: Floats
    now_taken: Floats


class WatchedRows(NamedTuple):
    """Watched entries of x, v and discrete states, at every step and not only at those kept.

    at        : (2,) the next row, and the row at which a stretch of steps ends; 0: nothing is watched
    of_x, of_v, of_discrete : which entries
    discrete  : `ForceTable.changed`
    weights   : (n,) of the first points, whose mean place and velocity are watched; none: they are not
    time (k,), x (n_x, k), v (n_v, k) : the rows, of x and v as columns, since few of their entries are
                watched; others are left as they were
    reported  : (k, of_discrete.size)
    mean      : (k, 6) place [m] and velocity [m/s]
    """

    at: NDArray[np.int64]
    of_x: NDArray[np.int64]
    of_v: NDArray[np.int64]
    of_discrete: NDArray[np.int64]
    discrete: Floats
    weights: Floats
    time: Floats
    x: Floats
    v: Floats
    reported: Floats
    mean: Floats


class StepInterval(NamedTuple):
    """Data of a stretch of steps: state, a record `CLOCK`, observations, room for states, samples.

    looks : what is watched of every step
    """

    motion: Motion
    clock: NDArray[np.void]
    seen: ObservedSteps | ObservedRuns
    kept: Kept | StoredRuns
    looks: WatchedRows


class EqualSteps(NamedTuple):
    """Range of `number` equal steps from `start` to `until` [s]: those from `first` on, at most `limit`."""

    start: float
    until: float
    number: int
    first: int
    limit: int


def motion_of(system: System, state: State, table: ForceTable) -> Motion:
    """A system in a state; the accelerations are still to be computed."""
    x, v = (np.array(part) for part in system.layout.pack(state.moving))
    inverse = system.layout.inverse_mass(system, state.discrete)
    return motion_at(x, v, inverse, table, system.body_inertia.copy(), system.blocks.centres)


def motion_at(
    x: Floats, v: Floats, inverse: Floats, table: ForceTable, inertia: Floats, centres: int
) -> Motion:
    """A state x, v, of which it keeps the arrays, under no force from outside; centres: n_c."""
    work = np.zeros((len(Stages._fields), len(x)))
    first_order = slice(centres, len(x))
    return Motion(
        x,
        v,
        c=x[:centres],
        z=x[first_order],
        inverse=inverse,
        inertia=inertia,
        external=np.zeros(len(inverse)),
        has_external=np.zeros(1),
        data=table.rows,
        takes=int(table.takes),
        work=work,
        z1=work[Stages._fields.index("x1"), first_order],
        rates=np.zeros((7, len(x) - centres)),
        taken=np.zeros(1),
    )


def clock_at(time: float, first_step: float) -> NDArray[np.void]:
    """A clock at a time [s] with its first step [s]."""
    clock = np.zeros(1, dtype=CLOCK)
    clock["time"], clock["step"] = time, first_step
    return clock


def no_extremes(system: System) -> ObservedSteps:
    """Nothing seen; steps are not looked at (`keep_above`, `look_above` are infinite)."""
    law = system.forces.cable.law
    twice = np.zeros(system.net.n_elements) if law.relaxation_time is None else 2.0 * law.relaxation_time
    peaks = np.zeros(1, dtype=PEAKS)
    peaks["kinetic"] = peaks["keep_above"] = peaks["look_above"] = np.inf
    groups = system.net.spans.values()
    largest = np.zeros(len(groups), dtype=LARGEST)
    largest["element"] = -1
    bounds = np.array([0, *(group.stop for group in groups)], dtype=Index)
    half = system.layout.half_mass(system)
    first, second = (3 * ends for ends in system.net.element_nodes.T.astype(Index))
    lengths, stiffness = law.natural_length.copy(), law.stiffness.copy()
    each, highest = np.zeros(system.net.n_elements), np.where(twice > 0.0, 0.0, lengths**2)
    outlets, winding = np.zeros(0, dtype=OUTLET), np.zeros(system.net.n_elements)
    own = lengths, stiffness, twice, twice.copy(), each, highest, np.ones_like(lengths), outlets, winding
    number = np.zeros(system.net.n_elements, dtype=np.int64) if law.number is None else law.number
    return ObservedSteps(peaks, largest, bounds, half, first, second, *own, number.copy(), law.table.copy())


def largest_tensions_of(records: NDArray[np.void]) -> Floats:
    """Return the records `LARGEST` (n,) as numbers (n, 3)."""
    return np.array(records.tolist()).reshape(-1, 3)


def no_samples() -> WatchedRows:
    """Nothing is watched."""
    none, row = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    no, at = np.zeros(0), np.zeros(2, dtype=np.int64)
    return WatchedRows(at, none, none, none, no, no, no, row, row, row, row)


def samples_of(watch: Watch | None, system: System, table: ForceTable) -> WatchedRows:
    """Room for what is watched of steps."""
    if watch is None:
        return no_samples()
    of_discrete = [table.place_of(name, place) for name, place in watch.reports]
    rows = max(16, min(_SAMPLES, 2**21 // max(1, system.blocks.n_v)))
    time, x, v = np.zeros(rows), *(np.zeros((n, rows)) for n in (system.blocks.n_x, system.blocks.n_v))
    reported, mean = np.zeros((rows, len(of_discrete))), np.zeros((rows, 6))
    at, entries = np.zeros(2, dtype=np.int64), np.array(of_discrete, dtype=np.int64)
    entries_of = at, watch.of_x, watch.of_v, entries
    return WatchedRows(*entries_of, table.changed, watch.weights, time, x, v, reported, mean)


def empty_states(rows: int, system: System) -> Kept:
    """Room for states."""
    x, v = (np.zeros((rows, n)) for n in (system.blocks.n_x, system.blocks.n_v))
    return Kept(np.zeros(rows), x, v, np.zeros(rows))
