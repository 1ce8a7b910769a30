"""The arrays that compiled steps work on, as named tuples: compiled code reads their fields by name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.system.system import Layout, State, System

Floats = NDArray[np.float64]


class Stages(NamedTuple):
    """Work space of one step, as rows of `Motion.work`; see `schemes.stages_of`.

    a1 ... a7   : (n_v,) accelerations of the stages; a1 holds that at the state, from the step before
    x1, v1      : the step's result
    v2, v3, v4  : (n_v,) velocities of stages
    of_x, of_v  : error estimates
    middle_x, middle_v, scratch : state in the middle of a step, and forces, for the work that is taken out
    Rows of positions use their first n_x entries.
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
    """A state in flat arrays (see `exunet.system.system.Layout`) and what moves it.

    x, v, z : (n_x,), (n_v,), (n_z,)
    inverse : (n_v,) 1 / mass or inertia; zero for what is held still
    inertia : (n_bodies, 3) principal moments [kg m2]
    push    : (n_v,) forces [N], and torques in body axes [N m], from outside
    data    : the kernel's
    work    : (17, n_v) the rows of `Stages`
    z1      : (n_z,) attitudes at a stage, and at the step's end
    turns   : (7, n_z) rates of the attitudes in the stages
    taken   : (1,) energy [J] that terms without a potential have taken out so far
    """

    x: Floats
    v: Floats
    z: Floats
    inverse: Floats
    inertia: Floats
    push: Floats
    data: tuple[Any, ...]
    work: Floats
    z1: Floats
    turns: Floats
    taken: Floats


# Where a step control stands: an array of one record, which compiled code reads and writes by name.
#
# time     : [s]
# step     : to try next [s]
# rejected : 1 after a rejected step, else 0
# tiny     : number of steps in a row that were of the least length, at which no error is too large
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
# look_above       : elastic energy [J] above which a tension may be the largest
# tension, time, element : the largest tension [N], when [s], and in which element (-1: none pulled)
PEAKS = np.dtype(
    [(name, "f8") for name in ("elastic", "kinetic", "keep_above", "look_above", "tension", "time")]
    + [("element", "i8")]
)


class Control(NamedTuple):
    """The limits of a step control: tolerance [m, m/s], longest and least step [s]."""

    tolerance: float
    longest: float
    least: float


class Seen(NamedTuple):
    """What is seen of steps, and what that takes.

    peaks            : one record `PEAKS`
    half             : (n_v,) half the mass or inertia [kg], [kg m2]
    ends             : (n_elements, 2) nodes of the elements
    length, stiffness, twice_time : (n_elements,) natural lengths [m], axial stiffnesses [N], 2 tau [s]
    """

    peaks: NDArray[np.void]
    half: Floats
    ends: NDArray[np.int64]
    length: Floats
    stiffness: Floats
    twice_time: Floats


class Kept(NamedTuple):
    """Rows of states: time (k,), x (k, n_x), v (k, n_v), z (k, n_z), taken (k,)."""

    time: Floats
    x: Floats
    v: Floats
    z: Floats
    taken: Floats


class Run(NamedTuple):
    """What a stretch of steps works on: the state, a record `CLOCK`, what was seen, room for states."""

    motion: Motion
    clock: NDArray[np.void]
    seen: Seen
    kept: Kept


class EqualSteps(NamedTuple):
    """Of the `number` equal steps from `start` to `until` [s], those from `first` on, at most `limit`."""

    start: float
    until: float
    number: int
    first: int
    limit: int


def motion_of(system: System, state: State, data: tuple[Any, ...]) -> Motion:
    """A system in a state; the accelerations are still to be computed."""
    layout = Layout.of(system)
    x, v, z = layout.pack(state)
    _, n_v, n_z = layout.sizes
    return Motion(
        x,
        v,
        z,
        inverse=layout.inverse_mass(system),
        inertia=system.body_inertia.copy(),
        push=np.zeros(n_v),
        data=data,
        work=np.zeros((len(Stages._fields), n_v)),
        z1=np.zeros(n_z),
        turns=np.zeros((7, n_z)),
        taken=np.zeros(1),
    )


def clock_at(time: float, first_step: float) -> NDArray[np.void]:
    """A clock at a time [s] with its first step [s]."""
    clock = np.zeros(1, dtype=CLOCK)
    clock["time"], clock["step"] = time, first_step
    return clock


def seen_nothing(system: System) -> Seen:
    """Nothing seen; steps are not looked at (`keep_above`, `look_above` are infinite)."""
    law = system.forces.cable.law
    twice = np.zeros(system.net.n_elements) if law.relaxation_time is None else 2.0 * law.relaxation_time
    peaks = np.zeros(1, dtype=PEAKS)
    peaks["kinetic"] = peaks["keep_above"] = peaks["look_above"] = np.inf
    peaks["element"] = -1
    half = Layout.of(system).half_mass(system)
    ends = system.net.element_nodes.copy()
    return Seen(peaks, half, ends, law.natural_length.copy(), law.stiffness.copy(), twice)


def empty_rows(rows: int, system: System) -> Kept:
    """Room for states."""
    n_x, n_v, n_z = Layout.of(system).sizes
    x, v, z = (np.zeros((rows, n)) for n in (n_x, n_v, n_z))
    return Kept(np.zeros(rows), x, v, z, np.zeros(rows))
