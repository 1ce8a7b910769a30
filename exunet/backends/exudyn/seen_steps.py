"""Looks at the engine's accepted steps in compiled code, with what the compiled loop looks with.

Energies, tensions, the work that is taken out and the memories that steps change come of each step; of the
states one in some is handed over. In Python, to read and look at each takes several times as long as a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.backends.compiled.many_steps import IMPORTS, STEPS, accept
from exunet.backends.compiled.schemes import accelerate, stages_of
from exunet.backends.compiled.seeing import see
from exunet.backends.compiled.sight import StepSight
from exunet.backends.compiled.work import book_push, work_of_step
from exunet.backends.compiled.work_space import Motion, SeenOfSteps, motion_of, seen_nothing
from exunet.backends.exudyn.applied_kernel import AppliedKernel
from exunet.backends.exudyn.coordinates import Coordinates
from exunet.backends.exudyn.model import Model
from exunet.backends.protocol import Arrays, Observer
from exunet.codegen.drivers import Place, take_state, was_asked, was_asked_there
from exunet.codegen.force_table import Takes
from exunet.codegen.kernel import Kernel
from exunet.forces.total import Forces
from exunet.system.system import State, System

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.codegen.borrowing import borrowed
    from exunet.codegen.sums import power, remember

Floats = NDArray[np.float64]


class Looking(NamedTuple):
    """What looking at steps works on.

    motion : the state at the start of a step; that at its end comes into the rows x1, v1
    watts  : (1,) power [W] that is taken out at the start
    place  : where the blocks stand in the engine's coordinates
    asked  : of the forces' own `Place`, which may be another
    """

    motion: Motion
    seen: SeenOfSteps
    watts: Floats
    place: Place
    asked: Floats


def look_from(t: float, q: Any, q_t: Any, y: Any, held: Any) -> None:
    """The step to come starts at t [s], from the engine's coordinates q, q_t, y; held : of a `Looking`."""
    m, seen, watts, place, _ = borrowed(held.value)
    s = stages_of(m.work)
    take_state(q, q_t, y, s.x1, s.v1, place)
    accelerate(t, s.x1, s.v1, m, s.a1)  # puts what follows from time and other entries into place
    accept(m, seen.half)
    keep_rates(m)
    if m.takes != Takes.NOTHING:
        watts[0] = power(t, m.x, m.v, m.data, s.scratch)


def look_at_step(begin: float, end: float, q: Any, q_t: Any, y: Any, held: Any) -> bool:
    """Look at an accepted step between two times [s], which ends with these coordinates; see `look_from`.

    Returns True if an element may be longer there than it is meant to be.
    """
    m, seen, watts, place, asked = borrowed(held.value)
    s = stages_of(m.work)
    integrated = m.takes != Takes.NOTHING
    if place.halfway and was_asked_there(end, q, place):
        elastic = place.told[0]
        take_asked(y, m, place)
        take_state(q, q_t, y, s.x1, s.v1, place)
        if m.takes == Takes.TOLD:
            m.taken[0] += (end - begin) * place.told[1]
            integrated = False
    elif was_asked(end, q, q_t, y, place):
        elastic = place.told[0]
        take_asked(y, m, place)
    else:
        take_state(q, q_t, y, s.x1, s.v1, place)
        elastic, _ = accelerate(end, s.x1, s.v1, m, s.a1)
    if integrated:
        watts[0] = work_of_step(begin, end - begin, watts[0], s.a1, m)
    keep_rates(m)
    if m.pushed[0] > 0.0:
        book_push(m)
    remember(end, s.x1, s.v1, m.data)
    asked[0] = np.nan  # with other memories, other forces
    kinetic = accept(m, seen.half)
    see(end, elastic, kinetic, m.x, m.v, seen)
    return elastic > seen.peaks[0]["keep_above"]


def keep_rates(m: Any) -> None:
    """The rates of first-order states with which the next step begins, for what its middle is."""
    a1 = stages_of(m.work).a1
    attitudes = 4 * m.inertia.shape[0]
    for k in range(attitudes, m.z.size):
        m.rates[0, k] = a1[m.v.size + k - attitudes]


def take_asked(y: Any, m: Any, place: Any) -> None:
    """The state of which the engine has asked for the forces last, and the rates then, into the stages."""
    s = stages_of(m.work)
    for c in range(m.x.size):
        s.x1[c] = place.x[c]
    for c in range(m.v.size):
        s.v1[c] = place.v[c]
    for k in range(y.size):
        s.x1[place.states + k] = y[k]
        s.a1[m.v.size + k] = place.force[m.v.size + k]


def seeing_kernel(forces: Forces, system: System) -> Kernel:
    """All forces of a scene, and what looks at steps with them."""
    bodies, first_order = bool(system.bodies), bool(system.blocks.states)
    looks = look_from, look_at_step
    helpers = *STEPS, keep_rates, take_asked
    return Kernel(forces, looks, helpers, bodies=bodies, first_order=first_order, imports=IMPORTS)


class SeenSteps:
    """What was seen of the accepted steps of a model whose forces are all those of one `seeing_kernel`.

    taken : (1,) energy [J] that terms without a potential have taken out so far
    sight : what is looked for, and what was found
    """

    def __init__(self, model: Model, system: System, state: State, observer: Observer) -> None:
        applied: AppliedKernel = model.applied
        self._applied, self._system = applied, system
        self._module = applied.kernel.module
        self._motion = motion_of(system, state, applied.table)
        s = stages_of(self._motion.work)  # with what has no coordinates
        s.x1[: len(self._motion.x)], s.v1[: len(self._motion.v)] = self._motion.x, self._motion.v
        self.taken = self._motion.taken
        seen, watts = seen_nothing(system), np.zeros(1)
        self.sight = StepSight(system, seen, observer)
        place = applied.place_of_all()
        self._looking = Looking(self._motion, seen, watts, place, applied.place.asked)
        self.remember(state.memory)

    def begin(self, time: float, now: Coordinates) -> None:
        """The step to come starts at a time [s], from coordinates."""
        self._module.look_from(time, *now, self._held)

    def step(self, begin: float, end: float, now: Coordinates) -> bool:
        """Look at an accepted step between two times [s]; True if its end must be handed over."""
        q, v, y = now
        return bool(self._module.look_at_step(begin, end, q, v, y, self._held))

    def remember(self, memory: Arrays, x: Floats | None = None) -> None:
        """Take all memories as they are now, which the forces know already; `begin` is to come.

        x : (n_x,) the state then; None: that of the step seen last
        """
        m = self._motion
        self._motion = m._replace(data=self._applied.table.rows)
        m.inverse[:] = self._system.layout.inverse_mass(self._system, memory)
        self.sight.remember(memory, m.x if x is None else x)
        self._looking = self._looking._replace(motion=self._motion)
        self._held = self._module.hold(self._looking)

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside, from now on."""
        self._motion.push[: force.size] = force.ravel()
        self._motion.pushed[0] = float(force.any())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For a snapshot, copies."""
        return {name: np.array(part) for name, part in ({"taken": self.taken} | self.sight.arrays()).items()}

    def restore(self, arrays: Arrays) -> None:
        """Go back to what `arrays` gave; the memories as they are then are told before."""
        self.taken[:] = arrays["taken"]
        self.sight.restore(arrays)
