"""Source text of a kernel's module: sums over the forces of a scene, and the functions that call them.

The text of the functions here is copied into the module of a kernel. How forces are summed does not depend
on which forces there are.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.forces.terms import Function
from exunet.kernels.compile import CALLED, INSIDE

if TYPE_CHECKING:  # the generated module holds these beside the functions below
    from exunet.kernels.pointers import (
        HeldTuple,
        borrowed,
        call_add,
        call_event,
        call_place,
        call_potential,
        call_power,
        call_remember,
        call_reporting,
        call_shorten,
        call_verlet_work,
        call_work,
        zero_of,
    )

    BODIES = True


def add_forces(t: float, x: Any, v: Any, rows: Any, force: Any) -> Any:
    """First place what has no equations of motion, then add to the forces that are given.

    Returns the elastic energy [J] and the power [W] that is taken out, of the calls that report them.
    """
    n = len(rows)
    for k in range(n):
        row = rows[n - 1 - k]
        if row["place"] != 0:
            call_place(row["place"], t, x, v, row["data"])
    held = zero_of(x)
    watts = zero_of(x)
    for k in range(n):
        row = rows[k]
        if row["elastic"] != 0:
            held += call_reporting(row["add"], t, x, v, row["data"], force)
        elif row["tells_power"] != 0:
            watts += call_reporting(row["add"], t, x, v, row["data"], force)
        else:
            call_add(row["add"], t, x, v, row["data"], force)
    return held, watts


def potential(x: Any, rows: Any) -> Any:
    """Potential energy [J] of the forces that have one."""
    total = zero_of(x)
    for k in range(len(rows)):
        row = rows[k]
        if row["potential"] != 0:
            total += call_potential(row["potential"], x, row["data"])
    return total


def power(t: float, x: Any, v: Any, rows: Any, scratch: Any) -> Any:
    """Power [W] that forces without a potential take out, but for those that report their work in a step."""
    total = zero_of(x)
    for k in range(len(rows)):
        row = rows[k]
        if row["power"] != 0:
            total += call_power(row["power"], t, x, v, row["data"])
        elif row["works"] != 0:
            for c in range(scratch.size):
                scratch[c] = 0.0
            call_add(row["add"], t, x, v, row["data"], scratch)
            for c in range(v.size):
                total -= scratch[c] * v[c]
    return total


def has_power(rows: Any) -> bool:
    """True if `power` is not zero always."""
    found = False
    for k in range(len(rows)):
        row = rows[k]
        found = found or row["power"] != 0 or row["works"] != 0
    return found


def extra_work(h: float, begin: Any, end: Any, rows: Any, verlet: bool) -> Any:
    """Work [J] taken out in a step of length h [s], of forces that report it, from the states at its ends.

    verlet : it was a step of velocity Verlet, at whose end forces were added last
    """
    total = zero_of(begin[0])
    for k in range(len(rows)):
        row = rows[k]
        if verlet and row["verlet_work"] != 0:
            total += call_verlet_work(row["verlet_work"], h, row["data"])
        elif row["work"] != 0:
            total += call_work(row["work"], h, begin[0], begin[1], end[0], end[1], row["data"])
    return total


def remember(t: float, x: Any, v: Any, rows: Any) -> None:
    """Let the forces remember the state at the end of an accepted step, with which they were asked last."""
    for k in range(len(rows)):
        row = rows[k]
        if row["remember"] != 0:
            call_remember(row["remember"], t, x, v, row["data"])


def is_due(t: float, x: Any, v: Any, rows: Any) -> bool:
    """True if an event function of the forces is not below zero at the end of an accepted step."""
    due = False
    for k in range(len(rows)):
        row = rows[k]
        if row["event"] != 0 and bool(call_event(row["event"], t, x, v, row["data"]) >= 0.0):
            due = True
    return due


def shortened(step: float, least: float, x: Any, v: Any, rows: Any) -> float:
    """A step [s] that ends near the next event of the forces, not above `step` nor below `least`."""
    for k in range(len(rows)):
        row = rows[k]
        if row["shorten"] != 0:
            step = call_shorten(row["shorten"], step, least, x, v, row["data"])
    return step


SUMS = (add_forces, potential, power, has_power, extra_work, remember, is_due, shortened)


def in_any_order(function: Function) -> Function:
    """Mark a function whose sums compiled code may make in any order: faster, with other last bits."""
    return function


def module_source(
    drivers: Iterable[Function] = (),
    helpers: Iterable[Function] = (),
    *,
    bodies: bool = False,
    first_order: bool = False,
    imports: Sequence[str] = (),
) -> str:
    """Text of the module with the sums over all forces, from `add_forces` to `remember`, and drivers.

    drivers are called from Python; their helpers, as all else, only in the module. bodies, first_order : the
    module integrates rigid bodies, or anything of first order (their attitudes too); else the compiler leaves
    that code out.
    """
    parts = [
        '"""Compiled by exunet for all scenes of a kind; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *imports,
        f"BODIES = {bodies}",
        f"FIRST_ORDER = {bodies or first_order}",
        *(_text(helper) for helper in (*SUMS, *helpers)),
        *(_text(driver, CALLED) for driver in drivers),
    ]
    return "\n\n\n".join(parts) + "\n"


