"""The arrays that compiled steps work on, as named tuples: compiled code reads their fields by name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.system.system import Layout, State, System

Floats = NDArray[np.float64]


class Stages(NamedTuple):
    """Work space of one step. a1 holds the acceleration at the state, from the step before.

    a1 ... a7   : (n_v,) accelerations of the stages
    x1, v1, z1  : the step's result
    v2, v3, v4  : (n_v,) velocities of stages
    of_x, of_v  : error estimates
    turns       : (7, n_z) rates of the attitudes in the stages
    middle_x, middle_v, scratch : state in the middle of a step, and forces, for the work that is taken out
    """

    a1: Floats
    a2: Floats
    a3: Floats
    a4: Floats
    a5: Floats
    a6: Floats
    a7: Floats
    x1: Floats
    v1: Floats
    z1: Floats
    v2: Floats
    v3: Floats
    v4: Floats
    of_x: Floats
    of_v: Floats
    turns: Floats
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
    stages  : work space
    taken   : (1,) energy [J] that terms without a potential have taken out so far
    """

    x: Floats
    v: Floats
    z: Floats
    inverse: Floats
    inertia: Floats
    push: Floats
    data: tuple[Any, ...]
    stages: Stages
    taken: Floats


class Clock(NamedTuple):
    """Where a step control stands; each (1,).

    time     : [s]
    step     : to try next [s]
    rejected : 1 after a rejected step, else 0
    tiny     : number of steps in a row that were of the least length, at which no error is too large
    beyond   : step [s] to go on with beyond a jump of the forces that is approached, else 0
    towards  : 1 if the last attempt was on the way to it
    steps, rejections : accepted and rejected so far
    """

    time: Floats
    step: Floats
    rejected: Floats
    tiny: Floats
    beyond: Floats
    towards: Floats
    steps: NDArray[np.int64]
    rejections: NDArray[np.int64]


class Control(NamedTuple):
    """The limits of a step control: tolerance [m, m/s], longest and least step [s]."""

    tolerance: float
    longest: float
    least: float


class Seen(NamedTuple):
    """What was seen of all accepted steps, not only of those that are kept; the first seven are (1,).

    elastic, kinetic : largest elastic and least kinetic energy [J] since they were last set back
    keep_above       : elastic energy [J] above which every step is kept for the guards
    look_above       : elastic energy [J] above which a tension may be the largest
    tension, time, element : the largest tension [N], when [s], and in which element (-1: none pulled)
    half             : (n_v,) half the mass or inertia [kg], [kg m2]
    ends             : (n_elements, 2) nodes of the elements
    length, stiffness, twice_time : (n_elements,) natural lengths [m], axial stiffnesses [N], 2 tau [s]
    """

    elastic: Floats
    kinetic: Floats
    keep_above: Floats
    look_above: Floats
    tension: Floats
    time: Floats
    element: Floats
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


def motion_of(system: System, state: State, data: tuple[Any, ...]) -> Motion:
    """A system in a state; the accelerations are still to be computed."""
    layout = Layout.of(system)
    x, v, z = layout.pack(state)
    n_x, n_v, n_z = layout.sizes
    of_v = {name: np.zeros(n_v) for name in Stages._fields}
    stages = Stages(
        **of_v | {"x1": np.zeros(n_x), "of_x": np.zeros(n_x), "middle_x": np.zeros(n_x)}
        | {"z1": np.zeros(n_z), "turns": np.zeros((7, n_z))}
    )  # fmt: skip
    inverse, inertia = layout.inverse_mass(system), system.body_inertia.copy()
    return Motion(x, v, z, inverse, inertia, np.zeros(n_v), data, stages, np.zeros(1))


def clock_at(time: float, first_step: float) -> Clock:
    """A clock at a time [s] with its first step [s]."""
    none = np.zeros(1, dtype=np.int64)
    zero = np.zeros(1)
    return Clock(
        np.array([time]),
        np.array([first_step]),
        *(zero, zero.copy(), zero.copy(), zero.copy()),
        steps=none,
        rejections=none.copy(),
    )


def seen_nothing(system: System) -> Seen:
    """Nothing seen; steps are not looked at (`keep_above`, `look_above` are infinite)."""
    law = system.forces.cable.law
    twice = np.zeros(system.net.n_elements) if law.relaxation_time is None else 2.0 * law.relaxation_time
    first = (0.0, np.inf, np.inf, np.inf, 0.0, 0.0, -1.0)
    half = Layout.of(system).half_mass(system)
    lengths, stiffness = law.natural_length.copy(), law.stiffness.copy()
    held = [np.array([value]) for value in first]
    return Seen(*held, half, system.net.element_nodes.copy(), lengths, stiffness, twice)  # type: ignore[call-arg]


def empty_rows(rows: int, system: System) -> Kept:
    """Room for states."""
    n_x, n_v, n_z = Layout.of(system).sizes
    x, v, z = (np.zeros((rows, n)) for n in (n_x, n_v, n_z))
    return Kept(np.zeros(rows), x, v, z, np.zeros(rows))