def loops_source(called: Iterable[Function], inside: Iterable[Function]) -> str:
    """Text of a module of functions that Python calls, and of those that they call."""
    parts = [
        '"""Compiled by exunet; safe to delete."""',
        "from __future__ import annotations\n\nimport math\n\nimport numpy as np",
        *(_text(item) for item in inside),
        *(_text(entry, CALLED) for entry in called),
    ]
    return "\n\n\n".join(parts) + "\n"


@functools.cache
def _text(function: Function, decorator: str = INSIDE) -> str:
    text = inspect.getsource(function).rstrip()
    return text if text.startswith("@") else f"{decorator}\n{text}"


class EngineCoordinates(NamedTuple):
    """Where the blocks (see `exunet.forces.blocks`) stand in the engine's coordinates, and work space.

    where  : (2, n_free) of each free coordinate of the points, where it stands in the engine's, and in x
    body   : (n_bodies,) where the six coordinates of each rigid body begin, if a term acts on one
    centre : where in x, v and force the centres of rigid bodies begin
    spin   : where in x their attitudes begin, in v angular velocities, in force torques
    states : where in x the first-order states begin, and in v nothing more
    felt   : which of the first-order states a force may depend on
    asked  : (1 + n,) time [s] and coordinates q, q_t of the engine, and felt states, of which `force` has
             the forces; a time that is not a number: of none
    reported   : (2,) elastic energy [J] and power [W] then, of the forces that report them
    halfway : forces that were evaluated at a step's end, with the velocity of the half step, are those of the
             end; see `MethodFacts.asks_halfway`
    x, v   : of all blocks, fixed nodes and first-order states too
    external : external forces [N]
    force  : all forces, and the rates of first-order states
    reference : positions [m] of the free coordinates
    The last five are equally long; each has its numbers at the beginning.
    """

    where: NDArray[np.uint32]
    body: NDArray[np.uint32]
    centre: int
    spin: int
    states: int
    felt: NDArray[np.uint32]
    asked: NDArray[np.float64]
    reported: NDArray[np.float64]
    halfway: bool
    x: NDArray[np.float64]
    v: NDArray[np.float64]
    external: NDArray[np.float64]
    force: NDArray[np.float64]
    reference: NDArray[np.float64]


def hold(value: Any) -> Any:
    """A tuple of tuples and arrays for a function that is called often; see `HeldTuple`."""
    return HeldTuple(value)


def engine_forces(t: float, q: Any, q_t: Any, y: Any, held: Any, out: Any) -> None:
    """Forces on the engine's coordinates into out, from all of these, q, q_t, and the first-order states y.

    held : from `hold`, of the rows of a `ForceTable` and a `EngineCoordinates`
    out : (n_free + 6 n_bodies,) forces on the free coordinates of points [N], then on each body the force
          [N] and the torque in its axes [N m]
    """
    data, at = borrowed(held.value)
    force = at.force
    free = at.where[1]
    ask(t, q, q_t, y, data, at)
    for k in range(free.size):
        out[k] = force[free[k]]
    for b in range(at.body.size if BODIES else 0):
        for k in range(3):
            out[free.size + 6 * b + k] = force[at.centre + 3 * b + k]
            out[free.size + 6 * b + 3 + k] = force[at.spin + 3 * b + k]


def engine_rates(t: float, q: Any, q_t: Any, y: Any, held: Any) -> None:
    """As `engine_forces`, for the rates of the first-order states, which then stand in its field `force`."""
    data, at = borrowed(held.value)
    if not (at.halfway and is_current_position(t, q, at)):
        ask(t, q, q_t, y, data, at)


def engine_accepts(t: float, q: Any, q_t: Any, y: Any, held: Any) -> None:
    """Let the terms remember the accepted step that ends at t [s]; arguments as of `engine_forces`."""
    data, at = borrowed(held.value)
    force = at.force
    known = at.halfway and is_current_position(t, q, at)
    load_state(q, q_t, y, at.x, at.v, at)
    at.asked[0] = np.nan
    if not known:
        for k in range(force.size):
            force[k] = 0.0
        add_forces(t, at.x, at.v, data, force)  # what they would remember of this state
    remember(t, at.x, at.v, data)


def ask(t: float, q: Any, q_t: Any, y: Any, data: Any, at: Any) -> None:
    """Put state and forces into a `EngineCoordinates`, unless those there are of this time and state already.

    An engine asks for forces and for rates one after the other, often of the same state.
    """
    if is_current(t, q, q_t, y, at):
        return
    x = at.x
    v = at.v
    external = at.external
    force = at.force
    load_state(q, q_t, y, x, v, at)
    for k in range(force.size):
        force[k] = external[k]
    at.reported[0], at.reported[1] = add_forces(t, x, v, data, force)
    asked = at.asked
    asked[0] = t
    for k in range(q.size):
        asked[1 + k] = q[k]
        asked[1 + q.size + k] = q_t[k]
    for k in range(at.felt.size):
        asked[1 + 2 * q.size + k] = y[at.felt[k]]


def is_current(t: float, q: Any, q_t: Any, y: Any, at: Any) -> bool:
    """True if they are of this time and state."""
    asked = at.asked
    same = is_current_position(t, q, at)
    for k in range(q.size if same else 0):
        same = same and asked[1 + q.size + k] == q_t[k]
    for k in range(at.felt.size):
        same = same and asked[1 + 2 * q.size + k] == y[at.felt[k]]
    return same


def is_current_position(t: float, q: Any, at: Any) -> bool:
    """True if they are of this time and these places, whatever the velocities."""
    asked = at.asked
    same = bool(asked[0] == t)
    for k in range(q.size if same else 0):
        same = same and asked[1 + k] == q[k]
    return same


def load_state(q: Any, q_t: Any, y: Any, x: Any, v: Any, at: Any) -> None:
    """States from the engine's coordinates q, q_t, and those of first order, y, into x, v."""
    reference = at.reference
    column = at.where[0]
    free = at.where[1]
    for k in range(free.size):
        x[free[k]] = reference[k] + q[column[k]]
        v[free[k]] = q_t[column[k]]
    if BODIES:
        load_bodies(q, q_t, x, v, at)
    for k in range(y.size):
        x[at.states + k] = y[k]


def load_bodies(q: Any, q_t: Any, x: Any, v: Any, place: Any) -> None:
    """States of the bodies from the engine's coordinates q, q_t into x, v."""
    for b in range(place.body.size):
        first = place.body[b]
        for k in range(3):
            x[place.centre + 3 * b + k] = q[first + k]
            v[place.centre + 3 * b + k] = q_t[first + k]
            v[place.spin + 3 * b + k] = q_t[first + 3 + k]
        quaternion(q, first + 3, x, place.spin + 4 * b)


def quaternion(q: Any, first: int, x: Any, place: int) -> None:
    """The unit quaternion of the rotation vector that begins at q[first], into x from `place` on."""
    half = 0.5 * math.sqrt(q[first] ** 2 + q[first + 1] ** 2 + q[first + 2] ** 2)
    # sin(a) / a = 1 - a^2 / 6 to the last bit below 1e-4
    ratio = 0.5 * math.sin(half) / half if half > 1e-4 else 0.5 - half * half / 12.0
    x[place] = math.cos(half)
    for k in range(3):
        x[place + 1 + k] = ratio * q[first + k]


def forces(t: float, x: Any, v: Any, data: Any, force: Any) -> Any:
    """`add_forces`, for Python."""
    return add_forces(t, borrowed(x), borrowed(v), borrowed(data), borrowed(force))


def potentials(positions: Any, data: Any, out: Any) -> None:
    """Potential energy of each row of states x (k, n_x) into out (k,)."""
    own = borrowed(data)
    x = borrowed(positions)
    for row in range(out.size):
        out[row] = potential(x[row], own)


def powers(times: Any, positions: Any, velocities: Any, data: Any, scratch: Any, out: Any) -> None:
    """Power taken out in each row of states x (k, n_x), v (k, n_v) into out (k,); scratch : (n_force,)."""
    own = borrowed(data)
    x = borrowed(positions)
    v = borrowed(velocities)
    forces = borrowed(scratch)
    for row in range(out.size):
        out[row] = power(times[row], x[row], v[row], own, forces)


def works(steps: Any, begin: Any, end: Any, data: Any, out: Any) -> None:
    """Work taken out in steps (k,) [s], of the forces that report it, into out (k,).

    begin, end : states there, each a pair of x (k, n_x) and v (k, n_v)
    """
    own = borrowed(data)
    x0, v0 = borrowed(begin)
    x1, v1 = borrowed(end)
    for row in range(out.size):
        out[row] = extra_work(steps[row], (x0[row], v0[row]), (x1[row], v1[row]), own, False)


HELPERS = (quaternion, load_bodies, load_state, is_current_position, is_current, ask)
DRIVERS = (hold, engine_forces, engine_rates, engine_accepts, forces, potentials, powers, works)
